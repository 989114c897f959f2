"""Fits the measured pendulums with `scipy.optimize.least_squares`.

`examples/identify.rs` compares its own fits with these.

Run: python scipy_compare.py measured.csv [results.csv]

The data must have one sample per time step of 0.005 s. The script ignores the column of times.

Model, data, weights, bounds and initial values are those of the example. The script fits only the
friction models in KINDS. If a fit fails, a second fit starts from the published values.

The fits use single shooting: the unknowns are physical numbers of the arms, and the initial state
of each segment. The Jacobian consists of forward differences with SciPy's default step. One
vectorized simulation computes all columns of the Jacobian. It perturbs the initial states of all
segments at once. `results.csv` receives the fitted physical numbers of all fits.
"""

import csv
import sys
import time

import numpy as np
from scipy.optimize import least_squares

DT = 0.005
SMOOTHING = 0.01
NOISE = {"theta": 0.003, "omega": 0.1}
FIELDS = ["mass", "center", "length", "inertia", "viscous", "dry", "quadratic"]
PUBLISHED = {
    1: [[0.14758, 0.14775, 0.0, 1.0912e-4]],
    2: [[0.093844, 0.108565, 0.172719, 4.3753e-4], [0.137596, 0.116779, 0.0, 1.26883e-3]],
    3: [[0.258172, 0.160000, 0.172800, 1.0004e-4], [0.279428, 0.202939, 0.228700, 3.1416e-4], [0.118624, 0.183709, 0.0, 1.6874e-4]],
}
FRICTION = 2.2394e-4
KINDS = {"viscous": ["viscous"], "dry + quadratic": ["dry", "quadratic"], "all": ["viscous", "dry", "quadratic"]}
GRAVITY = 9.81
# Limit of the RMS angle error of each segment, rad. A fit below this limit has found the minimum.
# Otherwise, the next start follows.
FAILED = 0.02


def rates(p, x):
    """Right-hand side. p: [batch, arm, field], x: [batch, 2 arms] in the order θ₁, ω₁, θ₂, …"""
    mass, center, length, inertia, viscous, dry, quadratic = np.moveaxis(p, -1, 0)
    theta, omega = x[:, 0::2], x[:, 1::2]
    arms = theta.shape[1]
    slip = np.diff(omega, axis=1, prepend=0.0)
    friction = viscous * slip + dry * np.tanh(slip / SMOOTHING) + quadratic * np.abs(slip) * slip
    torque = -friction
    torque[:, :-1] += friction[:, 1:]
    # Mass beyond the end of each arm.
    beyond = np.cumsum(mass[:, ::-1], axis=1)[:, ::-1] - mass
    moment = mass * center + beyond * length
    torque += GRAVITY * moment * np.sin(theta)
    diagonal = inertia + mass * center**2 + beyond * length**2
    if arms == 1:
        return np.stack([omega[:, 0], torque[:, 0] / diagonal[:, 0]], axis=1)
    matrix = np.zeros((len(x), arms, arms))
    for i in range(arms):
        matrix[:, i, i] = diagonal[:, i]
        for j in range(i):
            coupling = moment[:, i] * length[:, j]
            across = coupling * np.sin(theta[:, i] - theta[:, j])
            matrix[:, i, j] = matrix[:, j, i] = coupling * np.cos(theta[:, i] - theta[:, j])
            torque[:, i] -= across * omega[:, j] ** 2
            torque[:, j] += across * omega[:, i] ** 2
    alpha = np.linalg.solve(matrix, torque[..., None])[..., 0]
    return np.stack([omega, alpha], axis=2).reshape(x.shape)


def simulate(p, x, steps):
    """States [batch, step, component] by RK4."""
    states = [x]
    for _ in range(steps):
        a = rates(p, x)
        b = rates(p, x + 0.5 * DT * a)
        c = rates(p, x + 0.5 * DT * b)
        d = rates(p, x + DT * c)
        x = x + DT / 6 * (a + 2 * b + 2 * c + d)
        states.append(x)
    return np.stack(states, axis=1)


def read(path):
    """Returns the segments, each [sample, component] in the order θ₁, ω₁, θ₂, …"""
    rows = np.array([row for row in csv.reader(line for line in open(path) if line[0] != "#")][1:], dtype=float)
    arms = (rows.shape[1] - 2) // 2
    order = [2 + k for i in range(arms) for k in (i, arms + i)]
    return [rows[rows[:, 0] == segment][:, order] for segment in np.unique(rows[:, 0])]


