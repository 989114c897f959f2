"""Equations of traced functions agree with NumPy."""

import inspect
import time

import numpy as np
import pytest
from equations import Case, close, distributions, same, trace
from numpy import array, where, zeros

A = np.array([[0.0, 1.0, 0.5], [-2.0, 0.1, 3.0], [1.0, -1.0, 4.0]])
XP, FP = np.array([-1.0, 0.0, 0.5, 2.0]), np.array([3.0, -1.0, 4.0, 4.5])
SPECIAL = [0.0, -0.0, 1.0, -1.0, 0.5, 1e-300, -1e300, 5e-324, np.inf, -np.inf, np.nan, 3.0, np.pi]


def inputs(case, seed, count=60):
    """Random and special values of all arguments."""
    rng = np.random.default_rng(seed)
    sizes = [len(case.states), len(case.controls), len(case.states)]
    for i in range(count):
        scale = rng.choice([0.3, 3.0, 1e3])
        values = [rng.normal(0.0, scale, size) for size in sizes]
        if i % 3 == 2:
            values = [
                np.where(rng.random(size) < 0.5, rng.choice(SPECIAL, size), v)
                for size, v in zip(sizes, values)
            ]
        params = {name: rng.uniform(-2, 2) for name in case.system.get("parameters", {})}
        yield (
            *values,
            rng.uniform(0, 5),
            {**params, **{name: rng.normal() for name in case.system.get("tables", {})}},
        )


def check(role, function, equal=same, states=3, controls=2, params=None, tables=None, **options):
    case = Case(role, function, states, controls, params, tables, **options)
    for values in inputs(case, seed=1):
        expected, found = case.both(*values)
        assert len(expected) == len(found)
        for i, (a, b) in enumerate(zip(expected, found, strict=True)):
            assert equal(a, b), f"component {i} is {b!r}, NumPy has {a!r}, at {values}: {case.texts()[i]}"
    return case


def imported(x):
    """The functions that `from numpy import ...` names."""
    out = zeros(3)
    out[:] = array([x[2], x[0], 1.0])
    return where(array([x[0], x[1], 0.5]) > 0, out, -out)


def in_place(x, u, p):
    next = x.copy()
    next[0] += p.a * u[0]
    next[1:] *= 2.0
    view = next[:2]
    view -= 0.25
    x[2] = 7.0
    next.x3 = next.x3 + x.x3
    return next


def filled(x, u):
    out = np.zeros(3)
    for i in range(3):
        out[i] = A[i, 0] * x[0] + u[i % 2]
    out[1:] += np.ones(2)
    return out


# Couples the first row with the last one, and so on.
PAIRS = 0.5 * np.eye(6)[::-1]


def solve_by_factors(matrix, x):
    lower = np.linalg.cholesky(matrix)
    return np.linalg.solve(lower.T, np.linalg.solve(lower, np.append(x, x)))


def rk4_by_hand(x, u, p, t):
    def rate(x, t):
        return np.array([x.x2, -p.a * x.x1 + u[0], t])

    k1 = rate(x, t)
    k2 = rate(x + 0.05 * k1, t + 0.05)
    k3 = rate(x + 0.05 * k2, t + 0.05)
    k4 = rate(x + 0.1 * k3, t + 0.1)
    return x + 0.1 / 6 * (k1 + 2 * k2 + 2 * k3 + k4)


def loop(x):
    total = 0.0
    for value in x:
        total = total + value * abs(value)
    a, b, c = x
    return [total, max(1, 2) * a - b, -(-c)]


def logic(x, u):
    inside = (-1 < x[0]) & (x[0] < 1) | ~(x[1] >= 0.5)
    return [
        np.where(inside, x[0], u[0]),
        np.where(np.any(x > 1) ^ inside, 1, 2),
        np.where(np.all(x[:2] < x[1:]), x[2], 0),
    ]


def counts(x, u):
    over = x > 0.5
    return [np.sum(over) * 1.0, over[0] * x[1] + over[1] * over[2], np.mean(over)]


def conditions_in_place(x):
    over = x > 0
    over &= x < 1
    over[2] = x[0] > x[1]
    return np.where(over, x, -x)


def number_in_an_array(x):
    a, b = np.zeros(()), np.array(0.5)
    a[()] = x[0]
    b += x[1]
    a *= 2.0
    return [a, b[()], np.stack([a, b])[1] - b.copy()]


def conditions_like(x):
    over, all_over = np.zeros_like(x > 0), np.ones_like(x, dtype=bool)
    over[0] = all_over[1] = x[0] > x[1]
    return np.where(over, x, np.where(all_over, 2 * x, 1.0)) + (over[1] + over[2]) + all_over[0]


