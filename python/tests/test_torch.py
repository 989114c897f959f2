"""Steps, observations and costs in PyTorch."""

import copy
import gc
import subprocess
import sys

import numpy as np
import physgrad as pg
import pytest

torch = pytest.importorskip("torch", reason="PyTorch is not installed")

from networks import SCENES, flat, policy, relative, task, weights  # noqa: E402


def functions(of):
    return pg.torch.step(of), pg.torch.observe(of), pg.torch.running_cost(of), pg.torch.terminal_cost(of)


def batch(of, count=3, seed=0, dtype=torch.float64):
    """States, controls and parameters, all with gradients."""
    starts = torch.from_numpy(np.asarray(of.starts(count, seed=seed))).to(dtype)
    u = torch.from_numpy(np.random.default_rng(seed).standard_normal((count, of.control_dim))).to(dtype)
    tensors = starts[:, : of.state_dim], u, starts[:, of.state_dim :]
    return [tensor.clone().requires_grad_() for tensor in tensors]


def gradient(of, parts, starts, flow):
    """Gradient with respect to the weights. The flow selects the tensors that are detached."""
    step, observe, running_cost, terminal_cost = functions(of)
    parts = [torch.from_numpy(part.copy()).requires_grad_() for part in parts]
    starts = torch.from_numpy(starts)
    x, p = starts[:, : of.state_dim], starts[:, of.state_dim :]
    loss = torch.zeros(len(x), dtype=x.dtype)
    for t in range(of.horizon):
        y = observe(x, p, t)
        u = y.detach() if flow in "MS" else y
        for layer in range(0, len(parts), 2):
            u = u @ parts[layer] + parts[layer + 1]
            u = u if layer == len(parts) - 2 else torch.tanh(u)
        next = step(x.detach() if flow in "NS" else x, u, p, t)
        loss = loss + running_cost(x, u, next, p, t)
        x = next
    loss = (loss + terminal_cost(x, p)).mean()
    return flat(torch.autograd.grad(loss, parts))


@pytest.mark.parametrize("scene", SCENES)
@pytest.mark.parametrize("flow", ["R", "M", "N", "S"])
def test_detaching_gives_the_flows(scene, flow):
    of = task(scene)
    network, starts = policy(of), np.asarray(of.starts(5, seed=2), dtype=np.float64)
    expected = pg.gradients(of, network, starts, fields=[flow])[flow]
    found = gradient(of, weights(of, np.asarray(network.theta)), starts, flow)
    assert relative(found, expected) < 1e-10


@pytest.mark.parametrize("scene", SCENES)
def test_gradcheck_passes(scene):
    of = task(scene)
    step, observe, running_cost, terminal_cost = functions(of)
    x, u, p = batch(of)
    check = lambda f, *args: torch.autograd.gradcheck(f, args, atol=1e-6)  # noqa: E731
    assert check(lambda x, u, p: step(x, u, p, 3), x, u, p)
    assert check(lambda x, p: observe(x, p, 3), x, p)
    assert check(lambda x, u, next, p: running_cost(x, u, next, p, 3), x, u, (x + 0.1).detach().requires_grad_(), p)
    assert check(terminal_cost, x, p)


def test_values_are_those_of_the_task():
    of = task("params")
    x, u, p = batch(of)
    next = pg.torch.step(of)(x, u, p, t=5)
    expected = of.step(*(v.detach().numpy() for v in (x, u)), p=p.detach().numpy(), t=5)
    assert np.array_equal(next.detach().numpy(), expected)
    assert not np.array_equal(pg.torch.step(of)(x, u, p, t=6).detach().numpy(), expected)


@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
def test_leading_dimensions_broadcast(dtype):
    of = task("params")
    step = pg.torch.step(of)
    x, u, p = (tensor.detach() for tensor in batch(of, 6, dtype=dtype))
    expected = step(x, u, p)
    assert expected.dtype == dtype
    assert torch.equal(step(x.view(2, 3, -1), u.view(2, 3, -1), p.view(2, 3, -1)).view(6, -1), expected)
    assert torch.equal(step(x[0], u[0], p[0]), expected[0])
    # One control and one parameter vector for all rows: their gradients are sums over rows.
    shared = u[:1].clone().requires_grad_()
    step(x, shared, p[0]).sum().backward()
    each = u[:1].expand(6, -1).clone().requires_grad_()
    step(x, each, p[:1].expand(6, -1)).sum().backward()
    assert torch.allclose(shared.grad, each.grad.sum(0, keepdim=True))
    # Columns of a larger tensor.
    wide = torch.cat([x, x], 1)
    assert torch.equal(step(wide[:, : of.state_dim], u, p), expected)


