"""Transitions and rollouts as one function of PyTorch and of JAX."""

import copy
import pickle
import subprocess
import sys

import numpy as np
import physgrad as pg
import pytest
from networks import SCENES, policy, relative, task


class Torch:
    """Functions of arrays by PyTorch."""

    def __init__(self):
        self.torch = pytest.importorskip("torch", reason="PyTorch is not installed")
        self.module = pg.torch

    def __call__(self, f, arrays, bars):
        """Outputs, and cotangents of the arrays."""
        tensors = [self.torch.tensor(array, requires_grad=True) for array in arrays]
        outputs = f(*tensors)
        outputs = outputs if isinstance(outputs, tuple) else (outputs,)
        found = self.torch.autograd.grad(outputs, tensors, [self.torch.tensor(bar) for bar in bars])
        return [output.detach().numpy() for output in outputs], [bar.numpy() for bar in found]


class Jax:
    """Functions of arrays by JAX."""

    def __init__(self):
        self.jax = pytest.importorskip("jax", reason="JAX is not installed")
        self.jax.config.update("jax_enable_x64", True)
        self.module = pg.jax

    def __call__(self, f, arrays, bars):
        """Outputs, and cotangents of the arrays."""
        outputs, pull = self.jax.vjp(self.jax.jit(f), *arrays)
        found = pull(tuple(bars) if isinstance(outputs, tuple) else bars[0])
        outputs = outputs if isinstance(outputs, tuple) else (outputs,)
        return [np.asarray(output) for output in outputs], [np.asarray(bar) for bar in found]


@pytest.fixture(params=[Torch, Jax])
def framework(request):
    made = request.param()
    yield made
    if isinstance(made, Jax):
        made.jax.config.update("jax_enable_x64", False)


def random(*shapes, seed=0):
    rng = np.random.default_rng(seed)
    return [rng.standard_normal(shape) for shape in shapes]


@pytest.mark.parametrize("scene", SCENES)
def test_a_transition_is_three_functions(framework, scene):
    of = task(scene)
    starts = np.asarray(of.starts(5, seed=1), np.float64)
    x, p, (u,) = starts[:, : of.state_dim], starts[:, of.state_dim :], random((5, of.control_dim))
    bars = random((5, of.state_dim), (5, of.observation_dim), (5,))
    outputs, found = framework(lambda x, u, p: framework.module.transition(of)(x, u, p, 3), (x, u, p), bars)
    next = of.step(x, u, p=p, t=3)
    y, cost = of.observe(next, p=p, t=4), of.running_cost(x, u, next, p=p, t=3)
    for output, expected, own in zip(outputs, (next, y, cost), of.transition(x, u, p=p, t=3)):
        np.testing.assert_array_equal(output, expected)
        np.testing.assert_array_equal(own, expected)
    x_1, u_1, next_bar, p_1 = of.running_cost_vjp(x, u, next, bars[2], p=p, t=3)
    next_2, p_2 = of.observe_vjp(next, bars[1], p=p, t=4)
    x_3, u_3, p_3 = of.step_vjp(x, u, bars[0] + next_bar + next_2, p=p, t=3)
    own = of.transition_vjp(x, u, next, *bars, p=p, t=3)
    for bar, expected, alone in zip(found, (x_1 + x_3, u_1 + u_3, p_1 + p_2 + p_3), own):
        np.testing.assert_array_equal(bar, alone)
        if expected.size:
            assert relative(bar, expected) < 1e-13


@pytest.mark.parametrize("scene", SCENES)
def test_states_of_given_controls_are_those_of_steps(framework, scene):
    of = task(scene)
    starts = np.asarray(of.starts(6, seed=1), np.float64).reshape(2, 3, -1)
    (u,) = random((2, 3, 9, of.control_dim))
    (bar,) = random((2, 3, 10, of.state_dim), seed=1)
    (states,), (u_bar, starts_bar) = framework(framework.module.rollout(of), (u, starts), [bar])
    x, p = starts[..., : of.state_dim], starts[..., of.state_dim :]
    flat = lambda array: array.reshape(6, -1)  # noqa: E731
    expected = [flat(x)]
    for t in range(9):
        expected.append(of.step(expected[-1], flat(u[:, :, t]), p=flat(p), t=t))
    np.testing.assert_array_equal(states, np.stack(expected, 1).reshape(states.shape))
    lam, p_bar = flat(bar[:, :, 9]), 0.0
    for t in reversed(range(9)):
        x_bar, one, by_p = of.step_vjp(expected[t], flat(u[:, :, t]), lam, p=flat(p), t=t)
        np.testing.assert_allclose(flat(u_bar[:, :, t]), one, rtol=1e-12, atol=1e-12 * np.abs(one).max())
        lam, p_bar = x_bar + flat(bar[:, :, t]), p_bar + by_p
    assert relative(starts_bar[..., : of.state_dim], lam.reshape(x.shape)) < 1e-12
    if of.param_dim:
        assert relative(starts_bar[..., of.state_dim :], p_bar.reshape(p.shape)) < 1e-12