def kept(x, keepdims):
    """Kept axes broadcast in another way than those that are left out."""
    m = np.outer(x, x)
    over = [np.where(part(m > 0.1, axis=1, keepdims=keepdims), m, 1.0) for part in (np.any, np.all)]
    return sum([*over, *(m + part(m, axis=1, keepdims=keepdims) for part in (np.max, np.min, np.prod))])[1]


def kept_sums(x, keepdims):
    m = np.outer(x, x)
    parts = [part(m, axis=1, keepdims=keepdims) for part in (np.sum, np.mean, np.var, np.std)]
    parts += [m.sum(1, keepdims=keepdims), m.mean(axis=1, keepdims=keepdims)]
    parts += [np.add.reduce(m, 1, keepdims=keepdims)]
    return sum(m + part for part in parts)[1]


EXACT = {
    "number in an array": number_in_an_array,
    "filled with a number": lambda x, u: (
        np.full(3, x[0])
        + np.full((3,), fill_value=u[0])
        + np.full((2, 3), x)[1]
        + np.full_like([1.0, 2.0, 3.0], u[1])
        + np.full((3,), x[0] > 0)
        + np.full_like(x, [x[2], 1, 2], dtype=float)
    ),
    "arrays by the names of NumPy": lambda x: (
        np.array(object=[x[0], 1.0, x[2]]) + np.asarray(a=[1, 2, x[1]]) + np.asarray([x[0]], float, "C")
    ),
    "dtypes of arrays that are like others": lambda x: (
        np.zeros_like(x, dtype=np.float64)
        + np.ones_like(x, dtype=int) / 2 * x
        + np.full_like(x, 2.7, dtype=int)
        + np.full_like(x > 0, 2.0) * x
        + np.full_like(x, 0.1, dtype=np.float32)
        + np.empty_like(x, dtype=bool, shape=()) * 0.0
    ),
    "conditions that are like others": conditions_like,
    "constants among conditions": lambda x: [
        (lambda a: [a[0] + a[2], np.where(~a[0], 5.0, x[1]), a[2] | a[0]])(np.array([True, x[0] > 0, True]))[i]
        * x[i]
        for i in range(3)
    ],
    "inverted constants among conditions": lambda x: [
        (lambda a: ~a[0] * 1.0 + x[0])(np.array([True, x[0] > 0])),
        (lambda a: sum([~(a & a)[0], a.item(0) + a.tolist()[0], *(a | True)]) * x[1])(
            np.array([True, x[0] > 0])
        ),
        (lambda a: (a[0] + a[1]) * x[2])(np.where([True, True, False], True, x > 0)),
    ],
    "counts with constants": lambda x: (
        (lambda a: np.sum(a) + np.cumsum(a) + np.trace(np.stack([a, a])) + np.prod(a) + x)(
            np.array([True, True, x[0] > 0])
        )
    ),
    "largest of conditions": lambda x: (
        (np.maximum(x[0] > 0, x[1] > 0) | np.minimum(x[0] > 0, x[2] > 0)) * x
        + np.abs(x > 0)
        + np.where(np.max(x > 0) & ~np.min(x > 1), x, np.fmax(x > 0, x[0] > 1))
        + np.clip(x > 0, False, x[1] > 0)
    ),
    "integers of conditions": lambda x: (x > 0).astype(int) - 1 + (x[0] > 0).astype(np.int64) * x,
    "where of a constant condition": lambda x: [
        np.where(True, np.float32(0.1), x[0]) * 3.0,
        np.where(False, x[0], True) + np.where(True, True, x[0]),
        np.where(True, 1, x[0]) / 3 + x[1],
    ],
    "operators": lambda x, u: [
        x[0] + u[0] * x[1] - x[2] / u[1],
        -x[0] - -u[0],
        -(x[0] * x[1]) / (x[2] / u[0]),
    ],
    "order": lambda x, u: [x[0] - (x[1] - x[2]), x[0] / (x[1] / x[2]), (x[0] + x[1]) + (x[2] + u[0])],
    "constants": lambda x: [1e-5 * x[0] + -3, 2 - x[1] * np.pi, x[2] - -0.0 + 1e22 * x[0]],
    "unity": lambda x: [1.0 * x[0] + 0.0, x[1] / 1.0 - 0.0, -0.0 + x[2] * 1],
    "zeros": lambda x: [0.0 * x[0], x[1] + 0.0, 0.0 - x[2]],
    "squares": lambda x: [x[0] ** 2, x[1] ** 1 * x[2] ** 0, np.square(x[2])],
    "square of parentheses": lambda x: [-(x[0] ** 2), (-x[1]) ** 2, (x[0] - x[1]) ** 2],
    "reciprocals": lambda x: [x[0] ** -1, np.reciprocal(x[1]), 1 / x[2]],
    "roots of arrays": lambda x: x**0.5,
    "square roots": lambda x: [np.sqrt(np.abs(x[0])), np.sqrt(x[1]), abs(x[2])],
    "list divided": lambda x, u: [x[0], x[1] * 2, x[2]] / u[0],
    "sum of lists": lambda x, u, p: [x[0], x[1], x[2]] + p.a,
    "sum of Python": lambda x: [sum(x), sum([x[0], x[1]]), sum(a * b for a, b in zip(x, x))],
    "by name": lambda x, u, p, t: [x.x1 * p.a, x["x2"] + p["b"], u.u2 * t],
    "in another order": lambda t, p, x: [x[-1] * t, x[-2] - p.a, x[0]],
    "positions": lambda state, action, numbers, time: [state[0] + action[0], numbers.a * time, state[1]],
    "words": lambda state, params, time, action: [state[0] * params.a, time * action[0], state[1]],
    "variadic": lambda *arguments: [arguments[0][0] * arguments[1][0], arguments[2].a, arguments[3]],
    "dict": lambda x: {"x3": x[0], "x1": x[1], "x2": x[2]},
    "nested": lambda x: [np.array([x[2], x[0]]), (x[1],)],
    "in place": in_place,
    "filled": filled,
    "time step": lambda x, p: [x[0] + p.dt * x[1], x[1] * (1 - p["dt"]), x[2] / p.dt],
    "imported": imported,
    "loop": loop,
    "logic": logic,
    "counts": counts,
    "out": lambda x: [np.clip(x, -1, 1, out=x)[0], x[1], np.add(x, x, out=x)[2] + x[0]],
    "views": lambda x: [x[:1].squeeze() * 2, x[1:2].item(), x.ravel()[::-1][0]],
    "conditions in place": conditions_in_place,
    "any": lambda x: np.where((x > 0).any() & ~(x > 1).all(), x, np.where(np.any(x < 0, axis=0), 2 * x, -x)),
    "scalars": lambda x: x * 2 if np.isscalar(x[0]) and np.ndim(x[0]) == 0 and np.size(x) == 3 else -x,
    "polynomial": lambda x: (
        np.polynomial.Polynomial([1.0, 2.0, -3.0])(x[0]) + np.polynomial.polynomial.polyval(x, [1.0, 0.5])
    ),
    "rk4": rk4_by_hand,
    "limits": lambda x: [np.minimum(x[0], x[1]) + 0, np.maximum(x[1], 0.3), np.clip(x[2], -1, 2)],
    "one limit": lambda x, u: [
        np.clip(x[0], None, 0.5),
        np.clip(x[1], -0.5, np.inf),
        np.clip(x[2], a_min=0.1, a_max=None),
    ],
    "limits of arrays": lambda x: np.clip(x, [-1, 0.1, -3], 2.5) + x.clip(-0.5, 0.5),
    "signs": lambda x: np.sign(x) * x,
    "heaviside": lambda x: np.heaviside(x, 0.25) + np.heaviside(x[0], x[1]),
    "fmax": lambda x: [np.fmax(x[0], x[1]) + 0.0, np.fmin(x[1], x[2]) + 0.0, np.fmax(x[0], 0.3)],
    "where of arrays": lambda x: np.where(x > 0, x * 2, [1, 2, 3]),
    "constant conditions": lambda x: np.where([True, False, True], x, 5.0) + np.where(A[0] > 0.2, x, 0.0),
    "conditions of NaN": lambda x: [
        np.where(~(x[0] < x[1]), 1, 2),
        np.where(x[0] >= x[1], 1, 2),
        np.where(x[0] <= 0, 1, 2),
    ],
    "nested conditions": lambda x: np.where(
        x > 0, np.where(x > 1, 1, x), np.where((x < -1) | (x == x[:0].sum()), -1, 0) if False else -x
    ),
    "where of conditions": lambda x: np.where(np.where(x > 0, x < 1, x < -1), x, -x),
    "select": lambda x: np.select([x < -1, x < 0, x < 1], [x, 2 * x, 3 * x], default=4.0),
    "interp": lambda x: [
        np.interp(x[0], XP, FP),
        np.interp(x[1], XP, FP, left=-9, right=9),
        np.interp(x[2], [1.0], [2.0]),
    ],
    "polyval": lambda x: np.polyval([2.0, -1.0, 0.5], x),
    "running sums": lambda x: np.cumsum(x) + np.append(np.diff(x), 1.0) + np.cumprod(x),
    "moves": lambda x: (
        np.roll(x, 1) - np.flip(x) + np.hstack([x[1:], x[0]]) + np.concatenate([[x[0]], x[:2]])
    ),
    "stacks": lambda x: np.stack([x, 2 * x])[1] + np.vstack((x, x))[0] + np.reshape(x, (3, 1)).T.ravel(),
    "constants of constants": lambda x: np.tanh(np.array([np.log(np.ones(3)), np.zeros(3)])).sum(axis=0) + x,
    "like": lambda x: np.zeros_like(x) + np.ones_like(x) * x + np.full_like(x, 2.0),
    "cross": lambda x: np.cross(x, [1.0, x[0], 2.0]) + np.cross(A[0], x),
    "table": lambda x, p: [x[0] + p.wind, p.wind * 2, p["wind"] - x[1]],
    "float32": lambda x: np.array([0.1, 0.2, 0.3], dtype=np.float32) * x + np.float32(0.1),
    "integers": lambda x: np.arange(3) // 2 * x + np.int8(100) * x * np.int64(3) + 7 // 2 + 10**17,
    "array of parameters": lambda x, p: p.A[0] + x * p.A[1, 2],
    "detached": lambda x: trace.detach(x) * x + trace.detach(x[0]) + trace.detach(1.0),
    "long": lambda x, u: [
        sum((x[i % 3] - k) * u[0] / (k + x[1]) for i, k in enumerate(range(1, 30))),
        x[0],
        x[1],
    ],
    "default": lambda x, gain=3.0: x * gain,
    "constant": lambda x: [1.0, 2, np.float64(3.5)],
    "constant arrays": lambda x: np.zeros(3) * 2 + np.eye(3)[0] + (np.eye(3) * 2)[1] + np.zeros(3)[0] / 3 + x,
    "empty": lambda x: np.concatenate([x, x[:0]]),
    "augmented list": lambda x: np.array([x[0], 0.5, x[0] > 0]) * 2 + np.asarray(x),
    "hidden copy": lambda x: [x.copy().x1, x[:].x2, (x * 2).x3],
    "outer method": lambda x, u: np.add.outer(x, u)[:, 0] + np.multiply.outer(x, x)[1],
    "std": lambda x: [np.var(x), 0.0, x.mean()],
    "deep": lambda x: [sum((x[0] for _ in range(200)), x[1]), x[1], x[2]],
}
EXACT["nested conditions"] = lambda x: np.where(
    x > 0, np.where(x > 1, 1, x), np.where((x < -1) | (x > -0.5), -1, -x)
)
# Sums, whose zeros have other signs in other releases of NumPy.
SUMS = {
    "sums": lambda x, u: [x.sum() + np.sum(x[:2]), np.mean(x) - np.prod(u), np.max(x) - x.min()],
    "sums by axis": lambda x, u: np.sum(np.outer(x, u), axis=1) + np.outer(u, x).sum(axis=0),
    "means": lambda x, u: [np.outer(x, u).mean(), *np.mean(np.outer(u, x), axis=1)],
    "sums in pairs": lambda x, u: [
        np.sum(np.outer(x, x)),
        np.sum(np.outer(np.outer(x, x), x)),
        np.sum(np.outer(np.outer(x, x), np.outer(x, np.outer(u, x)))),
    ],
    "rows in pairs": lambda x: np.sum(np.outer(x, np.concatenate([x, x, x, x])), axis=-1),
    "reductions by method": lambda x: (
        np.add.reduce(np.outer(x, x)) + np.multiply.accumulate(x) + np.maximum.reduce(x)
    ),
    "traces": lambda x, u: np.outer(x, x).trace() + np.trace(np.outer(u, u)) + np.diag(np.outer(x, x)),
}
CLOSE = {
    "trigonometry": lambda x: [
        np.sin(x[0]) * np.cos(x[1]),
        np.tan(x[2]),
        np.arctan(x[0]) + np.arctan2(x[1], x[2]),
    ],
    "inverses": lambda x: [np.arcsin(x[0]), np.arccos(x[1]), np.arctan2(x[2], 1.0)],
    "exponentials": lambda x: [np.exp(-np.abs(x[0])), np.log(np.abs(x[1])), np.tanh(x[2])],
    "hyperbolic": lambda x: [np.sinh(x[0]), np.cosh(x[1]), np.arctanh(x[2])],
    "logarithms": lambda x: [np.log2(np.abs(x[0])), np.log10(np.abs(x[1])), np.log1p(x[2])],
    "small": lambda x: [np.log1p(x[0] * 1e-12), np.expm1(x[1] * 1e-12), np.expm1(x[2])],
    "powers": lambda x: [x[0] ** 3, x[1] ** -2, np.abs(x[2]) ** 1.7],
    "power functions": lambda x, p: [
        np.power(x[0], 4),
        np.float_power(np.abs(x[1]), 0.5),
        np.power(np.abs(x[2]), p.a),
    ],
    "traced exponents": lambda x, u: [np.abs(x[0]) ** u[0], 2.0 ** x[1], x[2] ** 5],
    "angles": lambda x: [np.deg2rad(x[0]), np.degrees(x[1]), np.radians(x[2])],
    "hypot": lambda x: [np.hypot(x[0], x[1]), np.hypot(x[2], 3.0), np.exp2(x[0])],
    "cbrt": lambda x: np.cbrt(np.where(np.abs(x) < 0.1, 0.0, x)) * (np.abs(x) < 1e3),
    "logaddexp": lambda x: np.logaddexp(0.0, x),
    "methods of elements": lambda x: np.sin(np.array([x[0], x[1], 0.5])) + [np.cos(v) for v in x],
}
# Sums of products: their order in NumPy depends on its libraries. Checked at finite numbers.
PRODUCTS = {
    "matrix": lambda x: A @ x + x @ A + A.dot(x) + np.dot(A, x) + x.dot(A) + np.matmul(A, x),
    "transposed": lambda x: x.T @ A @ x * np.ones(3),
    "norms": lambda x: [np.linalg.norm(x), np.linalg.norm(x, axis=0), np.linalg.norm([x[0], x[1]])],
    "other norms": lambda x: [
        np.linalg.norm(x, 1),
        np.linalg.norm(x, np.inf),
        np.linalg.norm(np.outer(x, x)),
    ],
    "rows": lambda x: np.linalg.norm(np.outer(x, x), axis=1),
    "deviations": lambda x, u: [
        np.std(x),
        x.var() - np.var(x, ddof=1),
        np.outer(x, u).std(axis=1).sum() + x.std(),
    ],
    "inner": lambda x: np.inner(x, x) + np.vdot(x, x) + np.einsum("i,i", x, x) + np.einsum("ij,j->i", A, x),
    "einsum of one element": lambda x: (
        np.einsum("i,i->i", x[:1], x) + np.einsum("ij,i->j", np.ones((1, 3)), x)
    ),
    "einsum": lambda x: (
        np.einsum("ij,jk,k->i", A, A, x)
        + np.einsum("ii->i", np.outer(x, x))
        + np.einsum("ij->i", np.outer(x, x))
    ),
    "kron": lambda x: np.kron(x, [1.0, 2.0])[:3] + np.tensordot(A, x, 1),
    "constant matrix": lambda x: (
        np.linalg.solve(A, x) + np.linalg.inv(A) @ x + np.linalg.det(A) * np.linalg.norm(A)
    ),
    "traced 1": lambda x: np.linalg.solve(np.array([[2.0 + x[0] ** 2]]), x[:1])[0] * np.ones(3),
    "traced 2": lambda x, u: [
        *np.linalg.solve(np.array([[3 + x[0] ** 2, 1], [1, 2]]), u),
        np.linalg.det(np.array([[x[0], 1], [x[1], 2]])),
    ],
    "traced 3": lambda x: (
        np.linalg.solve(np.outer(x, x) + 2 * np.eye(3), x) + np.linalg.inv(np.outer(x, x) + np.eye(3))[1]
    ),
    "traced 4": lambda x: np.linalg.solve(
        np.diag([1, 2, 3 + x[0] ** 2, 4]) + np.ones((4, 4)) * 0.1, np.append(x, 1.0)
    )[1:],
    "cholesky": lambda x: np.linalg.cholesky(np.outer(x, x) + 2 * np.eye(3)) @ x,
    "cholesky of six rows": lambda x: solve_by_factors(np.outer(*[np.tile(x, 2)] * 2) + 2 * np.eye(6), x)[:3],
    "separate equations": lambda x: np.linalg.solve(np.diag(np.tile(2 + x**2, 2)) + PAIRS, np.ones(6))[2:5],
    "right sides": lambda x: np.linalg.solve(np.outer(x, x) + 2 * np.eye(3), np.eye(3))[2],
}
PARAMS = {"a": 1.5, "b": -0.5, "A": np.array([[1.0, 2.0, 3.0], [4.0, 5.0, 6.0]])}
TABLES = {"wind": [0.0, 0.5]}