def test_vmap_is_one_batch():
    of = task("params")
    step, terminal_cost = pg.torch.step(of), pg.torch.terminal_cost(of)
    x, u, p = batch(of, 6)
    expected = step(x, u, p, 2)
    assert torch.equal(torch.vmap(lambda x, u, p: step(x, u, p, 2))(x, u, p), expected)
    assert torch.equal(torch.vmap(lambda x, u: step(x, u, p, 2), in_dims=(None, 0))(x, u[:, None])[2], step(x, u[2], p, 2))
    one = torch.autograd.grad(torch.vmap(lambda x, u, p: terminal_cost(step(x, u, p), p))(x, u, p).sum(), x)
    assert torch.equal(one[0], torch.autograd.grad(terminal_cost(step(x, u, p), p).sum(), x)[0])


@pytest.mark.parametrize("backend", ["aot_eager"])
def test_compiled_loops_have_equal_gradients(backend):
    of = task("params")
    step, _, running_cost, terminal_cost = functions(of)

    def loss(x, u, p):
        total = 0.0
        for t in range(3):
            next = step(x, u, p, t)
            total, x = total + running_cost(x, u, next, p, t), next
        return (total + terminal_cost(x, p)).sum()

    tensors = batch(of)
    expected = torch.autograd.grad(loss(*tensors), tensors)
    found = torch.autograd.grad(torch.compile(loss, backend=backend, fullgraph=True)(*tensors), tensors)
    assert all(map(torch.equal, found, expected))


def test_operators_follow_the_rules_of_torch():
    for scene in ("params", "terminal"):
        of = task(scene)
        x, u, p = batch(of)
        p, handle = p if of.param_dim else None, pg.torch.step(of).handle
        torch.library.opcheck(torch.ops.physgrad.step.default, (x, u, p, 1, handle))
        torch.library.opcheck(torch.ops.physgrad.terminal_cost.default, (x, p, 0, handle))
        one = (x[0], None if p is None else p[0], 0, handle)
        torch.library.opcheck(torch.ops.physgrad.terminal_cost.default, one)


@pytest.mark.parametrize(
    "change, error, message",
    [
        (lambda x, u: (x.float(), u), TypeError, "`x` torch.float32, `u` torch.float64"),
        (lambda x, u: (x.half(), u.half()), TypeError, "Use float32, or float64"),
        (lambda x, u: (x[:, :-1], u), ValueError, "`x` has shape"),
        (lambda x, u: (x, u.to("meta")), TypeError, "`u` is on meta, but the physics runs on the CPU"),
        (lambda x, u: (x, u[:2]), ValueError, "leading dimensions"),
    ],
)
def test_wrong_tensors_are_named(change, error, message):
    of = task("terminal")
    x, u, _ = batch(of)
    with pytest.raises(error, match=message):
        pg.torch.step(of)(*change(x.detach(), u.detach()))


def dual(f, inputs, tangents):
    """Tangent of the output by dual numbers."""
    ad = torch.autograd.forward_ad
    with ad.dual_level():
        return ad.unpack_dual(f(*map(ad.make_dual, inputs, tangents))).tangent


# Forward mode of a function of several inputs, as a function of inputs and tangents.
FORWARD = {
    "jvp": lambda f, inputs, tangents: torch.func.jvp(f, inputs, tangents)[1],
    "forward_ad": dual,
    "linearize": lambda f, inputs, tangents: torch.func.linearize(f, *inputs)[1](*tangents),
    "jacfwd": lambda f, inputs, tangents: contract(torch.func.jacfwd(f, tuple(range(len(inputs))))(*inputs), tangents),
    "jvp of vmap": lambda f, inputs, tangents: torch.func.jvp(torch.vmap(f), inputs, tangents)[1],
    "vmap of jvp": lambda f, inputs, tangents: torch.vmap(lambda x, v: torch.func.jvp(f, x, v)[1])(inputs, tangents),
    "with gradients": lambda f, inputs, tangents: torch.func.jvp(
        f, tuple(tensor.clone().requires_grad_() for tensor in inputs), tangents
    )[1],
}


def contract(jacobians, tangents):
    """Sum of the products of Jacobians, (output..., input...), with tangents, (input...)."""
    return sum(torch.tensordot(jacobian, tangent, tangent.dim()) for jacobian, tangent in zip(jacobians, tangents))


