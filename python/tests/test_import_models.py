"""Models of the kinds that people have, written for JAX and CasADi: steps and their derivatives."""

import functools
import importlib
import importlib.util
import os
import runpy
import types

import numpy as np
import pytest
from test_import import agree, needs_casadi, needs_jax, needs_module, trace_float64

from_jax = importlib.import_module("physgrad._import_jax").from_jax
RNG = np.random.default_rng(0)
HIDDEN, OUT = RNG.normal(size=(8, 3)), RNG.normal(size=(2, 8))
PLACES = np.linspace(-2.0, 2.0, 7)


def jax_models():
    """Rates by name, with the numbers of states and controls. The name of a step begins with `step`."""
    import jax
    import jax.numpy as jnp
    from jax import lax

    def reactor(x, u):
        c, hot = x[0], 350.0 + 5.0 * x[1]
        k = 7.2e10 * jnp.exp(-8750.0 / hot)
        return jnp.stack([(1.0 - c) - k * c, (350.0 - hot) + 209.2 * k * c + 2.09 * u[0]])

    def arm(x, u):
        def lagrangian(q, v):
            a = jnp.array([-jnp.sin(q[0]), jnp.cos(q[0])]) * v[0]
            b = a + jnp.array([-jnp.sin(q[0] + q[1]), jnp.cos(q[0] + q[1])]) * (v[0] + v[1])
            return 0.5 * a @ a + 0.5 * b @ b - 9.81 * (2 * jnp.sin(q[0]) + jnp.sin(q[0] + q[1]))

        q, v = x[:2], x[2:]
        mass = jax.hessian(lagrangian, 1)(q, v) + 0.1 * jnp.eye(2)
        bent = jax.jacfwd(jax.grad(lagrangian, 1))(q, v) @ v
        return jnp.concatenate([v, jnp.linalg.solve(mass, u + jax.grad(lagrangian)(q, v) - bent)])

    def six_masses(x, u):
        mass = jnp.outer(jnp.cos(x), jnp.cos(x)) + 3.0 * jnp.eye(6)
        return jax.scipy.linalg.cho_solve(jax.scipy.linalg.cho_factor(mass), u[0] - x)

    def triangular(x, u):
        lower = jnp.array([[2.0 + x[0] ** 2, 0.0], [x[1], 2.0]])
        solve = functools.partial(jax.scipy.linalg.solve_triangular, lower, lower=True)
        return solve(x) + solve(u[0] + x, trans=1)

    def neural(x, u):
        h = jax.nn.softplus(HIDDEN @ jnp.concatenate([x, u]))
        return OUT @ (jax.nn.gelu(h) + jax.nn.silu(h) + jax.nn.elu(h - 1.0))

    def contact(x, u):
        force = lax.cond(x[0] < 0, lambda x: -100 * x[0] - 2 * x[1], lambda x: 0.0 * x[0], x)
        return jnp.array([x[1], force - 9.81 + u[0]])

    def step_of_stages(x, u):
        def rate(x):
            return jnp.array([x[1] * x[2], -x[0] * x[2] + u[0], -0.5 * x[0] * x[1]])

        def stage(x, _):
            k = rate(x)
            return x + 0.1 * rate(x + 0.05 * k), k.sum()

        x, sums = lax.scan(stage, x, None, length=3)
        return lax.fori_loop(0, 3, lambda i, x: x.at[i].add(0.01 * i * sums[-1]), x)

    def step_by_newton(x, u):
        def residual(y):
            return y - x - 0.05 * jnp.array([y[1], (1 - y[0] ** 2) * y[1] - y[0] + u[0]])

        return lax.fori_loop(
            0, 2, lambda _, y: y - jnp.linalg.solve(jax.jacobian(residual)(y), residual(y)), x
        )

    def bodies(x, u):
        place = x[:4].reshape(2, 2)

        def pull(i):
            away = place - place[i]
            return (away / ((away**2).sum(-1) + 0.1)[:, None] ** 1.5).sum(0)

        return jnp.concatenate([x[4:], jax.vmap(pull)(jnp.arange(2)).ravel() * u[0]])

    @jax.custom_jvp
    def root(x):
        return jnp.sqrt(jnp.maximum(x, 1e-12))

    @root.defjvp
    def _(primals, tangents):
        y = root(*primals)
        return y, tangents[0] * jnp.where(primals[0] > 1e-12, 0.5 / y, 0.0)

    def tanks(x, u):
        return jnp.array([u[0] - root(x[0]), root(x[0]) - root(x[1])])

    def attitude(x, u):
        q, w = x[:4] / jnp.linalg.norm(x[:4]), x[4:]
        turn = jnp.array(
            [[0, -w[0], -w[1], -w[2]], [w[0], 0, w[2], -w[1]], [w[1], -w[2], 0, w[0]], [w[2], w[1], -w[0], 0]]
        )
        inertia = jnp.diag(jnp.array([1.0, 2.0, 3.0]))
        return jnp.concatenate([0.5 * turn @ q, jnp.linalg.inv(inertia) @ (u - jnp.cross(w, inertia @ w))])

    def tables(x, u):
        ends = {"left": -1.0, "right": 2.0}
        return jnp.interp(x, PLACES, np.sin(PLACES)) + u[0] * jnp.interp(x[0], PLACES, PLACES**2, **ends)

    def cases(x, u):
        parts = jnp.piecewise(x, [x < 0, x >= 1], [lambda v: -v, lambda v: v**2, lambda v: 0.5 * v])
        return parts + jnp.select([x < -1, x < 1], [0.2 * x, x * u[0]], x**2)

    def safe(x, u):
        tail = jax.scipy.special.erfc(x) + jnp.linalg.det(jnp.outer(x, x) + jnp.eye(2))
        return tail + jnp.nan_to_num(u[0] / (1 + x**2)) + jax.grad(lambda z: jax.nn.softplus(z).sum())(x)

    def grid(x, u):
        padded = jnp.pad(x, 1, mode="edge")
        transport = x * (jnp.roll(x, -1) - jnp.roll(x, 1)) / 2
        return padded[2:] - 2 * x + padded[:-2] - transport + u[0] * jnp.eye(6)[0]

    return {
        "reactor": (reactor, 2, 1),
        "arm": (arm, 4, 2),
        "six_masses": (six_masses, 6, 1),
        "triangular": (triangular, 2, 1),
        "neural": (neural, 2, 1),
        "contact": (contact, 2, 1),
        "step_of_stages": (step_of_stages, 3, 1),
        "step_by_newton": (step_by_newton, 2, 1),
        "bodies": (bodies, 8, 1),
        "tanks": (tanks, 2, 1),
        "attitude": (attitude, 7, 3),
        "tables": (tables, 3, 1),
        "cases": (cases, 2, 1),
        "safe": (safe, 2, 1),
        "grid": (grid, 6, 1),
    }