@pytest.mark.parametrize("name", EXACT)
def test_arithmetic_has_the_bits_of_numpy(name):
    check("rate", EXACT[name], params=PARAMS, tables=TABLES)
    if name not in ("table", "positions"):
        check("step", EXACT[name], params=PARAMS)


@pytest.mark.parametrize("keepdims", [True, 1, 0])
def test_axes_are_kept_as_numpy_keeps_them(keepdims):
    check("rate", lambda x: kept(x, keepdims))
    check("rate", lambda x: kept_sums(x, keepdims), lambda a, b: close(a, b, 1e-13))
    # Some releases of NumPy take np.True_ too.
    texts = [Case("rate", lambda x: kept(x, value), 3).texts() for value in (bool(keepdims), np.bool_(keepdims))]
    assert texts[0] == texts[1]


@pytest.mark.parametrize("name", SUMS)
def test_sums_add_in_the_order_of_numpy(name):
    check("rate", SUMS[name], lambda a, b: a == b or same(a, b))


@pytest.mark.parametrize("name", CLOSE)
def test_functions_agree_with_numpy(name):
    check("rate", CLOSE[name], lambda a, b: close(a, b, 4e-15), params=PARAMS)


@pytest.mark.parametrize("name", PRODUCTS)
def test_products_agree_with_numpy(name):
    case = Case("rate", PRODUCTS[name], 3, 2, PARAMS)
    rng = np.random.default_rng(2)
    for _ in range(50):
        expected, found = case.both(
            rng.normal(size=3), rng.normal(size=2), rng.normal(size=3), 0.0, {"a": 1.0, "b": 1.0}
        )
        assert np.allclose(found, expected, rtol=1e-12, atol=1e-13), case.texts()


