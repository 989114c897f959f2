"""Array functions: derivatives, shapes, dtypes and errors."""

import collections.abc
import copy
import itertools
import json
import subprocess
import sys
import types

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


def test_results_are_f32_only_if_all_arrays_are_float32(task):
    x, u, p = inputs(task)
    single = task.step(*(a.astype("f4") for a in (x, u)), p=p.astype("f4"))
    assert single.dtype == np.float32
    np.testing.assert_allclose(single, task.step(x, u, p=p), rtol=1e-4, atol=1e-4)
    assert task.step(x.tolist(), u.tolist(), p=p.tolist()).dtype == np.float64
    # As in NumPy, one array of float64 makes the result float64, without the rounding of the others.
    next, cost, bar = task.step(x, u, p=p), np.ones(len(x)), np.ones_like(x)
    y_bar = np.ones((len(x), task.observation_dim))
    calls = {
        "step": [x, u],
        "step_vjp": [x, u, bar],
        "step_jvp": [x, u, bar, np.ones_like(u)],
        "observe": [x],
        "observe_vjp": [x, y_bar],
        "running_cost": [x, u, next],
        "running_cost_vjp": [x, u, next, cost],
        "terminal_cost": [x],
        "terminal_cost_vjp": [x, cost],
    }
    for name, arrays in calls.items():

        def call(*arrays):
            *others, p = arrays
            result = getattr(task, name)(*others, p=p)
            return result[0] if isinstance(result, tuple) else result

        arrays = [*arrays, p]
        rounded = [a.astype("f4") for a in arrays]
        assert call(*rounded).dtype == np.float32, name
        for i in range(len(arrays)):
            mixed = [arrays[j] if j == i else rounded[j] for j in range(len(arrays))]
            found, expected = call(*mixed), call(*(a.astype("f8") for a in mixed))
            assert found.dtype == np.float64 and np.array_equal(found, expected), (name, i)


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
    for rows in ([*x[:1], np.ma.array(x[1], mask=[1, 0, 0, 0])], (np.ma.array(x[0], mask=[1, 0, 0, 0]), x[1])):
        with pytest.raises(ValueError, match="`starts` is a list with a masked array, element"):
            pg.losses(task, pg.Policy(task), rows)


def test_drawn_numbers_out_of_their_range_are_refused():
    task = pg.task("cart_pole", poles=1, horizon=5, pole_mass={"uniform": [0.1, 0.2]}, precision="f64")
    starts, policy, u = task.starts(3, seed=1), pg.Policy(task), np.zeros((3, 1))
    for value in (0.0, -0.1):
        bad = starts.copy()
        bad[1, -1] = value
        x, p = bad[:, :4], bad[:, 4:]
        for call in (
            lambda: task.step(x, u, p=p),
            lambda: task.step_vjp(x, u, x, p=p),
            lambda: task.observe(x, p=p),
            lambda: task.terminal_cost(x, p=p),
            lambda: pg.losses(task, policy, bad),
            lambda: pg.gradients(task, policy, bad.astype("f4")),
            lambda: pg.rollout(task, policy, bad),
        ):
            with pytest.raises(ValueError, match="row 1: `system.pole_mass` is .*; allowed: a positive number"):
                call()
        with pytest.raises(ValueError, match="`system.pole_mass` is .*; allowed: a positive number"):
            pg.optimize(task, bad[1])