def cases(of):
    """Functions of tensors with their inputs, all with p and t."""
    step, observe, running_cost, terminal_cost = functions(of)
    x, u, p = (tensor.detach() for tensor in batch(of))
    return {
        "step": (lambda x, u, p: step(x, u, p, 3), (x, u, p)),
        "observe": (lambda x, p: observe(x, p, 3), (x, p)),
        "running_cost": (lambda x, u, next, p: running_cost(x, u, next, p, 3), (x, u, x + 0.1, p)),
        "terminal_cost": (terminal_cost, (x, p)),
        "a sum": (lambda x, u, p: (2.0 * torch.sin(step(x, torch.tanh(u), p)) + x).sum(-1) * u.sum(-1), (x, u, p)),
    }


@pytest.mark.parametrize("scene", SCENES)
@pytest.mark.parametrize("mode", FORWARD)
def test_forward_mode_equals_the_jacobians_of_reverse_mode(scene, mode):
    torch.manual_seed(1)
    for name, (f, inputs) in cases(task(scene)).items():
        tangents = tuple(torch.randn_like(tensor) for tensor in inputs)
        jacobians = torch.autograd.functional.jacobian(f, inputs)
        expected, found = contract(jacobians, tangents), FORWARD[mode](f, inputs, tangents)
        assert relative(found.detach().numpy(), expected.numpy()) < 1e-10, name


def test_forward_mode_of_a_step_is_the_product_of_the_task():
    of = task("params")
    x, u, p = (tensor.detach() for tensor in batch(of))
    u_tan = torch.ones_like(u)
    found = torch.func.jvp(lambda u: pg.torch.step(of)(x, u, p, 2), (u,), (u_tan,))[1]
    expected = of.step_jvp(x.numpy(), u.numpy(), u_tan=u_tan.numpy(), p=p.numpy(), t=2)
    assert np.array_equal(found.numpy(), expected) and np.abs(expected).max() > 0


def test_transforms_of_reverse_mode_equal_autograd():
    for f, inputs in cases(task("params")).values():
        leaves = tuple(tensor.clone().requires_grad_() for tensor in inputs)
        expected = torch.autograd.grad(f(*leaves).sum(), leaves)
        every = tuple(range(len(inputs)))
        found = torch.func.grad(lambda *inputs: f(*inputs).sum(), every)(*inputs)
        assert all(map(torch.equal, found, expected))
        each = torch.vmap(torch.func.grad(lambda *inputs: f(*inputs).sum(), every))(*inputs)
        assert all(map(torch.allclose, each, expected))
        jacobians = torch.func.jacrev(f, every)(*inputs)
        assert all(map(torch.allclose, jacobians, torch.autograd.functional.jacobian(f, inputs)))


SECOND = {
    "double backward": lambda f, x: torch.autograd.functional.hvp(lambda x: f(x).sum(), x, torch.ones_like(x)),
    "functional.jvp": lambda f, x: torch.autograd.functional.jvp(f, x, torch.ones_like(x)),
    "hessian": lambda f, x: torch.func.hessian(f)(x),
    "jacfwd of jacfwd": lambda f, x: torch.func.jacfwd(torch.func.jacfwd(f))(x),
    "jacrev of jacrev": lambda f, x: torch.func.jacrev(torch.func.jacrev(f))(x),
    "jacrev of jacfwd": lambda f, x: torch.func.jacrev(torch.func.jacfwd(f))(x),
    "jvp of grad": lambda f, x: torch.func.jvp(torch.func.grad(lambda x: (f(x) ** 2).sum()), (x,), (x,)),
}


@pytest.mark.parametrize("mode", SECOND)
def test_second_derivatives_are_refused(mode):
    for name, (f, (x, *others)) in cases(task("params")).items():
        with pytest.raises(RuntimeError, match="has no second derivatives: the physics is differentiable once"):
            print(name, SECOND[mode](lambda x: f(x, *others), x))


def test_the_error_of_second_derivatives_names_forward_mode():
    f, (x, *others) = cases(task("params"))["step"]
    with pytest.raises(RuntimeError, match="use `torch.func.jvp` instead"):
        torch.autograd.functional.jvp(lambda x: f(x, *others), x, torch.ones_like(x))