def test_comparisons_with_infinity_have_the_truth_of_numpy():
    operations = [np.less, np.less_equal, np.greater, np.greater_equal]

    def observe(x):
        return [
            1.0 * operation(*pair)
            for operation in operations
            for bound in (np.inf, -np.inf)
            for pair in ((x[0], bound), (bound, x[0]))
        ]

    case = Case("observe", observe, 1)
    largest = np.finfo(float).max
    for value in (0.0, largest, -largest, np.inf, -np.inf, np.nan):
        expected, found = case.both([value], [], [0.0], 0.0)
        assert expected == found, value


COSTS = {
    "distance": lambda x, u, next: np.sum((next - x) ** 2) + 0.1 * u[0] ** 2,
    "all": lambda x, u, next, p, t: [next.x1 * p.a - x.x2 * t],
    "positions": lambda state, action, after, numbers, time: (
        state[0] - action[1] + after[2] * numbers.a + time
    ),
    "shared": lambda next: (
        (np.clip(next[0] * next[1] - next[2], -1, 1) / (1 + abs(next[0] * next[1] - next[2]))) ** 2
    ),
    "long and shared": lambda next: sum(
        v * v for v in [next[0] / (next[1] ** 2 + next[2] ** 2 + next[0] ** 2 + 1.0)]
    ),
}


