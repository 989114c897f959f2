"""Array functions: derivatives, shapes, dtypes and errors."""

import numpy as np
import pytest

import physgrad as pg

RNG = np.random.default_rng(0)


def inputs(task, rows=37):
    starts = task.starts(rows, seed=3, dtype="float64")
    x, p = starts[:, : task.state_dim], starts[:, task.state_dim :]
    return x, RNG.normal(size=(rows, task.control_dim)), p


@pytest.fixture(params=["cart_pole", "guidance", "pendulum", "actuated", "drawn"])
def task(request):
    if request.param == "drawn":
        return pg.task("cart_pole", pole_mass={"uniform": [0.1, 0.2]}, effects={"steady_wind": {}})
    if request.param == "actuated":
        settings = {"actuator.limit.bound": 2.0, "actuator.lag.time": 0.1, "integrator.substeps": 2}
        return pg.task("pendulum", settings=settings)
    return pg.task(request.param)


def test_jvp_and_vjp_are_transposed_and_equal_differences(task):
    x, u, p = inputs(task)
    x_tan, u_tan, p_tan, bar = (RNG.normal(size=a.shape) for a in (x, u, p, x))
    next_tan = task.step_jvp(x, u, x_tan, u_tan, p=p, p_tan=p_tan, t=2)
    x_bar, u_bar, p_bar = task.step_vjp(x, u, bar, p=p, t=2)
    forward = (bar * next_tan).sum(1)
    backward = (x_bar * x_tan).sum(1) + (u_bar * u_tan).sum(1) + (p_bar * p_tan).sum(1)
    np.testing.assert_allclose(forward, backward, rtol=1e-9, atol=1e-9)
    h = 1e-6
    ends = [task.step(x + s * h * x_tan, u + s * h * u_tan, p=p + s * h * p_tan, t=2) for s in (1, -1)]
    np.testing.assert_allclose(next_tan, (ends[0] - ends[1]) / (2 * h), rtol=1e-4, atol=1e-4)


def test_costs_have_exact_gradients(task):
    x, u, p = inputs(task)
    next, bar, h = task.step(x, u, p=p), RNG.normal(size=len(x)), 1e-6
    for i, (array, found) in enumerate(zip((x, u, next), task.running_cost_vjp(x, u, next, bar, p=p))):
        direction = RNG.normal(size=array.shape)
        ends = []
        for sign in (1, -1):
            arrays = [x, u, next]
            arrays[i] = array + sign * h * direction
            ends.append(task.running_cost(*arrays, p=p))
        np.testing.assert_allclose((found * direction).sum(1), bar * (ends[0] - ends[1]) / (2 * h), rtol=1e-4, atol=1e-6)
    direction = RNG.normal(size=x.shape)
    ends = [task.terminal_cost(x + sign * h * direction, p=p) for sign in (1, -1)]
    found = (task.terminal_cost_vjp(x, bar, p=p)[0] * direction).sum(1)
    np.testing.assert_allclose(found, bar * (ends[0] - ends[1]) / (2 * h), rtol=1e-4, atol=1e-6)


def test_rows_are_independent_of_their_number_and_strides(task):
    x, u, p = inputs(task, 1200)
    whole = task.step(x, u, p=p)
    assert np.array_equal(task.step(x[5:6], u[5:6], p=p[5:6]), whole[5:6])
    assert np.array_equal(task.step(np.asfortranarray(x)[::3], u[::3], p=p[::3]), whole[::3])
    # The numbers of this array do not begin at a multiple of their size.
    misaligned = np.frombuffer(b"\0" + x.tobytes(), np.uint8)[1:].view(x.dtype).reshape(x.shape)
    assert not misaligned.flags.aligned and np.array_equal(task.step(misaligned, u, p=p), whole)
    assert task.step(x[:0], u[:0], p=p[:0]).shape == (0, task.state_dim)


def test_dtypes_follow_x(task):
    x, u, p = inputs(task)
    single = task.step(x.astype("f4"), u, p=p)
    assert single.dtype == np.float32 and task.step(x, u.astype("f4"), p=p).dtype == np.float64
    np.testing.assert_allclose(single, task.step(x, u, p=p), rtol=1e-4, atol=1e-4)
    assert task.step(x.tolist(), u.tolist(), p=p.tolist()).dtype == np.float64


def test_errors_name_argument_shape_and_setting():
    task = pg.task("cart_pole", poles=1)
    with pytest.raises(ValueError, match=r"`x` has the shape \(4,\); expected \(B, 4\)"):
        task.step(np.zeros(4), np.zeros((1, 1)))
    with pytest.raises(ValueError, match=r"`u` has the shape \(2, 1\); expected \(3, 1\)"):
        task.step(np.zeros((3, 4)), np.zeros((2, 1)))
    with pytest.raises(ValueError, match="`system.poles` is 99; allowed: 1 to 64"):
        pg.task("cart_pole", poles=99)
    with pytest.raises(ValueError, match="pass `p` of shape"):
        drawn = pg.task("cart_pole", pole_mass={"uniform": [0.1, 0.2]})
        drawn.step(np.zeros((2, drawn.state_dim)), np.zeros((2, 1)))


def test_masked_arrays_are_refused_and_numpy_booleans_are_booleans():
    task = pg.task("cart_pole", poles=1, policy={"bias": np.True_})
    x, u = np.zeros((2, 4)), np.ma.masked_equal(np.zeros((2, 1)), 0.0)
    with pytest.raises(ValueError, match="`u` is a masked array; fill it"):
        task.step(x, u)


def test_attributes_and_settings():
    task = pg.task("cart_pole", poles=2, horizon=20, effects={"pole_damping": {}}, settings={"training.batch": 4})
    assert (task.name, task.state_dim, task.control_dim, task.param_dim, task.horizon) == ("cart_pole", 6, 1, 0, 20)
    assert len(task.state_names) == 6 and task.observation_dim == len(task.observation_names)
    assert task.settings["system"]["poles"] == 2 and task.settings["training"]["batch"] == 4
    assert "pole_damping" in task.settings["effects"] and "effects" not in pg.task("cart_pole").settings
    assert task.replace(poles=3).state_dim == 8
    x = np.ones((2, 6))
    assert np.array_equal(task.observe(x), x) and np.array_equal(task.observe_vjp(x, 2 * x)[0], 2 * x)