@pytest.mark.parametrize("scene", SCENES)
@pytest.mark.parametrize("flow", ["R", "M", "N", "S"])
def test_the_loss_of_a_rollout_has_the_gradients_of_the_task(framework, scene, flow):
    of = task(scene)
    network, starts = policy(of), np.asarray(of.starts(5, seed=2), np.float64)
    theta = np.asarray(network.theta)
    x, u = pg.rollout(of, network, starts)
    p, n = starts[:, of.state_dim :], of.state_dim
    x_bar, u_bar, weight = np.zeros_like(x), np.zeros_like(u), np.full(5, 0.2)
    for t in range(of.horizon):
        by_x, by_u, by_next, _ = of.running_cost_vjp(x[:, t], u[:, t], x[:, t + 1], weight, p=p, t=t)
        x_bar[:, t] += by_x
        x_bar[:, t + 1] += by_next
        u_bar[:, t] += by_u
    x_bar[:, -1] += of.terminal_cost_vjp(x[:, -1], weight, p=p)[0]
    rollout = framework.module.rollout(of, network, flow)
    outputs, (theta_bar, starts_bar) = framework(rollout, (theta, starts), [x_bar, u_bar])
    np.testing.assert_array_equal(outputs[0], x)
    np.testing.assert_array_equal(outputs[1], u)
    assert relative(theta_bar, pg.gradients(of, network, starts, fields=[flow])[flow]) < 1e-12
    if flow == "R":
        h, row = 1e-6, np.zeros_like(starts)
        row[:, n - 1] = h
        difference = (pg.losses(of, network, starts + row) - pg.losses(of, network, starts - row)) / (2 * h)
        assert relative(5 * starts_bar[:, n - 1], difference) < 1e-4


def test_functions_are_copied_pickled_and_compared(framework):
    of, other = task("params"), task("terminal")
    functions = [getattr(framework.module, name) for name in ("step", "observe", "running_cost", "terminal_cost", "transition")]
    made = [function(of) for function in functions] + [framework.module.rollout(of), framework.module.rollout(of, policy(of), "M")]
    for function in made:
        for found in (copy.deepcopy(function), pickle.loads(pickle.dumps(function))):
            assert found == function and hash(found) == hash(function) and found is not function
    assert len(set(made)) == len(made)
    assert framework.module.step(of) != framework.module.step(other)
    assert framework.module.rollout(of, policy(of)) != framework.module.rollout(of, policy(of), "M")


def test_wrong_rollouts_are_named(framework):
    of = task("params")
    network = policy(of)
    (u,), starts = random((3, 4, 1)), np.asarray(of.starts(3), np.float64)
    rollout, closed = framework.module.rollout(of), framework.module.rollout(of, network)
    arrays = framework.torch.tensor if isinstance(framework, Torch) else np.asarray
    with pytest.raises(ValueError, match="`starts` has shape"):
        rollout(arrays(u), arrays(starts[:, :-1]))
    with pytest.raises(ValueError, match="`u` has shape"):
        rollout(arrays(u[:, 0, 0]), arrays(starts))
    with pytest.raises(ValueError, match="leading dimensions"):
        rollout(arrays(u[:2]), arrays(starts))
    with pytest.raises(ValueError, match="`theta` has shape"):
        closed(arrays(network.theta[:-1]), arrays(starts))
    with pytest.raises(TypeError, match="dtypes are"):
        rollout(arrays(u), arrays(starts.astype(np.float32)))
    with pytest.raises(ValueError, match='`flow` is "C"'):
        framework.module.rollout(of, network, "C")
    with pytest.raises(ValueError, match="has no other paths|no other paths"):
        framework.module.rollout(of, flow="M")
    with pytest.raises(ValueError, match="the policy"):
        framework.module.rollout(task("running"), network)
    # A mass below 0, and a rollout that diverges, are errors with a place.
    with pytest.raises(Exception, match="is not finite|diverge|non-finite"):
        result = closed(arrays(np.full(len(network), 1e300)), arrays(starts))
        np.asarray(result[0])


def noisy():
    return pg.system(
        lambda x, u, p: [u.force + p.gust - x.q],
        states=["q"],
        controls=["force"],
        params={"gust": pg.noise(0.5), "late": 2.0},
        dt=0.1,
        horizon=5,
        settings={"precision": "f64"},
    )


def test_noise_has_no_gradient_in_the_starts(framework):
    of = noisy()
    starts, (u,) = of.starts(3), random((3, 5, 1))
    (states,), (_, bar) = framework(framework.module.rollout(of), (u, starts), [np.ones((3, 6, 1))])
    moved = starts + np.array([0.0, 1.0, 0.0])
    np.testing.assert_array_equal(framework(framework.module.rollout(of), (u, moved), [np.ones((3, 6, 1))])[0][0], states)
    assert np.abs(bar[:, 0]).min() > 1 and not bar[:, 1:].any()
    with pytest.raises(ValueError, match="`transition`: equations has noise"):
        framework.module.transition(of)


