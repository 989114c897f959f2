"""Functions of CasADi and JAX become equations with the values and the derivatives of CasADi and JAX."""

import importlib
import importlib.util
import os
import re

import numpy as np
import pytest
from equations import Reader, trace

from_jax = importlib.import_module("physgrad._import_jax").from_jax
needs_casadi = pytest.mark.skipif(
    importlib.util.find_spec("casadi") is None, reason="CasADi is not installed"
)
needs_jax = pytest.mark.skipif(importlib.util.find_spec("jax") is None, reason="JAX is not installed")
needs_module = pytest.mark.skipif(
    importlib.util.find_spec("physgrad._core") is None, reason="the compiled module is not installed"
)
SPECIAL = [0.0, -0.0, 1.0, -1.0, 0.5, -0.5, 2.0, 3.7, -25.0, 40.0, 1e-9, -1e-9, 1e200, -1e200]
NOT_FINITE = [np.inf, -np.inf, np.nan]


def texts_of(function, states=("x1", "x2", "x3"), controls=(), **options):
    """A function of the expressions of an imported function, as an observation."""
    found = trace.trace_settings(
        lambda x: x, states=states, controls=controls, dt=0.1, observe=function, **options
    )["system"]

    def values(x, t=0.0, **params):
        reader = Reader(
            found.get("define", {}), {**dict(zip(states, map(np.float64, x), strict=True)), **params, "t": t}
        )
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
        self.vertcat, self.exp, self.sin, self.cos = (
            (lambda *parts: jnp.stack(parts)),
            jnp.exp,
            jnp.sin,
            jnp.cos,
        )


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
                lambda x, u, p: x + 0.01 * model(Numpy(jnp), x, u, p[0]),
                *map(jnp.array, (xs[i], us[i], ps[i])),
            )
            agree(values, next[i], 1e-12)
            for expected, part in zip(vjp(jnp.array(bars[i])), found, strict=True):
                agree(expected, part[i], 1e-12, scale=np.abs(bars[i]).max())


@needs_casadi
@needs_module
def test_the_comparison_of_derivatives_notices_a_fault(monkeypatch):
    from physgrad import _import_casadi

    monkeypatch.setitem(
        _import_casadi.RULES, "OP_SQ", lambda a: trace.numbers.apply("mul", a, trace.detach(a))
    )
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
    found = trace.trace_settings(model._rhs_fun, states=4, controls=2, params={"alpha": 1.0}, dt=0.01)[
        "system"
    ]
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
    "sums": lambda ca, x, y: ca.vertcat(
        ca.sum1(ca.vertcat(x, y)), ca.norm_2(ca.vertcat(x, y)), ca.mmin(ca.vertcat(x, y))
    ),
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
    "nn": lambda jnp, x, y: jnp.stack(
        [f(x) for f in nn("relu sigmoid silu softplus gelu elu leaky_relu tanh")]
    ),
    "softmax": lambda jnp, x, y: nn("softmax")[0](
        jnp.stack([jnp.clip(x, -50, 50), jnp.clip(y, -50, 50), x * 0])
    ),
    "erf": lambda jnp, x, y: __import__("jax").scipy.special.erf(x),
    "erfc": lambda jnp, x, y: __import__("jax").scipy.special.erfc(x),
    "powers": lambda jnp, x, y: jnp.stack([x**2, x**3, x**-2, x**0.5, jnp.abs(x) ** 1.7, x**0]),
    "logic": lambda jnp, x, y: jnp.where((x < y) & ~(y < 0) | (x > 1) ^ (y > 1), x, y) + (x < y) * 2.0,
    "clip": lambda jnp, x, y: jnp.clip(x, -1, y) + jnp.clip(x, max=0.5),
    "where": lambda jnp, x, y: jnp.where(x > 0, jnp.sqrt(jnp.where(x > 0, x, 1.0)), 0.0),
}


def nn(names):
    import jax

    return [getattr(jax.nn, name) for name in names.split()]


def casadi_function(build):
    import casadi as ca

    x = ca.SX.sym("x", 3)
    return ca.Function("f", [x], [build(ca, x[0], x[1])], ["x"], ["y"])


def pairs():
    values = SPECIAL + NOT_FINITE
    return [(a, b) for a in values for b in values]


