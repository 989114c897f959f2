"""Trains one task with PPO of stable-baselines3 and with field C, and draws loss against seconds.

PPO uses rewards only, and field C uses derivatives of the physics. Both train networks with two
hidden layers of 64. Each test loss is a mean over 256 states, which differ between PPO and C.

    python ppo_beside_c.py            # minutes
    python ppo_beside_c.py --quick    # a few updates
"""

import argparse
import time
from pathlib import Path

import matplotlib
import numpy as np
import physgrad as pg
import physgrad.gym
from gymnasium.vector import AutoresetMode
from physgrad.sb3 import TaskVecEnv
from stable_baselines3 import PPO
from stable_baselines3.common.callbacks import BaseCallback

matplotlib.use("Agg")
import matplotlib.pyplot as plt


class Finite(TaskVecEnv):
    """Environments whose rewards end with the episode, as the loss does.

    Without "TimeLimit.truncated", PPO adds no value estimate of later steps.
    """

    def step_wait(self) -> tuple:
        y, reward, done, infos = super().step_wait()
        for info in infos:
            info.pop("TimeLimit.truncated", None)
        return y, reward, done, infos


def ppo_loss(agent: PPO, task: pg.Task, starts: np.ndarray, bound: float) -> float:
    """Mean loss of the agent, without exploration, from ``starts``."""
    starts = starts.astype(np.float32)
    x, p = starts[:, : task.state_dim], starts[:, task.state_dim :]
    loss = np.zeros(len(x))
    for t in range(task.horizon):
        action, _ = agent.predict(task.observe(x, p=p, t=t), deterministic=True)
        u = (action * bound).astype(np.float32)
        following = task.step(x, u, p=p, t=t)
        loss += task.running_cost(x, u, following, p=p, t=t)
        x = following
    return float((loss + task.terminal_cost(x, p=p)).mean())


def train_ppo(task: pg.Task, seconds: float, steps: int, seed: int = 0, bound: float = 60.0) -> list[tuple[float, float]]:
    """Trains by PPO. Returns pairs (seconds of training without the tests, test loss)."""
    envs = pg.gym.TaskVectorEnv(task, 64, bound, AutoresetMode.SAME_STEP)
    agent = PPO(
        "MlpPolicy", Finite(envs), n_steps=task.horizon, batch_size=800, n_epochs=10, gamma=1.0, gae_lambda=0.95,
        learning_rate=3e-4, policy_kwargs={"net_arch": [64, 64]}, device="cpu", seed=seed,
    )  # fmt: skip
    starts, curve = task.starts(256, seed=seed + 1000), []

    class Measure(BaseCallback):
        def __init__(self) -> None:
            super().__init__()
            self.begin, self.tested = time.perf_counter(), 0.0

        def _on_step(self) -> bool:
            return time.perf_counter() - self.begin - self.tested < seconds

        def _on_rollout_end(self) -> None:
            now = time.perf_counter()
            curve.append((now - self.begin - self.tested, ppo_loss(agent, task, starts, bound)))
            self.tested += time.perf_counter() - now

    agent.learn(steps, callback=Measure())
    return curve


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--quick", action="store_true", help="a few updates")
    parser.add_argument("--seconds", type=float, default=300.0, help="longest training by PPO")
    parser.add_argument("--out", type=Path, default=Path("runs/python_ppo"), help="folder of the picture")
    options = parser.parse_args()
    options.out.mkdir(parents=True, exist_ok=True)

    task = pg.task("cart_pole", poles=1)
    run = pg.train(task, pg.Mlp(task, [64, 64], seed=0), field="C", epochs=2 if options.quick else 100, seed=0)
    losses = run.history["test_loss"]
    seconds = np.cumsum(run.history["seconds"])
    print(f"C: test loss {losses[-1]:.4f} after {seconds[-1]:.1f} s")
    curve = train_ppo(task, options.seconds, 12_800 if options.quick else 5_000_000)
    print(f"PPO: test loss {curve[-1][1]:.4f} after {curve[-1][0]:.1f} s, best {min(loss for _, loss in curve):.4f}")

    figure, axes = plt.subplots(figsize=(7, 4), layout="constrained")
    axes.plot(seconds, losses, color="#CC79A7", label="field C")
    axes.plot(*zip(*curve), color="#000000", label="PPO")
    axes.set(xlabel="seconds of training", ylabel="test loss", xscale="log", yscale="log", title="cart_pole, one pole")
    axes.legend()
    figure.savefig(options.out / "ppo_beside_c.png", dpi=150)
    print(f"picture: {options.out / 'ppo_beside_c.png'}")


if __name__ == "__main__":
    main()