@pytest.mark.parametrize("name", COSTS)
def test_running_costs_have_the_bits_of_numpy(name):
    check("running_cost", COSTS[name], params=PARAMS)


def test_observations_and_terminal_costs_have_the_bits_of_numpy():
    check("observe", lambda x, p, t: {"a": x[0] * p.a, "b": [x[1:], t]}, params=PARAMS)
    check("observe", lambda x: x[0], params=PARAMS)
    check("terminal_cost", lambda x, p: p.a * x[2], params=PARAMS)


def test_names_of_attributes_of_arrays_are_names():
    """A state `T` is not the transpose."""
    labels = [name for name in dir(np.ndarray) if not name.startswith("_") and name not in trace.RESERVED]

    def rate(x, p):
        total = x + np.sin(x) * 2
        total[0] += x.T * p.numbers
        x *= 0.5
        return total + x + total.shape - x["size"] + np.where(x > 0, x.dtype, x.view)

    assert len(Case("rate", rate, labels, params={"numbers": 2.0}).texts()) == len(labels)
    assert Case("rate", lambda x: [getattr(x, name) for name in labels], labels).texts() == labels


def test_names_of_parameters_may_be_those_of_methods():
    settings = trace.trace_settings(
        lambda x, p: x * p.values * p["keys"], states=1, params={"values": 1, "keys": 2}, dt=0.1
    )
    assert settings["system"]["rate"]["x1"] == "x1 * values * keys"


