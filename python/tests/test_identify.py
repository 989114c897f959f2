"""Identification and checks of derivatives."""

import re

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
    assert fit["converged"] and np.isclose(fit["values"]["system.pole_mass"], 0.17, rtol=1e-6)
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
        assert np.isclose(fit["values"]["system.cart_mass"], 1.0, rtol=1e-6), parts
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
    assert np.isclose(fit["values"]["system.pole_mass"], 0.17, rtol=1e-6)


def test_names_start_at_the_values_of_the_task():
    _, data = measured()
    task = pg.task("cart_pole", poles=1, horizon=40, pole_mass=0.1, precision="f64")
    by_name = pg.identify(task, data, params=["system.pole_mass"])
    by_start = pg.identify(task, data, params={"system.pole_mass": 0.1})
    bounded = pg.identify(task, data, params={"system.pole_mass": {"start": 0.1, "min": 0.05, "max": 0.12}})
    assert by_name["values"] == by_start["values"] and np.isclose(by_name["values"]["system.pole_mass"], 0.17, rtol=1e-6)
    assert bounded["at_bound"] == ["system.pole_mass"] and bounded["values"]["system.pole_mass"] == 0.12
    assert bounded["statuses"] == {"system.pole_mass": "at bound"} and np.isnan(bounded["errors"]["system.pole_mass"])
    assert by_name["statuses"] == {"system.pole_mass": "estimated"}
    again = pg.identify(task.replace(pole_mass={"start": 0.1}), data, params=["system.pole_mass"])
    assert again["values"] == by_name["values"]


def test_names_without_a_value_are_refused():
    task, data = measured()
    drawn = task.replace(pole_mass={"uniform": [0.1, 0.2]})
    with pytest.raises(ValueError, match="`system.pole_mass` is no single number in the task; give an initial value"):
        pg.identify(drawn, data, params=["system.pole_mass"])
    with pytest.raises(ValueError, match="`system.pole_weight` in `params` is no setting of the task"):
        pg.identify(task, data, params=["system.pole_weight"])
    with pytest.raises(TypeError, match="`params` is a str; allowed: a list of keys"):
        pg.identify(task, data, params="system.pole_mass")


def test_parameters_out_of_their_range_are_refused():
    task, data = measured()
    drawn = task.replace(pole_mass={"uniform": [0.1, 0.2]})
    segment = {"x": data[0][0], "u": data[0][1], "p": {"system.pole_mass": -0.24}}
    with pytest.raises(ValueError, match="segment 0: `system.pole_mass` is -0.24; allowed: a positive number"):
        pg.identify(drawn, [segment], params={"system.cart_mass": 1.3})


def test_checks_return_a_table():
    table = pg.check(pg.task("pendulum", horizon=10))
    assert "rollout" in table and "FAILED" not in table


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
