"""Trains a robot, and runs the policy in Gymnasium with MuJoCo.

Usage: python sim_to_sim.py [PRESET ...] [--quick], with the presets of `ENVIRONMENTS`. Needs
`gymnasium[mujoco]`. Presets `_run` train whole episodes by windows, in minutes, on the contacts of
the file; the others train short rollouts on smooth contacts, in seconds.
"""

import sys

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


def main() -> None:
    names = [word for word in sys.argv[1:] if word in ENVIRONMENTS] or ["half_cheetah"]
    quick = "--quick" in sys.argv
    for name in names:
        task = pg.task(name)
        run = pg.train(task, epochs=2 if quick else task.epochs, progress=False)
        policy = run.best_policy
        stiff = task.replace(contacts="file")
        losses = pg.losses(stiff, policy, stiff.starts(256, seed=1))
        trained = run.history["test_loss"].min()
        print(f"{name}: loss {trained:.3f} in training, {losses.mean():.3f} with the contacts of the file")
        lengths = {task.horizon, min(4 * task.horizon, 1000), 1000}
        for steps in (task.horizon,) if quick else sorted(lengths):
            returns, distances = evaluate(policy, name, task.observation_dim, steps, 2 if quick else 10)
            print(
                f"{ENVIRONMENTS[name]}, {steps} steps: return {returns.mean():.1f} ± {returns.std():.1f}, "
                f"distance {distances.mean():.2f} m"
            )


if __name__ == "__main__":
    main()