# Formulas that overflow at arguments of 1e100 and more, and roots of negative infinite numbers.
LIMITED = set("asinh arcsinh arccosh acosh expm1 log1p sinc arctanh atanh nn logaddexp powers".split())


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


# Points without kinks, and of both signs.
POINTS = [(0.37, 0.62), (-0.6, 0.21), (1.7, -2.3), (-3.1, 0.8), (0.05, 4.2), (12.0, -0.01)]


def derivatives_agree(function, vjp):
    """Whether derivatives of an observation by the state are those of `vjp(x, bars)`."""
    import physgrad as pg

    task = pg.system(lambda x: x, states=3, controls=1, dt=0.1, observe=function)
    for point in POINTS:
        x = np.array([[*point, 0.0]])
        # Outside of a domain the value is NaN, and derivatives are arbitrary.
        if not np.all(np.isfinite(task.observe(x))):
            continue
        bars = np.random.default_rng(3).normal(size=(1, task.observation_dim))
        agree(vjp(x[0], bars[0]), task.observe_vjp(x, bars)[0], 1e-12, scale=1.0)


@needs_casadi
@needs_module
@pytest.mark.parametrize("name", CASADI)
def test_operations_have_the_derivatives_of_casadi(name):
    import casadi as ca

    f = casadi_function(CASADI[name])
    x, bar = ca.SX.sym("x", 3), ca.SX.sym("bar", f.numel_out(0))
    derivatives_agree(f, ca.Function("vjp", [x, bar], [ca.jtimes(ca.densify(f(x)), x, bar, True)]))


@needs_jax
@needs_module
@pytest.mark.parametrize("name", JAX)
def test_operations_have_the_derivatives_of_jax(name):
    import jax
    import jax.numpy as jnp

    def f(x):
        return jnp.ravel(JAX[name](jnp, x[0], x[1])) * 1.0

    with trace_float64():
        derivatives_agree(from_jax(f), lambda x, bars: jax.vjp(f, jnp.array(x))[1](jnp.array(bars))[0])


@needs_jax
def test_an_arm_of_its_lagrangian():
    """Derivatives by JAX inside of the function, and a traced mass matrix."""
    import jax
    import jax.numpy as jnp

    def energy(q, v):
        c = jnp.cos(q[1])
        mass = jnp.array([[3.0 + 2.0 * c, 1.0 + c], [1.0 + c, 1.0]])
        return 0.5 * v @ mass @ v + 9.81 * (jnp.cos(q[0]) + jnp.cos(q[0] + q[1]))

    def acceleration(x):
        q, v = x[:2], x[1:]
        force = jax.grad(energy)(q, v) - jax.jacfwd(jax.grad(energy, 1))(q, v) @ v
        return jnp.linalg.solve(jax.hessian(energy, 1)(q, v), force)

    values = texts_of(from_jax(acceleration))
    with trace_float64():
        for x in np.random.default_rng(0).normal(size=(4, 3)):
            agree(acceleration(jnp.array(x)), values(x), 1e-12, scale=1.0)


# Random programs. Dispatch of single operations in JAX takes most of the time.
MORE = 10 if os.environ.get("PHYSGRAD_PYTHON_ALL") == "1" else 1


def choose_from(rng, operations, registers, run, count):
    """Operations and the places of their arguments; later registers are more likely."""
    steps = []
    for _ in range(count):
        operation, arity = operations[rng.integers(len(operations))]
        places = [int(len(registers) * rng.random() ** 0.5) for _ in range(arity)]
        steps.append((operation, places))
        registers.append(run(operation, [registers[place] for place in places]))
    return steps


# Operations whose results have equal bits in all programs. The sign of a zero has a sign in CasADi and JAX.
EXACT_CASADI = [
    *[(lambda ca, a, b, n=n: getattr(ca, n)(a, b), 2) for n in "plus minus times rdivide fmin fmax".split()],
    *[(lambda ca, a, n=n: getattr(ca, n)(a), 1) for n in "sqrt fabs logic_not".split()],
    (lambda ca, a: a * a, 1),
    (lambda ca, a: 2 * a, 1),
    (lambda ca, a: 1 / a, 1),
    (lambda ca, a: 1 - a, 1),
    (lambda ca, a, b: a < b, 2),
    (lambda ca, a, b: a == b, 2),
    (lambda ca, a, b: ca.logic_and(a, b <= 1), 2),
    (lambda ca, a, b, c: ca.if_else(a, b, c), 3),
    (lambda ca, a, b, c: ca.if_else(a > b, b, c), 3),
]
SMOOTH_CASADI = (
    EXACT_CASADI[:6]
    + [(lambda ca, a, n=n: getattr(ca, n)(a), 1) for n in "sin cos tanh atan asinh expm1 erf".split()]
    + [
        (lambda ca, a: ca.log1p(a * a), 1),
        (lambda ca, a, b: ca.hypot(a, 1 + b * b), 2),
        (lambda ca, a: a**3, 1),
    ]
)