def test_two_values_of_one_setting_are_refused():
    task = pg.task("cart_pole", poles=1)
    policy = pg.Mlp(task, [8], seed=1)
    for call, message in [
        (lambda: pg.task("cart_pole", system={"poles": 1}, poles=2), "`system.poles` is 1 and 2; give one value"),
        (lambda: pg.task("cart_pole", settings={"system.poles": 1}, poles=2), "`system.poles` is 1 and 2"),
        (lambda: task.replace(settings={"horizon": 5}, horizon=6), "`horizon` is 5 and 6"),
        (lambda: pg.Mlp(task, [8], policy={"widths": [5]}), "`policy.widths` is "),
        (lambda: pg.Run(task, training={"learning_rate": 0.5}, learning_rate=0.25), "`training.learning_rate` is 0.5 and 0.25"),
        (lambda: pg.Run(task, policy, settings={"policy.widths": [5]}), r"`policy.widths` is \[5\], but the given policy has \[8\]"),
        (lambda: pg.Run(task, policy, policy={"activation": "relu"}), None),
        (lambda: pg.Run(task, policy, settings={"initial_policy": "x.safetensors"}), "`initial_policy` is "),
    ]:
        with pytest.raises((ValueError, TypeError), match=message):
            call()
    pg.task("cart_pole", system={"poles": 1}, poles=1)
    pg.Run(task, policy, settings={"policy.widths": [8]}, epochs=1)


def test_attributes_and_settings():
    task = pg.task("cart_pole", poles=2, horizon=20, effects={"pole_damping": {}}, settings={"training.batch": 4})
    assert (task.name, task.state_dim, task.control_dim, task.param_dim, task.horizon) == ("cart_pole", 6, 1, 0, 20)
    assert len(task.state_names) == 6 and task.observation_dim == len(task.observation_names)
    assert task.settings["system"]["poles"] == 2 and task.settings["training"]["batch"] == 4
    assert "pole_damping" in task.settings["effects"] and "effects" not in pg.task("cart_pole").settings
    assert task.replace(poles=3).state_dim == 8
    x = np.ones((2, 6))
    assert np.array_equal(task.observe(x), x) and np.array_equal(task.observe_vjp(x, 2 * x)[0], 2 * x)


def test_settings_and_parameters_refuse_changes_that_would_have_no_effect():
    task = pg.task("cart_pole", poles=1, effects={"steady_wind": {}}, policy={"widths": [8, 4]})
    for change in (
        lambda s: s.__setitem__("horizon", 3),
        lambda s: s["system"].update(poles=3),
        lambda s: s["effects"]["steady_wind"].pop("speed", None),
        lambda s: s.clear(),
    ):
        with pytest.raises(TypeError, match="`task.replace` returns a task with other settings"):
            change(task.settings)
    with pytest.raises(TypeError, match="does not support item assignment"):
        task.settings["policy"]["widths"][0] = 3
    # The settings are still a dict: they can be copied, written as JSON and passed to a task.
    copied = copy.deepcopy(task.settings)
    copied["system"]["poles"] = 2
    assert type(copied) is dict and json.loads(json.dumps(task.settings))["policy"]["widths"] == [8, 4]
    assert task.replace(settings=copied).state_dim == 6 and task.replace(settings=task.settings).settings == task.settings
    policy = pg.Policy(task)
    with pytest.raises(ValueError, match="read-only"):
        policy.theta[0] = 5.0
    policy.theta = np.full(len(policy), 0.25)
    assert (policy.theta == 0.25).all()


def test_policies_of_a_run_refuse_changes_and_their_copies_accept_them(tmp_path):
    task = pg.task("cart_pole", poles=1, horizon=5)
    run = pg.Run(task, epochs=1, train_samples=4, test_samples=4)
    run.policy.save(tmp_path / "policy.safetensors")
    for policy in (run.policy, run.best_policy):
        for change in (lambda: setattr(policy, "theta", policy.theta), lambda: policy.load(tmp_path / "policy.safetensors")):
            with pytest.raises(TypeError, match="the policy of a run refuses changes, which would not reach the run"):
                change()
    copied = run.policy.copy()
    copied.theta = np.zeros(len(copied))
    assert (copied.theta == 0.0).all() and not (run.policy.theta == 0.0).all()


