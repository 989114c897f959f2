"""The result of `identify`: its statistics beside SciPy and lmfit, its options, and how it shows itself."""

import json
import math
import pickle
import re
import warnings

import numpy as np
import pytest

import physgrad as pg

NAMES = ["system.cart_mass", "system.pole_mass"]
NOISE = np.array([0.002, 0.02, 0.003, 0.03])


def task():
    return pg.task("cart_pole", poles=1, horizon=30, precision="f64")


def noisy(count=3, noise=NOISE):
    """Measurements with noise, of the masses 1 kg and 0.1 kg."""
    x, u = pg.rollout(task(), pg.Mlp(task(), [8], seed=3, zero_init_output=False), task().starts(count, seed=1))
    u = u + 5.0 * np.sin(np.arange(30) / 4)[:, None]
    for t in range(30):
        x[:, t + 1] = task().step(x[:, t], u[:, t])
    x = x[:, :-1]
    x = x + noise * np.random.default_rng(1).normal(size=x.shape)
    return [(x[i], u[i]) for i in range(count)]


@pytest.fixture(scope="module")
def data():
    return noisy()


@pytest.fixture(scope="module")
def fit(data):
    return pg.identify(task(), data, {"system.cart_mass": 1.3, "system.pole_mass": {"start": 0.13, "min": 0.01}}, NOISE)


def residuals(data, noise):
    """Residuals over all segments as a function of both masses and all initial states."""
    x, u = (np.stack(part) for part in zip(*data))

    def simulated(unknowns):
        masses = dict(zip(("cart_mass", "pole_mass"), map(float, unknowns[:2])))
        of = task().replace(**masses)
        states = [np.reshape(unknowns[2:], (len(x), 4))]
        for t in range(x.shape[1] - 1):
            states.append(of.step(states[-1], u[:, t]))
        return ((np.stack(states, axis=1) - x) / noise).ravel()

    return simulated, np.concatenate([[1.3, 0.13], x[:, 0].ravel()])


def test_values_and_errors_are_those_of_scipy(data, fit):
    optimize = pytest.importorskip("scipy.optimize")
    simulated, start = residuals(data, NOISE)
    size = np.concatenate([[1.0, 0.1], np.tile([0.1, 1.0, 0.1, 1.0], 3)])
    found = optimize.least_squares(simulated, start, "3-point", x_scale=size, xtol=1e-14, ftol=1e-14, gtol=1e-14)
    errors = np.sqrt(np.diag(np.linalg.inv(found.jac.T @ found.jac)))
    np.testing.assert_allclose([fit.values[name] for name in NAMES], found.x[:2], rtol=0, atol=1e-4 * errors[:2].min())
    np.testing.assert_allclose([fit.errors[name] for name in NAMES], errors[:2], rtol=1e-5)
    assert fit.chi_squared == pytest.approx(2 * found.cost, rel=1e-8)
    np.testing.assert_allclose(fit.initial_states.ravel(), found.x[2:], atol=1e-3 * errors[2:].min())
    covariance = np.linalg.inv(found.jac.T @ found.jac)
    assert fit.correlations[0, 1] == pytest.approx(covariance[0, 1] / (errors[0] * errors[1]), abs=1e-5)
    # The noise is about as large as the difference from the true numbers.
    assert all(abs(fit.values[name] - true) < 4 * fit.errors[name] for name, true in zip(NAMES, (1.0, 0.1)))


def test_sizes_and_criteria_are_those_of_lmfit(data):
    lmfit = pytest.importorskip("lmfit")
    with warnings.catch_warnings():
        # States of unequal noise have correlated residuals without `noise`.
        warnings.simplefilter("ignore")
        ours = pg.identify(task(), data, {"system.cart_mass": 1.3, "system.pole_mass": 0.13})
    simulated, start = residuals(data, 1.0)
    parameters = lmfit.Parameters()
    for i, value in enumerate(start):
        parameters.add(f"p{i}", value=value)
    theirs = lmfit.minimize(lambda p: simulated(list(p.valuesdict().values())), parameters, xtol=1e-12, ftol=1e-12)
    assert (ours.measurements, ours.unknowns, ours.freedom) == (theirs.ndata, theirs.nvarys, theirs.nfree)
    assert ours.chi_squared == pytest.approx(theirs.chisqr, rel=1e-8)
    assert ours.reduced_chi_squared == pytest.approx(theirs.redchi, rel=1e-8)
    assert ours.aic == pytest.approx(theirs.aic, rel=1e-8) and ours.bic == pytest.approx(theirs.bic, rel=1e-8)
    for i, name in enumerate(NAMES):
        assert ours.values[name] == pytest.approx(theirs.params[f"p{i}"].value, rel=1e-5)
        # Derivatives of lmfit are forward differences.
        assert ours.errors[name] == pytest.approx(theirs.params[f"p{i}"].stderr, rel=1e-2)


