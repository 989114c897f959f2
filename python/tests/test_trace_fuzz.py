"""Random functions of random operations of NumPy, against NumPy."""

import importlib.util
import os

import numpy as np
import pytest
from equations import Case, same, trace

N, M = 3, 2
UNARY = [
    np.negative,
    np.abs,
    np.square,
    np.sqrt,
    np.sin,
    np.cos,
    np.tanh,
    np.exp,
    np.sign,
    np.arctan,
    np.reciprocal,
    lambda a: a**2,
    lambda a: -a,
    abs,
    np.copy,
    np.flip,
    lambda a: np.roll(a, 1),
    lambda a: a[::-1] if np.ndim(a) else a,
    lambda a: a[0] if np.ndim(a) else a,
    lambda a: a[..., -1] if np.ndim(a) else a,
    np.transpose,
    np.ravel,
    np.zeros_like,
    lambda a: np.clip(a, -0.5, 2.0),
    lambda a: np.maximum(a, 0.0),
    lambda a: 2.0 * a,
    lambda a: 1 - a,
    lambda a: a / 3,
    lambda a: np.where(a > 0.3, a, -1.0),
    lambda a: np.where((a > -1) & ~(a > 1), a, 2.0),
    lambda a: a * (a < 0.5),
    np.diff,
    lambda a: np.max(a),
    np.atleast_1d,
    np.prod,
    np.cumsum,
    lambda a: np.stack([a, 2 * a]),
    lambda a: np.reshape(a, -1),
    lambda a: np.sum(a, axis=0),
    lambda a: np.minimum.reduce(a),
]
BINARY = [
    np.add,
    np.subtract,
    np.multiply,
    np.divide,
    np.maximum,
    np.minimum,
    np.hypot,
    np.arctan2,
    lambda a, b: a + b,
    lambda a, b: a - b,
    lambda a, b: a * b,
    lambda a, b: a / b,
    lambda a, b: np.where(a < b, a, b),
    lambda a, b: np.where(a >= b, 1.0, b),
    np.outer,
    lambda a, b: np.array([a, b]),
    lambda a, b: np.concatenate([a, b]),
    lambda a, b: np.append(a, b),
    lambda a, b: np.select([a > b, a > 0], [a, b], 0.5),
    lambda a, b: np.heaviside(a, b),
    lambda a, b: np.fmax(a, b),
    lambda a, b: changed(a, b),
]
# NumPy 1 computes float32 arrays with float64 scalars in float32; the tracer follows NumPy 2.
TENTH = np.float32(0.1) if np.lib.NumpyVersion(np.__version__) >= "2.0.0" else 0.1
CONSTANTS = [0.0, 1.0, -2.5, 3, TENTH, np.array([1.0, -1.0, 0.5]), np.arange(2), np.eye(2), 1e-3]


def changed(a, b):
    """Changes an array in place."""
    a = np.array(a)
    a[..., 0] += b[..., 0]
    a *= 0.5
    return a


class Program:
    """Operations on registers, of which the first are arguments and constants."""

    def __init__(self, seed, unary=UNARY, binary=BINARY):
        rng = np.random.default_rng(seed)
        self.steps, self.chosen = [], CONSTANTS
        registers = self.begin(rng.normal(size=N), rng.normal(size=M), rng.normal(), 0.3)
        while len(self.steps) < 12:
            operations = unary if rng.random() < 0.5 else binary
            operation = operations[rng.integers(len(operations))]
            count = 1 if operations is unary else 2
            # Later registers are more likely, so that operations nest.
            places = [int(len(registers) * rng.random() ** 0.5) for _ in range(count)]
            try:
                with np.errstate(all="ignore"):
                    result = operation(*(registers[place] for place in places))
            except (ValueError, IndexError, TypeError, ZeroDivisionError):
                continue
            # Old releases of NumPy make arrays of rows of different lengths.
            if np.size(result) > 40 or np.size(result) == 0 or np.asarray(result).dtype == object:
                continue
            registers.append(result)
            self.steps.append((operation, places))

    def begin(self, x, u, a, t):
        return [x, u, a, t, x[0], x[1], u[1], *self.chosen]

    def __call__(self, x, u, p, t):
        registers = self.begin(x, u, p.a, t)
        for operation, places in self.steps:
            registers.append(operation(*(registers[place] for place in places)))
        return np.concatenate([np.ravel(value) for value in registers[-6:]])