def test_mappings_are_settings_and_long_keys_are_refused_at_once():
    effects = types.MappingProxyType({"steady_wind": types.MappingProxyType({"speed": 2.0})})
    assert pg.task("cart_pole", effects=effects).settings["effects"]["steady_wind"]["speed"] == 2.0
    for key in ("a" * 10**6, "é" * 10**6):
        with pytest.raises(ValueError, match=r"the key that begins with `.{40}` has more than 1000 bytes") as error:
            pg.task("cart_pole", settings={key: 1})
        assert len(str(error.value)) < 200


@pytest.mark.parametrize(
    "count, error, message",
    [
        (10**12, MemoryError, "the initial states would take 32000.0 GB"),
        (10**18, MemoryError, "the initial states would take"),
        (-1, ValueError, "`count` is -1; allowed: a whole number that is not negative"),
        (10**30, ValueError, r"`count` is 1000000000000000000000000000000; allowed: a whole number below 2\^64"),
    ],
)
def test_too_many_rows_are_refused(count, error, message):
    with pytest.raises(error, match=message):
        pg.task("cart_pole", poles=1).starts(count, dtype="float64")


def test_views_of_many_rows_do_not_fit_into_memory():
    task = pg.task("cart_pole", poles=1)
    x, u = np.broadcast_to(np.zeros(4), (10**12, 4)), np.broadcast_to(np.zeros(1), (10**12, 1))
    policy = pg.Policy(task)
    for call in (
        lambda: task.step(x, u),
        lambda: task.observe(x),
        lambda: policy(x),
        lambda: pg.rollout(task, policy, x),
        lambda: pg.losses(task, policy, x),
        lambda: pg.gradients(task, policy, x),
    ):
        with pytest.raises(MemoryError, match="would take 32000.0 GB"):
            call()
    # A wrong shape is found before a copy.
    with pytest.raises(ValueError, match=r"`u` has the shape \(1000000000000, 1\); expected \(1, 1\)"):
        task.step(np.zeros((1, 4)), u)
    long = pg.task("cart_pole", poles=1, horizon=50_000)
    with pytest.raises(MemoryError, match="the rollouts would take 1000.0 GB"):
        pg.rollout(long, policy, np.zeros((10**6, 4), "f4"))


def nested(depth):
    value = 1
    for _ in range(depth):
        value = [value]
    return value


def itself(kind):
    value = kind()
    if kind is list:
        value.append(value)
    else:
        value["system"] = value
    return value


@pytest.mark.parametrize(
    "value",
    [nested(100_000), [[0] * 1000] * 1000, itself(list), itself(dict), itertools.count(), range(10**15)],
    ids=["nested", "large", "list", "dict", "count", "range"],
)
def test_settings_without_an_end_are_refused(value):
    task = pg.task("cart_pole")
    message = "nested more than 16 times|more than 100000 elements|allowed"
    for call in (
        lambda: pg.task("cart_pole", poles=value),
        lambda: task.replace(settings={"system": value}),
        lambda: task.replace(effects={"steady_wind": value}),
        lambda: pg.Policy(task, widths=value),
        lambda: pg.identify(task, [], params={"system.pole_mass": value}),
    ):
        with pytest.raises((ValueError, TypeError), match=message):
            call()


