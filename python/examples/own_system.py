"""Writes a cart with poles in NumPy, compares it with the built-in task, and trains a controller.

python own_system.py            # a minute
python own_system.py --quick    # two epochs
"""

import argparse

import numpy as np
import physgrad as pg

POLES, DT = 4, 0.01
NUMBERS = {"cart_mass": 1.0, "pole_mass": 0.1, "half_length": 0.5, "gravity": 9.8}


def step(x, u, p):
    """Semi-implicit Euler, in the order of operations of the built-in task."""
    mass, moment = p.cart_mass + p.pole_mass, p.pole_mass * p.half_length
    inertia, coupling = moment * (4 / 3) * p.half_length, moment * moment / mass
    next = x.copy()
    push = u.force
    for i in range(2, len(x), 2):
        angle, rate = x[i], x[i + 1]
        lever = moment * np.cos(angle)
        centrifugal = moment * np.sin(angle) * rate * rate
        a = (u.force + centrifugal) * (1 / mass)
        torque = moment * p.gravity * np.sin(angle)
        alpha = (torque - lever * a) / (inertia - coupling * np.cos(angle) * np.cos(angle))
        push = push + (centrifugal - lever * alpha)
        next[i + 1] = rate + DT * alpha
        next[i] = angle + DT * next[i + 1]
    next[1] = x[1] + DT * push * (1 / mass)
    next[0] = x[0] + DT * next[1]
    return next


def height(x):
    """The mean of 1 - cos(angle) over the poles."""
    return 1 - sum(np.cos(x[2::2])) * (1 / POLES)


def start(name):
    """Angles within 30° of hanging, and other components within 1."""
    return pg.uniform(np.pi - np.pi / 6, np.pi + np.pi / 6) if name.startswith("angle") else pg.uniform(-1, 1)


parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
parser.add_argument("--quick", action="store_true", help="train for two epochs")
options = parser.parse_args()

states = ["position", "speed", *(f"{name}{i + 1}" for i in range(POLES) for name in ("angle", "rate"))]
task = pg.system(
    step=step,
    states=states,
    controls={"force": (-60, 60)},
    params=NUMBERS,
    dt=DT,
    horizon=100,
    start={name: start(name) for name in states},
    terminal_cost=height,
)
built_in = pg.task("cart_pole", poles=POLES)
x = task.starts(100, seed=1, dtype="float64")
u = np.linspace(-60, 60, 100)[:, None]
difference = np.abs(task.step(x, u) - built_in.step(x, u)).max()
print(f"largest difference from the built-in task after one step: {difference:.1e}")

run = pg.train(task, pg.Mlp(task, [64, 64], seed=1), field="C", epochs=2 if options.quick else 100, seed=1)
losses = run.history["test_loss"]
print(f"test loss {losses[0]:.3f} after one epoch, {losses[-1]:.4f} after {len(losses)}")
