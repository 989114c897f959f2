"""Times systems in NumPy beside JAX and CasADi: one core, alternating, the same formulas and numbers.

    python speed_of_graphs.py            # ten minutes
    python speed_of_graphs.py --quick    # few repetitions, small sizes

Times are medians per sample and step in ns, with the call from Python. Ratios are those of physgrad to
the other: medians over the repetitions, with an interval of 95 %. JAX is compiled by `jit` before. CasADi
evaluates all samples by one `map`, or each one by a call; it has float64 only.
"""

import argparse
import os
import time

# Before JAX starts its threads.
if hasattr(os, "sched_setaffinity"):  # Linux
    os.sched_setaffinity(0, {min(os.sched_getaffinity(0))})
os.environ["XLA_FLAGS"] = "--xla_cpu_multi_thread_eigen=false intra_op_parallelism_threads=1"

import numpy as np
import physgrad as pg
from systems import cart_pole, quadrotor

parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
parser.add_argument("--quick", action="store_true", help="few repetitions, small sizes")
options = parser.parse_args()
# Seconds of one side in each repetition, and repetitions.
SPAN, REPEATS = (0.002, 5) if options.quick else (0.05, 41)
BATCHES = [8] if options.quick else [64, 1024]


def imported(name):
    try:
        return __import__(name)
    except ImportError:
        print(f"without {name}, which is not installed")


jax, casadi = imported("jax"), imported("casadi")
if jax:
    jax.config.update("jax_enable_x64", True)
    import jax.numpy as jnp


class CartPole:
    """The formulas of `systems/cart_pole.py` on components, for any library. A `row` has values over time."""

    make, tables = cart_pole.make, []

    def step(lib, x, u):
        c, next, push = cart_pole, list(x), u[0]
        for i in range(2, 2 + 2 * c.POLES, 2):
            sin, cos, rate = lib.sin(x[i]), lib.cos(x[i]), x[i + 1]
            lever, centrifugal = c.MOMENT * cos, c.MOMENT * sin * rate * rate
            a = (u[0] + centrifugal) * (1 / c.MASS)
            alpha = (c.MOMENT * c.GRAVITY * sin - lever * a) / (c.INERTIA - c.COUPLING * cos * cos)
            push = push + (centrifugal - lever * alpha)
            next[i + 1] = rate + c.DT * alpha
            next[i] = x[i] + c.DT * next[i + 1]
        next[1] = x[1] + c.DT * push * (1 / c.MASS)
        next[0] = x[0] + c.DT * next[1]
        return next

    def observe(lib, x, row):
        return x

    def running(u, next, row):
        return 0.0

    def terminal(lib, x):
        return 1 - sum(lib.cos(x[i]) for i in range(2, len(x), 2)) * (1 / cart_pole.POLES)


class Quadrotor:
    """The formulas of `systems/quadrotor.py` on components, for any library."""

    make, tables = quadrotor.make, ["px", "pz", "vx", "vz"]

    def step(lib, x, u):
        q, next = quadrotor, list(x)
        sin, cos = lib.sin(x[2]), lib.cos(x[2])
        thrust = (u[0] + u[1]) / q.MASS + q.GRAVITY
        next[3] = x[3] - thrust * sin * q.DT
        next[4] = x[4] + (thrust * cos - q.GRAVITY) * q.DT
        next[5] = x[5] + (u[1] - u[0]) * (2 / (q.MASS * q.ARM)) * q.DT
        next[:3] = [x[i] + next[i + 3] * q.DT for i in range(3)]
        return next

    def observe(lib, x, row):
        away = [x[0] - row[0], x[1] - row[1], x[3] - row[2], x[4] - row[3]]
        return lib.stack([*away, lib.sin(x[2]), lib.cos(x[2]), x[5]])

    def running(u, next, row):
        dx, dz = next[0] - row[0], next[1] - row[1]
        return (dx * dx + dz * dz) * (1 / quadrotor.STEPS) + (u[0] * u[0] + u[1] * u[1]) * 1e-6

    def terminal(lib, x):
        return 0.0


def steps_of_jax(system, x, u, bars):
    """Calls of a step, and of a step with its gradient."""

    def step(x, u):
        return jnp.stack(system.step(jnp, x.T, u.T), axis=-1)

    def with_gradient(x, u, bars):
        next, back = jax.vjp(step, x, u)
        return next, *back(bars)

    one, both = jax.jit(step), jax.jit(with_gradient)
    x, u, bars = map(jnp.asarray, (x, u, bars))
    return lambda: one(x, u).block_until_ready(), lambda: jax.block_until_ready(both(x, u, bars))


def steps_of_casadi(system, x, u, bars):
    """Calls of a step, and of a step with its gradient: first for all samples, then one by one."""
    sizes = x.shape[1], u.shape[1]
    sx, su, bar = (casadi.SX.sym("s", size) for size in (*sizes, sizes[0]))
    next = casadi.vertcat(*system.step(casadi, casadi.vertsplit(sx), casadi.vertsplit(su)))
    back = [casadi.jtimes(next, v, bar, True) for v in (sx, su)]
    one = casadi.Function("one", [sx, su], [next])
    both = casadi.Function("both", [sx, su, bar], [next, *back])
    mapped = one.map(len(x)), both.map(len(x))
    columns = [casadi.DM(value.T) for value in (x, u, bars)]
    rows = [[casadi.DM(row) for row in value] for value in (x, u, bars)]
    return {
        "map": (lambda: mapped[0](*columns[:2]), lambda: mapped[1](*columns)),
        "calls": (
            lambda: [one(*row) for row in zip(*rows[:2])],
            lambda: [both(*row) for row in zip(*rows)],
        ),
    }