def random_casadi(seed, operations):
    import casadi as ca

    rng = np.random.default_rng(seed)
    x = ca.SX.sym("x", 3)
    registers = [x[0], x[1], x[2], ca.SX(0.5), ca.SX(-2.0)]
    choose_from(rng, operations, registers, lambda operation, args: operation(ca, *args), 12)
    return ca.Function("f", [x], [ca.vertcat(*registers[5:])])


EXACT_JAX = [
    *[
        (lambda jnp, a, b, n=n: getattr(jnp, n)(a, b), 2)
        for n in "add subtract multiply divide maximum minimum fmax".split()
    ],
    *[(lambda jnp, a, n=n: getattr(jnp, n)(a), 1) for n in "sqrt abs negative flip".split()],
    (lambda jnp, a: jnp.roll(a, 1), 1),
    (lambda jnp, a: a[jnp.array([2, 0, 0])], 1),
    (lambda jnp, a: jnp.broadcast_to(jnp.max(a), 3), 1),
    (lambda jnp, a, b: a.at[1:].set(b[:2]), 2),
    (lambda jnp, a, b: a.at[jnp.array([0, 2])].add(b[1]), 2),
    (lambda jnp, a, b: jnp.concatenate([a[:1], b[1:]]), 2),
    (lambda jnp, a, b: jnp.stack([a, b])[:, 1].repeat(2)[:3], 2),
    (lambda jnp, a, b: (a < b) * 1.0, 2),
    (lambda jnp, a, b: jnp.where((a == b) | (b > 1), a, -b), 2),
    (lambda jnp, a, b: jnp.where(jnp.any(a > b), a, b), 2),
    (lambda jnp, a, b: jnp.diagonal(jnp.outer(a, b)), 2),
    (lambda jnp, a, b: jnp.clip(a, -1, b), 2),
    (lambda jnp, a, b: jnp.select([a < b, b > 1], [a, -b], 0.5), 2),
    (lambda jnp, a: jnp.piecewise(a, [a < 0, a > 1], [lambda v: -v, lambda v: 2 * v, 0.5]), 1),
    (lambda jnp, a: jnp.nan_to_num(a), 1),
]
SMOOTH_JAX = (
    EXACT_JAX[:3]
    + EXACT_JAX[8:]
    + [
        *[
            (lambda jnp, a, n=n: getattr(jnp, n)(a), 1)
            for n in "sin cos tanh arctan arcsinh expm1 cumsum".split()
        ],
        (lambda jnp, a: jnp.broadcast_to(jnp.sum(a), 3) + jnp.dot(a, a), 1),
        (lambda jnp, a: jnp.eye(3)[:, ::-1] @ a + jnp.einsum("i,j->j", a, a), 1),
        (lambda jnp, a, b: jnp.linalg.solve(jnp.outer(b, b) / (1 + b @ b) + 2 * jnp.eye(3), a), 2),
        (lambda jnp, a, b: solve_by_factors(jnp, jnp.outer(a, a) / (1 + a @ a) + 2 * jnp.eye(3), b), 2),
        (lambda jnp, a: jnp.interp(a, jnp.array([-1.0, 0.5, 2.0]), jnp.array([3.0, -1.0, 1.0])), 1),
        (lambda jnp, a: jax_of("scipy").special.erfc(a), 1),
        (lambda jnp, a: lax().fori_loop(0, 3, lambda i, s: s * 0.5 + a[i], a), 1),
        (lambda jnp, a, b: lax().scan(lambda s, row: (s + row, s * row), 0.0, b)[1] + a, 2),
        (lambda jnp, a, b: lax().cond(a[0] > b[0], lambda v: v, lambda v: -v, b), 2),
        (lambda jnp, a, b: jax_of("vmap")(lambda v, w: jnp.hypot(v, 1 + w * w))(a, b), 2),
        (lambda jnp, a: jax_of("nn").sigmoid(a) + jax_of("nn").softmax(a), 1),
        (lambda jnp, a: jax_of("grad")(lambda v: jnp.sum(jnp.sin(v) * v))(a), 1),
    ]
)


