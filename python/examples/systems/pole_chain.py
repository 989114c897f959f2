"""A chain of three poles on a cart in NumPy, in the order of operations of the task `pole_chain`."""

import numpy as np
import physgrad as pg
from systems.elimination import solve

POLES, DT = 3, 0.01
CART_MASS, POLE_MASS, HALF_LENGTH, GRAVITY = 1.0, 0.1, 0.5, 9.8
# The built-in task, and its settings.
BUILT_IN = ("pole_chain", {"poles": POLES})


def moment(k):
    """kg m, of pole `k` and those above."""
    return POLE_MASS * HALF_LENGTH * (1 + 2 * (POLES - 1 - k))


def inertia(j, k):
    """kg m^2, of the poles j <= k."""
    own = 4 / 3 if j == k else 2.0
    return POLE_MASS * HALF_LENGTH * HALF_LENGTH * (own + 4 * (POLES - 1 - k))


def rate(x, u):
    """Lagrange's equations of the cart and the angles from upright."""
    angle, omega = x[2::2], x[3::2]
    sin, cos, spin = np.sin(angle), np.cos(angle), omega * omega
    mass, force = np.zeros((1 + POLES, 1 + POLES)), np.zeros(1 + POLES)
    mass[0, 0], force[0] = CART_MASS + POLES * POLE_MASS, u.force
    for j in range(POLES):
        force[0] += moment(j) * sin[j] * spin[j]
        mass[1 + j, 0] = moment(j) * cos[j]
        force[1 + j] = moment(j) * GRAVITY * sin[j]
        for k in range(j):
            throw = inertia(k, j) * (sin[j] * cos[k] - cos[j] * sin[k])
            mass[1 + j, 1 + k] = inertia(k, j) * (cos[j] * cos[k] + sin[j] * sin[k])
            force[1 + j] -= throw * omega[k] * omega[k]
            force[1 + k] += throw * spin[j]
        mass[1 + j, 1 + j] = inertia(j, j)
    rates = x.copy()
    rates[0::2], rates[1::2] = x[1::2], solve(mass, force)
    return rates


def height(x):
    """The mean of 1 - cos(angle) over the poles."""
    return sum(1 - np.cos(x[2::2])) * (1 / POLES)


def make(**settings):
    """The task. Angles begin within 30° of hanging, and other components within pi / 6."""
    around = np.pi / 6
    states = ["position", "speed", *(f"{name}{i + 1}" for i in range(POLES) for name in ("angle", "rate"))]
    middle = {name: np.pi if name.startswith("angle") else 0.0 for name in states}
    return pg.system(
        rate,
        states=states,
        controls={"force": (-30, 30)},
        dt=DT,
        start={name: pg.uniform(center - around, center + around) for name, center in middle.items()},
        terminal_cost=height,
        **{"horizon": 100, "training": {"clip": "norm", "clip_limit": 1.0}, **settings},
    )