def test_names_of_the_package_are_names():
    def rate(x, p):
        y = x * p["_values"] + p._used + np.where(x > 0, x, p._values)
        y._index = y._names + y["_given"]
        return y[:].copy() + x._unknown

    labels = ["_names", "_given", "_index", "_unknown", "_value"]
    check("rate", rate, states=labels, controls=0, params={"_values": 2.0, "_used": 3.0})
    with pytest.raises(AttributeError, match="there is no `x`"):
        trace.trace_settings(lambda x: x * x.x, states=labels, dt=0.1)


def tanks(x, u, p, t):
    q = p.valve * np.sqrt(x.h1)
    return [p.gain * np.clip(u.pump, 0, 5) - q, q - p.valve * np.sqrt(x.h2)] / p.area


def test_the_settings_of_two_tanks():
    found = trace.trace_settings(
        tanks,
        states=["h1", "h2"],
        controls={"pump": (0, 5)},
        dt=1.0,
        horizon=50,
        start={"h1": distributions.uniform(0.1, 0.5)},
        params={
            "valve": distributions.trained(0.02, min=0),
            "gain": distributions.normal(0.01, 0.001),
            "area": 1.0,
        },
        running_cost=lambda x, u, next, p, t: (next.h2 - 0.3) ** 2 + 1e-3 * u.pump**2,
        terminal_cost=lambda x: x.h1 - x.h2,
        observe=lambda x: [x.h1, x.h2 - 0.3],
        units={"h1": "m"},
        substeps=2,
        epochs=3,
        training={"learning_rate": 1e-3},
    )
    assert found == {
        "task": "equations",
        "horizon": 50,
        "system": {
            "states": ["h1", "h2"],
            "controls": ["pump"],
            "dt": 1.0,
            "bounds": {"pump": [0.0, 5.0]},
            "units": {"h1": "m"},
            "parameters": {
                "valve": {"start": 0.02, "min": 0.0},
                "gain": {"normal": [0.01, 0.001]},
                "area": 1.0,
            },
            "start": {"h1": {"uniform": [0.1, 0.5]}},
            "define": {"v1": "valve * sqrt(h1)"},
            "observe": ["h1", "h2 - 0.3"],
            "rate": {"h1": "(gain * clip(pump, 0, 5) - v1) / area", "h2": "(v1 - valve * sqrt(h2)) / area"},
        },
        "loss": {"running": "(next.h2 - 0.3)^2 + 0.001 * pump^2", "terminal": "h1 - h2"},
        "integrator": {"method": "rk4", "substeps": 2},
        "epochs": 3,
        "training": {"learning_rate": 1e-3},
    }