def test_products_are_differentiable_by_their_tangents():
    of = task("params")
    x, u, p = (tensor.detach() for tensor in batch(of))
    f = lambda u: pg.torch.step(of)(x, u, p)  # noqa: E731
    u_tan = torch.ones_like(u).requires_grad_()
    tangent = lambda u_tan: torch.func.jvp(f, (u,), (u_tan,))[1]  # noqa: E731
    assert torch.autograd.gradcheck(tangent, (u_tan,), atol=1e-6)


def test_compiled_functions_refuse_forward_mode():
    of = task("terminal")
    x, u, _ = (tensor.detach() for tensor in batch(of))
    step = pg.torch.step(of)
    compiled = torch.compile(lambda u: torch.func.jvp(lambda u: step(x, u), (u,), (u,))[1], backend="eager")
    with pytest.raises(Exception, match="not support forward mode"):
        compiled(u)


def test_exported_and_traced_graphs_refuse_forward_mode():
    of = task("terminal")
    x, u, _ = (tensor.detach() for tensor in batch(of))
    step = pg.torch.step(of)

    class Step(torch.nn.Module):
        def forward(self, u):
            return step(x, u)

    exported = torch.export.export(Step(), (u,)).module()
    traced = torch.fx.experimental.proxy_tensor.make_fx(lambda u: step(x, u))(u)
    for graph in (exported, traced):
        torch.testing.assert_close(graph(u), step(x, u))
        for product in (lambda: torch.func.jvp(graph, (u,), (u,)), lambda: torch.func.jacfwd(graph)(u)):
            with pytest.raises(RuntimeError, match="do not support forward mode"):
                product()


def test_a_graph_outlives_the_task():
    of = task("terminal")
    x, u, _ = batch(of)
    loss = pg.torch.step(of)(x, u).sum()
    del of
    gc.collect()
    loss.backward()
    assert torch.isfinite(x.grad).all()


class Controlled(torch.nn.Module):
    """A network and the physics that it controls, over some steps."""

    def __init__(self, of):
        super().__init__()
        self.network = torch.nn.Linear(of.observation_dim, of.control_dim, dtype=torch.float64)
        self.step, self.observe = pg.torch.step(of), pg.torch.observe(of)
        self.rollout = pg.torch.rollout(of)
        self.transition = pg.torch.transition(of)

    def forward(self, x, p):
        first = self.network(self.observe(x, p))
        x, _, cost = self.transition(self.step(x, first, p), first, p, 1)
        controls = torch.stack([first, first], -2)
        return self.rollout(controls, torch.cat([x, p], -1)).sum((-1, -2)) + cost


def test_modules_with_physics_are_saved_and_loaded(tmp_path):
    of = task("params").replace(horizon=2)
    module = Controlled(of)
    x, _, p = (tensor.detach() for tensor in batch(of))
    torch.save(module, tmp_path / "module.pt")
    torch.save(module.state_dict(), tmp_path / "state.pt")
    whole = torch.load(tmp_path / "module.pt", weights_only=False)
    other = Controlled(of)
    assert not torch.equal(other(x, p), module(x, p)), "the weights of another module differ"
    other.load_state_dict(torch.load(tmp_path / "state.pt"))
    expected = torch.autograd.grad(module(x, p).sum(), list(module.parameters()))
    for again in (whole, other, copy.deepcopy(module)):
        assert again.step == module.step and again.rollout == module.rollout and again.step.task == of
        assert torch.equal(again(x, p), module(x, p))
        assert all(map(torch.equal, torch.autograd.grad(again(x, p).sum(), list(again.parameters())), expected))
    # The weights of a copy are its own.
    with torch.no_grad():
        whole.network.bias += 1.0
    assert not torch.equal(whole(x, p), module(x, p))


def test_a_saved_module_needs_no_task_in_another_process(tmp_path):
    of = task("params")
    x, u, p = (tensor.detach() for tensor in batch(of))
    torch.save((pg.torch.step(of), x, u, p), tmp_path / "step.pt")
    program = (
        "import sys, torch; step, x, u, p = torch.load(sys.argv[1], weights_only=False); "
        "torch.save(step(x, u, p, 3), sys.argv[2])"
    )
    command = [sys.executable, "-c", program, tmp_path / "step.pt", tmp_path / "next.pt"]
    ran = subprocess.run(command, capture_output=True, text=True, timeout=300)
    assert ran.returncode == 0, ran.stderr
    assert torch.equal(torch.load(tmp_path / "next.pt"), pg.torch.step(of)(x, u, p, 3))
