"""Identification and checks of derivatives."""

import json
import os
import re
import shutil
import subprocess
import sys
import warnings

import numpy as np
import pytest

import physgrad as pg


def measured(pole_mass=0.17):
    """A task, and exact measurements with this mass in kg."""
    task = pg.task("cart_pole", poles=1, horizon=40, pole_mass=pole_mass, precision="f64")
    x, u = pg.rollout(task, pg.Mlp(task, [8], seed=1, zero_init_output=False), task.starts(4, seed=1))
    return task, [(x[i, :-1], u[i]) for i in range(4)]


def test_a_known_number_is_identified():
    task, data = measured()
    fit = pg.identify(task, data, params={"system.pole_mass": 0.1})
    assert fit.converged and np.isclose(fit.values["system.pole_mass"], 0.17, rtol=1e-6)
    with pytest.raises(ValueError, match="shape"):
        pg.identify(task, [(x[:, :2], u) for x, u in data], params={"system.pole_mass": 0.1})
    with pytest.raises(ValueError):
        pg.identify(task, data)


def windy():
    """A task with gusts, and one exact recording: states, controls and the phase of the gusts."""
    task = pg.task("cart_pole", poles=1, horizon=80, effects={"gusty_wind": {"gust": 8.0, "period": 0.5}}, precision="f64")
    start = task.starts(1, seed=1)
    x, u = pg.rollout(task, pg.Mlp(task, [8], seed=1, zero_init_output=False), start)
    return task, x[0], u[0], {"start_of_gusts": start[0, -1]}


def test_a_segment_begins_at_its_time():
    task, x, u, p = windy()
    for parts in [[(0, 80)], [(17, 80)], [(5, 30), (43, 70)]]:
        data = [{"x": x[a:b], "u": u[a:b], "t": a * task.dt, "p": p} for a, b in parts]
        fit = pg.identify(task.replace(cart_mass=1.3), data, params=["system.cart_mass"])
        assert np.isclose(fit.values["system.cart_mass"], 1.0, rtol=1e-6), parts
    for change, message in [
        ({"t": 0.004}, "the physics depends on time and has steps of 0.01 s from 0"),
        ({"t": -0.1}, "the physics depends on time"),
        ({"t": np.inf}, "allowed: finite times in s"),
        ({"p": {}}, "`start_of_gusts`, which has no value; give a dict"),
        ({"p": {"phase": 1.0}}, '"phase" in "p" is no parameter of the task; allowed: start_of_gusts'),
        ({"start": 0.1}, 'segment 0 has the key "start"; allowed: "x", "u", "t" and "p"'),
    ]:
        segment = {"x": x[:60], "u": u[:60], "p": p} | change
        with pytest.raises(ValueError, match=re.escape(message)):
            pg.identify(task.replace(cart_mass=1.3), [segment], params=["system.cart_mass"])


def test_angles_may_wrap():
    task = measured()[0].replace(horizon=150)
    x, u = pg.rollout(task, pg.Mlp(task, [8], seed=1, zero_init_output=False), task.starts(4, seed=1))
    x[..., 2] = np.pi - np.mod(np.pi - x[..., 2], 2 * np.pi)
    assert (np.abs(np.diff(x[..., 2])) > np.pi).any()
    fit = pg.identify(task, [(x[i, :-1], u[i]) for i in range(4)], params={"system.pole_mass": 0.1})
    assert np.isclose(fit.values["system.pole_mass"], 0.17, rtol=1e-6)


def test_warnings_of_a_fit_are_in_its_result_and_are_raised():
    task, data = measured()
    params, noise = {"system.pole_mass": 0.1}, [1e-3] * 4
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        fit = pg.identify(task, data, params)
    assert fit.warnings == [] and fit.notes == []
    rng = np.random.default_rng(0)
    noisy = [(x + 0.1 * rng.normal(size=x.shape), u) for x, u in data]
    unseen = [(np.where(np.arange(4) == 0, np.nan, x), u) for x, u in data]
    for given, noise, start in [
        (noisy, noise, "χ² per degree of freedom is "),
        (unseen, None, "the data do not determine the initial values of x; measure them in the first row of each segment"),
    ]:
        with pytest.warns(UserWarning) as raised:
            fit = pg.identify(task, given, params, noise)
        assert [str(warning.message) for warning in raised] == fit.warnings
        assert any(warning.startswith(start) for warning in fit.warnings), fit.warnings
        assert "--" not in "".join(fit.warnings), "options of the command line"


