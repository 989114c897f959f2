"""Differentiable physics: gradients of long simulations, and neural controllers trained with them.

`task` opens a preset or a scene file, `bodies` a robot from a model file, and `system` a system that is
written as functions of NumPy.
`presets` lists the presets. Methods of a `Task` evaluate steps, observations and costs on arrays,
with their derivatives. `train` trains a policy. `rollout` and `losses` evaluate policies and functions,
and `gradients` evaluates policies. `optimize` minimizes the loss over the controls from one initial
state. `identify` fits physical numbers to measurements, `check` compares derivatives with dual
numbers, and `accuracy` measures errors and costs of integrators.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING, Any

from . import _notebook
from ._core import (
    Divergence,
    Policy,
    Run,
    Task,
    __version__ as __version__,
    check,
    gradients,
    presets,
)
from ._accuracy import Accuracy, accuracy
from ._distributions import choice, log_uniform, noise, normal, table, trained, uniform
from ._fit import Fit, identify
from ._import_jax import from_jax
from ._model import Model, model as _model_of
from ._plan import Plan, optimize
from ._progress import Progress, is_watched
from ._rollouts import losses, rollout
from .trace import detach, system, with_arguments_of

if TYPE_CHECKING:
    from typing_extensions import Unpack

    from . import gym as gym
    from . import jax as jax
    from . import torch as torch
    from ._types import Path, RunSettings

__all__ = [
    "Accuracy",
    "Divergence",
    "Fit",
    "Mlp",
    "Model",
    "Plan",
    "Policy",
    "Run",
    "Task",
    "accuracy",
    "bodies",
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


# The frameworks of these modules need not be installed, so `__getattr__` imports them on first use.
_MODULES = ("gym", "jax", "torch")

for _kind, _shown in ((Task, _notebook.task), (Policy, _notebook.policy), (Run, _notebook.run)):
    setattr(_kind, "_repr_html_", _shown)
setattr(Task, "model", property(_model_of))


@with_arguments_of(Task)
def task(name: Path, **settings: Any) -> Task:
    """Opens a preset by name, for example "cart_pole", or a scene file by its path.

    The arguments `horizon`, `precision`, `field`, `epochs`, `seed`, `tags` and `log` are settings
    outside of sections. `effects`, `actuator`, `sensor`, `integrator`, `loss`, `policy`, `training` and
    `system` accept a dict of the settings of the section. `vary` and `fit` are dicts of numbers that are
    drawn or trained, by key, as in `vary={"cart_mass": pg.uniform(0.8, 1.2)}`. `settings` accepts a dict
    of dotted keys, as in `settings={"system.poles": 4}`. Other keyword arguments are settings of the
    section `system`, as in `poles=4`.

    A dict changes only its keys. `{}` adds an effect or a part of the actuator or the sensor with its
    default values, and None removes one, as in `effects={"bumpers": None}` or
    `**{"effects.bumpers": None}`. A section that is an empty dict is refused.

    Raises `ValueError` with the key and its allowed values if a setting is invalid, and
    `FileNotFoundError` if there is no such file.
    """
    return Task(_text("name", name), **settings)


@with_arguments_of(Task)
def scene(name: Path, **settings: Any) -> Task:
    """Opens a scene file, for example "windy.toml". Arguments are those of `task`."""
    return Task(_text("name", name), **settings)


@with_arguments_of(Task)
def bodies(model: Path, **settings: Any) -> Task:
    """A robot from an MJCF or URDF file, or one that comes with physgrad, as in `pg.bodies("ant")`.

    The state is `[qpos, qvel]`, with the names in `task.state_names`. Keyword arguments are those of
    `task`. Settings of the section `system` are, among others:

    - `frames`: steps of the model per control, and `method`: "file", "euler", "implicit_fast", "rk4".
    - `contacts`: "file", "smooth" for trainings, or "none".
    - `spread`: half widths of the noise on initial positions and velocities; `start`: initial values by
      name, as in `start={"qpos": {"rootz": 1.2}}`; `pose`: a named pose of the file.
    - `observe`: expressions that the policy observes, or `hidden`: states that it does not observe.
    - `body`, `joint`, `motor`, `shape`: numbers of the model, as in
      `body={"torso": {"mass": pg.uniform(3, 4)}}`.

    Costs are expressions, as in `loss={"running": "qvel.hinge^2 - next.body.torso.z"}`. The scene keeps the
    text of the file.

    Raises `ValueError` with file, line and element if the file has something that is not simulated.
    """
    return Task._of("bodies", model=_text("model", model), **settings)


def _text(argument: str, path: Path) -> str:
    """A name or a path as text."""
    if not isinstance(path, (str, os.PathLike)):
        raise TypeError(f"`{argument}` is of type {type(path).__name__}; allowed: text or a path")
    return str(path)


def Mlp(task: Task, widths: Sequence[int] = (100, 100), seed: int = 0, **settings: Any) -> Policy:
    """A multilayer perceptron with hidden layers of these widths and random parameters.

    Other keyword arguments are settings of the section `policy`, as in `activation="relu"`.
    """
    return Policy(task, seed=seed, kind="mlp", widths=widths, **settings)


def train(
    task: Task,
    policy: Policy | None = None,
    *,
    callback: Callable[[dict[str, float]], object] | None = None,
    out: Path | None = None,
    threads: int | None = None,
    progress: bool | None = None,
    **settings: Unpack[RunSettings],
) -> Run:
    """Trains a policy, and returns the `Run`. Without a policy, trains that of the task.

    `field`, `epochs`, `seed` and other settings outside of sections are keyword arguments, as in
    `task`. Others are settings of the section `training`, as in `learning_rate=3e-4`. `callback`
    receives the record of every epoch, a dict, and stops the training by returning False; `run.train()`
    continues. With a folder `out`, saves the run there, as `physgrad train` does. A terminal or a
    notebook shows the progress, unless `progress` is False; True shows it anywhere. `threads` is the
    number of threads; results do not depend on it. Does not change the argument `policy`: `run.policy`
    is the trained policy.

    After Ctrl-C, `KeyboardInterrupt` has the attribute `run`. `run.train()` continues. The
    exception `Divergence` has this attribute too.
    """
    run = Run(task, policy, threads=threads, **settings)
    if out is not None:
        run.save(_text("out", out))
    shown = None
    if is_watched() if progress is None else progress:
        shown = Progress(run.task.settings["epochs"], callback)
    try:
        run.train(callback if shown is None else shown)
    except (KeyboardInterrupt, Divergence) as error:
        error.run = run  # type: ignore[union-attr]
        raise
    finally:
        if shown is not None:
            shown.close()
    return run


def load(folder: Path) -> Run:
    """Opens the run in a folder, at its last checkpoint.

    `run.train(epochs=600)` continues the run up to 600 epochs in total. Raises `FileNotFoundError` if
    there is no run in the folder.
    """
    return Run.load(_text("folder", folder))


# A checker of types takes a module with `__getattr__` for one with any name.
if not TYPE_CHECKING:

    def __getattr__(name: str) -> Any:
        """Imports `torch`, `jax` and `gym` on first use: each requires its framework."""
        if name in _MODULES:
            import importlib

            return importlib.import_module(f"{__name__}.{name}")
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")


def __dir__() -> list[str]:
    """The public names, for completion."""
    return [*__all__, *_MODULES, "__version__"]
