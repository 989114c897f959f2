"""Differentiable physics: gradients of long simulations, and neural controllers trained with them.

`task` opens a built-in task or a scene file. Its methods evaluate steps, observations and costs on
arrays, with their derivatives.
"""

from ._core import Divergence, Task, __version__

__all__ = ["Divergence", "Task", "scene", "task"]


def task(name, **settings):
    """Opens a preset by name, for example "cart_pole", or a scene file by its path.

    Keyword arguments are settings of the section `system`, as in `poles=4`. The arguments
    `horizon`, `precision`, `field`, `epochs` and `seed` are settings outside of sections. `effects`,
    `actuator`, `integrator`, `loss`, `policy`, `training` and `system` accept a dict of their
    settings. `settings` accepts a dict of dotted keys, as in `settings={"system.poles": 4}`.

    Raises `ValueError` with the key and its allowed values if a setting is invalid.
    """
    return Task(name, **settings)


def scene(path, **settings):
    """Opens a scene file, for example "windy.toml". Arguments are those of `task`."""
    return Task(str(path), **settings)


def __getattr__(name):
    """Imports `torch`, `jax` and `gym` on first use: each requires its framework."""
    if name in ("torch", "jax", "gym"):
        import importlib

        return importlib.import_module(f"{__name__}.{name}")
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
