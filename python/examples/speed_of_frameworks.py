"""Times gradients of a rollout in JAX and PyTorch: physics by physgrad, beside the same formulas by hand.

    python speed_of_frameworks.py            # ten minutes
    python speed_of_frameworks.py --quick    # few repetitions, one small size

One time is that of the mean loss of 100 steps of a cart with four poles, and its gradient by the gains of
a linear policy, in float32, on one core. All sides alternate. Times are medians in ms; ratios are medians
of those of one repetition to the formulas by hand, with an interval of 95 %.
"""

import argparse
import os
import time

# Before the frameworks start their threads.
if hasattr(os, "sched_setaffinity"):  # Linux
    os.sched_setaffinity(0, {min(os.sched_getaffinity(0))})

import numpy as np
import physgrad as pg
from systems.cart_pole import COUPLING, DT, GRAVITY, INERTIA, MASS, MOMENT, POLES

parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
parser.add_argument("--quick", action="store_true", help="few repetitions, one small size")
options = parser.parse_args()
STEPS = 20 if options.quick else 100
# Seconds of one side in each repetition, repetitions, samples.
SPAN, REPEATS, BATCHES = (0.01, 3, [8]) if options.quick else (0.3, 15, [64, 1024])

task = pg.task("cart_pole", poles=POLES, horizon=STEPS)
linear = pg.Policy(task, kind="linear", bias=False)
GAINS = (0.1 * np.random.default_rng(0).standard_normal(task.observation_dim)).astype(np.float32)
linear.theta = GAINS


def by_hand(lib, x, u):
    """The next state, in arrays of (batch, components), for JAX and PyTorch."""
    position, speed, angle, rate = x
    sin, cos = lib.sin(angle), lib.cos(angle)
    lever, centrifugal = MOMENT * cos, MOMENT * sin * rate * rate
    a = (u + centrifugal) / MASS
    alpha = (MOMENT * GRAVITY * sin - lever * a) / (INERTIA - COUPLING * cos * cos)
    rate = rate + DT * alpha
    speed = speed + DT * (u + (centrifugal - lever * alpha).sum(1)[:, None]) / MASS
    return position + DT * speed, speed, angle + DT * rate, rate


def apart(x):
    return x[:, :1], x[:, 1:2], x[:, 2::2], x[:, 3::2]


def gains(theta):
    """Gains of the parts of the state."""
    return theta[:1], theta[1:2], theta[2::2], theta[3::2]


def control(x, k):
    return sum((part * gain).sum(1) for part, gain in zip(x, k))[:, None]


def in_jax(starts):
    """Calls by name."""
    import jax
    import jax.numpy as jnp

    step, transition, terminal_cost = pg.jax.step(task), pg.jax.transition(task), pg.jax.terminal_cost(task)
    rollout, starts = pg.jax.rollout(task, linear), jnp.asarray(starts)

    def hand(theta):
        k = gains(theta)
        x = jax.lax.scan(lambda x, _: (by_hand(jnp, x, control(x, k)), None), apart(starts), length=STEPS)[0]
        return (1 - jnp.cos(x[2]).mean(1)).mean()

    def steps(theta):
        body = lambda x, t: (step(x, (x @ theta)[:, None], t=t), None)  # noqa: E731
        return terminal_cost(jax.lax.scan(body, starts, jnp.arange(STEPS))[0]).mean()

    def transitions(theta):
        def body(carry, t):
            x, y = carry
            next, y, cost = transition(x, (y @ theta)[:, None], t=t)
            return (next, y), cost

        (x, _), costs = jax.lax.scan(body, (starts, starts), jnp.arange(STEPS))
        return (costs.sum(0) + terminal_cost(x)).mean()

    def whole(theta):
        return terminal_cost(rollout(theta, starts)[0][:, -1]).mean()

    def call(loss):
        compiled, theta = jax.jit(jax.value_and_grad(loss)), jnp.asarray(GAINS)
        return lambda: jax.block_until_ready(compiled(theta))

    return {"by hand": call(hand), "step": call(steps), "transition": call(transitions), "rollout": call(whole)}


def in_torch(starts):
    """Calls by name."""
    import torch

    torch.set_num_threads(1)
    step, transition, terminal_cost = pg.torch.step(task), pg.torch.transition(task), pg.torch.terminal_cost(task)
    rollout, starts = pg.torch.rollout(task, linear), torch.from_numpy(starts)

    def hand(theta):
        k, x = gains(theta), apart(starts)
        for _ in range(STEPS):
            x = by_hand(torch, x, control(x, k))
        return (1 - torch.cos(x[2]).mean(1)).mean()

    def steps(theta):
        x = starts
        for t in range(STEPS):
            x = step(x, (x @ theta)[:, None], t=t)
        return terminal_cost(x).mean()

    def transitions(theta):
        x = y = starts
        total = 0.0
        for t in range(STEPS):
            x, y, cost = transition(x, (y @ theta)[:, None], t=t)
            total = total + cost
        return (total + terminal_cost(x)).mean()

    def whole(theta):
        return terminal_cost(rollout(theta, starts)[0][:, -1]).mean()

    def call(loss):
        def run():
            theta = torch.tensor(GAINS, requires_grad=True)
            value = loss(theta)
            value.backward()
            return value.detach(), theta.grad

        return run

    return {"by hand": call(hand), "step": call(steps), "transition": call(transitions), "rollout": call(whole)}


def measure(calls):
    """Milliseconds, (repetitions, calls)."""
    counts = []
    for call in calls.values():
        call()
        begin = time.perf_counter()
        call()
        counts.append(max(1, int(SPAN / (time.perf_counter() - begin))))
    times = np.empty((REPEATS, len(calls)))
    for row in times:
        for i, (call, count) in enumerate(zip(calls.values(), counts)):
            begin = time.perf_counter()
            for _ in range(count):
                call()
            row[i] = 1e3 * (time.perf_counter() - begin) / count
    return times


def interval(values):
    """Median, with the order statistics that enclose it with a probability of 95 %."""
    values, half = np.sort(values), 0.98 * np.sqrt(len(values))
    low, high = (int(max(0, round(len(values) / 2 - half))), int(min(len(values) - 1, round(len(values) / 2 + half - 1))))
    return f"{np.median(values):7.2f}  ({values[low]:.2f} to {values[high]:.2f})"


print(f"{'framework':10}{'samples':>8}  {'physics':22}{'ms':>9}  ratio to the formulas by hand")
for framework, calls_of in {"JAX": in_jax, "PyTorch": in_torch}.items():
    for batch in BATCHES:
        starts = task.starts(batch)
        try:
            calls = calls_of(starts)
        except ImportError as error:
            print(f"without {framework}: {error}")
            break
        values = {name: [float(np.asarray(part).ravel()[0]) for part in call()] for name, call in calls.items()}
        calls["pg.gradients"] = lambda: pg.gradients(task, linear, starts, fields=["R"])
        for name, (loss, slope) in values.items():
            expected = values["by hand"]
            assert abs(loss - expected[0]) < 1e-3 and abs(slope - expected[1]) < 1e-2 * max(1, abs(expected[1])), (name, values)
        times = measure(calls)
        for i, name in enumerate(calls):
            print(f"{framework:10}{batch:8}  {name:22}{np.median(times[:, i]):9.3f}  {interval(times[:, i] / times[:, 0])}")
