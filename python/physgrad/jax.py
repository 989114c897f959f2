"""Differentiable functions of a task for JAX.

Each function of this module takes a task and returns a function of arrays::

    step = pg.jax.step(task)
    x = step(x, u, t=t)            # (..., n), (..., m) -> (..., n)

The functions work under ``jit``, ``vmap``, ``grad``, ``vjp`` and ``lax.scan``, on the CPU. XLA calls
the physics itself, without Python. Arrays are all float32, or all float64 after
``jax.config.update("jax_enable_x64", True)``. Leading dimensions are batch dimensions and broadcast.
``p`` are the parameters of the rows, shape (..., np), and ``t`` is the step number, an int or an
integer array, which broadcasts to the batch dimensions as NumPy arrays do: t of shape (4,) has one
number for each column of a batch (2, 4), and t of shape (2, 1) one for each row. Rows with equal
numbers in a row are one call of the physics. Gradients are the exact derivatives of the task (reverse
mode, once differentiable). Functions of equal tasks are equal, and can be pickled. Errors:
``ValueError`` for a shape, ``TypeError`` for a dtype.
"""

from __future__ import annotations

import ctypes
from functools import partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from . import _core
from ._functions import RolloutFunction, TaskFunction, lead, missing_parameters, refuse_noise

__all__ = ["observe", "rollout", "running_cost", "step", "terminal_cost", "transition"]

if not hasattr(jax, "ffi"):
    raise ImportError(f"physgrad.jax needs JAX 0.5 or newer, not {jax.__version__}")
jax.ffi.register_ffi_target("physgrad", jax.ffi.pycapsule(ctypes.c_void_p(_core.xla_handler)), platform="cpu")

_CODES = {name: np.int64(code) for code, name in enumerate(_core.operation_names())}
# Outputs of a call that its derivative needs, instead of computing them again.
_SAVED = {"transition": 1, "states": 1}


class _Call(NamedTuple):
    """An operation of the task of this handle. Shapes of outputs follow the leading dimensions."""

    operation: str
    handle: int
    outputs: tuple[tuple[int, ...], ...]


def _ffi(of: _Call, operation: str, shapes: list[tuple[int, ...]], t: jax.Array, arrays: Any) -> list[jax.Array]:
    outputs = [jax.ShapeDtypeStruct(shape, arrays[0].dtype) for shape in shapes]
    call = jax.ffi.ffi_call("physgrad", outputs, vmap_method="broadcast_all")
    return list(call(t, *arrays, handle=np.int64(of.handle), operation=_CODES[operation]))


@partial(jax.custom_vjp, nondiff_argnums=(0,))
def _call(of: _Call, arrays: tuple, t: jax.Array) -> tuple:
    batch = arrays[-1].shape[:-1]
    return tuple(_ffi(of, of.operation, [batch + shape for shape in of.outputs], t, arrays))


def _forward(of: _Call, arrays: tuple, t: jax.Array) -> tuple:
    outputs = _call(of, arrays, t)
    return outputs, (arrays, outputs[: _SAVED.get(of.operation, 0)], t)


def _backward(of: _Call, saved: tuple, bars: tuple) -> tuple:
    arrays, outputs, t = saved
    shapes = [array.shape for array in arrays]
    return tuple(_ffi(of, f"{of.operation}_vjp", shapes, t, (*arrays, *outputs, *bars))), None


_call.defvjp(_forward, _backward)


class _Rows(TaskFunction):
    """A function of rows: inputs, then parameters, and a step number."""

    def _rows(self, inputs: dict[str, Any], p: Any, t: Any) -> tuple:
        task, name = self.task, self.name
        sizes = {"x": task.state_dim, "u": task.control_dim, "next": task.state_dim, "p": task.param_dim}
        inputs = {label: jnp.asarray(array) for label, array in inputs.items()}
        if p is None:
            if task.param_dim:
                raise missing_parameters(name, task)
            p = jnp.zeros((0,), inputs["x"].dtype)
        inputs["p"] = jnp.asarray(p)
        _check(name, {label: (sizes[label],) for label in inputs}, inputs)
        batch, t = lead(name, {label: array.shape for label, array in inputs.items()}), _steps(name, t)
        # All dimensions, so that those which `vmap` inserts in front stay aligned with those of the arrays.
        aligned = (1,) * (len(batch) - t.ndim) + t.shape
        if len(aligned) > len(batch) or any(size not in (1, whole) for size, whole in zip(aligned, batch)):
            raise ValueError(f"`{name}`: `t` has shape {t.shape}, which does not broadcast to the batch dimensions {batch}")
        arrays = tuple(jnp.broadcast_to(array, (*batch, array.shape[-1])) for array in inputs.values())
        widths = {"next": (task.state_dim,), "y": (task.observation_dim,), "cost": ()}
        of = _Call(name, self.handle, tuple(widths[output] for output in self.outputs))
        return _call(of, arrays, t.reshape(aligned))