def lax():
    return jax_of("lax")


def jax_of(name):
    import jax

    return getattr(jax, name)


def solve_by_factors(jnp, matrix, right):
    linalg = jax_of("scipy").linalg
    return linalg.cho_solve(linalg.cho_factor(matrix), right)


def random_jax(seed, operations):
    import jax.numpy as jnp

    rng = np.random.default_rng(seed)
    steps = []

    def f(x):
        registers = [x, x * 0.5, jnp.array([0.5, -2.0, 1.0])]
        if not steps:
            steps.extend(
                choose_from(rng, operations, registers, lambda operation, args: operation(jnp, *args), 9)
            )
        else:
            for operation, places in steps:
                registers.append(operation(jnp, *(registers[place] for place in places)))
        return jnp.concatenate(registers[3:])

    return f


def samples(seed, values):
    rng = np.random.default_rng(seed)
    for i in range(8):
        yield rng.normal(size=3) if i % 2 or values is None else rng.choice(values, 3)


def compare_random(make, seeds, values, tolerance, wrap, evaluate):
    """Whether random functions agree. Constants may be infinite, which is refused."""
    traced = 0
    for seed in seeds:
        function = make(seed)
        try:
            found = texts_of(wrap(function))
        except ValueError as error:
            assert "a constant is" in str(error) or "not finite" in str(error)
            continue
        traced += 1
        for x in samples(seed, values):
            expected = np.ravel(evaluate(function, x))
            if tolerance and np.max(np.abs(expected)) > 1e4:
                continue
            agree(expected, found(x), tolerance, scale=1.0 if tolerance else 0.0)
    assert traced > 0.6 * len(seeds)


@needs_casadi
def test_random_exact_functions_of_casadi():
    compare_random(
        lambda seed: random_casadi(seed, EXACT_CASADI),
        range(300),
        SPECIAL + NOT_FINITE,
        0.0,
        lambda f: f,
        lambda f, x: f(x),
    )


@needs_casadi
def test_random_smooth_functions_of_casadi():
    compare_random(
        lambda seed: random_casadi(seed, SMOOTH_CASADI),
        range(100),
        None,
        1e-10,
        lambda f: f,
        lambda f, x: f(x),
    )


@needs_jax
@pytest.mark.parametrize(
    "operations, values, tolerance", [(EXACT_JAX, SPECIAL + NOT_FINITE, 0.0), (SMOOTH_JAX, None, 1e-9)]
)
def test_random_functions_of_jax(operations, values, tolerance):
    with trace_float64():
        import jax.numpy as jnp

        compare_random(
            lambda seed: random_jax(seed, operations),
            range(10, 10 + 6 * MORE),
            values,
            tolerance,
            from_jax,
            lambda f, x: f(jnp.array(x)),
        )


@needs_casadi
@pytest.mark.parametrize("name, wrong", [("OP_FMIN", "fmax"), ("OP_LT", "le"), ("OP_IF_ELSE_ZERO", None)])
def test_the_comparison_of_random_functions_notices_a_fault(name, wrong, monkeypatch):
    from physgrad import _import_casadi, _import_numbers

    fault = {
        "fmax": _import_numbers.fmax,
        "le": lambda a, b: trace.numbers.compare("le", a, b),
        None: lambda c, a: trace.lift(c) * a,
    }[wrong]
    monkeypatch.setitem(_import_casadi.RULES, name, fault)
    with pytest.raises(AssertionError):
        test_random_exact_functions_of_casadi()


@needs_jax
def test_the_comparison_with_jax_notices_a_fault(monkeypatch):
    from physgrad import _import_jax

    monkeypatch.setitem(_import_jax.RULES, "max", _import_jax.RULES["min"])
    with pytest.raises(AssertionError):
        test_random_functions_of_jax(EXACT_JAX, SPECIAL, 0.0)


# Arguments and refusals.


