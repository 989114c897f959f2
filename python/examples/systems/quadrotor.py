"""A planar quadrotor on a figure eight in NumPy, in the order of operations of `examples/quadrotor.rs`."""

import math

import numpy as np
import physgrad as pg

MASS, ARM, DT, STEPS, GRAVITY = 0.8, 0.2, 0.05, 80, 9.81


def reference():
    """Position, m, and velocity, m/s, to reach at the end of each step."""
    rate, turn = math.tau / (STEPS * DT), [math.tau * (t + 1) / STEPS for t in range(STEPS)]
    return {
        "px": pg.table([math.sin(a) for a in turn]),
        "pz": pg.table([0.5 * math.sin(2 * a) for a in turn]),
        "vx": pg.table([rate * math.cos(a) for a in turn]),
        "vz": pg.table([rate * math.cos(2 * a) for a in turn]),
    }


def step(x, u):
    """Semi-implicit Euler. Thrusts, N, are those beyond half the weight."""
    next = x.copy()
    thrust = (u.left + u.right) / MASS + GRAVITY
    next[3] = x[3] - thrust * np.sin(x.tilt) * DT
    next[4] = x[4] + (thrust * np.cos(x.tilt) - GRAVITY) * DT
    next[5] = x[5] + (u.right - u.left) * (2 / (MASS * ARM)) * DT
    next[:3] = x[:3] + next[3:] * DT
    return next


def observe(x, p):
    return [x.x - p.px, x.z - p.pz, x.x_rate - p.vx, x.z_rate - p.vz, np.sin(x.tilt), np.cos(x.tilt), x[5]]


def cost(u, next, p):
    dx, dz = next.x - p.px, next.z - p.pz
    return (dx * dx + dz * dz) * (1 / STEPS) + (u.left * u.left + u.right * u.right) * 1e-6


def make(**settings):
    """The task. All components begin within 0.2."""
    states = ["x", "z", "tilt", "x_rate", "z_rate", "tilt_rate"]
    return pg.system(
        step=step,
        states=states,
        controls=["left", "right"],
        params=reference(),
        dt=DT,
        start={name: pg.uniform(-0.2, 0.2) for name in states},
        observe=observe,
        running_cost=cost,
        **{"horizon": STEPS, "training": {"clip": "norm", "clip_limit": 1.0}, **settings},
    )
