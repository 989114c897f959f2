"""Rigid arms on joints with friction in NumPy, in the order of operations of the task `pendulum`."""

import numpy as np
import physgrad as pg
from systems.elimination import solve

ARMS, DT = 3, 0.01
NUMBERS = {"mass": 0.1, "center": 0.1, "length": 0.2, "inertia": 0.1 * 0.2 * 0.2 / 12, "gravity": 9.81}
FRICTION = {"viscous": 2e-4, "dry": 1e-4, "quadratic": 3e-4}
# The built-in task, and its settings.
BUILT_IN = ("pendulum", {"arms": [FRICTION] * ARMS})


def rate(x, u, p):
    """Lagrange's equations of the angles from upright."""
    angle, omega = x[0::2], x[1::2]
    sin, cos = np.sin(angle), np.cos(angle)
    torque, matrix = np.zeros(ARMS), np.zeros((ARMS, ARMS))
    torque[0] += u.torque
    for i in range(ARMS):
        r = omega[i] - omega[i - 1] if i > 0 else omega[0]
        friction = p.viscous * r + p.dry * np.tanh(r * 100) + p.quadratic * abs(r) * r
        torque[i] -= friction
        if i > 0:
            torque[i - 1] += friction
    # The mass of all arms after each one, which moves with its end.
    beyond = np.zeros(ARMS)
    for i in reversed(range(1, ARMS)):
        beyond[i - 1] = beyond[i] + p.mass
    for i in range(ARMS):
        moment = p.mass * p.center + beyond[i] * p.length
        torque[i] += p.gravity * moment * sin[i]
        for j in range(i):
            coupling = moment * p.length
            across = coupling * (sin[i] * cos[j] - cos[i] * sin[j])
            matrix[i, j] = coupling * (cos[i] * cos[j] + sin[i] * sin[j])
            torque[i] -= across * omega[j] * omega[j]
            torque[j] += across * omega[i] * omega[i]
        matrix[i, i] = p.inertia + p.mass * p.center * p.center + beyond[i] * p.length * p.length
    rates = x.copy()
    rates[0::2], rates[1::2] = omega, solve(matrix, torque)
    return rates


def height(x):
    """The mean of 1 - cos(angle) over the arms."""
    return sum(1 - np.cos(x[0::2])) * (1 / ARMS)


def make(**settings):
    """The task. Angles begin within 30° of hanging, and rates within pi / 6."""
    around = np.pi / 6
    states = [f"{name}{i + 1}" for i in range(ARMS) for name in ("angle", "rate")]
    middle = {name: np.pi if name.startswith("angle") else 0.0 for name in states}
    return pg.system(
        rate,
        states=states,
        controls={"torque": (-1, 1)},
        params=NUMBERS | FRICTION,
        dt=DT,
        start={name: pg.uniform(center - around, center + around) for name, center in middle.items()},
        terminal_cost=height,
        **{"horizon": 100, "training": {"clip": "norm", "clip_limit": 1.0}, **settings},
    )
