"""Two drivers herd four evaders, in NumPy, in the order of operations of the task `guidance`.

The task also scales separations beyond 2^±60 m, which this file leaves out.
"""

import numpy as np
import physgrad as pg

DRIVERS, EVADERS, DT, HORIZON = 2, 4, 4 / 60, 60
SOFTENING, REGULARIZATION = 0.1, 1.0
FRICTION = np.array([[1.0]] * DRIVERS + [[4.0]] * EVADERS)
SPREAD, EVADE, FLOCK, FLOCK_DISTANCE = 0.2, 15.0, 0.2, 0.5
# The built-in task, and its settings.
BUILT_IN = ("guidance", {"drivers": DRIVERS, "evaders": EVADERS})


def repulsion(r, far, near):
    """The force (far / d + near / d^2) r with d = softening + |r|. The derivative of |r| at 0 is 0."""
    square = r[0] * r[0] + r[1] * r[1]
    length = np.where(square > 0, np.sqrt(np.where(square > 0, square, 1)), 0)
    per_d = 1 / (SOFTENING + length)
    return r * per_d * (far + near * per_d)


def step(x, u):
    """Explicit Euler. The state has the rows [x, y, vx, vy], first of the drivers."""
    agents = np.reshape(x, (-1, 4))
    place, velocity = agents[:, :2], agents[:, 2:]
    radial, tangential = np.reshape(u, (-1, 2)).T
    # The controls act along and across the vector from the sum of the evaders, as in the task.
    along, across = (place[:DRIVERS] - sum(place[DRIVERS:])).T
    force = np.zeros((DRIVERS + EVADERS, 2))
    force[:DRIVERS, 0] = radial * along - tangential * across
    force[:DRIVERS, 1] = radial * across + tangential * along
    force -= FRICTION * velocity
    for b in range(DRIVERS):
        for a in range(b):
            push = repulsion(place[b] - place[a], 0, SPREAD)
            force[b], force[a] = force[b] + push, force[a] - push
    for b in range(DRIVERS, len(force)):
        for a in range(DRIVERS):
            force[b] += repulsion(place[b] - place[a], 0, EVADE)
    for b in range(DRIVERS, len(force)):
        for a in range(DRIVERS, b):
            push = repulsion(place[b] - place[a], FLOCK, -FLOCK * FLOCK_DISTANCE)
            force[b], force[a] = force[b] + push, force[a] - push
    return np.ravel(np.hstack([place + DT * velocity, velocity + DT * force]))


def cost(u, next):
    """Squared controls, and squared distances of the evaders from the origin."""
    evaders = np.reshape(next, (-1, 4))[DRIVERS:, :2]
    effort = sum(u * u) * (REGULARIZATION / (2 * DRIVERS * HORIZON))
    return effort + sum(x * x + y * y for x, y in evaders) * (1 / (2 * EVADERS * HORIZON))


def make(**settings):
    """The task. Agents begin in squares; those of the task `guidance` begin on rings."""
    names = [f"driver{i + 1}" for i in range(DRIVERS)] + [f"evader{i + 1}" for i in range(EVADERS)]
    start = {f"driver{i + 1}_x": pg.uniform(3, 4) for i in range(DRIVERS)}
    start |= {f"evader{i + 1}_{axis}": pg.uniform(0.5, 1.5) for i in range(EVADERS) for axis in "xy"}
    return pg.system(
        step=step,
        states=[f"{name}_{part}" for name in names for part in ("x", "y", "vx", "vy")],
        controls={f"{part}{i + 1}": (-5, 5) for i in range(DRIVERS) for part in ("radial", "tangential")},
        dt=DT,
        start=start,
        running_cost=cost,
        **{"horizon": HORIZON, **settings},
    )