ENDLESS = """
import resource, sys
import numpy as np, physgrad as pg
resource.setrlimit(resource.RLIMIT_AS, (8 << 30, 8 << 30))
task, cart = pg.task("lqr", horizon=5), pg.task("cart_pole", poles=1)
policy, start, view = pg.Policy(task), task.starts(1), np.broadcast_to
data, mass = [(cart.starts(3), np.zeros((3, 1)))], ["system.cart_mass"]
calls = {
    "`bounds` has 10000000000000 elements; allowed: at most 1, one pair": lambda: pg.optimize(task, start[0], bounds=view(1.0, (10**13, 2))),
    "`bounds` has 100000000000000 elements": lambda: pg.optimize(task, start[0], bounds=range(10**14)),
    "`bounds` has too many elements": lambda: pg.optimize(task, start[0], bounds=range(10**30)),
    "expected a sequence of length 2": lambda: pg.optimize(task, start[0], bounds=[range(10**14)]),
    "`fields` has 100000000000000 elements; allowed: at most 9, the number": lambda: pg.gradients(task, policy, start, fields=range(10**14)),
    "`params` has 100000000000000 elements; allowed: at most ": lambda: pg.identify(cart, data, params=range(10**14)),
    "`noise` has 100000000000000 elements; allowed: at most 4, one": lambda: pg.identify(cart, data, mass, view(1.0, 10**14)),
    "`data` has 100000000000000 elements; allowed: at most ": lambda: pg.identify(cart, range(10**14), mass),
    "`policy.widths` has more than 100000 elements": lambda: pg.Mlp(task, range(10**14)),
    "`system.masses` has more than 100000 elements": lambda: pg.task("double_pendulum", masses=view(1.0, 10**14)),
    "`tags` has more than 100000 elements": lambda: pg.task("lqr", tags=range(10**14)),
}
arrays = {
    "start": lambda: pg.optimize(task, range(10**14)),
    "theta": lambda: setattr(policy, "theta", range(10**14)),
    "starts": lambda: pg.losses(task, policy, range(10**14)),
}
for message, call in calls.items():
    try:
        call()
    except ValueError as error:
        print("ok" if message in str(error) else f"{message}: {error}")
for name, call in arrays.items():
    try:
        call()
    except MemoryError as error:
        print("ok" if "the elements of an argument would take" in str(error) else f"{name}: {error}")
"""


@pytest.mark.skipif(sys.platform != "linux", reason="limits the memory as Linux does")
def test_long_sequences_are_refused_with_their_limit_before_memory_is_reserved():
    ran = subprocess.run([sys.executable, "-c", ENDLESS], capture_output=True, text=True, timeout=120)
    assert ran.returncode == 0 and ran.stdout.split() == ["ok"] * 14, ran.stdout + ran.stderr


class Endless(collections.abc.Mapping):
    def __getitem__(self, key):
        return 1

    def __iter__(self):
        return map(str, itertools.count())

    def __len__(self):
        return 1


def test_mappings_without_an_end_are_refused():
    for change in ({"system": Endless()}, {"effects": {"steady_wind": Endless()}}, {"settings": Endless()}):
        with pytest.raises(ValueError, match="more than 100000 elements"):
            pg.task("cart_pole", **change)


def test_mappings_are_no_arrays_in_a_list_either():
    row = collections.ChainMap({i: 0.1 * i for i in range(4)})
    task = pg.task("cart_pole", poles=1)
    for name, call in (
        ("x", lambda: task.step([row], np.zeros((1, 1)))),
        ("starts", lambda: pg.losses(task, pg.Policy(task), [row])),
    ):
        with pytest.raises(TypeError, match=f"^`{name}\\[0\\]` is of type ChainMap; allowed: an array$"):
            call()


