"""Trains a robot, and runs the policy in Gymnasium with MuJoCo.

Usage: python sim_to_sim.py [PRESET ...] [--seed N] [--quick], with the presets of `ENVIRONMENTS`. Needs
`gymnasium[mujoco]`. Presets `_run` train whole episodes by windows, in minutes, on the contacts of
the file; the others train short rollouts on smooth contacts, in seconds.
"""

from __future__ import annotations

import argparse

import numpy as np

import physgrad as pg

ENVIRONMENTS = {
    "half_cheetah": "HalfCheetah-v5",
    "hopper": "Hopper-v5",
    "walker2d": "Walker2d-v5",
    "half_cheetah_run": "HalfCheetah-v5",
    "hopper_run": "Hopper-v5",
    "walker2d_run": "Walker2d-v5",
    "ant_run": "Ant-v5",
}


def evaluate(policy: pg.Policy, name: str, inputs: int, steps: int, episodes: int) -> tuple[np.ndarray, np.ndarray]:
    """Returns and distances of episodes in the unmodified environment.

    The policy observes the first `inputs` numbers; in Ant-v5, contact forces follow them.
    """
    import gymnasium

    env = gymnasium.make(ENVIRONMENTS[name])
    returns, distances = [], []
    for seed in range(episodes):
        y, _ = env.reset(seed=seed)
        start, total = env.unwrapped.data.qpos[0], 0.0
        for _ in range(steps):
            y, reward, terminated, truncated, _ = env.step(policy(y[None, :inputs])[0])
            total += float(reward)
            if terminated or truncated:
                break
        returns.append(total)
        distances.append(env.unwrapped.data.qpos[0] - start)
    return np.array(returns), np.array(distances)


def compare(name: str, seed: int, quick: bool) -> None:
    """Trains a preset, and prints what the last and the best policy reach here and in MuJoCo."""
    task = pg.task(name)
    epochs, episodes = task.settings["epochs"], 10
    lengths = sorted({task.horizon, min(4 * task.horizon, 1000), 1000})
    if quick:
        epochs, episodes, lengths = 2, 2, lengths[:1]
    run = pg.train(task, epochs=epochs, seed=seed, progress=False)
    stiff = task.replace(contacts="file")
    starts = stiff.starts(256, seed=1)
    for kind, policy in (("last", run.policy), ("best", run.best_policy)):
        trained = run.history["test_loss"]
        loss = trained[-1] if kind == "last" else trained.min()
        on_file = pg.losses(stiff, policy, starts).mean()
        print(f"{name}, {kind} policy: loss {loss:.3f} in training, {on_file:.3f} with the contacts of the file")
        for steps in lengths:
            returns, distances = evaluate(policy, name, task.observation_dim, steps, episodes)
            print(
                f"{ENVIRONMENTS[name]}, {steps} steps: return {returns.mean():.1f} ± {returns.std():.1f}, "
                f"distance {distances.mean():.2f} m"
            )


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("presets", nargs="*", metavar="PRESET", help=", ".join(ENVIRONMENTS))
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--quick", action="store_true", help="2 epochs and 2 short episodes")
    arguments = parser.parse_args()
    unknown = set(arguments.presets) - set(ENVIRONMENTS)
    if unknown:
        parser.error(f"{', '.join(sorted(unknown))}; allowed: {', '.join(ENVIRONMENTS)}")
    for name in arguments.presets or ["half_cheetah"]:
        compare(name, arguments.seed, arguments.quick)


if __name__ == "__main__":
    main()