def test_angles_that_turn_by_more_than_half_a_turn_between_rows_are_a_warning():
    task = pg.task("cart_pole", poles=1, horizon=40, precision="f64")
    u = np.random.default_rng(1).normal(size=(2, 40, 1))
    x = np.zeros((2, 40, 4))
    x[:, 0, 2:] = [[3.0, 66.0], [3.0, -66.0]]
    for t in range(39):
        x[:, t + 1] = task.replace(cart_mass=1.3).step(x[:, t], u[:, t])
    x[..., 2] = np.pi - np.mod(np.pi - x[..., 2], 2 * np.pi)
    x[:, np.arange(40) % 8 != 0, 2] = np.nan
    with pytest.warns(UserWarning, match="theta_1 is more than half a turn from the simulated one in .* rows"):
        fit = pg.identify(task, list(zip(x, u)), ["system.cart_mass"], [0.01, 0.05, 0.01, 0.05])
    assert fit.notes[0].startswith("theta_1 wraps: the fit removes ") and "(first row 8 of segment 1)" in fit.notes[0]


def test_numbers_of_rows_have_a_limit():
    task = pg.task("cart_pole", poles=1)

    def segment(rows):
        return np.broadcast_to(np.zeros(4), (rows, 4)), np.broadcast_to(np.zeros(1), (rows, 1))

    x, u = segment(10**6)
    for data in ([segment(10**12)], [segment(3 * 10**7)], [(x, u)] * 60, [{"x": x, "u": u}] * 60):
        with pytest.raises(MemoryError, match="rows in total; allowed: "):
            pg.identify(task, data, ["system.cart_mass"])
    # Wrong shapes are found before a copy.
    with pytest.raises(ValueError, match="states of segment 0 have the shape"):
        pg.identify(task, [(np.broadcast_to(np.zeros(1), (3, 10**9)), u[:3])], ["system.cart_mass"])
    with pytest.raises(ValueError, match="controls of segment 0 have 1000000 rows"):
        pg.identify(task, [(x[:3], u)], ["system.cart_mass"])


LARGE = """
import numpy as np, physgrad as pg, resource
task = pg.task("cart_pole", poles=1)
resource.setrlimit(resource.RLIMIT_AS, (3 << 30, 3 << 30))
x, u = np.broadcast_to(np.zeros(4), (3 * 10**6, 4)), np.broadcast_to(np.zeros(1), (3 * 10**6, 1))
try:
    pg.identify(task, [(x, u)], ["system.cart_mass"])
except MemoryError as error:
    print(error)
"""


@pytest.mark.skipif(sys.platform != "linux", reason="limits the memory as Linux does")
def test_a_fit_that_does_not_fit_into_memory_is_refused_before_it_begins():
    ran = subprocess.run([sys.executable, "-c", LARGE], capture_output=True, text=True, timeout=120)
    assert ran.returncode == 0 and ran.stdout.startswith("the fit would take"), ran.stdout + ran.stderr


@pytest.mark.parametrize("rows, is_allowed", [(40, True), (39, True), (38, False), (41, False), (50, False), (0, False)])
def test_controls_have_as_many_rows_as_the_states_or_one_less(rows, is_allowed):
    task, [(x, u), *_] = measured()
    u = np.resize(u, (rows, 1))
    if is_allowed:
        assert pg.identify(task, [(x, u)], {"system.pole_mass": 0.1}).converged
    else:
        message = f"the controls of segment 0 have {rows} rows; expected as many as the states, or one less"
        with pytest.raises(ValueError, match=message):
            pg.identify(task, [(x, u)], {"system.pole_mass": 0.1})


def test_only_nan_marks_a_missing_measurement():
    task, [(x, u), *_] = measured()
    for name, array, value in [("states", x, np.inf), ("states", x, -np.inf), ("controls", u, np.inf), ("controls", u, np.nan)]:
        changed = {"states": x.copy(), "controls": u.copy()}
        changed[name][7, -1] = value
        message = f"{name} of segment 0: row 7 has {str(value).replace('nan', 'NaN')} in column {array.shape[1] - 1}"
        with pytest.raises(ValueError, match=message):
            pg.identify(task, [tuple(changed.values())], {"system.pole_mass": 0.1})


@pytest.mark.parametrize("noise", [1e-200, 1e200, 0.0, -1.0])
def test_noise_without_a_size_is_refused(noise):
    task, data = measured()
    with pytest.raises(ValueError, match=r"the noise of state component 2 is .*; allowed: 1e-100 to 1e100"):
        pg.identify(task, data, {"system.pole_mass": 0.1}, [0.1, 0.1, noise, 0.1])


