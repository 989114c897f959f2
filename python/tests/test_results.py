"""Results of `optimize` and `accuracy`, presets, tasks of policies, and rollouts of functions."""

import json
import warnings

import numpy as np
import pytest

import physgrad as pg


def task(**settings):
    return pg.task("cart_pole", **{"poles": 1, "horizon": 30, "precision": "f64"} | settings)


SETTINGS = {
    "plain": {},
    "wind": {"effects": {"gusty_wind": {}, "pole_damping": {}}},
    "actuator": {"actuator": {"delay": {"steps": 2}, "limit": {"bound": 5.0}}},
    "sensor": {"sensor": {"noise": {"deviation": 0.01}, "delay": {"steps": 3}}},
    "drawn": {"pole_mass": {"uniform": [0.1, 0.2]}, "cart_mass": {"noise": 0.05, "mean": 1.0}},
    "running": {"loss": {"mode": "running"}},
}


@pytest.mark.parametrize("name", SETTINGS)
def test_a_function_has_the_rollouts_of_the_policy_that_it_calls(name):
    try:
        of = task(**SETTINGS[name])
    except ValueError as error:
        pytest.fail(f"{name}: {error}")
    policy = pg.Mlp(of, [8], seed=1, zero_init_output=False)
    for dtype, tolerance in (("float64", 1e-12), ("float32", 1e-3)):
        starts = of.starts(5, seed=2, dtype=dtype)
        x, u = pg.rollout(of, policy, starts)
        for act in (policy, lambda y: policy(y), lambda y, t: policy(y)):
            found = pg.rollout(of, act, starts)
            assert [part.dtype for part in found] == [starts.dtype] * 2
            np.testing.assert_allclose(found[0], x, rtol=tolerance, atol=tolerance)
            np.testing.assert_allclose(found[1], u, rtol=tolerance, atol=tolerance)
            np.testing.assert_allclose(pg.losses(of, act, starts), pg.losses(of, policy, starts), rtol=tolerance)


def test_a_function_receives_observations_and_steps():
    of, seen = task(), []

    class Memory:
        def __call__(self, y, t=0):
            seen.append((t, y.shape))
            return np.full(len(y), 0.5 * t)

    x, u = pg.rollout(of, Memory(), of.starts(4))
    assert seen == [(t, (4, of.observation_dim)) for t in range(30)]
    np.testing.assert_array_equal(u[:, :, 0], np.tile(0.5 * np.arange(30), (4, 1)))
    # A second argument with another name and a default is a setting of the function.
    _, u = pg.rollout(of, lambda y, gain=2.0: gain * np.ones((len(y), 1)), of.starts(4))
    assert (u == 2.0).all()


def test_functions_without_controls_are_refused():
    of = task()
    for act, message in [
        (lambda y: np.zeros((2, 3)), r"`policy` returned an array of shape \(2, 3\) and dtype float64 at step 0; expected controls of shape \(4, 1\)"),
        (lambda y: None, r"`policy` returned an array of shape \(\) and dtype object"),
        (lambda y: np.full((4, 1), "a"), "dtype <U1"),
    ]:
        with pytest.raises(ValueError, match=message):
            pg.rollout(of, act, of.starts(4))
    with pytest.raises(TypeError, match=r"`policy` is of type dict; allowed: a `Policy`, or a function f\(y\) or f\(y, t\)"):
        pg.losses(of, {}, of.starts(4))
    with pytest.raises(ValueError, match=r"`starts` has the shape \(4, 3\); expected \(B, 4\)"):
        pg.rollout(of, lambda y: y[:, :1], np.zeros((4, 3)))
    with pytest.raises(pg.Divergence, match="component 0 of the control is not finite in step 3 of sample 2") as raised:
        pg.rollout(of, lambda y, t: np.where((np.arange(4) == 2) & (t == 3), np.nan, 0.0), of.starts(4))
    error = raised.value
    assert (error.variable, error.step, error.sample, error.component) == ("control", 3, 2, 0)
    policy = pg.Mlp(of, [8], seed=1, zero_init_output=False)
    policy.theta = policy.theta * 1e155
    for call in (pg.rollout, pg.losses):
        places = []
        for act in (policy, lambda y: policy(y)):
            with pytest.raises(pg.Divergence) as raised:
                call(of, act, of.starts(4, seed=1))
            places.append([getattr(raised.value, name) for name in ("variable", "step", "sample", "component")])
        assert places[0] == places[1]


