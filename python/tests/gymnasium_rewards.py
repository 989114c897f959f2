"""Writes `gymnasium_rewards.json`, episodes of the robots of Gymnasium with random actions, for `test_rewards.py`.

Usage: python gymnasium_rewards.py. Needs `gymnasium[mujoco]`. A state has positions and velocities; there is one
more than actions and rewards. `ended` says whether the episode ended in the last step.
"""

import json
from importlib.metadata import version
from pathlib import Path

import gymnasium
import numpy as np

# Largest number of steps of each environment. Those with an end have one within it.
ENVIRONMENTS = {
    "HalfCheetah-v5": 12,
    "Hopper-v5": 60,
    "Walker2d-v5": 30,
    "Ant-v5": 6,
    "Swimmer-v5": 6,
    "Reacher-v5": 6,
    "InvertedDoublePendulum-v5": 20,
}


def episode(name: str, count: int) -> dict:
    env, rng = gymnasium.make(name), np.random.default_rng(0)
    env.reset(seed=0)
    data = env.unwrapped.data
    state = lambda: [*data.qpos.tolist(), *data.qvel.tolist()]  # noqa: E731
    states, actions, rewards, contacts, ended = [state()], [], [], [], False
    while len(actions) < count and not ended:
        actions.append(rng.uniform(-1, 1, env.action_space.shape).round(2).tolist())
        _, reward, ended, _, info = env.step(np.array(actions[-1]))
        states.append(state())
        rewards.append(float(reward))
        contacts.append(-float(info.get("reward_contact", 0.0)))
    found = {"actions": actions, "states": states, "rewards": rewards, "ended": ended}
    return {**found, "contact_costs": contacts} if any(contacts) else found


if __name__ == "__main__":
    stored = {package: version(package) for package in ("gymnasium", "mujoco")}
    stored |= {name: episode(name, count) for name, count in ENVIRONMENTS.items()}
    # One line for each state.
    text = json.dumps(stored).replace("], [", "],\n[").replace(', "', ',\n"')
    Path(__file__).with_suffix(".json").write_text(text + "\n", encoding="utf-8")