def test_names_start_at_the_values_of_the_task():
    _, data = measured()
    task = pg.task("cart_pole", poles=1, horizon=40, pole_mass=0.1, precision="f64")
    by_name = pg.identify(task, data, params=["system.pole_mass"])
    by_start = pg.identify(task, data, params={"system.pole_mass": 0.1})
    bounded = pg.identify(task, data, params={"system.pole_mass": {"start": 0.1, "min": 0.05, "max": 0.12}})
    assert by_name.values == by_start.values and np.isclose(by_name.values["system.pole_mass"], 0.17, rtol=1e-6)
    assert bounded.at_bound == ["system.pole_mass"] and bounded.values["system.pole_mass"] == 0.12
    assert bounded.statuses == {"system.pole_mass": "at bound"} and np.isnan(bounded.errors["system.pole_mass"])
    assert by_name.statuses == {"system.pole_mass": "estimated"}
    again = pg.identify(task.replace(pole_mass={"start": 0.1}), data, params=["system.pole_mass"])
    assert again.values == by_name.values


def test_bounds_of_the_section_fit_hold_for_other_initial_values():
    task, data = measured()
    task = task.replace(cart_mass={"start": 0.8, "min": 0.5, "max": 0.95})
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        for params in (["system.cart_mass"], {"system.cart_mass": 0.9}, {"system.cart_mass": {"start": 0.9, "min": 0.6}}):
            assert pg.identify(task, data, params).values == {"system.cart_mass": 0.95}, params
        free = pg.identify(task, data, {"system.cart_mass": {"start": 0.9, "max": 9.0}})
    assert np.isclose(free.values["system.cart_mass"], 1.0, rtol=1e-6)


@pytest.mark.parametrize("kind", [list, dict.fromkeys])
def test_results_have_the_order_of_the_parameters(kind):
    task, data = measured()
    names = ["system.pole_mass", "system.half_length", "system.cart_mass"]
    starts = {"system.pole_mass": 0.1, "system.half_length": 0.45, "system.cart_mass": {"start": 1.2, "min": 1.1}}
    rng = np.random.default_rng(0)
    noisy = [(x + 0.01 * rng.normal(size=x.shape), u) for x, u in data]
    task = task.replace(pole_mass=0.1, half_length=0.45, cart_mass=starts["system.cart_mass"])

    def fit(order):
        if kind is list:
            # Numbers that only the section `fit` of the task names follow those in `params`.
            return pg.identify(task, noisy, [name for name in order if name != "system.cart_mass"], [0.01] * 4)
        return pg.identify(task, noisy, {name: starts[name] for name in order}, [0.01] * 4)

    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        one, other = fit(names), fit([names[1], names[0], names[2]])
    assert one.at_bound == ["system.cart_mass"] and (one.errors["system.pole_mass"] > 0.0)
    place = [1, 0, 2]
    for key in ("values", "errors", "robust_errors", "statuses", "starts", "bounds"):
        ours, others = getattr(one, key), getattr(other, key)
        assert list(ours) == names and list(others) == [names[i] for i in place], key
        np.testing.assert_equal(ours, others)
    assert one.robust_errors[names[0]] != one.robust_errors[names[1]]
    np.testing.assert_equal(other.correlations, one.correlations[np.ix_(place, place)])


def test_bounds_and_combinations_have_the_order_of_the_parameters():
    task, data = measured()
    names = ["system.pole_mass", "system.cart_mass"]
    bounds = {"system.pole_mass": {"start": 0.1, "min": 0.05, "max": 0.12}, "system.cart_mass": {"start": 1.2, "min": 1.15}}
    masses = ["system.gravity", "system.half_length", "system.cart_mass", "system.pole_mass"]
    rest = [(np.zeros((20, 4)), np.zeros((20, 1)))]
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        for order in (names, names[::-1]):
            fit = pg.identify(task, data, {name: bounds[name] for name in order})
            assert fit.at_bound == order, fit
        for order in (masses, masses[::-1]):
            for combination in pg.identify(task, rest, order).undetermined:
                assert combination == [name for name in order if name in combination]


def test_names_without_a_value_are_refused():
    task, data = measured()
    drawn = task.replace(pole_mass={"uniform": [0.1, 0.2]})
    with pytest.raises(ValueError, match="`system.pole_mass` is no single number in the task; give an initial value"):
        pg.identify(drawn, data, params=["system.pole_mass"])
    listed = "no number `system.pole_weight`; numbers of its system: .*system.pole_mass, "
    with pytest.raises(ValueError, match=listed):
        pg.identify(task, data, params=["system.pole_weight"])
    with pytest.raises(TypeError, match="`params` is of type str; allowed: a list or tuple of keys, or a dict"):
        pg.identify(task, data, params="system.pole_mass")


def test_fitted_values_out_of_the_range_of_their_setting_are_a_warning():
    # A wrong fixed mass of the cart makes the mass of the pole negative.
    task, data = measured(pole_mass=0.01)
    with pytest.warns(UserWarning):
        fit = pg.identify(task.replace(cart_mass=1.5), data, {"system.half_length": 0.4, "system.pole_mass": 0.2})
    assert fit.converged and fit.values["system.pole_mass"] < 0.0, fit.values
    assert any("outside of the range of its setting: `system.pole_mass` is -" in text for text in fit.warnings), fit


