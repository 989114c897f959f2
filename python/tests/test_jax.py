"""Steps, observations and costs in JAX."""

import os
import subprocess
import sys

import numpy as np
import physgrad as pg
import pytest

jax = pytest.importorskip("jax", reason="JAX is not installed")

import jax.numpy as jnp  # noqa: E402
from jax.test_util import check_grads  # noqa: E402
from networks import SCENES, flat, policy, relative, task, weights  # noqa: E402


@pytest.fixture(autouse=True)
def double_precision():
    jax.config.update("jax_enable_x64", True)
    yield
    jax.config.update("jax_enable_x64", False)


def test_double_precision_must_be_global():
    of = task("terminal")
    jax.config.update("jax_enable_x64", False)
    with jax.enable_x64(True):
        x, u, _ = batch(of, 1000)
        step = jax.jit(pg.jax.step(of))
        try:
            found = np.asarray(step(x, u))
        except Exception as error:  # JAX wraps errors of callbacks in errors of its own.
            assert "at the start" in str(error)
        else:
            assert np.array_equal(found, of.step(x, u))


def functions(of):
    return pg.jax.step(of), pg.jax.observe(of), pg.jax.running_cost(of), pg.jax.terminal_cost(of)


def batch(of, count=3, seed=0):
    starts = np.asarray(of.starts(count, seed=seed), dtype=np.float64)
    u = np.random.default_rng(seed).standard_normal((count, of.control_dim))
    return starts[:, : of.state_dim], u, starts[:, of.state_dim :]


def calls(f, *arrays):
    """Names of the primitives of a function that call the physics, with the shapes of their results."""
    found = []

    def visit(jaxpr):
        for equation in jaxpr.eqns:
            if equation.primitive.name == "ffi_call":
                found.append((int(dict(equation.params["attributes"])["operation"]), equation.outvars[0].aval.shape))
            for value in equation.params.values():
                for inner in value if isinstance(value, (tuple, list)) else (value,):
                    if hasattr(inner, "jaxpr"):
                        visit(inner.jaxpr)
                    elif hasattr(inner, "eqns"):
                        visit(inner)

    visit(jax.make_jaxpr(f)(*arrays).jaxpr)
    names = pg._core.operation_names()
    return [(names[code], shape) for code, shape in found]


def loss(of, parts, starts, flow):
    """Mean loss. The flow selects the arrays whose gradients stop."""
    step, observe, running_cost, terminal_cost = functions(of)
    x, p = starts[:, : of.state_dim], starts[:, of.state_dim :]
    stop = jax.lax.stop_gradient

    def body(x, t):
        y = observe(x, p, t)
        u = stop(y) if flow in "MS" else y
        for layer in range(0, len(parts), 2):
            u = u @ parts[layer] + parts[layer + 1]
            u = u if layer == len(parts) - 2 else jnp.tanh(u)
        next = step(stop(x) if flow in "NS" else x, u, p, t)
        return next, running_cost(x, u, next, p, t)

    x, costs = jax.lax.scan(body, x, jnp.arange(of.horizon))
    return (costs.sum(0) + terminal_cost(x, p)).mean()


@pytest.mark.parametrize("scene", SCENES)
@pytest.mark.parametrize("flow", ["R", "M", "N", "S"])
def test_stopping_gradients_gives_the_flows(scene, flow):
    of = task(scene)
    network, starts = policy(of), np.asarray(of.starts(5, seed=2), dtype=np.float64)
    expected = pg.gradients(of, network, starts, fields=[flow])[flow]
    parts = weights(of, np.asarray(network.theta))
    found = jax.jit(jax.grad(lambda parts: loss(of, parts, starts, flow)))(parts)
    assert relative(flat(found), expected) < 1e-10


@pytest.mark.parametrize("scene", SCENES)
def test_check_grads_passes(scene):
    of = task(scene)
    step, observe, running_cost, terminal_cost = functions(of)
    x, u, p = batch(of)
    check = lambda f, *args: check_grads(f, args, order=1, modes=["rev"])  # noqa: E731
    check(lambda x, u, p: step(x, u, p, 3), x, u, p)
    check(lambda x, p: observe(x, p, 3), x, p)
    check(lambda x, u, next, p: running_cost(x, u, next, p, 3), x, u, x + 0.1, p)
    check(terminal_cost, x, p)


