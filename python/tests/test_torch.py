"""Steps, observations and costs in PyTorch."""

import gc

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
        p, handle = p if of.param_dim else None, pg.torch._handle(of)
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


def test_second_derivatives_are_refused():
    of = task("terminal")
    x, u, _ = batch(of)
    (first,) = torch.autograd.grad(pg.torch.step(of)(x, u).sum(), x, create_graph=True)
    with pytest.raises(RuntimeError, match="no autograd formula"):
        torch.autograd.grad(first.sum(), x)


def test_a_graph_outlives_the_task():
    of = task("terminal")
    x, u, _ = batch(of)
    loss = pg.torch.step(of)(x, u).sum()
    del of
    gc.collect()
    loss.backward()
    assert torch.isfinite(x.grad).all()
