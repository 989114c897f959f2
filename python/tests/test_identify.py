"""Identification and checks of derivatives."""

import numpy as np
import pytest

import physgrad as pg


def test_a_known_number_is_identified():
    task = pg.task("cart_pole", poles=1, horizon=40, pole_mass=0.17, precision="f64")
    x, u = pg.rollout(task, pg.Mlp(task, [8], seed=1, zero_init_output=False), task.starts(4, seed=1))
    data = [(x[i, :-1], u[i]) for i in range(4)]
    fit = pg.identify(task, data, params={"system.pole_mass": 0.1})
    assert fit["converged"] and np.isclose(fit["values"]["system.pole_mass"], 0.17, rtol=1e-6)
    with pytest.raises(ValueError, match="shape"):
        pg.identify(task, [(x[0, :, :2], u[0])], params={"system.pole_mass": 0.1})
    with pytest.raises(ValueError):
        pg.identify(task, data)


def test_checks_return_a_table():
    table = pg.check(pg.task("pendulum", horizon=10))
    assert "rollout" in table and "FAILED" not in table