@needs_casadi
def test_inputs_are_matched_by_name_and_by_order():
    import casadi as ca

    x, u, t = ca.SX.sym("x", 2), ca.SX.sym("u"), ca.SX.sym("t")
    p, nothing, n = ca.SX.sym("p", 5), ca.SX.sym("z", 0), ca.SX.sym("next", 2)
    given = {"states": ["a", "b"], "controls": ["c"], "dt": 0.1}
    params = {"k": 1.0, "M": np.array([[1.0, 2.0], [3.0, 4.0]])}

    def rate(f, **options):
        return list(trace.trace_settings(f, **given, **options)["system"]["rate"].values())

    out = [ca.vertcat(x[0] + u, x[1] * t)]
    assert rate(ca.Function("f", [t, u, x], out, ["time", "_u", "states"], ["r"])) == ["a + c", "b * t"]
    assert rate(ca.Function("f", [x, nothing, u], [x + u], ["x0", "z0", "u"], ["r"])) == ["a + c", "b + c"]
    by_columns = ca.Function("f", [x, u, p], [ca.vertcat(p[0] + x[0], p[2] * x[1])])
    assert rate(by_columns, params=params) == ["k + a", "3 * b"]
    sparse = ca.Function("f", [x], [ca.vertcat(ca.SX(1, 1), x[0])])
    assert rate(sparse) == ["0", "a"]
    cost = ca.Function("L", [n, x], [ca.sumsqr(n - x)], ["x_next", "x"], ["L"])
    found = trace.trace_settings(ca.Function("f", [x], [x]), **given, running_cost=cost)
    assert found["loss"] == {"running": "(next.a - a)^2 + (next.b - b)^2"}


@needs_jax
def test_parameters_of_jax_have_names_and_order():
    import jax.numpy as jnp

    def rate(x, u, p, t):
        gain, matrix = p
        total = p.k + p["k"] + p[0] + gain + jnp.sum(jnp.asarray(p))
        return {"b": matrix[1] @ x + u[0], "a": total * t}

    found = trace.trace_settings(
        from_jax(rate),
        states=["a", "b"],
        controls=["c"],
        params={"k": 1.0, "M": np.array([[1.0, 2.0], [3.0, 4.0]])},
        dt=0.1,
        terminal_cost=from_jax(lambda x: x @ x),
    )
    assert found["system"]["rate"]["b"] == "3 * a + 4 * b + c"
    assert found["loss"]["terminal"] == "a * a + b * b"


def casadi_refusals():
    import casadi as ca

    x, y, m = ca.SX.sym("x", 2), ca.SX.sym("y"), ca.MX.sym("m", 2)
    z = ca.SX.sym("z")
    root = ca.rootfinder("root", "newton", ca.Function("r", [y, z], [y * y - z]))
    table = ca.interpolant("table", "linear", [[0.0, 1.0, 2.0]], [0.0, 1.0, 4.0])
    return {
        "floor": (ca.Function("f", [x], [ca.floor(x)]), r"^`f`: floor is constant between jumps.*atan2"),
        "ceil": (ca.Function("f", [x], [ca.ceil(x)]), "ceil is constant.*if_else"),
        "fmod": (ca.Function("f", [x], [ca.fmod(x, 2)]), r"fmod jumps.*atan2\(sin\(a\), cos\(a\)\)"),
        "remainder": (ca.Function("f", [x], [ca.remainder(x, 3)]), r"another number than 2\*pi"),
        "infinite": (ca.Function("f", [x], [x * np.inf]), "a constant is inf"),
        "interpolant": (
            ca.Function("f", [m], [m * table(m[0])]),
            r"calls `table` \(LinearInterpolant\).*formula",
        ),
        "rootfinder": (ca.Function("f", [m], [m * root(m[0], m[1])]), r"`root` \(Newton\)"),
        "solver": (ca.Function("f", [m], [ca.solve(ca.diag(m) + 1, m)]), "Build the function with SX"),
        "free": (ca.Function("f", [x], [x * y], {"allow_free": True}), "symbols y are not inputs"),
        "outputs": (ca.Function("f", [x], [x, y * 0], ["x"], ["xdot", "L"]), r"2 outputs: xdot, L.*f.slice"),
        "sizes": (
            ca.Function("f", [ca.SX.sym("x", 3)], [x[0] * 0]),
            r"shape \(3, 1\), and its argument 2 numbers",
        ),
        "place": (ca.Function("f", [y, x], [x], ["w", "x"], ["r"]), "argument `w` that does not fit"),
    }