JAX_MODELS = (
    "reactor arm six_masses triangular neural contact step_of_stages step_by_newton bodies tanks attitude "
    "tables cases safe grid".split()
)


def task_of(name, function, n, m):
    """The task of a step, or of one explicit step of a rate."""
    import physgrad as pg

    functions = {"step": function} if name.startswith("step") else {"rate": function, "method": "euler"}
    return pg.system(functions.pop("rate", None), states=n, controls=m, dt=0.1, **functions)


def points(n, m):
    rng = np.random.default_rng(5)
    return rng.normal(size=(30, n)), rng.normal(size=(30, m)), rng.normal(size=(30, n))


@needs_jax
@needs_module
@pytest.mark.parametrize("name", JAX_MODELS)
def test_models_of_jax_have_their_steps_and_derivatives(name):
    import jax

    models = jax_models()
    assert list(models) == JAX_MODELS
    function, n, m = models[name]
    task, (x, u, bars) = task_of(name, from_jax(function), n, m), points(n, m)

    def of_jax(x, u, bar):
        next, back = jax.vjp(
            function if name.startswith("step") else lambda x, u: x + 0.1 * function(x, u), x, u
        )
        return next, *back(bar)

    with trace_float64():
        expected = jax.jit(jax.vmap(of_jax))(x, u, bars)
    for a, b in zip(expected, (task.step(x, u), *task.step_vjp(x, u, bars)[:2]), strict=True):
        agree(a, b, 1e-12, scale=1.0)


