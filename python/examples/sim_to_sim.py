"""Trains a robot with smooth contacts, and runs the policy in Gymnasium with MuJoCo.

Usage: python sim_to_sim.py [half_cheetah|hopper|walker2d] [--quick]. Needs `gymnasium[mujoco]`.
"""

import sys

import numpy as np

import physgrad as pg

ENVIRONMENTS = {"half_cheetah": "HalfCheetah-v5", "hopper": "Hopper-v5", "walker2d": "Walker2d-v5"}


def evaluate(policy: pg.Policy, name: str, steps: int, episodes: int = 10) -> tuple[np.ndarray, np.ndarray]:
    """Returns and distances of episodes in the unmodified environment."""
    import gymnasium

    env = gymnasium.make(ENVIRONMENTS[name])
    returns, distances = [], []
    for seed in range(episodes):
        y, _ = env.reset(seed=seed)
        start, total = env.unwrapped.data.qpos[0], 0.0
        for _ in range(steps):
            y, reward, terminated, truncated, _ = env.step(policy(y[None])[0])
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
        smooth = run.history["test_loss"].min()
        print(f"{name}: loss {smooth:.3f} with smooth contacts, {losses.mean():.3f} with those of the file")
        for steps in (task.horizon,) if quick else (task.horizon, 4 * task.horizon, 1000):
            returns, distances = evaluate(policy, name, steps, 2 if quick else 10)
            print(
                f"{ENVIRONMENTS[name]}, {steps} steps: return {returns.mean():.1f} ± {returns.std():.1f}, "
                f"distance {distances.mean():.2f} m"
            )


if __name__ == "__main__":
    main()