def test_names_of_list_elements_start_at_the_values_of_the_task():
    task = pg.task("pendulum", horizon=20, precision="f64")
    x, u = pg.rollout(task, pg.Policy(task), task.starts(2, seed=1))
    key = "system.arms[0].mass"
    fit = pg.identify(task, [(x[i, :-1], u[i]) for i in range(2)], params=[key])
    assert np.isclose(fit.values[key], task.settings["system"]["arms"][0]["mass"])


def test_parameters_out_of_their_range_are_refused():
    task, data = measured()
    drawn = task.replace(pole_mass={"uniform": [0.1, 0.2]})
    segment = {"x": data[0][0], "u": data[0][1], "p": {"system.pole_mass": float("nan")}}
    fit = pg.identify(drawn, data[:1], params={"system.cart_mass": 1.3})
    assert any(note.startswith("1 segment without system.pole_mass: the fit uses 0.15") for note in fit.notes), fit
    with pytest.raises(ValueError, match="segment 0: \"system.pole_mass\" in \"p\" is NaN; give its value, or omit it"):
        pg.identify(drawn, [segment], params={"system.cart_mass": 1.3})
    segment = {"x": data[0][0], "u": data[0][1], "p": {"system.pole_mass": -0.24}}
    with pytest.raises(ValueError, match="segment 0: `system.pole_mass` is -0.24; allowed: a positive number"):
        pg.identify(drawn, [segment], params={"system.cart_mass": 1.3})


def test_checks_return_a_table():
    table = pg.check(pg.task("pendulum", horizon=10))
    assert "rollout" in table and "FAILED" not in table


def test_checks_have_the_notes_of_the_program(tmp_path):
    few = pg.system(
        lambda x, u, p: [u.push - x.place - abs(x.place - 0.5)],
        states=["place"], controls=["push"], dt=0.1, horizon=20,
        start={"place": pg.uniform(0, 1)}, loss={"running": "place^2"}, policy={"kind": "linear"}, field="C",
    )
    notes = pg.check(few).split("\n")
    assert any(note.startswith("time step") for note in notes)
    assert any(note.startswith("kink: ") for note in notes)
    assert any(note.startswith("mean loss and R: ") for note in notes)
    assert any('C has no advantage' in note and note.endswith('`field = "R"`') for note in notes)
    scene = tmp_path / "scene.toml"
    scene.write_text('scene = 1\ntask = "cart_pole"\nhorizon = 20\n[system]\npoles = 1\n')
    program = os.environ.get("PHYSGRAD", shutil.which("physgrad"))
    if program is None:
        pytest.skip("set PHYSGRAD to the program")
    command = [program, "check", str(scene), "--json"]
    expected = json.loads(subprocess.run(command, check=True, capture_output=True).stdout)["notes"]
    assert len(expected) > 3 and pg.check(pg.scene(scene)).split("\n")[-len(expected) :] == expected


def test_an_unknown_number_lists_parameters():
    own = pg.system(
        lambda x, u, p: [p.gain * u.push], states=["place"], controls=["push"], params={"gain": 1.0}, dt=0.1
    )
    data = [(np.zeros((2, 1)), np.zeros((1, 1)))]
    for params in (["gian"], {"gian": 1.0}):
        listed = "no number `gian`; numbers of its system: gain; did you mean `gain`"
        with pytest.raises(ValueError, match=listed):
            pg.identify(own, data, params)
    with pytest.raises(ValueError, match="`system.gian` is unknown; parameters: `gain`; did you mean `gain`"):
        own.replace(gian=2.0)
    with pytest.raises(ValueError, match="`system.mass` is unknown; allowed: `states`, .*; parameters: `gain`"):
        own.replace(mass=2.0)


def test_checks_are_at_the_parameters_of_the_policy():
    task = pg.task("cart_pole", poles=1, horizon=20, precision="f64")
    policy = pg.Mlp(task, [8], seed=1, zero_init_output=False)
    table = pg.check(task, policy)
    assert "FAILED" not in table and table == pg.check(task, policy) != pg.check(task)
    other = pg.Mlp(task, [8], seed=2, zero_init_output=False)
    assert pg.check(task, other) != table
    policy.theta = policy.theta * 1e200
    with pytest.raises(AssertionError, match="cannot be checked"):
        pg.check(task, policy)
    with pytest.raises(ValueError, match="create a policy for this task"):
        pg.check(task, pg.Mlp(pg.task("cart_pole", poles=2), [8]))