def test_sets_are_no_lists():
    task = pg.task("lqr", horizon=5)
    cart = pg.task("cart_pole", poles=1)
    data, policy = [(cart.starts(3), np.zeros((3, 1)))], pg.Policy(task)
    for name, kind, call in (
        ("system.masses", "set", lambda: pg.task("double_pendulum", masses={2.0, 1.0})),
        ("system.masses", "frozenset", lambda: pg.task("double_pendulum", masses=frozenset((2.0, 1.0)))),
        ("system.masses", "set", lambda: pg.task("double_pendulum", settings={"system": {"masses": {2.0, 1.0}}})),
        ("effects.obstacles.centers", "set", lambda: pg.task("guidance", effects={"obstacles": {"centers": [{1.0, 2.0}]}})),
        ("policy.widths", "set", lambda: pg.Mlp(task, {8, 4})),
        ("policy.widths", "set", lambda: pg.Policy(task, widths={8, 4})),
        ("tags", "set", lambda: pg.task("lqr", tags={"a", "b"})),
        ("bounds", "set", lambda: pg.optimize(task, [0.0] * task.start_dim, bounds={(1.0, 2.0)})),
        ("fields", "set", lambda: pg.gradients(task, policy, task.starts(1), fields={"R", "M"})),
        ("params", "set", lambda: pg.identify(cart, data, {"system.cart_mass", "system.pole_mass"})),
        ("noise", "set", lambda: pg.identify(cart, data, ["system.cart_mass"], {0.1, 0.2})),
        ("data", "set", lambda: pg.identify(cart, {1, 2}, ["system.cart_mass"])),
    ):
        with pytest.raises(TypeError, match=f"^`{name}` is of type {kind}, which has no order; give a list or a tuple$"):
            call()
    # Keys and values of a dict have its order, and a generator that of its work.
    for masses in ({2.0: 0, 1.0: 0}.keys(), {0: 2.0, 1: 1.0}.values(), (m for m in (2.0, 1.0))):
        assert pg.task("double_pendulum", masses=masses).settings["system"]["masses"] == (2.0, 1.0)


def test_other_objects_are_no_lists():
    task = pg.task("lqr", horizon=5)
    policy, start = pg.Policy(task), task.starts(1)
    for fields, kind in (("R", "str"), (b"R", "bytes"), ({"R": 1}, "dict"), (3, "int"), (iter("R"), "str_ascii_iterator|str_iterator")):
        with pytest.raises(TypeError, match=f"`fields` is of type ({kind}); allowed: a list or tuple of names of fields"):
            pg.gradients(task, policy, start, fields=fields)
    for call in (pg.losses, pg.rollout, pg.gradients):
        with pytest.raises(TypeError, match="`starts` is of type dict; allowed: an array$"):
            call(task, policy, {0: 1.0})
    assert list(pg.gradients(task, policy, start, fields=np.array(["M", "R"]))) == ["M", "R"]
    assert list(pg.gradients(task, policy, start)) == ["R", "M", "S", "C"]


@pytest.mark.parametrize("iterations", [1_000_001, 10**18])
def test_numbers_of_iterations_have_a_limit(iterations):
    task = pg.task("lqr", horizon=5)
    with pytest.raises(ValueError, match=f"the largest number of iterations is {iterations}; allowed: 0 to 1000000$"):
        pg.optimize(task, task.starts(1)[0], iterations=iterations)
    assert pg.optimize(task, task.starts(1)[0], iterations=1_000_000).converged
    run = pg.Run(task, epochs=1, train_samples=4, test_samples=4)
    for epochs in (10**10, 10**18, 2**64 - 1):
        with pytest.raises(ValueError, match="`epochs` is .*; allowed: 0 to 1000000000"):
            run.train(epochs=epochs)


def test_none_removes_effects_and_parts_of_the_actuator():
    task = pg.task("cart_pole_windy", actuator={"limit": {"bound": 2.0}, "lag": {"time": 0.1}})
    every = list(task.settings["effects"])
    assert len(every) > 1 and "gusty_wind" in every
    rest = [name for name in every if name != "gusty_wind"]
    for change in ({"effects": {"gusty_wind": None}}, {"effects.gusty_wind": None}, {"settings": {"effects": {"gusty_wind": None}}}):
        for calm in (task.replace(**change), pg.Run(task, **change, epochs=1).task):
            assert list(calm.settings["effects"]) == rest, change
    assert list(pg.task("cart_pole_windy", effects={"gusty_wind": None}).settings["effects"]) == rest
    free = task.replace(effects=dict.fromkeys(every), actuator={"limit": None, "lag": None})
    assert not free.settings.get("effects") and not free.settings.get("actuator")
    assert free.state_names == pg.task("cart_pole").state_names
    # A table changes only its keys, also beside a removal.
    other = task.replace(effects={"gusty_wind": None, "bumpers": {}}, actuator={"limit": {"bound": 3.0}})
    assert set(other.settings["effects"]) == {*rest, "bumpers"} and other.settings["actuator"]["limit"]["bound"] == 3.0
    assert other.settings["actuator"]["lag"]["time"] == 0.1
    assert task.replace(effects={"gusty_wind": {}}).settings == task.settings
    with pytest.raises(ValueError, match="`effects.gusty_wind` is None, but `effects.gusty_wind.speed` has a value"):
        task.replace(**{"effects.gusty_wind": None, "effects.gusty_wind.speed": 2.0})
    # Numbers of a removed effect neither vary nor train.
    drawn = pg.task("cart_pole", effects={"steady_wind": {"speed": {"uniform": [1.0, 2.0]}}})
    assert drawn.param_dim == 1 and drawn.replace(effects={"steady_wind": None}).param_dim == 0