def test_values_are_those_of_the_task():
    of = task("params")
    x, u, p = batch(of)
    assert np.array_equal(pg.jax.step(of)(x, u, p, t=5), of.step(x, u, p=p, t=5))
    single = [array.astype(np.float32) for array in (x, u, p)]
    assert np.array_equal(pg.jax.step(of)(*single, t=5), of.step(*single[:2], p=single[2], t=5))


def test_vmap_is_one_call():
    of = task("params")
    step, terminal_cost = pg.jax.step(of), pg.jax.terminal_cost(of)
    x, u, p = batch(of, 6)
    expected = of.step(x, u, p=p, t=2)
    mapped = jax.vmap(lambda x, u, p: step(x, u, p, 2))
    assert np.array_equal(mapped(x, u, p), expected)
    assert np.array_equal(jax.jit(mapped)(x, u, p), expected)
    # Shared controls, and two nested calls of vmap.
    both = jax.vmap(jax.vmap(lambda x, u: step(x, u, p[0], 2), in_axes=(0, None)), in_axes=(None, 0))(x, u)
    assert both.shape == (6, 6, of.state_dim)
    assert np.array_equal(both[2], of.step(x, np.broadcast_to(u[2], u.shape), p=np.broadcast_to(p[0], p.shape), t=2))
    each = jax.vmap(jax.grad(lambda x, u, p: terminal_cost(step(x, u, p), p)))
    n = of.state_dim
    assert calls(each, x, u, p) == [("step", (6, n)), ("terminal_cost", (6,)), ("terminal_cost_vjp", (6, n)), ("step_vjp", (6, n))]
    all_rows = jax.grad(lambda x: terminal_cost(step(x, u, p), p).sum())(x)
    assert np.array_equal(jax.jit(each)(x, u, p), all_rows)


def test_step_numbers_may_differ_under_vmap():
    of = task("params")
    x, u, p = batch(of, 4)
    t = np.array([5, 2, 5, 0])
    found = jax.vmap(pg.jax.step(of))(x, u, p, t)
    expected = np.concatenate([of.step(x[i : i + 1], u[i : i + 1], p=p[i : i + 1], t=int(t[i])) for i in range(4)])
    assert np.array_equal(found, expected)
    gradient = jax.vmap(jax.grad(lambda x, u, p, t: pg.jax.step(of)(x, u, p, t).sum()))(x, u, p, t)
    parts = [of.step_vjp(x[i : i + 1], u[i : i + 1], np.ones_like(x[:1]), p=p[i : i + 1], t=int(t[i]))[0] for i in range(4)]
    assert np.array_equal(gradient, np.concatenate(parts))


@pytest.mark.parametrize(
    "change, error, message",
    [
        (lambda x, u: (x.astype(np.float32), u), TypeError, "`x` float32, `u` float64"),
        (lambda x, u: (x.astype(np.int32), u), TypeError, "Use float32, or float64"),
        (lambda x, u: (x[:, :-1], u), ValueError, "`x` has shape"),
        (lambda x, u: (x, u[:2]), ValueError, "leading dimensions"),
    ],
)
def test_wrong_arrays_are_named(change, error, message):
    of = task("terminal")
    x, u, _ = batch(of)
    with pytest.raises(error, match=message):
        pg.jax.step(of)(*change(x, u))


def test_vmap_of_the_step_number_or_the_cotangent_only():
    of = task("terminal")
    x, u, _ = batch(of, 1)
    x, u, step = x[0], u[0], pg.jax.step(of)
    ts = jnp.arange(3)
    found = jax.vmap(lambda t: step(x, u, None, t))(ts)
    assert np.array_equal(found, np.stack([step(x, u, None, int(t)) for t in ts]))
    slopes = jax.vmap(lambda t: jax.grad(lambda x: step(x, u, None, t).sum())(x))(ts)
    assert np.array_equal(slopes[1], jax.grad(lambda x: step(x, u, None, 1).sum())(x))
    jacobian = jax.jacrev(lambda x: step(x, u))(x)
    rows = [jax.vjp(lambda x: step(x, u), x)[1](row)[0] for row in jnp.eye(of.state_dim)]
    assert np.array_equal(jacobian, np.stack(rows))
    nested = jax.vmap(lambda x: jax.jacrev(lambda x: step(x, u))(x))(jnp.stack([x, 2 * x]))
    assert relative(nested[0], jacobian) < 1e-12
    weights = jnp.arange(1.0, 4.0)
    scaled = jax.vmap(lambda w: jax.grad(lambda x: (w * step(x, u)).sum())(x))(weights)
    assert relative(scaled[2], 3 * scaled[0]) < 1e-12


