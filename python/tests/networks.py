"""Tasks and weights that the tests of several frameworks share."""

import numpy as np
import physgrad as pg

# One task of each kind: terminal cost, running cost, parameters and step numbers, a delay, and a robot with the
# contacts of its file. Its policy has no bounds, as the networks of the tests have none.
SCENES = {
    "terminal": ("cart_pole", {"poles": 2, "horizon": 12}),
    "running": ("guidance", {"horizon": 12}),
    "params": ("cart_pole", {"poles": 1, "horizon": 12, "effects": {"gusty_wind": {}}, "loss": {"mode": "running"}}),
    "delay": ("cart_pole", {"poles": 1, "horizon": 12, "settings": {"actuator.delay.steps": 2}}),
    "robot": ("half_cheetah_run", {"horizon": 4, "policy": {"bounds": False}}),
}


def task(name: str) -> pg.Task:
    """A scene in f64 with a short horizon."""
    kind, settings = SCENES[name]
    settings = {**settings, "settings": {**settings.get("settings", {}), "precision": "f64"}}
    return pg.task(kind, **settings)


def policy(task: pg.Task) -> "pg.Mlp":
    """An MLP with nonzero weights in all layers."""
    policy = pg.Mlp(task, [8, 6], seed=3)
    rng = np.random.default_rng(4)
    policy.theta = policy.theta + 0.3 * rng.standard_normal(policy.theta.shape)
    return policy


def weights(task: pg.Task, theta: np.ndarray) -> list[np.ndarray]:
    """Kernels (inputs, outputs) and biases of ``policy``, layer by layer."""
    widths = [task.observation_dim, 8, 6, task.control_dim]
    parts, offset = [], 0
    for inputs, outputs in zip(widths, widths[1:]):
        for shape in ((inputs, outputs), (outputs,)):
            size = int(np.prod(shape))
            parts.append(theta[offset : offset + size].reshape(shape))
            offset += size
    assert offset == theta.size
    return parts


def flat(parts: list) -> np.ndarray:
    """Concatenates arrays in the order of theta."""
    return np.concatenate([np.asarray(part).ravel() for part in parts])


def relative(a: np.ndarray, b: np.ndarray) -> float:
    """Largest difference, relative to the largest component of ``b``. 0 if both are equal."""
    difference = np.abs(a - b).max()
    return 0.0 if difference == 0 else float(difference / np.abs(b).max())