class Problem:
    def __init__(self, segments, friction, factor):
        self.segments, self.simulations = segments, 0
        self.arms = segments[0].shape[1] // 2
        self.base = np.zeros((self.arms, len(FIELDS)))
        self.names, self.places, starts = [], [], []
        for i, published in enumerate(PUBLISHED[self.arms]):
            self.base[i, :4] = published
            last = i + 1 == self.arms
            fitted = ["center"] + ([] if last else ["length", "inertia"]) + friction
            for k, field in enumerate(FIELDS):
                if field in fitted:
                    value = self.base[i, k] if k < 4 else FRICTION * (0.1 if field == "quadratic" else 1)
                    # Initial values are alternately too large and too small, if `factor` exceeds 1.
                    starts.append(value * factor if len(starts) % 2 == 0 else value / factor)
                    self.names.append(f"{field}_{i + 1}")
                    self.places.append((i, k))
        self.scale = np.array(starts)
        self.steps = max(len(segment) for segment in segments) - 1
        self.weights = np.tile([1 / NOISE["theta"], 1 / NOISE["omega"]], self.arms)

    def batch(self, points):
        """Returns the weighted residuals of several points by segment, from one simulation."""
        count, size = len(self.scale), len(self.segments)
        p = np.tile(self.base, (len(points), size, 1, 1))
        for (arm, field), values in zip(self.places, (points[:, :count] * self.scale).T):
            p[:, :, arm, field] = values[:, None]
        x = points[:, count:].reshape(len(points) * size, 2 * self.arms)
        states = simulate(p.reshape(-1, self.arms, len(FIELDS)), x, self.steps).reshape(len(points), size, self.steps + 1, -1)
        self.simulations += len(points)
        pieces = [(states[:, i, : len(s)] - s) * self.weights for i, s in enumerate(self.segments)]
        return pieces

    def residuals(self, point):
        flat = np.concatenate([piece.ravel() for piece in self.batch(point[None])])
        return np.where(np.isfinite(flat), np.clip(flat, -1e6, 1e6), 1e6)

    def jacobian(self, point):
        count, size, n = len(self.scale), len(self.segments), 2 * self.arms
        steps = 1.5e-8 * np.maximum(1, np.abs(point)) * np.where(point < 0, -1, 1)
        directions = np.zeros((1 + count + n, len(point)))
        for i in range(count):
            directions[1 + i, i] = 1
        for i in range(n):
            directions[1 + count + i, count + i :: n] = 1
        pieces = self.batch(point + directions * steps)
        matrix = np.zeros((sum(piece[0].size for piece in pieces), len(point)))
        row = 0
        for segment, piece in enumerate(pieces):
            slopes = (piece[1:] - piece[0]).reshape(count + n, -1)
            rows = slice(row, row + slopes.shape[1])
            columns = np.r_[0:count, count + n * segment : count + n * (segment + 1)]
            matrix[rows, columns] = (slopes / steps[columns][:, None]).T
            row = rows.stop
        return np.nan_to_num(np.clip(matrix, -1e12, 1e12))

    def fit(self):
        start = np.concatenate([np.ones(len(self.scale))] + [segment[0] for segment in self.segments])
        low = np.full(len(start), -np.inf)
        # With fixed masses, only the sum inertia + mass center² has to be positive.
        low[: len(self.scale)] = [-np.inf if name.startswith("inertia") else 0 for name in self.names]
        begin = time.perf_counter()
        with np.errstate(all="ignore"):
            result = least_squares(self.residuals, start, self.jacobian, bounds=(low, np.inf), x_scale="jac", max_nfev=200)
        seconds = time.perf_counter() - begin
        errors = [np.sqrt(np.mean((piece[0, :, 0::2] * NOISE["theta"]) ** 2)) for piece in self.batch(result.x[None])]
        return result, errors, seconds


def main():
    segments = read(sys.argv[1])
    rows = []
    for friction, kinds in KINDS.items():
        for subset, fitted in [("all", segments), ("half", segments[::2])]:
            best = np.inf
            for start, factor in [("30 % off", 1.3), ("published", 1.0)]:
                if best < FAILED:
                    break
                problem = Problem(fitted, kinds, factor)
                result, errors, seconds = problem.fit()
                print(
                    f"{friction}, {subset} segments, start {start}: χ² {2 * result.cost:.6g}, angle errors median {np.median(errors):.4f}, "
                    f"max {np.max(errors):.4f} rad, {seconds:.1f} s, {result.njev} Jacobians, {problem.simulations} simulations, "
                    f"status {result.status}",
                    flush=True,
                )
                print("  angle errors, rad:", " ".join(f"{error:.4f}" for error in errors))
                best = np.max(errors)
                values = result.x[: len(problem.scale)] * problem.scale
                print("  " + ", ".join(f"{name} {value:.4e}" for name, value in zip(problem.names, values)), flush=True)
                rows += [[friction, subset, start, name, repr(float(value))] for name, value in zip(problem.names, values)]
    if len(sys.argv) > 2:
        with open(sys.argv[2], "w", newline="") as file:
            csv.writer(file).writerows([["friction", "segments", "start", "name", "value"], *rows])


main()