def transition_of(of):
    call, x = pg.torch.transition(of), start(of)[:, : of.state_dim]
    return lambda u: call(x, u[:, 0])[0], controls(of)


def states_of(of):
    call, starts = pg.torch.rollout(of), start(of)
    return lambda u: call(u, starts), controls(of)


def policy_of(of):
    call, starts = pg.torch.rollout(of, policy(of)), start(of)
    return lambda theta: call(theta, starts)[0], parameters(of)


def start(of):
    return pg.torch.torch.tensor(of.starts(3, dtype="float64"))


def controls(of):
    return pg.torch.torch.tensor(random((3, 4, of.control_dim))[0])


def parameters(of):
    return pg.torch.torch.tensor(np.asarray(policy(of).theta))


@pytest.mark.parametrize("function", [transition_of, states_of, policy_of])
def test_torch_transforms_of_reverse_mode_agree_and_others_are_refused(function):
    torch = pytest.importorskip("torch", reason="PyTorch is not installed")
    f, x = function(task("terminal"))
    leaf = x.clone().requires_grad_()
    expected = torch.autograd.grad(f(leaf).sin().sum(), leaf)[0]
    torch.testing.assert_close(torch.func.grad(lambda x: f(x).sin().sum())(x), expected)
    (once,) = torch.autograd.grad(torch.utils.checkpoint.checkpoint(f, leaf, use_reentrant=False).sin().sum(), leaf)
    torch.testing.assert_close(once, expected)
    compiled = torch.compile(lambda x: f(x).sin().sum(), backend="aot_eager", fullgraph=True)
    torch.testing.assert_close(torch.autograd.grad(compiled(leaf), leaf)[0], expected)
    with pytest.raises(RuntimeError, match="has no forward mode"):
        torch.func.jvp(f, (x,), (x,))
    with pytest.raises(RuntimeError, match="has no second derivatives"):
        (first,) = torch.autograd.grad(f(leaf).sin().sum(), leaf, create_graph=True)
        first.sum().backward()


SAVED = """
import sys
import torch
import physgrad as pg

of = pg.task("cart_pole", poles=1, settings={"precision": "f64"})
x, u = torch.full((1, 4), 0.5, dtype=torch.float64), torch.ones(1, 1, dtype=torch.float64)


class Step(torch.nn.Module):
    def forward(self, x, u):
        return pg.torch.step(of)(x, u)


if sys.argv[1] == "save":
    torch.export.save(torch.export.export(Step(), (x, u)), "step.pt2")
else:
    pg.torch.step(pg.task("cart_pole", poles=1, gravity=1.0))
    loaded = torch.export.load("step.pt2").module()
    try:
        loaded(x, u)
    except RuntimeError as error:
        assert "is one of a task that this process does not know" in str(error), error
    else:
        raise AssertionError("the graph of another task is not refused")
    expected = pg.torch.step(of)(x, u)
    assert torch.equal(loaded(x, u), expected)
"""


def test_a_graph_of_another_process_computes_its_own_task(tmp_path):
    pytest.importorskip("torch", reason="PyTorch is not installed")
    for part in ("save", "load"):
        subprocess.run([sys.executable, "-c", SAVED, part], cwd=tmp_path, check=True, timeout=300)


def test_torch_names_arguments_that_are_no_tensors():
    pytest.importorskip("torch", reason="PyTorch is not installed")
    of = task("terminal")
    x = of.starts(2, dtype="float64")
    with pytest.raises(TypeError, match="`x` is of type ndarray; allowed: a tensor. Use `torch.from_numpy"):
        pg.torch.step(of)(x, controls(of)[:2, 0])
    with pytest.raises(TypeError, match="`t` is of type float; allowed: an int"):
        pg.torch.step(of)(start(of), controls(of)[:, 0], t=1.5)


def test_jax_maps_rollouts_over_parameters_and_starts():
    jax = pytest.importorskip("jax", reason="JAX is not installed")
    jax.config.update("jax_enable_x64", True)
    try:
        of = task("params")
        network, starts = policy(of), np.asarray(of.starts(4), np.float64)
        thetas = np.stack([network.theta, 1.1 * network.theta])
        rollout = pg.jax.rollout(of, network)
        both = jax.vmap(rollout, in_axes=(0, None))(thetas, starts)
        for theta, x in zip(thetas, both[0]):
            np.testing.assert_array_equal(x, rollout(theta, starts)[0])
        each = jax.vmap(rollout, in_axes=(None, 0))(thetas[0], starts)
        np.testing.assert_array_equal(each[0], rollout(thetas[0], starts)[0])
        slopes = jax.vmap(jax.grad(lambda theta: rollout(theta, starts)[0].sum()))(thetas)
        np.testing.assert_array_equal(slopes[1], jax.grad(lambda theta: rollout(theta, starts)[0].sum())(thetas[1]))
    finally:
        jax.config.update("jax_enable_x64", False)
