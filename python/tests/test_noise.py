"""Noise in the steps of rollouts, and sensors."""

import numpy as np
import physgrad as pg
import pytest


def cart(**more):
    """A cart with noise of force and of a sensor."""
    return pg.system(
        lambda x, u, p: [x.speed, (u.force + p.gust) / p.mass],
        states=["position", "speed"],
        controls={"force": (-5, 5)},
        params={"mass": pg.uniform(0.8, 1.2), "gust": pg.noise(0.5), "encoder": pg.noise(0.05, hold=2)},
        start={"position": pg.uniform(-1, 1)},
        observe=lambda x, p: [x.position + p.encoder, x.speed],
        running_cost=lambda x, u, next: next.position**2 + 0.01 * u.force**2,
        dt=0.1,
        horizon=15,
        precision="f64",
        **more,
    )


def test_a_loop_with_the_parameters_of_each_step_is_the_rollout():
    task = cart()
    assert task.start_dim == task.state_dim + task.param_dim + 1
    policy = pg.Mlp(task, [8], seed=3)
    policy.theta = policy.theta + 0.1
    starts = task.starts(7, seed=5)
    states, controls = pg.rollout(task, policy, starts)
    losses = pg.losses(task, policy, starts)
    x, total, seen = starts[:, :2], np.zeros(7), []
    for t in range(task.horizon):
        p = task.params_at(starts, t)
        seen.append(p)
        following = task.step(x, controls[:, t], p=p, t=t)
        total += task.running_cost(x, controls[:, t], following, p=p, t=t)
        x = following
        np.testing.assert_array_equal(x, states[:, t + 1])
    np.testing.assert_allclose(total, losses, rtol=1e-14)
    names = task.param_names
    mass, gust, encoder = (names.index(f"system.parameters.{name}") for name in ("mass", "gust", "encoder"))
    seen = np.array(seen)
    assert (seen[:, :, mass] == seen[0, :, mass]).all()
    assert (seen[1:, :, gust] != seen[:-1, :, gust]).all()
    assert (seen[1:14:2, :, encoder] == seen[0:14:2, :, encoder]).all()
    assert abs(seen[:, :, gust].std() - 0.5) < 0.15


def test_environments_have_the_noise_of_rollouts():
    pytest.importorskip("gymnasium", reason="Gymnasium is not installed")
    task = cart()
    env = pg.gym.make(task)
    env.reset(seed=1)
    rows = env.unwrapped._rows
    start = np.concatenate([rows.x, rows.p, rows.key], axis=1)
    x, rewards, expected = start[:, :2], [], []
    for t in range(task.horizon):
        _, reward, *_ = env.step(np.array([0.2], np.float32))
        p = task.params_at(start, t)
        u = np.full((1, 1), np.float64(np.float32(0.2)) * 5.0)
        following = task.step(x, u, p=p, t=t)
        expected.append(-task.running_cost(x, u, following, p=p, t=t)[0])
        rewards.append(reward)
        x = following
    np.testing.assert_allclose(rewards, expected, rtol=1e-6)


def test_trainings_differ_by_their_seed_only():
    runs = [
        pg.train(cart(), pg.Mlp(cart(), [8], seed=0), epochs=3, seed=seed, train_samples=16, test_samples=8)
        for seed in (0, 0, 1)
    ]
    first, again, other = (run.history["test_loss"] for run in runs)
    np.testing.assert_array_equal(first, again)
    assert (first != other).all()


def test_a_sensor_delays_what_the_policy_sees():
    task = cart(sensor={"delay": {"steps": 2}, "noise": {"deviation": [0.1, 0.0]}})
    assert task.state_names[2:] == ["y_1_2_ago", "speed_2_ago", "y_1_1_ago", "speed_1_ago"]
    assert "sensor.noise[0]" in task.param_names
    pg.check(task)
    policy = pg.Mlp(task, [])
    policy.theta = np.array([0.0, 1.0, 0.0])  # u is the speed that the policy sees
    states, controls = pg.rollout(task, policy, task.starts(3))
    np.testing.assert_allclose(controls[:, 2:, 0], states[:, :13, 1], rtol=1e-14)
    assert (controls[:, :2, 0] == states[:, :1, 1]).all()


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ((-1.0,), "the deviation -1.0 is negative"),
        ((1.0, float("nan")), "is not a finite number"),
        ((1.0, 0.0, 0), "hold=0 is not a number of steps"),
    ],
)
def test_wrong_noise_is_refused(arguments, message):
    with pytest.raises(ValueError, match=message):
        pg.noise(*arguments)