@pytest.mark.parametrize("lead", [(4, 4), (2, 4), (3, 2, 4)])
@pytest.mark.parametrize("shape", [(4,), (1, 4), (2, 1), (4, 1), (2, 4), (1,), (3, 1, 1)])
def test_step_numbers_broadcast_as_in_numpy(lead, shape):
    of = task("params")
    x, u, p = (np.asarray(array).reshape(*lead, -1) for array in batch(of, int(np.prod(lead))))
    t = 7 * np.arange(np.prod(shape)).reshape(shape)
    step, running_cost = pg.jax.step(of), pg.jax.running_cost(of)
    try:
        every = np.broadcast_to(t, lead)
    except ValueError:
        with pytest.raises(ValueError, match="`step`: `t` has shape .*, which does not broadcast to the batch dimensions"):
            step(x, u, p, t)
        return
    rows = list(np.ndindex(*lead))
    next = np.empty_like(x)
    for row in rows:
        next[row] = of.step(x[row][None], u[row][None], p=p[row][None], t=int(every[row]))[0]
    found, pull = jax.vjp(jax.jit(lambda x, u, p: step(x, u, p, t)), x, u, p)
    assert np.array_equal(found, next)
    bar = np.random.default_rng(1).normal(size=x.shape)
    bars = pull(bar)
    for row in rows:
        own = of.step_vjp(x[row][None], u[row][None], bar[row][None], p=p[row][None], t=int(every[row]))
        assert all(np.array_equal(all_rows[row], one[0]) for all_rows, one in zip(bars, own))
    # An outer `vmap` over another batch keeps the alignment, for mapped and for equal step numbers.
    twice = [np.stack([array, array]) for array in (x, u, p)]
    assert np.array_equal(jax.vmap(lambda x, u, p: step(x, u, p, t))(*twice)[1], next)
    assert np.array_equal(jax.vmap(step)(*twice, np.stack([t + 1, t]))[1], next)
    costs = running_cost(x, u, next, p, t)
    assert costs.shape == lead and np.array_equal(costs, running_cost(x, u, next, p, every))


@pytest.mark.parametrize("t, error", [(1.5, TypeError), (np.arange(3), ValueError), (np.zeros((5, 1), int), ValueError)])
def test_wrong_step_numbers_are_named(t, error):
    of = task("terminal")
    x, u, _ = batch(of, 5)
    with pytest.raises(error, match="`step`: `t` has"):
        pg.jax.step(of)(x, u, None, t)


def test_forward_mode_is_refused():
    of = task("terminal")
    x, u, _ = batch(of)
    with pytest.raises(TypeError, match="custom_vjp"):
        jax.jvp(pg.jax.step(of), (x, u), (x, u))


@pytest.mark.parametrize("cores", ["all", "one"])
def test_large_batches_without_waiting_do_not_block(cores):
    """Callbacks of JAX wait for arrays. A waiting thread must not block the one that it needs."""
    script = """
import os, sys
if sys.argv[1] == "one" and hasattr(os, "sched_setaffinity"):
    os.sched_setaffinity(0, {min(os.sched_getaffinity(0))})
import jax, jax.numpy as jnp, physgrad as pg
task = pg.task("cart_pole", poles=2, horizon=5)
step, cost = pg.jax.step(task), pg.jax.terminal_cost(task)
starts = jnp.asarray(task.starts(50_000, seed=0), jnp.float32)
def loss(w):
    x, _ = jax.lax.scan(lambda x, t: (step(x, jnp.tanh(x @ w), t=t), None), starts, jnp.arange(5))
    return cost(x).mean()
gradient, w = jax.jit(jax.grad(loss)), jnp.zeros((task.state_dim, task.control_dim))
for _ in range(10):
    w = w - gradient(w)
print(bool(jnp.isfinite(w).all()))
"""
    ran = subprocess.run([sys.executable, "-c", script, cores], capture_output=True, text=True, timeout=300, env=os.environ)
    assert ran.stdout.strip() == "True", ran.stderr
