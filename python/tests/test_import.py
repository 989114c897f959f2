"""Functions of CasADi and JAX become equations with the values and the derivatives of CasADi and JAX."""

import importlib.util

import numpy as np
import pytest
from equations import Reader, trace

from_jax = trace.JaxFunction
needs_casadi = pytest.mark.skipif(importlib.util.find_spec("casadi") is None, reason="CasADi is not installed")
needs_jax = pytest.mark.skipif(importlib.util.find_spec("jax") is None, reason="JAX is not installed")
needs_module = pytest.mark.skipif(
    importlib.util.find_spec("physgrad._core") is None, reason="the compiled module is not installed"
)
SPECIAL = [0.0, -0.0, 1.0, -1.0, 0.5, -0.5, 2.0, 3.7, -25.0, 40.0, 1e-9, -1e-9, 1e200, -1e200]
NOT_FINITE = [np.inf, -np.inf, np.nan]
A, B = ["x1", "x2", "x3"], ["u1"]


def texts_of(function, states=A, controls=(), **options):
    """A function of the expressions of an imported function, as an observation."""
    found = trace.trace_settings(
        lambda x: x, states=states, controls=controls, dt=0.1, observe=function, **options
    )["system"]

    def values(x, t=0.0, **params):
        reader = Reader(found.get("define", {}), {**dict(zip(states, map(np.float64, x))), **params, "t": t})
        with np.errstate(all="ignore"):
            return np.array([reader.read(text) for text in found["observe"]])

    values.texts = found["observe"]
    return values


def agree(expected, found, tolerance, scale=0.0):
    expected, found = np.ravel(expected), np.ravel(found)
    finite = np.isfinite(expected)
    assert expected.shape == found.shape
    assert np.array_equal(expected[~finite], found[~finite], equal_nan=True), (expected, found)
    error = np.abs(expected[finite] - found[finite])
    assert np.all(error <= tolerance * np.maximum(np.abs(expected[finite]), scale)), (expected, found, error)


# Models.


def van_der_pol(ca, x, u, p):
    """The oscillator of the example `direct_multiple_shooting.py` of CasADi."""
    return ca.vertcat((1 - x[1] ** 2) * x[0] - x[1] + u[0], p * x[0])


def reactor(ca, x, u, p):
    """The CSTR of the documentation of do-mpc, "Continuous stirred tank reactor (CSTR)"; p is alpha."""
    a, b, hot, jacket = x[0], x[1], x[2], x[3]
    k1 = 1.287e12 * ca.exp(-9758.3 / (hot + 273.15))
    k2 = 1.287e12 * ca.exp(-9758.3 / (hot + 273.15))
    k3 = 9.043e9 * ca.exp(-p * 8560.0 / (hot + 273.15))
    heat = (k1 * a * 4.2 + k2 * b * -11.0 + k3 * a**2 * -41.85) / (-0.9342 * 3.01)
    flow = 4032.0 * 0.215
    return ca.vertcat(
        u[0] * (5.1 - a) - k1 * a - k3 * a**2,
        -u[0] * b + k1 * a - k2 * b,
        heat + u[0] * (130.0 - hot) + flow * (jacket - hot) / (0.9342 * 3.01 * 10.01),
        (u[1] + flow * (hot - jacket)) / (5.0 * 2.0),
    )


def cart_pole(ca, x, u, p):
    """The pendulum on a cart of the examples of acados, `pendulum_model.py`; p is the mass of the ball."""
    s, c, length, gravity = ca.sin(x[1]), ca.cos(x[1]), 0.8, 9.81
    below = 1.0 + p - p * c * c
    return ca.vertcat(
        x[2],
        x[3],
        (-p * length * s * x[3] * x[3] + p * gravity * c * s + u[0]) / below,
        (-p * length * c * s * x[3] * x[3] + u[0] * c + (1.0 + p) * gravity * s) / (length * below),
    )


class Numpy:
    """`vertcat` for functions of JAX."""

    def __init__(self, jnp):
        self.vertcat, self.exp, self.sin, self.cos = (lambda *parts: jnp.stack(parts)), jnp.exp, jnp.sin, jnp.cos


MODELS = {
    "van der Pol": (van_der_pol, 2, 1, [0.5, -0.8], [0.3], 1.1),
    "reactor": (reactor, 4, 2, [0.8, 0.5, 134.14, 130.0], [5.0, -1000.0], 1.02),
    "cart-pole": (cart_pole, 4, 1, [0.1, 2.5, -0.4, 1.2], [3.0], 0.15),
}


def case_of(name):
    model, n, m, x, u, p = MODELS[name]
    rng = np.random.default_rng(1)
    xs = np.array(x) * rng.uniform(0.9, 1.1, (20, n))
    us = np.array(u) * rng.uniform(0.5, 1.5, (20, m))
    ps = p * rng.uniform(0.9, 1.1, (20, 1))
    return model, n, m, xs, us, ps, rng.normal(size=(20, n))