def test_tables_and_steps():
    found = trace.trace_settings(
        step=lambda x, p: x + p.wind,
        states=1,
        params={"wind": distributions.table([0.0, 0.5])},
        dt=0.1,
        tables={"gust": [1, 2]},
    )
    assert found["system"]["tables"] == {"gust": [1.0, 2.0], "wind": [0.0, 0.5]}
    assert (
        found["system"]["next"] == {"x1": "x1 + wind"} and "integrator" not in found and "loss" not in found
    )


def test_the_name_dt_is_that_of_the_time_step():
    for given in ({"states": ["dt"]}, {"params": {"dt": 2.0}}, {"tables": {"dt": [1.0]}}, {"controls": ["dt"]}):
        with pytest.raises(ValueError, match="`dt` in `.*` has a meaning in expressions"):
            trace.trace_settings(**{"step": lambda x, p: x * p.dt, "states": 1, "dt": 0.1} | given)
    # It is no parameter in the order.
    assert len(trace.trace_settings(step=lambda x, p: x * (1 + len(p)), states=1, dt=0.1)["system"]) == 4
    with pytest.raises((AttributeError, LookupError), match="there is no parameter"):
        trace.trace_settings(step=lambda x, p: x * p["_used"], states=1, dt=0.1)


def test_a_step_follows_a_change_of_dt():
    pg = pytest.importorskip("physgrad", reason="needs the compiled module")
    if not hasattr(pg, "Task"):
        pytest.skip("needs the compiled module")
    task = pg.system(step=lambda x, u, p: x + p.dt * u, states=1, controls=1, dt=0.5)
    x, u = np.array([[1.0]]), np.array([[2.0]])
    assert task.step(x, u) == 2.0 and task.replace(dt=0.25).step(x, u) == 1.5


def test_system_has_the_arguments_of_its_settings():
    found = list(inspect.signature(trace.system).parameters.values())
    assert found == list(inspect.signature(trace.trace_settings).parameters.values())


