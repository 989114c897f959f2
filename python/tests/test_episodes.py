"""Episodes that end, and trainings by windows of them."""

import numpy as np
import pytest

import physgrad as pg


def fall(end=lambda x: abs(x.angle) > 0.8, **settings):
    """A pendulum that falls, whose episodes end at an angle of 0.8 rad."""

    def rate(x, u):
        return [x.speed, np.sin(x.angle) + u.torque]

    task = pg.system(
        rate,
        states=["angle", "speed"],
        controls={"torque": (-1, 1)},
        dt=0.1,
        horizon=40,
        start=dict(angle=pg.uniform(-0.3, 0.3), speed=pg.uniform(-0.3, 0.3)),
        running_cost=lambda x, u, next: next.angle**2 - 1,
        end=end,
    )
    return task.replace(**settings)


def test_a_condition_ends_episodes_in_rollouts_and_environments():
    task = fall(precision="f64")
    assert (task.state_dim, task.ended) == (3, 2)
    gymnasium = pytest.importorskip("gymnasium")
    env = pg.gym.make(task)
    assert isinstance(env, gymnasium.Env)
    lengths = []
    for seed in range(8):
        env.reset(seed=seed)
        start = env.state
        total, steps, over = 0.0, 0, False
        while not over:
            y, reward, terminated, truncated, _ = env.step(np.zeros(1))
            total, steps, over = total + reward, steps + 1, terminated or truncated
        assert terminated == (abs(y[0]) > 0.8) and terminated != truncated
        with pytest.raises(RuntimeError, match=f"step {steps}: the episode has ended"):
            env.step(np.zeros(1))
        loss = pg.losses(task, lambda y: np.zeros((len(y), 1)), start[None])[0]
        assert total == pytest.approx(-loss, rel=1e-12)
        lengths.append(steps)
    assert min(lengths) < 40, lengths


def test_an_end_is_a_condition_of_the_state():
    starts = fall(end=None).starts(8, dtype="float64", seed=3)
    assert fall(end=None).ended is None

    def losses(task):
        return pg.losses(task, lambda y: np.zeros((len(y), 1)), np.pad(starts, ((0, 0), (0, 1))))

    expected = losses(fall(end=None, precision="f64", loss={"end": "abs(angle) > 0.8"}))

    def far(x):
        return np.any(np.abs(np.array([x.angle, x.angle / 2])) > np.array([0.8, 5.0]))

    casadi = pytest.importorskip("casadi")
    x = casadi.SX.sym("x", 2)
    for end in (
        lambda x: abs(x.angle) > 0.8,
        lambda x, p: [(x.angle > 0.8) | (x.angle < -0.8)],
        far,
        casadi.Function("end", [x], [casadi.fabs(x[0]) > 0.8]),
    ):
        assert (losses(fall(end=end, precision="f64")) == expected).all()
    with pytest.raises(TypeError, match=r"returned one number; `end` returns one condition on the state"):
        fall(end=lambda x: x.angle)
    with pytest.raises(TypeError, match=r"returned True; `end` returns one condition"):
        fall(end=lambda x: True)
    with pytest.raises(TypeError, match=r"argument `u` that does not fit: `end` receives x, p"):
        fall(end=lambda x, u: x.angle > u.torque)
    with pytest.raises(ValueError, match=r"`loss.end` is given twice"):
        pg.system(
            lambda x, u: [u.a],
            states=["q"],
            controls=["a"],
            dt=0.1,
            end=lambda x: x.q > 1,
            loss={"end": "q > 2"},
        )


def test_vector_environments_begin_anew_after_an_end():
    pytest.importorskip("gymnasium")
    env = pg.gym.make_vec(fall(), 4)
    env.reset(seed=1)
    ends = 0
    for _ in range(120):
        _, _, terminated, truncated, _ = env.step(np.ones((4, 1)))
        assert not (terminated & truncated).any()
        ends += int(terminated.sum())
    assert ends > 4


def test_a_training_by_windows_reports_lengths_and_values():
    settings = dict(batch=16, train_samples=16, test_samples=8, resample=True, discount=0.95)
    window = {"steps": 5, "noise": 0.1, "value": {"widths": [16]}}
    run = pg.train(fall(), epochs=3, window=window, learning_rate=1e-2, progress=False, **settings)
    history = run.history
    assert np.isfinite([history[name] for name in ("length", "value_error", "explained")]).all()
    assert history["length"].max() <= 40
    again = pg.train(fall(), epochs=3, window=window, learning_rate=1e-2, progress=False, threads=1, **settings)
    assert (again.history["test_loss"] == history["test_loss"]).all()


def test_settings_of_windows_are_checked():
    with pytest.raises(ValueError, match="window.steps.* is 41; allowed: 1 to 40"):
        pg.train(fall(), epochs=1, window={"steps": 41})
    with pytest.raises(ValueError, match=r"training.discount.* is 1; allowed: below 1 with `window.value`"):
        pg.train(fall(), epochs=1, window={"steps": 5, "value": {}})
    with pytest.raises(ValueError, match="loss.end.*a number where a condition is expected"):
        fall().replace(loss={"end": "angle"})