def task_of(function, n, m):
    import physgrad as pg

    return pg.system(step=function, states=n, controls=m, params={"k": pg.uniform(0.1, 2.0)}, dt=0.01)


@needs_casadi
@needs_module
@pytest.mark.parametrize("kind", ["SX", "MX"])
@pytest.mark.parametrize("name", MODELS)
def test_steps_have_the_derivatives_of_casadi(name, kind):
    import casadi as ca

    model, n, m, xs, us, ps, bars = case_of(name)
    x, u, p = (getattr(ca, kind).sym(s, size) for s, size in (("x", n), ("u", m), ("p", 1)))
    next = x + 0.01 * model(ca, x, u, p)
    f = ca.Function("f", [p, x, u], [next], ["p", "x", "u"], ["next"])
    task = task_of(f, n, m)
    bar = getattr(ca, kind).sym("bar", n)
    vjp = ca.Function("vjp", [x, u, p, bar], [ca.jtimes(next, v, bar, True) for v in (x, u, p)])
    found = task.step_vjp(xs, us, bars, p=ps)
    for i in range(len(xs)):
        agree(f(ps[i], xs[i], us[i]), task.step(xs, us, p=ps)[i], 1e-12)
        for expected, part in zip(vjp(xs[i], us[i], ps[i], bars[i]), found, strict=True):
            agree(expected, part[i], 1e-12, scale=np.abs(bars[i]).max())


@needs_jax
@needs_module
@pytest.mark.parametrize("name", MODELS)
def test_steps_have_the_derivatives_of_jax(name):
    import jax
    import jax.numpy as jnp

    model, n, m, xs, us, ps, bars = case_of(name)
    task = task_of(from_jax(lambda x, u, p: x + 0.01 * model(Numpy(jnp), x, u, p.k)), n, m)
    found, next = task.step_vjp(xs, us, bars, p=ps), task.step(xs, us, p=ps)
    with trace_float64():
        for i in range(len(xs)):
            values, vjp = jax.vjp(
                lambda x, u, p: x + 0.01 * model(Numpy(jnp), x, u, p[0]), *map(jnp.array, (xs[i], us[i], ps[i]))
            )
            agree(values, next[i], 1e-12)
            for expected, part in zip(vjp(jnp.array(bars[i])), found, strict=True):
                agree(expected, part[i], 1e-12, scale=np.abs(bars[i]).max())


@needs_casadi
@needs_module
def test_the_comparison_of_derivatives_notices_a_fault(monkeypatch):
    from physgrad import _import_casadi

    monkeypatch.setitem(_import_casadi.RULES, "OP_SQ", lambda a: trace.numbers.apply("mul", a, trace.detach(a)))
    with pytest.raises(AssertionError):
        test_steps_have_the_derivatives_of_casadi("van der Pol", "SX")


@needs_casadi
def test_models_of_do_mpc_are_functions_of_casadi():
    do_mpc = pytest.importorskip("do_mpc", reason="do-mpc is not installed")
    model = do_mpc.model.Model("continuous")
    x = [model.set_variable("_x", name) for name in ("C_a", "C_b", "T_R", "T_K")]
    u = [model.set_variable("_u", name) for name in ("F", "Q_dot")]
    alpha = model.set_variable("_p", "alpha")
    import casadi as ca

    for label, value in zip(("C_a", "C_b", "T_R", "T_K"), ca.vertsplit(reactor(ca, x, u, alpha))):
        model.set_rhs(label, value)
    model.setup()
    found = trace.trace_settings(
        model._rhs_fun, states=4, controls=2, params={"alpha": 1.0}, dt=0.01
    )["system"]
    state, control = MODELS["reactor"][3:5]
    known = dict(zip(["x1", "x2", "x3", "x4", "u1", "u2", "alpha"], map(np.float64, [*state, *control, 1.0])))
    values = [Reader(found["define"], known).read(text) for text in found["rate"].values()]
    direct = ca.Function("f", [*x, *u, alpha], [reactor(ca, x, u, alpha)])
    agree(direct(*state, *control, 1.0), values, 1e-12)


def trace_float64():
    from physgrad import _import_jax

    return _import_jax.float64()


# Single operations.

