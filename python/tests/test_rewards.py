"""Robots of the presets beside those of Gymnasium. `gymnasium_rewards.py` has stored the numbers of MuJoCo."""

import json
from pathlib import Path

import numpy as np
import physgrad as pg
import pytest

gymnasium = pytest.importorskip("gymnasium", reason="Gymnasium is not installed")

STORED = json.loads((Path(__file__).parent / "gymnasium_rewards.json").read_text(encoding="utf-8"))


def environment(preset, **settings):
    assert pg.gym, "the import registers the environments"
    return gymnasium.make(f"physgrad/{preset}-v0", precision="f64", **settings).unwrapped


def restarted(env, episode):
    """Rewards and next states of every step of an episode, each from the stored state."""
    states = np.zeros((len(episode["states"]), env.task.state_dim))
    states[:, : len(episode["states"][0])] = episode["states"]
    rewards, following, ended = [], [], []
    for state, action in zip(states, episode["actions"]):
        env.reset(options={"state": state})
        _, reward, terminated, *_ = env.step(np.array(action))
        rewards.append(reward)
        following.append(env.state[: len(episode["states"][0])])
        ended.append(terminated)
    return np.array(rewards), np.array(following), ended


def test_half_cheetah_run_is_half_cheetah_of_gymnasium():
    episode, env = STORED["HalfCheetah-v5"], environment("half_cheetah_run")
    states, rewards = np.array(episode["states"]), np.array(episode["rewards"])
    assert (env.task.horizon, env.task.dt) == (1000, 0.05)
    found, following, _ = restarted(env, episode)
    assert np.abs(found - rewards).max() < 1e-7 and np.abs(following - states[1:]).max() < 1e-9
    # Without new starts, and the observations.
    env.reset(options={"state": states[0]})
    for after, action, reward in zip(states[1:], episode["actions"], rewards, strict=True):
        y, own, *_ = env.step(np.array(action))
        assert abs(own - reward) < 1e-6
        assert np.abs(y - after[1:]).max() < 1e-6, "positions but the first, and velocities"
    single = gymnasium.make("physgrad/half_cheetah_run-v0").unwrapped
    single.reset(options={"state": states[0]})
    total = sum(single.step(np.array(action))[1] for action in episode["actions"])
    assert total == pytest.approx(rewards.sum(), abs=0.01)


def shaping(limits, height, weight):
    """What `hopper_run` and `walker2d_run` add to the reward: the velocity, and costs of leaning and sinking."""
    angle, gain = limits

    def added(episode):
        states = np.array(episode["states"])
        velocity, z, pitch = np.diff(states[:, 0]) / 0.008, states[1:, 1], states[1:, 2]
        lean = gain * np.maximum(0, np.abs(pitch) / angle - 1) ** 2
        low = weight * np.maximum(0, (height - z) / 0.1) ** 2
        end = np.zeros(len(z))
        # The costs of the end, and Gymnasium gives nothing for its step.
        end[-1] = 99 * episode["ended"]
        return velocity - lean - low - end

    return added


def effort(episode):
    return (np.array(episode["actions"]) ** 2).sum(1)


def survival(episode):
    """What `InvertedDoublePendulum-v5` gives for a pole that stands."""
    standing = np.full(len(episode["rewards"]), 10.0)
    standing[-1] *= not episode["ended"]
    return standing


# Preset, environment, factor of its reward, settings with which it has the steps of the environment, what its reward
# has more than that of the environment, and the tolerance of rewards. Ant, Reacher and the pendulum read positions
# before the end of the last step of MuJoCo.
ROBOTS = {
    "half_cheetah": ("HalfCheetah-v5", 32, {"contacts": "file"}, lambda episode: 0.0, 1e-7),
    "swimmer": ("Swimmer-v5", 64, {"method": "file"}, lambda episode: 0.0, 1e-7),
    "hopper_run": ("Hopper-v5", 1, {"method": "file"}, shaping((0.1, 10), 0.8, 2), 1e-6),
    "walker2d_run": ("Walker2d-v5", 1, {"method": "file"}, shaping((0.3, 2), 1.1, 2), 1e-6),
    "ant_run": ("Ant-v5", 1, {}, lambda episode: np.array(episode["contact_costs"]), 0.01),
    "reacher": ("Reacher-v5", 50, {"method": "file"}, lambda episode: 0.9 * effort(episode), 1e-5),
    "inverted_double_pendulum": (
        "InvertedDoublePendulum-v5",
        100,
        {"method": "file", "frames": 5},
        lambda episode: -survival(episode),
        2e-4,
    ),
}


@pytest.mark.parametrize("preset", ROBOTS)
def test_rewards_differ_from_those_of_gymnasium_as_the_guide_says(preset):
    name, factor, settings, more, tolerance = ROBOTS[preset]
    episode, env = STORED[name], environment(preset, **settings)
    rewards, following, ended = restarted(env, episode)
    # Ant normalizes the orientation of its first state.
    first = 1 if name == "Ant-v5" else 0
    states = np.array(episode["states"])[1:]
    assert np.abs(following - states)[first:].max() < 1e-9
    assert np.abs(factor * rewards - episode["rewards"] - more(episode))[first:].max() < tolerance
    assert any(ended[:-1]) is False
    if env.task.ended is not None:
        assert ended[-1] == episode["ended"]


def test_the_ids_of_all_presets_are_registered():
    for preset in pg.presets():
        assert f"physgrad/{preset}-v0" in gymnasium.registry
    env = gymnasium.make("physgrad/ant-v0", horizon=5)
    assert env.unwrapped.task == pg.task("ant", horizon=5)
    envs = gymnasium.make_vec("physgrad/hopper_run-v0", 3).unwrapped
    assert envs.task == pg.task("hopper_run") and envs.num_envs == 3


def test_an_unknown_id_is_refused_with_a_name_that_exists():
    with pytest.raises(gymnasium.error.NameNotFound, match="Did you mean: `half_cheetah_run`"):
        gymnasium.make("physgrad/half_cheeta_run-v0")
    with pytest.raises(ValueError, match="`physgrad/ant-v0` is an id for `gymnasium.make`; the name is `ant`"):
        pg.gym.make("physgrad/ant-v0")
    with pytest.raises(ValueError, match="`physgrad.gym:physgrad/ant-v0` is an id .* the name is `ant`"):
        pg.gym.make_vec("physgrad.gym:physgrad/ant-v0", 2)
    with pytest.raises(ValueError, match="did you mean `ant`"):
        pg.gym.make("antt")