CASADI_REFUSED = (
    "floor ceil fmod remainder infinite interpolant rootfinder solver free outputs sizes place".split()
)


@needs_casadi
@pytest.mark.parametrize("name", CASADI_REFUSED)
def test_functions_of_casadi_without_equations_are_refused(name):
    function, words = casadi_refusals()[name]
    with pytest.raises((TypeError, ValueError)) as caught:
        trace.trace_settings(function, states=2, controls=1, dt=0.1)
    assert re.search(words, str(caught.value), re.DOTALL), str(caught.value)


def while_of(jnp, x):
    return lax().while_loop(lambda v: v[0] < 1, lambda v: v + 1, x)


JAX_REFUSED = {
    "floor": (lambda jnp, x: jnp.floor(x), r"^test_import.py:\d+: `floor` jumps"),
    "rem": (lambda jnp, x: jnp.fmod(x, 2.0), r"`rem` jumps.*arctan2"),
    "mod": (lambda jnp, x: jnp.mod(x, 2.0), "only as the angle"),
    "sort": (lambda jnp, x: jnp.sort(x), "`sort` depends on values"),
    "while": (while_of, r"number of turns.*fori_loop"),
    "index": (lambda jnp, x: jnp.arange(5.0)[jnp.argmax(x)] * x, "`argmax` depends"),
    "traced index": (
        lambda jnp, x: jnp.arange(2.0)[(x[0] > 0).astype(int)] * x,
        "an index depends on traced numbers",
    ),
    "float32": (lambda jnp, x: x.astype(jnp.float32) * 2, "is a float64, not float32"),
    "integers": (lambda jnp, x: x.astype(int) * x, "a change to integers rounds"),
    "random": (
        lambda jnp, x: x * jax_of("random").normal(jax_of("random").PRNGKey(0)),
        "must not draw random",
    ),
    "callback": (lambda jnp, x: jax_of("pure_callback")(np.sin, x, x), "calls Python"),
    "qr": (lambda jnp, x: jnp.linalg.qr(jnp.outer(x, x))[0] @ x, "`qr` of a traced matrix"),
    "six rows": (
        lambda jnp, x: jnp.linalg.solve(jnp.outer(*[jnp.tile(x, 3)] * 2) + jnp.eye(6), jnp.ones(6))[:2],
        "limited to 4 rows, not 6.*cho_solve of JAX",
    ),
    "search": (lambda jnp, x: jnp.searchsorted(jnp.arange(3.0), x) * 1.0, "searchsorted is not.*np.interp"),
    "argmax of numbers": (lambda jnp, x: jnp.argmax(x) * x, "`argmax` depends on values"),
    "digitize": (lambda jnp, x: jnp.digitize(x, jnp.arange(3.0)) * x, "searchsorted is not"),
    "eigenvalues": (lambda jnp, x: jnp.linalg.eigvalsh(jnp.outer(x, x)), "`eigh` of a traced matrix"),
    "print": (lambda jnp, x: (jax_of("debug").print("{}", x), x)[1], "leave `jax.debug.print` out"),
    "unknown": (lambda jnp, x: jax_of("scipy").special.gammaln(x), r"test_import.py:\d+: `lgamma` of JAX"),
    "infinite": (lambda jnp, x: jnp.where(x > 0, x, jnp.inf), "a constant is inf"),
}


@needs_jax
@pytest.mark.parametrize("name", JAX_REFUSED)
def test_functions_of_jax_without_equations_are_refused(name):
    import jax.numpy as jnp

    function, words = JAX_REFUSED[name]
    with pytest.raises((TypeError, ValueError, IndexError)) as caught:
        trace.trace_settings(from_jax(lambda x: function(jnp, x)), states=2, dt=0.1)
    assert re.search(words, str(caught.value), re.DOTALL), str(caught.value)


@needs_jax
def test_a_function_of_jax_needs_from_jax():
    import jax.numpy as jnp

    for function in (lambda x: jnp.sin(x), lambda x: jnp.array([x[0], x[1]])):
        with pytest.raises(TypeError) as caught:
            trace.trace_settings(function, states=2, dt=0.1)
        if hasattr(caught.value, "__notes__"):
            assert "give pg.from_jax(function)" in " ".join(caught.value.__notes__)
    with pytest.raises(TypeError, match="from_jax needs a function"):
        from_jax(3)