CASADI = {
    name: lambda ca, x, y, name=name: getattr(ca, name)(x)
    for name in (
        "sin cos tan asin acos atan sinh cosh tanh asinh acosh atanh exp log sqrt fabs sign log1p expm1 erf "
        "log10 logic_not".split()
    )
} | {
    name: lambda ca, x, y, name=name: getattr(ca, name)(x, y)
    for name in "fmin fmax atan2 copysign hypot logic_and logic_or".split()
}
CASADI |= {
    "operators": lambda ca, x, y: ca.vertcat(x + y, x - y, x * y, x / y, -x, 2 * x, 1 / x, x * x),
    "comparisons": lambda ca, x, y: ca.vertcat(x < y, x <= y, x > y, x >= y, x == y, x != y),
    "comparisons as numbers": lambda ca, x, y: (x < y) * 2 + (y < 1) - ca.if_else(x != y, (x < 0) + 3, y < 0),
    "if_else": lambda ca, x, y: ca.vertcat(ca.if_else(x > y, x, y), ca.if_else(x, y, 2)),
    "logical numbers": lambda ca, x, y: ca.if_else(ca.logic_or(x < y, ca.logic_not(y)), 1, 2),
    "powers": lambda ca, x, y: ca.vertcat(x**2, x**3, x**-1, x**-2, x**0.5, x**1.7, x**0, x**7),
    "power of a constant": lambda ca, x, y: 2**x,
    "bounds": lambda ca, x, y: ca.vertcat(ca.fmin(ca.fmax(x, -1), 1), ca.fmin(x, np.inf), ca.fmax(0, x)),
    "sums": lambda ca, x, y: ca.vertcat(ca.sum1(ca.vertcat(x, y)), ca.norm_2(ca.vertcat(x, y)), ca.mmin(ca.vertcat(x, y))),
}
JAX = {
    name: lambda jnp, x, y, name=name: getattr(jnp, name)(x)
    for name in (
        "sin cos tan arcsin arccos arctan sinh cosh tanh arcsinh arccosh arctanh exp log sqrt abs sign log1p "
        "expm1 exp2 cbrt square negative reciprocal isfinite isnan signbit log10 sinc deg2rad".split()
    )
} | {
    name: lambda jnp, x, y, name=name: getattr(jnp, name)(x, y)
    for name in (
        "maximum minimum fmax fmin arctan2 hypot copysign add subtract multiply divide less equal not_equal "
        "heaviside logaddexp".split()
    )
}
JAX |= {
    "nn": lambda jnp, x, y: jnp.stack([f(x) for f in nn("relu sigmoid silu softplus gelu elu leaky_relu tanh")]),
    "softmax": lambda jnp, x, y: nn("softmax")[0](jnp.stack([jnp.clip(x, -50, 50), jnp.clip(y, -50, 50), x * 0])),
    "erf": lambda jnp, x, y: __import__("jax").scipy.special.erf(x),
    "powers": lambda jnp, x, y: jnp.stack([x**2, x**3, x**-2, x**0.5, jnp.abs(x) ** 1.7, x**0]),
    "logic": lambda jnp, x, y: jnp.where((x < y) & ~(y < 0) | (x > 1) ^ (y > 1), x, y) + (x < y) * 2.0,
    "clip": lambda jnp, x, y: jnp.clip(x, -1, y) + jnp.clip(x, max=0.5),
    "where": lambda jnp, x, y: jnp.where(x > 0, jnp.sqrt(jnp.where(x > 0, x, 1.0)), 0.0),
}


def nn(names):
    import jax

    return [getattr(jax.nn, name) for name in names.split()]


def casadi_function(build, names=("x1", "x2")):
    import casadi as ca

    x = ca.SX.sym("x", 3)
    return ca.Function("f", [x], [build(ca, x[0], x[1])], ["x"], ["y"])


def pairs():
    values = SPECIAL + NOT_FINITE
    return [(a, b) for a in values for b in values]


# Where functions of the interpreter differ: infinite arguments of formulas.
LIMITED = {"asinh", "arcsinh", "arccosh", "acosh", "expm1", "log1p", "sinc", "arctanh", "atanh", "nn", "logaddexp"}


@needs_casadi
@pytest.mark.parametrize("name", CASADI)
def test_operations_have_the_values_of_casadi(name):
    f = casadi_function(CASADI[name])
    values = texts_of(f)
    for a, b in pairs():
        if name not in LIMITED or np.isfinite(a + b) and abs(a) < 1e100 and abs(b) < 1e100:
            agree(f([a, b, 0.0]), values([a, b, 0.0]), 4e-14)


@needs_jax
@pytest.mark.parametrize("name", JAX)
def test_operations_have_the_values_of_jax(name):
    import jax
    import jax.numpy as jnp

    def f(x):
        return JAX[name](jnp, x[0], x[1])

    values = texts_of(from_jax(f))
    with trace_float64():
        compiled = jax.jit(f)
        for a, b in pairs():
            if name not in LIMITED or np.isfinite(a + b) and abs(a) < 1e100 and abs(b) < 1e100:
                agree(compiled(jnp.array([a, b, 0.0])), values([a, b, 0.0]), 4e-14, scale=1e-300)