def casadi_models():
    import casadi as ca

    x, u, x2, x4, u2, x6 = (ca.SX.sym(*s) for s in (("x", 7), ("u",), ("x", 2), ("x", 4), ("u", 2), ("x", 6)))
    m2, mu = ca.MX.sym("x", 2), ca.MX.sym("u")
    van_der_pol = ca.Function("f", [m2, mu], [ca.vertcat(m2[1], (1 - m2[0] ** 2) * m2[1] - m2[0] + mu)])
    steps = ca.Function("s", [m2, mu], [m2 + 0.02 * van_der_pol(m2, mu)]).mapaccum("steps", 5)
    c = ca.cos(x4[1])
    mass = ca.vertcat(ca.horzcat(3 + 2 * c, 1 + c), ca.horzcat(1 + c, 1.1))
    slip = x4[2] + ca.atan(0.5 * ca.tan(u2[1]))
    energy = 0.5 * ca.sumsqr(x4[2:]) + ca.cos(x4[0] - x4[1]) + 0.25 * x4[0] ** 4
    slope = ca.gradient(energy, x4)
    q, w = x[:4] / ca.norm_2(x[:4]), x[4:]
    turn = ca.vertcat(ca.horzcat(0, -w.T), ca.horzcat(w, -ca.skew(w)))
    inertia = ca.diag(ca.DM([1, 2, 3]))
    spd = ca.mtimes(x6, x6.T) + 3 * ca.SX.eye(6)
    table = ca.pw_lin(x2[0], [-1, 0, 1.0], [0, 1.0, 0.5])
    outputs = {
        "step_simple_rk": (m2, mu, ca.simpleRK(van_der_pol, 3, 4)(m2, mu, 0.1)),
        "step_mapaccum": (m2, mu, steps(m2, ca.repmat(mu, 1, 5))[:, -1]),
        "neural": (m2, mu, ca.mtimes(ca.DM(OUT), ca.tanh(ca.mtimes(ca.DM(HIDDEN), ca.vertcat(m2, mu))))),
        "short_circuit": (m2, mu, ca.if_else(m2[0] > 0, ca.sin(m2), m2 * mu, True)),
        "arm": (x4, u2, ca.vertcat(x4[2:], ca.solve(mass, u2 - 9.81 * ca.sin(x4[:2])))),
        "car": (x4, u2, ca.vertcat(x4[3] * ca.cos(slip), x4[3] * ca.sin(slip), ca.tan(u2[1]), u2[0])),
        "hamilton": (x4, u2, ca.vertcat(slope[2:], u2 - slope[:2])),
        "attitude": (x, u, ca.vertcat(0.5 * turn @ q, ca.inv(inertia) @ (u - ca.cross(w, inertia @ w)))),
        "six_masses": (x6, u, ca.solve(spd, x6 * u)),
        "tables": (x2, u, ca.vertcat(table, ca.pw_const(x2[1], [-0.5, 0.5], [0, 1.0, 2.0]) * u)),
    }
    return {name: ca.Function("f", [x, u], [f], ["x", "u"], ["r"]) for name, (x, u, f) in outputs.items()}


CASADI_MODELS = (
    "step_simple_rk step_mapaccum neural short_circuit arm car hamilton attitude six_masses tables".split()
)


@needs_casadi
@needs_module
@pytest.mark.parametrize("name", CASADI_MODELS)
def test_models_of_casadi_have_their_steps_and_derivatives(name):
    models = casadi_models()
    assert list(models) == CASADI_MODELS
    agrees_with_casadi(name, models[name])