class step(_Rows):
    """``step(task)(x, u, p=None, t=0)``, the next states.

    Shapes: x (..., n), u (..., m), p (..., np); result (..., n).
    """

    name, outputs = "step", ("next",)

    def __call__(self, x: Any, u: Any, p: Any = None, t: Any = 0) -> jax.Array:
        """Returns the next states, (..., n)."""
        return self._rows({"x": x, "u": u}, p, t)[0]


class observe(_Rows):
    """``observe(task)(x, p=None, t=0)``, the observations of a policy.

    Shapes: x (..., n), p (..., np); result (..., observation_dim).
    """

    name, outputs = "observe", ("y",)

    def __call__(self, x: Any, p: Any = None, t: Any = 0) -> jax.Array:
        """Returns the observations, (..., observation_dim)."""
        return self._rows({"x": x}, p, t)[0]


class running_cost(_Rows):
    """``running_cost(task)(x, u, next, p=None, t=0)``, the costs of a step.

    Shapes: x and next (..., n), u (..., m), p (..., np); result (...).
    """

    name, outputs = "running_cost", ("cost",)

    def __call__(self, x: Any, u: Any, next: Any, p: Any = None, t: Any = 0) -> jax.Array:
        """Returns the costs, (...)."""
        return self._rows({"x": x, "u": u, "next": next}, p, t)[0]


class terminal_cost(_Rows):
    """``terminal_cost(task)(x, p=None)``, the costs of last states.

    Shapes: x (..., n), p (..., np); result (...).
    """

    name, outputs = "terminal_cost", ("cost",)

    def __call__(self, x: Any, p: Any = None) -> jax.Array:
        """Returns the costs, (...)."""
        return self._rows({"x": x}, p, 0)[0]


class transition(_Rows):
    """``transition(task)(x, u, p=None, t=0)``: next states, their observations and the costs of the step.

    One call in place of those of ``step``, ``observe`` and ``running_cost``. The observation is that of
    step t + 1, with the parameters of this step. Shapes: x (..., n), u (..., m), p (..., np); results
    (..., n), (..., observation_dim) and (...).
    """

    name, outputs = "transition", ("next", "y", "cost")

    def __init__(self, task: Any) -> None:
        refuse_noise(task)
        super().__init__(task)

    def __call__(self, x: Any, u: Any, p: Any = None, t: Any = 0) -> tuple[jax.Array, jax.Array, jax.Array]:
        """Returns ``(next, y, cost)``."""
        return self._rows({"x": x, "u": u}, p, t)


class rollout(RolloutFunction):
    __doc__ = RolloutFunction.__doc__

    def __call__(self, first: Any, starts: Any) -> Any:
        """Returns the states, or states and controls of a policy."""
        task = self.task
        n, m, label = task.state_dim, task.control_dim, "u" if self.policy is None else "theta"
        arrays = {label: jnp.asarray(first), "starts": jnp.asarray(starts)}
        shape = (..., m) if self.policy is None else (self.parameters,)
        _check("rollout", {label: shape, "starts": (task.start_dim,)}, arrays)
        first, starts = arrays.values()
        if self.policy is not None:
            steps = task.horizon
            of = _Call("rollout", self.handle, ((steps + 1, n), (steps, m)))
            return _call(of, (first, starts), jnp.asarray(0))
        if first.shape[:-2] != starts.shape[:-1]:
            batch = lead("rollout", {label: first.shape[:-1], "starts": starts.shape})
            first = jnp.broadcast_to(first, (*batch, *first.shape[-2:]))
            starts = jnp.broadcast_to(starts, (*batch, starts.shape[-1]))
        of = _Call("states", self.handle, ((first.shape[-2] + 1, n),))
        return _call(of, (first, starts), jnp.asarray(0))[0]


def _check(name: str, shapes: dict[str, tuple], arrays: dict[str, jax.Array]) -> None:
    first = next(iter(arrays.values())).dtype
    for label, array in arrays.items():
        if array.dtype not in (jnp.float32, jnp.float64) or array.dtype != first:
            dtypes = ", ".join(f"`{label}` {array.dtype}" for label, array in arrays.items())
            raise TypeError(f"`{name}`: dtypes are {dtypes}. Use float32, or float64, for all of them")
        size, least = shapes[label][-1], len(shapes[label])
        if array.ndim < least or array.shape[-1] != size:
            dims = "its last dimension must be" if least == 1 else "its last dimensions must be steps and"
            raise ValueError(f"`{name}`: `{label}` has shape {array.shape}, but {dims} {size}")


def _steps(name: str, t: Any) -> jax.Array:
    t = jnp.asarray(t)
    if not jnp.issubdtype(t.dtype, jnp.integer) or t.dtype in (jnp.uint32, jnp.uint64):
        raise TypeError(f"`{name}`: `t` has the dtype {t.dtype}. Use an int or an integer array with a sign")
    return t if t.dtype in (jnp.int32, jnp.int64) else t.astype(jnp.int32)