def test_states_follow_the_physics_and_explain_chi_squared(data, fit):
    fitted = fit.fitted_task
    assert fitted.settings["system"]["pole_mass"] == fit.values["system.pole_mass"]
    for states, (x, u), times, residual in zip(fit.states, data, fit.times, fit.residuals):
        np.testing.assert_allclose(fitted.step(states[:-1], u[: len(states) - 1]), states[1:], atol=1e-7)
        np.testing.assert_array_equal(residual, x - states)
        assert times.shape == (30,) and times[-1] == pytest.approx(0.29)
    parts = np.concatenate(fit.residuals) / NOISE
    assert fit.chi_squared == pytest.approx((parts**2).sum(), rel=1e-12)
    assert fit.measurements == parts.size and fit.freedom == parts.size - 2 - 12
    assert 0.5 < fit.reduced_chi_squared < 2 and fit.converged and fit.initial_states.shape == (3, 4)
    assert fit.rms["theta_1"] == pytest.approx(np.sqrt((np.concatenate(fit.residuals)[:, 2] ** 2).mean()))
    assert fit.starts == {"system.cart_mass": 1.3, "system.pole_mass": 0.13}
    assert fit.bounds == {"system.cart_mass": (-math.inf, math.inf), "system.pole_mass": (0.01, math.inf)}


def test_whole_segments_and_exact_starts(data, fit):
    params = {"system.cart_mass": 1.3, "system.pole_mass": 0.13}
    whole = pg.identify(task(), data, params, NOISE, window=0)
    assert (fit.window, whole.window) == (10, 0)
    assert whole.values["system.cart_mass"] == pytest.approx(fit.values["system.cart_mass"], rel=1e-6)
    with warnings.catch_warnings():
        # The first rows have noise.
        warnings.simplefilter("ignore")
        exact = pg.identify(task(), data, params, NOISE, exact_starts=True)
    np.testing.assert_array_equal(exact.initial_states, [x[0] for x, _ in data])
    assert exact.unknowns == 2 and exact.measurements == 3 * 29 * 4
    with pytest.raises(ValueError, match="`window` is -1; allowed: an integer of at least 0"):
        pg.identify(task(), data, params, NOISE, window=-1)
    missing = [(np.where(np.arange(30)[:, None] == 0, [1.0, np.nan, 1.0, 1.0], x), u) for x, u in data]
    with pytest.raises(ValueError, match="segment 0: the first row lacks x_dot, but `exact_starts` takes it as"):
        pg.identify(task(), missing, params, NOISE, exact_starts=True)


def test_other_segments_validate_a_fit():
    data = noisy(5)
    params = {"system.cart_mass": 1.3, "system.pole_mass": 0.13}
    fit = pg.identify(task(), data, params, NOISE, every=2)
    alone = pg.identify(task(), data[::2], params, NOISE)
    assert fit.values == alone.values and len(fit.states) == 3 and alone.validation is None
    other = fit.validation
    assert len(other.states) == 2 and other.values == {} and other.unknowns == 8 and other.converged
    assert 0.5 < other.reduced_chi_squared < 2
    np.testing.assert_array_equal(other.measured[1], data[3][0])
    np.testing.assert_allclose(fit.fitted_task.step(other.states[0][:-1], data[1][1][:29]), other.states[0][1:], atol=1e-7)
    assert "Validation: residuals of 2 other segments" in fit.summary()
    with pytest.raises(ValueError, match="`every` is 0; allowed: an integer of at least 1"):
        pg.identify(task(), data, params, NOISE, every=0)
    with pytest.raises(ValueError, match="`every` is 2, and no segment remains for validation"):
        pg.identify(task(), data[:1], params, NOISE, every=2)


def test_a_state_without_a_measurement_needs_no_noise(data):
    params = {"system.cart_mass": 1.3, "system.pole_mass": 0.13}
    unseen = [(np.where(np.arange(4) == 3, np.nan, x), u) for x, u in data]
    by_one = pg.identify(task(), unseen, params, [*NOISE[:3], 1.0])
    for noise in ([*NOISE[:3], np.nan], dict(zip(task().state_names[:3], NOISE))):
        assert pg.identify(task(), unseen, params, noise).values == by_one.values
        with pytest.raises(ValueError, match="`noise` has no number for omega_1, which the data measure"):
            pg.identify(task(), data, params, noise)
    with pytest.raises(ValueError, match="`noise`: 'theta' is no state; states: x, x_dot, theta_1, omega_1"):
        pg.identify(task(), data, params, {"theta": 0.1})


