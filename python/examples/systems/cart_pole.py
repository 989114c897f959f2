"""A cart with four poles in NumPy, in the order of operations of the task `cart_pole`."""

import numpy as np
import physgrad as pg

POLES, DT = 4, 0.01
CART_MASS, POLE_MASS, HALF_LENGTH, GRAVITY = 1.0, 0.1, 0.5, 9.8
MASS, MOMENT = CART_MASS + POLE_MASS, POLE_MASS * HALF_LENGTH
INERTIA, COUPLING = MOMENT * (4 / 3) * HALF_LENGTH, MOMENT * MOMENT / MASS
# The built-in task, and its settings.
BUILT_IN = ("cart_pole", {"poles": POLES})


def step(x, u):
    """Semi-implicit Euler."""
    next = x.copy()
    angle, rate = x[2::2], x[3::2]
    sin, cos = np.sin(angle), np.cos(angle)
    lever = MOMENT * cos
    centrifugal = MOMENT * sin * rate * rate
    a = (u.force + centrifugal) * (1 / MASS)
    alpha = (MOMENT * GRAVITY * sin - lever * a) / (INERTIA - COUPLING * cos * cos)
    push = sum(centrifugal - lever * alpha, start=u.force)
    next[3::2] = rate + DT * alpha
    next[2::2] = angle + DT * next[3::2]
    next[1] = x[1] + DT * push * (1 / MASS)
    next[0] = x[0] + DT * next[1]
    return next


def height(x):
    """The mean of 1 - cos(angle) over the poles."""
    return 1 - sum(np.cos(x[2::2])) * (1 / POLES)


def make(**settings):
    """The task. Angles begin within 30° of hanging, and other components within 1."""
    hanging = pg.uniform(np.pi - np.pi / 6, np.pi + np.pi / 6)
    states = ["position", "speed", *(f"{name}{i + 1}" for i in range(POLES) for name in ("angle", "rate"))]
    return pg.system(
        step=step,
        states=states,
        controls={"force": (-60, 60)},
        dt=DT,
        start={name: hanging if name.startswith("angle") else pg.uniform(-1, 1) for name in states},
        terminal_cost=height,
        **{"horizon": 100, **settings},
    )
