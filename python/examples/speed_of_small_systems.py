"""Times gradients of a small system in JAX: a quadcopter in a plane, by physgrad and by hand.

    python speed_of_small_systems.py            # a minute
    python speed_of_small_systems.py --quick    # few repetitions, one size

One time is that of the mean cost of 100 steps and its gradient by given controls, in float32, on one core, divided
by the number of steps. A step of Euler evaluates the rates once, one of Runge-Kutta four times, so their
difference is the time of three evaluations, and the rest is what a step costs besides. All sides alternate.
"""

import argparse
import os
import time

# Before JAX starts its threads.
if hasattr(os, "sched_setaffinity"):  # Linux
    os.sched_setaffinity(0, {min(os.sched_getaffinity(0))})

import jax
import jax.numpy as jnp
import numpy as np
import physgrad as pg

parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
parser.add_argument("--quick", action="store_true", help="few repetitions, one size")
options = parser.parse_args()
STEPS = 10 if options.quick else 100
REPEATS, BATCHES = (3, [8]) if options.quick else (15, [1, 8, 64, 256, 1024])
DT, GRAVITY = 0.02, 9.81


def rates(lib, x, u):
    """Rates of position, angle and their velocities, for thrusts about those of hovering."""
    angle, thrust = x[2], u[0] + u[1] + GRAVITY
    return [x[3], x[4], x[5], -thrust * lib.sin(angle), thrust * lib.cos(angle) - GRAVITY, 5.0 * (u[0] - u[1])]


def cost(x, u):
    return x[0] ** 2 + x[1] ** 2 + 0.01 * (u[0] ** 2 + u[1] ** 2)


def parts(array):
    return [array[..., i] for i in range(array.shape[-1])]


def by_hand(method, x, u):
    """The next state, (batch, 6)."""
    rate = lambda x: jnp.stack(rates(jnp, parts(x), parts(u)), -1)  # noqa: E731
    a = rate(x)
    if method == "euler":
        return x + DT * a
    b = rate(x + DT / 2 * a)
    c = rate(x + DT / 2 * b)
    return x + DT / 6 * (a + 2 * b + 2 * c + rate(x + DT * c))


def losses(method):
    """The task, and losses of controls (batch, steps, 2) by name."""
    task = pg.system(
        lambda x, u, p: rates(np, x, u),
        states=["x", "z", "angle", "vx", "vz", "spin"],
        controls=["left", "right"],
        start={"x": pg.uniform(-1, 1), "z": pg.uniform(-1, 1)},
        running_cost=lambda x, u, next: cost(next, u),
        dt=DT,
        horizon=STEPS,
        method=method,
    )
    transition, rollout = pg.jax.transition(task), pg.jax.rollout(task)

    def hand(u, x):
        def body(x, u):
            x = by_hand(method, x, u)
            return x, cost(parts(x), parts(u))

        return jax.lax.scan(body, x, jnp.swapaxes(u, 0, 1))[1].sum(0).mean()

    def steps(u, x):
        def body(x, at):
            x, _, value = transition(x, at[0], t=at[1])
            return x, value

        return jax.lax.scan(body, x, (jnp.swapaxes(u, 0, 1), jnp.arange(STEPS)))[1].sum(0).mean()

    def whole(u, x):
        return cost(parts(rollout(u, x)[:, 1:]), parts(u)).sum(1).mean()

    return task, {"by hand": hand, "transition": steps, "rollout": whole}


def measure(calls, batch):
    """Microseconds for each step, (repetitions, calls)."""
    count, times = max(1, 100 // batch), np.empty((REPEATS, len(calls)))
    for row in times:
        for i, call in enumerate(calls.values()):
            begin = time.perf_counter()
            for _ in range(count):
                jax.block_until_ready(call())
            row[i] = 1e6 * (time.perf_counter() - begin) / count / STEPS
    return times


print(f"{'method':8}{'samples':>8}  {'physics':12}{'µs per step':>12}  ratio to the formulas by hand")
for method in ("euler", "rk4"):
    task, functions = losses(method)
    for batch in BATCHES:
        x = jnp.asarray(task.starts(batch, dtype="float32"))
        u = jnp.asarray(0.1 * np.random.default_rng(0).standard_normal((batch, STEPS, 2)), jnp.float32)
        compiled = {name: jax.jit(jax.value_and_grad(loss)) for name, loss in functions.items()}
        expected = compiled["by hand"](u, x)
        for call in compiled.values():
            assert all(np.allclose(a, b, rtol=1e-3, atol=1e-6) for a, b in zip(call(u, x), expected))
        times = measure({name: lambda call=call: call(u, x) for name, call in compiled.items()}, batch)
        for i, name in enumerate(compiled):
            ratio = np.median(times[:, i] / times[:, 0])
            print(f"{method:8}{batch:8}  {name:12}{np.median(times[:, i]):12.2f}  {ratio:5.2f}")
