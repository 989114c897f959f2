"""Differentiable physics: gradients of long simulations, and neural controllers trained with them.

`task` opens a preset or a scene file, and `system` a system that is written as functions of NumPy.
`presets` lists the presets. Methods of a `Task` evaluate steps, observations and costs on arrays,
with their derivatives. `train` trains a policy. `rollout` and `losses` evaluate policies and functions,
and `gradients` evaluates policies. `optimize` minimizes the loss over the controls from one initial
state. `identify` fits physical numbers to measurements, `check` compares derivatives with dual
numbers, and `accuracy` measures errors and costs of integrators.
"""

from ._core import (
    Divergence,
    Policy,
    Run,
    Task,
    __version__,
    check,
    gradients,
    presets,
)
from ._accuracy import Accuracy, accuracy
from ._distributions import choice, log_uniform, noise, normal, table, trained, uniform
from ._fit import Fit, identify
from ._import_jax import from_jax
from ._plan import Plan, optimize
from ._rollouts import losses, rollout
from .trace import detach, system

__all__ = [
    "Accuracy",
    "Divergence",
    "Fit",
    "Mlp",
    "Plan",
    "Policy",
    "Run",
    "Task",
    "accuracy",
    "check",
    "choice",
    "detach",
    "from_jax",
    "gradients",
    "identify",
    "load",
    "log_uniform",
    "losses",
    "noise",
    "normal",
    "optimize",
    "presets",
    "rollout",
    "scene",
    "system",
    "table",
    "task",
    "train",
    "trained",
    "uniform",
]


def task(name, **settings):
    """Opens a preset by name, for example "cart_pole", or a scene file by its path.

    The arguments `horizon`, `precision`, `field`, `epochs`, `seed`, `tags` and `log` are settings
    outside of sections. `effects`, `actuator`, `sensor`, `integrator`, `loss`, `policy`, `training` and
    `system` accept a dict of the settings of the section. `settings` accepts a dict of dotted keys,
    as in `settings={"system.poles": 4}`. Other keyword arguments are settings of the section
    `system`, as in `poles=4`.

    A dict changes only its keys. `{}` adds an effect or a part of the actuator or the sensor with its
    default values, and None removes one, as in `effects={"bumpers": None}` or
    `**{"effects.bumpers": None}`. A section that is an empty dict is refused.

    Raises `ValueError` with the key and its allowed values if a setting is invalid.
    """
    return Task(str(name), **settings)


def scene(path, **settings):
    """Opens a scene file, for example "windy.toml". Arguments are those of `task`."""
    return Task(str(path), **settings)


def Mlp(task, widths=(100, 100), seed=0, **settings):
    """A multilayer perceptron with hidden layers of these widths and random parameters.

    Other keyword arguments are settings of the section `policy`, as in `activation="relu"`.
    """
    return Policy(task, seed=seed, kind="mlp", widths=widths, **settings)


def train(task, policy=None, *, callback=None, out=None, threads=None, **settings):
    """Trains a policy, and returns the `Run`. Without a policy, trains that of the task.

    `field`, `epochs`, `seed` and other settings outside of sections are keyword arguments, as in
    `task`. Others are settings of the section `training`, as in `learning_rate=3e-4`. `callback`
    receives the record of every epoch, a dict. With a folder `out`, saves the run there, as
    `physgrad train` does. `threads` is the number of threads; results do not depend on it. Does not
    change the argument `policy`: `run.policy` is the trained policy.

    After Ctrl-C, `KeyboardInterrupt` has the attribute `run`. `run.train()` continues. The
    exception `Divergence` has this attribute too.
    """
    run = Run(task, policy, threads=threads, **settings)
    if out is not None:
        run.save(out)
    try:
        run.train(callback)
    except (KeyboardInterrupt, Divergence) as error:
        error.run = run
        raise
    return run


def load(folder):
    """Opens the run in a folder, at its last checkpoint.

    `run.train(epochs=600)` continues the run up to 600 epochs in total.
    """
    return Run.load(folder)


def __getattr__(name):
    """Imports `torch`, `jax` and `gym` on first use: each requires its framework."""
    if name in ("torch", "jax", "gym"):
        import importlib

        return importlib.import_module(f"{__name__}.{name}")
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