@pytest.mark.filterwarnings("ignore::RuntimeWarning")
# Sums of NumPy begin at 0.0 or -0.0, depending on the release; all else has equal bits.
@pytest.mark.parametrize("block", range(16 if os.environ.get("PHYSGRAD_PYTHON_ALL") == "1" else 6))
def test_random_functions_have_the_bits_of_numpy(block):
    differing, traced = 0, 0
    for seed in range(100 * block, 100 * block + 100):
        program = Program(seed)
        try:
            case = Case(
                "observe", lambda x, p, t, program=program: program(x, x[:2], p, t), N, params={"a": 1.0}
            )
        except ValueError as error:
            # Operations on constants alone may divide by zero.
            assert "finite" in str(error)
            continue
        except TypeError as error:
            assert "make the constants float64" in str(error)
            continue
        traced += 1
        rng = np.random.default_rng(seed)
        for trial in range(6):
            x = (
                rng.normal(size=N)
                if trial % 2
                else rng.choice([0.0, -0.0, 1.0, -1.0, 0.5, np.inf, np.nan, 1e300, 1e-310], N)
            )
            expected, found = case.both(x, [], x, rng.random(), {"a": rng.normal()})
            assert len(expected) == len(found)
            for i, (a, b) in enumerate(zip(expected, found, strict=True)):
                assert same(a, b) or (a == b == 0.0), (
                    f"seed {seed}, component {i}: NumPy {a!r}, text {b!r}: {case.texts()[i]}"
                )
                differing += not same(a, b)
    assert traced >= 70
    assert differing <= 40


@pytest.mark.filterwarnings("ignore::RuntimeWarning")
def test_the_comparison_notices_a_wrong_operation(monkeypatch):
    from physgrad import _trace_elements

    monkeypatch.setitem(
        _trace_elements.ELEMENTWISE, "subtract", lambda a, b: trace.numbers.apply("add", a, b)
    )
    with pytest.raises(AssertionError):
        test_random_functions_have_the_bits_of_numpy(0)


# Functions that NumPy also has for complex numbers, except at kinks.
SMOOTH_UNARY = [
    *[
        np.negative,
        np.square,
        np.sin,
        np.cos,
        np.tanh,
        np.exp,
        np.arctan,
        np.sinh,
        np.expm1,
        np.cumsum,
        np.prod,
    ],
    *[np.flip, np.ravel, np.diff],
    lambda a: np.sqrt(1 + a * a),
    lambda a: np.log(1 + a * a),
    lambda a: 1 / (2 + np.sin(a)),
    lambda a: a**3,
    lambda a: (1 + a * a) ** 0.3,
    lambda a: np.arcsin(0.5 * np.sin(a)),
    lambda a: np.where((a > -1) & ~(a > 1), a, 2.0),
    lambda a: a[::-1] if np.ndim(a) else a,
    lambda a: a[0] if np.ndim(a) else a,
    lambda a: np.mean(a),
    lambda a: np.linalg.solve(np.outer(a, a) + 3 * np.eye(len(a)), a) if np.shape(a) in ((2,), (3,)) else a,
]
SMOOTH_BINARY = [
    *[np.add, np.subtract, np.multiply, np.outer, np.append],
    lambda a, b: a / (2 + np.sin(b)),
    lambda a, b: np.where(a < b, a, b),
    lambda a, b: np.array([a, b]),
    lambda a, b: a @ b,
    lambda a, b: np.einsum("i,i->i", a, b),
]


def random_derivatives(seeds):
    """Compares derivatives of random functions with those of a step along the imaginary axis."""
    import physgrad as pg

    compared = 0
    for seed in seeds:
        program = Program(seed, SMOOTH_UNARY, SMOOTH_BINARY)
        try:
            task = pg.system(
                lambda x: x,
                states=N,
                controls=1,
                dt=0.1,
                observe=lambda x, p, t: program(x, x[:2], p, t),
                params={"a": 1.3},
            )
        except ValueError as error:
            assert "finite" in str(error)
            continue
        params, rng = type("Params", (), {"a": 1.3}), np.random.default_rng(seed)
        x = rng.normal(size=(4, N))
        y = task.observe(x)
        bars = rng.normal(size=y.shape)
        found = task.observe_vjp(x, bars)[0]
        for i in range(len(x)):
            steps = [x[i] + 1e-200j * unit for unit in np.eye(N)]
            slopes = np.array([program(z, z[:2], params, 0.0).imag * 1e200 for z in steps])
            size = np.abs(slopes * bars[i]).sum(axis=1).max()
            if np.isfinite(size) and size < 1e6:
                assert np.abs(found[i] - slopes @ bars[i]).max() <= 1e-11 * max(size, 1.0), f"seed {seed}"
                compared += 1
    assert compared > 2 * len(seeds)


needs_module = pytest.mark.skipif(
    importlib.util.find_spec("physgrad._core") is None, reason="the compiled module is not installed"
)


@needs_module
@pytest.mark.filterwarnings("ignore::RuntimeWarning")
@pytest.mark.parametrize("block", range(10 if os.environ.get("PHYSGRAD_PYTHON_ALL") == "1" else 1))
def test_random_functions_have_the_derivatives_of_complex_steps(block):
    random_derivatives(range(100 * block, 100 * block + 100))


@needs_module
@pytest.mark.filterwarnings("ignore::RuntimeWarning")
def test_the_comparison_of_derivatives_notices_a_constant(monkeypatch):
    from physgrad import _trace_elements

    monkeypatch.setitem(
        _trace_elements.ELEMENTWISE, "sin", lambda a: trace.detach(trace.numbers.apply("sin", a))
    )
    with pytest.raises(AssertionError):
        random_derivatives(range(100))