def rollout_of_jax(system, task, policy, starts):
    """A call of the gradient of the mean loss with respect to the weights of a network."""
    found = task.settings["system"].get("tables", {})
    rows = jnp.asarray(np.array([found[name] for name in system.tables]).T, starts.dtype)
    widths, layers, rest = [task.observation_dim, 64, 64, task.control_dim], [], policy.theta
    for inputs, outputs in zip(widths, widths[1:]):
        kernel, bias, rest = np.split(rest, np.cumsum([inputs * outputs, outputs]))
        layers.append(
            (jnp.asarray(kernel.reshape(inputs, outputs).T, starts.dtype), jnp.asarray(bias, starts.dtype))
        )

    def act(layers, y):
        for kernel, bias in layers[:-1]:
            y = jnp.tanh(kernel @ y + bias[:, None])
        return layers[-1][0] @ y + layers[-1][1][:, None]

    def loss(layers, x):
        def turn(carry, row):
            x, total = carry
            u = act(layers, system.observe(jnp, x, row))
            next = jnp.stack(system.step(jnp, x, u))
            return (next, total + system.running(u, next, row)), None

        begin = x.T, jnp.zeros(len(x), x.dtype)
        (x, total), _ = jax.lax.scan(turn, begin, rows if system.tables else None, length=task.horizon)
        return (total + system.terminal(jnp, x)).mean()

    gradient = jax.jit(jax.grad(loss))
    x = jnp.asarray(starts)
    return lambda: jax.block_until_ready(gradient(layers, x))


def alternate(calls):
    """Seconds of each call in each repetition, in turn."""
    counts, times = {}, {name: [] for name in calls}
    for name, call in calls.items():
        call()
        begin, counts[name] = time.perf_counter(), 0
        while time.perf_counter() - begin < SPAN:
            call()
            counts[name] += 1
    for _ in range(REPEATS):
        for name, call in calls.items():
            begin = time.perf_counter()
            for _ in range(counts[name]):
                call()
            times[name].append((time.perf_counter() - begin) / counts[name])
    return {name: np.array(values) for name, values in times.items()}


def with_interval(values):
    """The median, and an interval of 95 % by order statistics."""
    ordered, middle = np.sort(values), len(values) // 2
    reach = int(np.ceil(0.98 * np.sqrt(len(values))))
    low, high = ordered[max(middle - reach, 0)], ordered[min(middle + reach, len(values) - 1)]
    return f"{ordered[middle]:.2g} ({low:.2g} to {high:.2g})"


def report(what, calls, samples):
    times = alternate(calls)
    cells = [what, f"{1e9 * np.median(times['physgrad']) / samples:.0f}"]
    for name in OTHERS:
        if name in times:
            cells += [
                f"{1e9 * np.median(times[name]) / samples:.0f}",
                with_interval(times["physgrad"] / times[name]),
            ]
        else:
            cells += ["", ""]
    print(f"| {' | '.join(cells)} |", flush=True)


def agree(found, expected, tolerance):
    """Whether both sides compute the same numbers."""
    for a, b in zip(found, expected, strict=True):
        assert np.abs(np.asarray(a) - np.asarray(b)).max() <= tolerance * np.abs(b).max()


OTHERS = ["JAX", "CasADi, map", "CasADi, calls"]
print(f"| ns per sample and step | physgrad | {' | '.join(f'{name} | ratio' for name in OTHERS)} |")
print(f"|---|---|{'---|---|' * len(OTHERS)}")
for name, system in (("cart-pole, 4 poles", CartPole), ("quadrotor", Quadrotor)):
    for precision, dtype, tolerance in (("f32", "float32", 1e-4), ("f64", "float64", 1e-10)):
        task, rng = system.make(precision=precision), np.random.default_rng(1)
        for batch in BATCHES:
            x = task.starts(batch, seed=2, dtype=dtype)
            u, bars = (rng.normal(size=(batch, n)).astype(dtype) for n in (task.control_dim, task.state_dim))
            step = {"physgrad": lambda: task.step(x, u)}
            both = {"physgrad": lambda: (task.step(x, u), *task.step_vjp(x, u, bars)[:2])}
            policy = pg.Mlp(task, [64, 64], seed=1, zero_init_output=False)
            rollout = {"physgrad": lambda: pg.gradients(task, policy, x, fields=["R"])}
            if jax:
                step["JAX"], both["JAX"] = steps_of_jax(system, x, u, bars)
                rollout["JAX"] = rollout_of_jax(system, task, policy, x)
                agree(both["physgrad"](), both["JAX"](), tolerance)
                flat = [part for kernel, bias in rollout["JAX"]() for part in (kernel.T.ravel(), bias)]
                agree([rollout["physgrad"]()["R"]], [np.concatenate(flat)], 100 * tolerance)
            if casadi and precision == "f64":
                for way, (one, gradient) in steps_of_casadi(system, x, u, bars).items():
                    step[f"CasADi, {way}"], both[f"CasADi, {way}"] = one, gradient
                agree(both["physgrad"](), [value.toarray().T for value in both["CasADi, map"]()], tolerance)
            label = f"{name}, {precision}, {batch}"
            report(f"{label}: step", step, batch)
            report(f"{label}: step and gradient", both, batch)
            report(f"{label}: rollout and gradient", rollout, batch * task.horizon)