@pytest.mark.parametrize(
    "change, message",
    [
        ({"effects": {"rain": None}}, "`effects.rain` is None: .* has no such effect or part of the actuator or the sensor; it has .*gusty_wind"),
        ({"effects": None}, "`effects` is None, which removes single effects and parts of the actuator only; give a value"),
        ({"actuator": {"delay": None}}, "`actuator.delay` is None: .* has no such effect or part of the actuator or the sensor; it has "),
        ({"actuator": {"gusty_wind": None}}, "`actuator.gusty_wind` is None: .* has no such effect"),
        ({"effects": {"gusty_wind": {"gust": None}}}, "`effects.gusty_wind.gust` is None, which removes single effects"),
        ({"poles": None}, "`system.poles` is None, which removes single effects"),
        ({"horizon": None}, "`horizon` is None, which removes single effects"),
        ({"integrator": {"method": None}}, "`integrator.method` is None, which removes single effects"),
        ({"effects": {"gusty_wind": None}, "settings": {"effects.gusty_wind": {}}}, "`effects.gusty_wind` is (None and {}|{} and None); give one value"),
        ({"effects": {}}, r"`effects` is an empty table, which changes nothing; a table changes only its keys, and None removes one of .*"),
        ({"settings": {"effects": {}}}, "`effects` is an empty table"),
        ({"actuator": {}}, '`actuator` is an empty table, which changes nothing; .* None removes one of limit, lag, as in {"limit": None}'),
        ({"integrator": {}}, "`integrator` is an empty table, which changes nothing; a table changes only its keys: .*method"),
        ({"system": {}}, "`system` is an empty table, which changes nothing; a table changes only its keys: .*poles"),
        ({"training": {}}, "`training` is an empty table"),
    ],
)
def test_what_cannot_be_removed_is_refused_with_the_reason(change, message):
    first = {"actuator": {"limit": {"bound": 2.0}, "lag": {"time": 0.1}}, "integrator": {"method": "rk4"}}
    task = pg.task("cart_pole_windy", **first)
    for call in (lambda: task.replace(**change), lambda: pg.Run(task, settings=change.get("settings", {}) | keys(change))):
        with pytest.raises(ValueError, match=message):
            call()


def keys(change):
    """The same change as dotted keys, for a call with other defaults of keyword arguments."""
    return {key if key != "poles" else "system.poles": value for key, value in change.items() if key != "settings"}


def test_an_empty_section_is_refused_where_the_task_has_none_and_kept_where_it_has_no_settings():
    with pytest.raises(ValueError, match="`effects` is an empty table, which changes nothing; omit it"):
        pg.task("cart_pole", effects={})
    task = pg.task("lqr")
    assert task.settings["loss"] == {} and task.replace(settings=task.settings).settings == task.settings
    with pytest.raises(ValueError, match="`training.learning_rate` is None, which removes"):
        pg.train(task, pg.Policy(task), learning_rate=None)
    with pytest.raises(ValueError, match="`policy.widths` is None, which removes"):
        pg.train(task, pg.Policy(task), settings={"policy.widths": None})