def test_a_plan_has_attributes():
    of = task()
    start = of.starts(1, seed=2)[0]
    plan = pg.optimize(of, start, bounds=[[-5, 5]], iterations=30)
    x, u = pg.rollout(of, lambda y, t: plan.u[t][None], start[None])
    np.testing.assert_allclose(x[0], plan.x, atol=1e-9)
    assert plan.cost == pytest.approx(pg.losses(of, lambda y, t: plan.u[t][None], start[None])[0], rel=1e-9)
    kept = json.loads(json.dumps(plan.to_dict()))
    assert kept["cost"] == plan.cost and np.shape(kept["gains"]) == (30, 1, 4) and kept["task"]["task"] == "cart_pole"
    assert repr(plan).startswith("<physgrad.Plan of cart_pole: cost ") and f"{plan.iterations} iterations" in repr(plan)
    assert plan.stop in str(plan) and plan.stop in plan._repr_html_()


def test_a_search_begins_at_initial_controls():
    of = task(horizon=60)
    start = of.starts(1, seed=2)[0]
    plan = pg.optimize(of, start, bounds=[[-20, 20]], iterations=100)
    for initial in (plan, plan.u, plan.u.tolist()):
        with pytest.warns(UserWarning, match="the search ended where it began"):
            again = pg.optimize(of, start, bounds=[[-20, 20]], iterations=100, initial=initial)
        assert again.costs[0] == pytest.approx(plan.cost, rel=1e-9) and again.iterations < plan.iterations
        assert again.cost <= plan.cost * (1 + 1e-9)
    policy = pg.Mlp(of, [8], seed=1, zero_init_output=False)
    for initial in (policy, lambda y: policy(y)):
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            begun = pg.optimize(of, start, iterations=1, initial=initial)
        assert begun.costs[0] == pytest.approx(pg.losses(of, policy, start[None])[0], rel=1e-9)
    # Initial controls beyond the bounds begin at the bounds.
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        bounded = pg.optimize(of, start, bounds=[[-1, 1]], iterations=1, initial=np.full((60, 1), 9.0))
    assert bounded.costs[0] == pytest.approx(pg.losses(of, lambda y: np.ones(len(y)), start[None])[0], rel=1e-9)
    with pytest.raises(ValueError, match=r"`initial` has the shape \(59, 1\); expected \(60, 1\)"):
        pg.optimize(of, start, initial=plan.u[1:])


def test_accuracy_has_attributes():
    found = pg.accuracy(pg.task("cart_pole", poles=1, horizon=5), target=1e-3, rounds=1)
    kept = json.loads(json.dumps(found.to_dict()))
    assert kept["cheapest"]["method"] == found.cheapest.method and kept["cheapest"]["task"]["horizon"] == 5
    assert kept["settings"]["method"] == found.settings["method"]
    rows = len(found.settings["method"])
    assert repr(found).startswith(f"<physgrad.Accuracy of cart_pole: {rows} settings; cheapest: ")
    assert len(str(found).splitlines()) == rows + 2 and found._repr_html_().count("<tr>") == rows + 1


def test_presets_open():
    presets = pg.presets()
    assert {"cart_pole", "cart_pole_windy", "quantum_5", "pendulum"} < set(presets)
    assert all(isinstance(pg.task(name), pg.Task) and text for name, text in presets.items())


def test_policies_know_their_task():
    of = task()
    policy = pg.Mlp(of, [8], activation="relu")
    assert policy.task.settings["policy"]["widths"] == (8,) and policy.task.settings["system"] == of.settings["system"]
    copy = policy.copy()
    assert copy.task == policy.task
    copy.theta = copy.theta + 1.0
    assert not np.array_equal(copy.theta, policy.theta)
    run = pg.train(of, policy, epochs=1, train_samples=32, test_samples=32)
    assert run.policy.task.settings["policy"] == policy.task.settings["policy"]
