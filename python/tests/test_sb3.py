"""Environments of Stable-Baselines3."""

import functools
import os

import numpy as np
import physgrad as pg
import pytest

pytest.importorskip("gymnasium", reason="Gymnasium is not installed")
sb3 = pytest.importorskip("stable_baselines3", reason="stable-baselines3 is not installed")

from gymnasium.vector import AutoresetMode  # noqa: E402
from stable_baselines3.common.env_util import make_vec_env  # noqa: E402
from stable_baselines3.common.vec_env import DummyVecEnv, SubprocVecEnv, VecMonitor  # noqa: E402

slow = pytest.mark.skipif(
    os.environ.get("PHYSGRAD_PYTHON_ALL") != "1", reason="takes minutes; set PHYSGRAD_PYTHON_ALL=1"
)


def test_the_adapter_has_the_episodes_of_the_vector_environment():
    task = pg.task("cart_pole", poles=1, horizon=4, effects={"gusty_wind": {}})
    envs = pg.gym.make_sb3(task, 3, bound=5.0)
    own = pg.gym.TaskVectorEnv(task, 3, 5.0, AutoresetMode.SAME_STEP)
    envs.seed(7)
    np.testing.assert_array_equal(envs.reset(), own.reset(seed=7)[0])
    rng = np.random.default_rng(0)
    for step in range(1, 10):
        actions = rng.uniform(-1, 1, (3, 1)).astype(np.float32)
        y, reward, done, infos = envs.step(actions)
        expected, rewards, _, truncated, info = own.step(actions)
        np.testing.assert_array_equal(y, expected)
        np.testing.assert_array_equal(reward, rewards.astype(np.float32))
        assert done.tolist() == truncated.tolist() == [step % 4 == 0] * 3
        for row in range(3):
            if step % 4 == 0:
                np.testing.assert_array_equal(infos[row].pop("terminal_observation"), info["final_obs"][row])
                assert infos[row].pop("TimeLimit.truncated") is True
            assert infos[row] == {}


def test_the_adapter_takes_options_seeds_and_settings():
    envs = pg.gym.make_sb3("cart_pole", 2, poles=1, max_episode_steps=3, render_mode="rgb_array")
    assert envs.num_envs == 2 and envs.environments.task.horizon == 3
    x = np.array([0.1, -0.2, 3.0, 0.4], np.float32)
    envs.set_options({"state": x})
    envs.reset()
    np.testing.assert_array_equal(envs.get_attr("state", 1), [x])
    envs.set_options([{"state": x}, {}])
    with pytest.raises(ValueError, match="options of the environments have different names"):
        envs.reset()
    envs.set_options()
    envs.seed(3)
    first = envs.reset()
    assert not np.array_equal(first, envs.reset())
    envs.seed(3)
    np.testing.assert_array_equal(envs.reset(), first)
    assert envs.get_attr("render_mode") == ["rgb_array"] * 2 and len(envs.get_images()) == 2
    assert envs.env_is_wrapped(VecMonitor) == [False, False]
    with pytest.raises(AttributeError, match="`task` does not change"):
        envs.set_attr("task", None)
    with pytest.raises(AttributeError, match="no methods of their own"):
        envs.env_method("reset")
    envs.close()


def test_make_vec_env_creates_environments_by_their_ids():
    envs = make_vec_env("physgrad/cart_pole-v0", n_envs=2, seed=0, env_kwargs={"poles": 1, "horizon": 3})
    envs.reset()
    for _ in range(3):
        _, _, done, infos = envs.step(np.zeros((2, 1), np.float32))
    assert done.all() and all(info["TimeLimit.truncated"] for info in infos)
    assert envs.get_images()[0].dtype == np.uint8


def test_environments_in_processes_are_those_of_one_process():
    task = pg.task("cart_pole", poles=1, horizon=4, effects={"gusty_wind": {}})
    makers = [functools.partial(pg.gym.make, task, bound=bound) for bound in (5.0, 20.0)]
    envs, own = SubprocVecEnv(makers, start_method="spawn"), DummyVecEnv(makers)
    try:
        for vector in (envs, own):
            vector.seed(7)
        np.testing.assert_array_equal(envs.reset(), own.reset())
        rng, ends = np.random.default_rng(0), 0
        for _ in range(10):
            actions = rng.uniform(-1, 1, (2, 1)).astype(np.float32)
            (y, reward, done, infos), expected = envs.step(actions), own.step(actions)
            for a, b in zip((y, reward, done), expected, strict=False):
                np.testing.assert_array_equal(a, b)
            for info, other in zip(infos, expected[3], strict=True):
                assert info["TimeLimit.truncated"] == other["TimeLimit.truncated"]
                if "terminal_observation" in other:
                    np.testing.assert_array_equal(info["terminal_observation"], other["terminal_observation"])
            ends += done.sum()
        assert ends == 4 and envs.get_attr("task") == [task, task]
    finally:
        envs.close()


def mean_loss(agent, task, starts):
    """Mean loss of rollouts from ``starts``, by an agent without exploration, or without control."""
    env = pg.gym.TaskVectorEnv(task, len(starts))
    y, _ = env.reset(options={"state": starts[:, : task.state_dim]})
    total = np.zeros(len(starts))
    for _ in range(task.horizon):
        actions = np.zeros((len(starts), 1)) if agent is None else agent.predict(y, deterministic=True)[0]
        y, reward, *_ = env.step(actions)
        total -= reward
    return total.mean()


def one_pole():
    return pg.task("cart_pole", poles=1, loss={"mode": "running"})


def trained(name, seed):
    """An agent after its declared budget."""
    if name == "PPO":
        envs, steps = VecMonitor(pg.gym.make_sb3(one_pole(), 32)), 500_000
        settings = {"n_steps": 100, "batch_size": 800}
    else:
        # One update per step: each call steps 8 environments, and 8 updates follow.
        envs, steps = VecMonitor(pg.gym.make_sb3(one_pole(), 8)), 80_000
        settings = {"train_freq": 1, "gradient_steps": 8, "learning_rate": 1e-3}
        settings["policy_kwargs"] = {"net_arch": [64, 64]}
    agent = getattr(sb3, name)("MlpPolicy", envs, gamma=0.98, seed=seed, device="cpu", **settings)
    return agent.learn(steps)


MISSED = "measured: after 80,000 steps, losses of 0.45, 1.04, 0.95 with the seeds 0, 1, 2; allowed: 0.49"


@slow
@pytest.mark.parametrize("name", ["PPO", pytest.param("SAC", marks=pytest.mark.xfail(reason=MISSED))])
def test_agents_learn_one_pole(name):
    """The loss falls to a quarter of that without control, within a fixed number of steps.

    The criterion and the budgets were declared before their first measurement. PPO passes (0.44,
    beside 1.97 without control). SAC missed its first budget. The second, here, counts as passed if
    the seeds 0, 1 and 2 all pass; 1 and 2 did not. The seed 0 alone, which runs here, passed.
    """
    agent, task = trained(name, seed=0), one_pole()
    starts = task.starts(128, seed=1)
    without, learned = (mean_loss(agent, task, starts) for agent in (None, agent))
    print(f"{name}: loss {learned:.3f}, without control {without:.3f}")
    assert learned < 0.25 * without