def test_generated_names_differ_from_all_names():
    def rate(x, p):
        twice = np.sin(x[0]) + p.v2
        return [twice * twice, twice, twice * p.v4]

    found = trace.trace_settings(rate, states=["v1", "y", "z"], params={"v2": 1.0, "v4": 1.0}, dt=0.1)[
        "system"
    ]
    assert found["define"] == {"v3": "sin(v1) + v2"} and found["rate"]["z"] == "v3 * v4"


def test_long_expressions_are_broken():
    case = Case("rate", EXACT["long"], 3, 2)
    texts = [*case.texts(), *case.system["define"].values()]
    assert len(texts) > 5 and max(map(len, texts)) <= 100


def by_xor(x):
    c = x[0] > 0
    for i in range(40):
        c = c ^ (x[0] > 0.1 * i)
    return np.where(c, x, -x)


def by_where(x):
    c = x[0] > 0
    for i in range(40):
        c = np.where(c, c & (x[0] > 0.1 * i), ~c)
    return np.where(c, x, -x)


def by_chains(x):
    c, d = x[0] > 0, x[1] > 0
    for i in range(40):
        c, d = c | (x[1] > 3 + i), ~(d & (x[0] < 0.1 * i))
    return np.where(c & d, x, np.where(~c, 2 * x, -x))


@pytest.mark.parametrize("function", [by_xor, by_where, by_chains])
def test_conditions_of_conditions_are_shared(function):
    """Repeated at each use, 40 conditions would be 2^40 comparisons."""
    begin = time.perf_counter()
    case = Case("rate", function, 2)
    assert time.perf_counter() - begin < 1.0
    texts = [*case.texts(), *case.system["define"].values()]
    assert max(map(len, texts)) <= 120 and sum(map(len, texts)) < 40 * 120
    for a in [*np.linspace(-0.55, 5.05, 57), np.nan]:
        for b in (-1.0, 3.5, np.nan):
            expected, found = case.both([a, b], [], [0.0, 0.0], 0.0)
            assert all(map(same, expected, found)), (a, b)


def of_1000_operations(x, u):
    a, b = x
    for _ in range(125):
        a = a + 0.1 * np.sin(b) - 0.01 * a * b
        b = b * a / 3.0
    return [a, b + u[0]]


def test_a_thousand_operations_are_traced_soon():
    """The limit is several times what an idle machine needs."""
    times = []
    for _ in range(5):
        begin = time.process_time()
        found = trace.trace_settings(of_1000_operations, states=2, controls=1, dt=0.1)
        times.append(time.process_time() - begin)
    assert len(found["system"]["define"]) == 249
    assert min(times) < 0.04, times


def test_short_conditions_are_repeated():
    case = Case("rate", lambda x: np.where((x[0] > 0) ^ (x[1] > 1), x, -x), ["a", "b"])
    assert case.system["define"] == {"v1": "where((a > 0 or b > 1) and not (a > 0 and b > 1), 1, 0)"}
    assert case.texts() == ["where(v1 > 0.5, a, -a)", "where(v1 > 0.5, b, -b)"]
    assert "define" not in Case("rate", lambda x: np.where((x > 0).all(), x, -x), ["a", "b"]).system


def test_only_needed_parentheses_are_written():
    def rate(x):
        a, b, c = x
        return [a - (b - c) * -(a / b), (a * b) ** 2 * (a - b) - (-c) ** 2, -(a**2) / (b * c) + (a + b) + c]

    assert Case("rate", rate, ["a", "b", "c"]).texts() == [
        "a - (b - c) * -(a / b)",
        "(a * b)^2 * (a - b) - (-c)^2",
        "-a^2 / (b * c) + (a + b) + c",
    ]


def test_equal_operations_are_shared_among_functions():
    found = trace.trace_settings(
        lambda x: [np.sin(x[0] * 2), x[1]],
        states=2,
        dt=0.1,
        terminal_cost=lambda x: np.sin(x[0] * 2),
        observe=lambda x: x[0] * 2,
    )
    assert found["system"]["define"] == {"v1": "2 * x1"} or found["system"]["define"].keys() == {"v1", "v2"}


def test_arrays_of_parameters_are_constants():
    gains = np.array([[1.0, 0.0], [0.0, 2.0]])
    settings = trace.trace_settings(lambda x, p: p.K @ x, states=2, params={"K": gains}, dt=0.1)
    assert "parameters" not in settings["system"] and settings["system"]["rate"]["x2"] == "0 * x1 + 2 * x2"
    gains[0, 0] = 5.0