def test_elements_of_lists_are_unknown_numbers():
    pendulum = pg.task("pendulum", horizon=40, precision="f64")
    start = pendulum.starts(2, seed=1)
    x, u = pg.rollout(pendulum, lambda y, t: np.full(y.shape[0], np.sin(0.3 * t)), start)
    key = "system.arms[0].mass"
    mass = pendulum.settings["system"]["arms"][0]["mass"]
    heavier = pendulum.replace(settings={key: 1.2 * mass})
    fit = pg.identify(heavier, [(x[i, :-1], u[i]) for i in range(2)], params=[key])
    assert fit.values[key] == pytest.approx(mass, rel=1e-6) and fit.starts[key] == pytest.approx(1.2 * mass)
    assert fit.fitted_task.settings["system"]["arms"][0]["mass"] == fit.values[key]


def test_warnings_are_raised_where_the_call_is(data):
    unseen = [(np.where(np.arange(4) == 0, np.nan, x), u) for x, u in data]
    with pytest.warns(UserWarning) as raised:
        pg.identify(task(), unseen, ["system.cart_mass"], [np.nan, *NOISE[1:]])
    assert {warning.filename for warning in raised} == {__file__}


def test_the_summary_has_numbers_errors_bounds_and_correlations(fit):
    text = fit.summary()
    assert text == str(fit)
    lines = text.splitlines()
    rows = {line.split()[0]: line.split() for line in lines if line.endswith("estimated")}
    value, error = fit.values["system.pole_mass"], fit.errors["system.pole_mass"]
    expected = [f"{value:.6g}", "±", f"{error:.2g}", f"{100 * error / value:.2g}", "%"]
    assert rows["system.pole_mass"] == ["system.pole_mass", *expected, *rows["system.pole_mass"][6:]]
    assert rows["system.pole_mass"][-5:] == ["0.13", "0.01", "to", "inf", "estimated"]
    pair = f"{fit.correlations[0, 1]:+.3f}"
    assert abs(fit.correlations[0, 1]) > 0.1 and pair in text and "Correlations above 0.1" in text
    assert pair not in fit.summary(min_correlation=0.999)
    assert repr(fit).startswith("<physgrad.Fit of cart_pole: system.cart_mass 0.9") and repr(fit).endswith("; converged>")


def test_bounds_and_open_numbers_show_in_the_summary(data):
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        fit = pg.identify(task(), data, {"system.pole_mass": {"start": 0.05, "min": 0.01, "max": 0.06}}, NOISE)
    line = next(line for line in fit.summary().splitlines() if "system.pole_mass" in line and "bound" in line)
    assert "at bound" in line and "0.01 to 0.06" in line and "±" not in line
    assert any(line.startswith("warning: ") for line in fit.summary().splitlines()) and fit.at_bound == ["system.pole_mass"]


def test_a_fit_is_a_dict_a_pickle_and_a_table_in_notebooks(fit):
    kept = json.loads(json.dumps(fit.to_dict()))
    assert kept["values"] == fit.values and kept["states"][0][0] == fit.states[0][0].tolist() and kept["noise"] == NOISE.tolist()
    assert kept["task"]["task"] == "cart_pole" and kept["validation"] is None
    again = pickle.loads(pickle.dumps(fit))
    assert again.values == fit.values and again.summary() == fit.summary()
    page = fit._repr_html_()
    assert page.count("<tr>") == page.count("</tr>") > 12 and "system.pole_mass" in page and "estimated" in page
    assert re.search(r"<td[^>]*>± ", page)


def test_a_plot_has_measured_and_fitted_states_with_residuals(fit, data, tmp_path):
    pytest.importorskip("matplotlib").use("Agg")
    figure = fit.plot([2])
    assert len(figure.axes) == 8
    above, below = figure.axes[4], figure.axes[5]
    points, line = above.get_lines()
    assert above.get_ylabel() == "theta_1"
    np.testing.assert_array_equal(points.get_ydata(), data[2][0][:, 2])
    np.testing.assert_array_equal(line.get_ydata(), fit.states[2][:, 2])
    np.testing.assert_array_equal(below.get_lines()[1].get_ydata(), fit.residuals[2][:, 2])
    fit.plot().savefig(tmp_path / "fit.png")
    assert (tmp_path / "fit.png").stat().st_size > 10_000