def agrees_with_casadi(name, f, given=None):
    import casadi as ca

    n, m = f.numel_in(0), f.numel_in(1)
    task, given = task_of(name, f, n, m), given or points(n, m)
    x, u, bar = ca.MX.sym("x", n), ca.MX.sym("u", m), ca.MX.sym("bar", n)
    next = f(x, u) if name.startswith("step") else x + 0.1 * f(x, u)
    reverse = [ca.jtimes(next, x, bar, True), ca.jtimes(next, u, bar, True)]
    expected = ca.Function("all", [x, u, bar], [next, *reverse]).map(30)(*(value.T for value in given))
    found = (task.step(*given[:2]), *task.step_vjp(*given)[:2])
    for a, b in zip(expected, found, strict=True):
        agree(np.array(a).T, b, 1e-12, scale=1.0)


# Examples of CasADi that run within seconds and have a model of an own kind.
SCRIPTS = (
    "bouncing_ball direct_multiple_shooting implicit_runge-kutta multipoint_simulation race_car rocket "
    "vdp_indirect_multiple_shooting".split()
)


def model_of_example(found):
    """The step `F` or the rate of an example as a function of x and u."""
    import casadi as ca

    f = found["F"] if "xj" in found else found.get("f")
    if isinstance(f, ca.Function):
        return f.slice("f", [0, 1], [0])
    if isinstance(f, types.FunctionType):
        x, u = ca.SX.sym("x", 2), ca.SX.sym("u")
        return ca.Function("f", [x, u], [f(x, u)])
    x = found["dae"]["x"]
    return ca.Function("f", [x, found["dae"].get("u", type(x).sym("u"))], [found["dae"]["ode"]])


def run_example(variable, *path):
    """The variables of a script in the folder that a variable of the environment names."""
    folder = os.environ.get(variable)
    if folder is None:
        pytest.skip(f"{variable} does not name a folder of examples")
    pytest.importorskip("matplotlib", reason="matplotlib is not installed").use("Agg")
    return runpy.run_path(os.path.join(folder, *path))


@needs_casadi
@needs_module
@pytest.mark.parametrize("script", SCRIPTS)
def test_examples_of_casadi_have_their_steps_and_derivatives(script):
    found = run_example("PHYSGRAD_CASADI_EXAMPLES", f"{script}.py")
    agrees_with_casadi("step" if script == "rocket" else "rate", model_of_example(found))


@needs_casadi
@needs_module
@pytest.mark.parametrize(
    "example",
    "CSTR Lotka_Volterra batch_reactor dynamic_bicycle_model industrial_poly kinematic_bicycle_model "
    "oscillating_masses_discrete triple_tank_ekf".split(),
)
def test_examples_of_do_mpc_have_their_steps_and_derivatives(example):
    import casadi as ca

    pytest.importorskip("do_mpc", reason="do-mpc is not installed")
    model = run_example("PHYSGRAD_DO_MPC_EXAMPLES", example, "template_model.py")["template_model"]()
    f = model._rhs_fun
    x, u, *others = (ca.SX.sym(name, f.numel_in(i)) for i, name in enumerate(f.name_in()))
    # The parameters, and values that vary over time.
    rng = np.random.default_rng(5)
    constants = [rng.uniform(0.5, 1.5, other.numel()) for other in others]
    kind = "step" if model.model_type == "discrete" else "rate"
    # Concentrations and temperatures are positive.
    states, controls, bars = points(x.numel(), u.numel())
    given = 0.5 + np.abs(states), 0.5 + np.abs(controls), bars
    agrees_with_casadi(kind, ca.Function("f", [x, u], [f(x, u, *constants)]), given)


@needs_jax
@needs_module
def test_the_comparison_with_models_of_jax_notices_a_fault(monkeypatch):
    from physgrad import _trace_algebra

    right = _trace_algebra.substitute
    monkeypatch.setattr(_trace_algebra, "substitute", lambda m, b, lower: right(m, b, not lower))
    with pytest.raises(AssertionError):
        test_models_of_jax_have_their_steps_and_derivatives("triangular")
