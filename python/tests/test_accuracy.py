"""Errors and costs of integrators against orders of convergence and the program."""

import json
import os
import shutil
import subprocess

import numpy as np
import pytest

import physgrad as pg

TASK = {"poles": 1, "horizon": 10}


@pytest.fixture(scope="module")
def found():
    return pg.accuracy(pg.task("cart_pole", **TASK), target=1e-5)


def test_errors_fall_with_the_order_of_the_method(found):
    settings = {name: np.asarray(column) for name, column in found.settings.items()}
    assert len({column.shape for column in settings.values()}) == 1
    for method, order in (("euler", 1), ("heun", 2), ("rk4", 4)):
        chosen = (settings["method"] == method) & (settings["precision"] == "f64")
        assert settings["substeps"][chosen].tolist() == [1, 2, 4, 8, 16]
        errors = settings["trajectory"][chosen]
        # Omits the step from 8 to 16 substeps: rounding errors limit the accuracy of RK4 there.
        np.testing.assert_allclose(np.log2(errors[:-1] / errors[1:])[:3], order, atol=0.35)
    assert all(error < 1e-8 for error in found.reference.values())


def test_the_cheapest_setting_reaches_the_target_and_is_a_task(found):
    settings, cheapest = found.settings, found.cheapest
    reached = settings["trajectory"] <= 1e-5
    fastest = np.argmin(np.where(reached, settings["forward_seconds"], np.inf))
    chosen = np.flatnonzero(reached & (settings["forward_seconds"] == cheapest.seconds))
    assert cheapest.error <= 1e-5 and len(chosen) == 1
    assert settings["operations"][chosen[0]] <= settings["operations"][fastest]
    assert cheapest.task.settings["precision"] == cheapest.precision
    assert cheapest.task.settings["integrator"]["substeps"] == cheapest.substeps
    assert cheapest.task.settings["integrator"].get("method", "native") == cheapest.method


def test_errors_are_those_of_the_program(found, tmp_path):
    program = os.environ.get("PHYSGRAD", shutil.which("physgrad")) or pytest.skip("set PHYSGRAD to the program")
    options = ["--set", "system.poles=1", "--set", "horizon=10", "--json", "--rounds", "1", "-o", str(tmp_path / "accuracy")]
    done = subprocess.run([program, "accuracy", "cart_pole", *options], check=True, capture_output=True, text=True)
    rows = json.loads(done.stdout)["settings"]
    columns = {"method": "method", "substeps": "substeps", "trajectory": "trajectory_error", "R": "r_error", "M": "m_error"}
    for name, column in columns.items():
        assert list(found.settings[name]) == [row[column] for row in rows]


def test_invalid_arguments_name_allowed_ones():
    task = pg.task("cart_pole", **TASK)
    with pytest.raises(ValueError, match='`metric` is "r2"; allowed: "trajectory", "loss", "R", "M"'):
        pg.accuracy(task, metric="r2")
    with pytest.raises(ValueError, match="`target` is -1; allowed: a positive error"):
        pg.accuracy(task, target=-1.0)
    for rounds in (0, 1001):
        with pytest.raises(ValueError, match=f"`rounds` is {rounds}; allowed: an integer from 1 to 1000"):
            pg.accuracy(task, rounds=rounds)
