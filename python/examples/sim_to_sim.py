"""Trains a robot with smooth contacts, and runs the policy in Gymnasium with MuJoCo.

Usage: python sim_to_sim.py [PRESET ...] [--quick], with presets half_cheetah, hopper, walker2d,
half_cheetah_run and hopper_run. Needs `gymnasium[mujoco]`. Presets `_run` train whole episodes by
windows, in minutes, and then train again on the contacts of the file.
"""

import sys

import numpy as np

import physgrad as pg

ENVIRONMENTS = {"half_cheetah": "HalfCheetah-v5", "hopper": "Hopper-v5", "walker2d": "Walker2d-v5"}
ENVIRONMENTS |= {"half_cheetah_run": "HalfCheetah-v5", "hopper_run": "Hopper-v5"}
# Hopper-v5 ends an episode here.
END = {"loss": {"end": "qpos.rootz < 0.7 or abs(qpos.rooty) > 0.2"}}


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
        stiff = task.replace(contacts="file", **(END if name == "hopper_run" else {}))
        if name.endswith("_run"):
            # The new value function is wrong at first: the policy moves slowly until it has learned.
            again = {"learning_rate": 5e-4, "warm_up": 15, "epochs": 2 if quick else 60}
            policy = pg.train(stiff, policy, progress=False, **again).best_policy
        losses = pg.losses(stiff, policy, stiff.starts(256, seed=1))
        smooth = run.history["test_loss"].min()
        print(f"{name}: loss {smooth:.3f} with smooth contacts, {losses.mean():.3f} with those of the file")
        lengths = {task.horizon, min(4 * task.horizon, 1000), 1000}
        for steps in (task.horizon,) if quick else sorted(lengths):
            returns, distances = evaluate(policy, name, steps, 2 if quick else 10)
            print(
                f"{ENVIRONMENTS[name]}, {steps} steps: return {returns.mean():.1f} ± {returns.std():.1f}, "
                f"distance {distances.mean():.2f} m"
            )


if __name__ == "__main__":
    main()
