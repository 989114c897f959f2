"""Differentiable functions of a task for JAX.

Each function of this module takes a task and returns a function of arrays::

    step = pg.jax.step(task)
    x = step(x, u, t=t)            # (..., n), (..., m) -> (..., n)

The functions work under ``jit``, ``vmap``, ``grad``, ``vjp`` and ``lax.scan``, on the CPU. ``vmap``
calls the physics once for all samples with equal ``t``. Arrays are all float32, or all float64
after ``jax.config.update("jax_enable_x64", True)``. The context manager ``jax.enable_x64`` has no
effect in other threads, which may call the physics. Leading dimensions are batch dimensions and
broadcast. ``p`` are the parameters of the rows, shape (..., np), and ``t`` is the step number, an
int or an integer array, which broadcasts to the batch dimensions as NumPy arrays do: t of shape (4,)
has one number for each column of a batch (2, 4), and t of shape (2, 1) one for each row. Gradients
are the exact derivatives of the task (reverse mode, once differentiable). Errors: ``ValueError``
for a shape, ``TypeError`` for a dtype.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from ._functions import OBSERVE, RUNNING_COST, STEP, TERMINAL_COST, Function, lead

__all__ = ["observe", "running_cost", "step", "terminal_cost"]


def step(task: Any) -> Callable[..., jax.Array]:
    """Returns ``step(x, u, p=None, t=0)``, the next states.

    Shapes: x (..., n), u (..., m), p (..., np); result (..., n).
    """
    call = _function(STEP, task)
    return lambda x, u, p=None, t=0: call((x, u), p, t)


def observe(task: Any) -> Callable[..., jax.Array]:
    """Returns ``observe(x, p=None, t=0)``, the observations of a policy.

    Shapes: x (..., n), p (..., np); result (..., observation_dim).
    """
    call = _function(OBSERVE, task)
    return lambda x, p=None, t=0: call((x,), p, t)


def running_cost(task: Any) -> Callable[..., jax.Array]:
    """Returns ``running_cost(x, u, next, p=None, t=0)``, the costs of a step.

    Shapes: x and next (..., n), u (..., m), p (..., np); result (...).
    """
    call = _function(RUNNING_COST, task)
    return lambda x, u, next, p=None, t=0: call((x, u, next), p, t)


def terminal_cost(task: Any) -> Callable[..., jax.Array]:
    """Returns ``terminal_cost(x, p=None)``, the costs of last states.

    Shapes: x (..., n), p (..., np); result (...).
    """
    call = _function(TERMINAL_COST, task)
    return lambda x, p=None: call((x,), p, 0)


def _function(function: Function, task: Any) -> Callable[..., jax.Array]:
    count, components = len(function.inputs), function.output_shape(task)

    def host_call(dtype: np.dtype, t: Any, *arrays: Any) -> np.ndarray:
        t, shape, arrays = _host(dtype, t, arrays, ())
        output = np.empty(shape + components, dtype)
        for now, rows in _steps(t, shape):
            inputs = [array[rows] for array in arrays]
            output[rows] = function.call(task, inputs[:count], *(inputs[count:] or [None]), now)
        return output

    def host_vjp(dtype: np.dtype, t: Any, output_bar: Any, *arrays: Any) -> list[np.ndarray]:
        output_bar = np.asarray(output_bar)
        t, shape, arrays = _host(dtype, t, arrays, output_bar.shape[: output_bar.ndim - len(components)])
        output_bar = np.broadcast_to(output_bar, shape + components)
        bars = [np.empty(size, dtype) for size in function.shapes(task, shape)]
        for now, rows in _steps(t, shape):
            inputs = [array[rows] for array in arrays]
            found = function.vjp(task, inputs[:count], *(inputs[count:] or [None]), now, output_bar[rows])
            for bar, part in zip(bars, found):
                bar[rows] = part
        return bars

    @jax.custom_vjp
    def call(arrays: tuple, t: Any) -> jax.Array:
        dtype = arrays[0].dtype
        output = jax.ShapeDtypeStruct(arrays[0].shape[:-1] + components, dtype)
        return jax.pure_callback(partial(host_call, dtype), output, t, *arrays, vmap_method="expand_dims")

    def forward(arrays: tuple, t: Any) -> tuple:
        return call(arrays, t), (arrays, t)

    def backward(saved: tuple, output_bar: jax.Array) -> tuple:
        arrays, t = saved
        dtype = arrays[0].dtype
        outputs = [jax.ShapeDtypeStruct(shape, dtype) for shape in function.shapes(task, arrays[0].shape[:-1])]
        bars = jax.pure_callback(partial(host_vjp, dtype), outputs, t, output_bar, *arrays, vmap_method="expand_dims")
        return tuple(bars[: len(arrays)]), None

    call.defvjp(forward, backward)
    dims = function.dims(task) | {"p": task.param_dim}

    def checked(inputs: tuple, p: Any, t: Any) -> jax.Array:
        arrays = [jnp.asarray(array) for array in (inputs if p is None else (*inputs, p))]
        _check(function.name, dims, arrays)
        shape, t = lead(function.name, {label: array.shape for label, array in zip(dims, arrays)}), jnp.asarray(t)
        if not jnp.issubdtype(t.dtype, jnp.integer):
            raise TypeError(f"`{function.name}`: `t` has the dtype {t.dtype}. Use an int or an integer array")
        # All dimensions, so that those which `vmap` inserts in front stay aligned with those of the arrays.
        aligned = (1,) * (len(shape) - t.ndim) + t.shape
        if len(aligned) > len(shape) or any(size not in (1, batch) for size, batch in zip(aligned, shape)):
            raise ValueError(
                f"`{function.name}`: `t` has shape {t.shape}, which does not broadcast to the batch dimensions {shape}"
            )
        t = t.reshape(aligned)
        return call(tuple(jnp.broadcast_to(array, (*shape, array.shape[-1])) for array in arrays), t)

    return checked


def _check(name: str, dims: dict[str, int], arrays: list[jax.Array]) -> None:
    first = arrays[0].dtype
    for (label, size), array in zip(dims.items(), arrays):
        if array.dtype not in (jnp.float32, jnp.float64) or array.dtype != first:
            dtypes = ", ".join(f"`{label}` {array.dtype}" for label, array in zip(dims, arrays))
            raise TypeError(f"`{name}`: dtypes are {dtypes}. Use float32, or float64, for all of them")
        if array.ndim == 0 or array.shape[-1] != size:
            raise ValueError(f"`{name}`: `{label}` has shape {array.shape}, but its last dimension must be {size}")


def _host(
    dtype: np.dtype, t: Any, arrays: tuple, output_lead: tuple[int, ...]
) -> tuple[np.ndarray, tuple[int, ...], list[np.ndarray]]:
    """Broadcasts arrays of a callback: ``vmap`` inserts dimensions of length 1.

    If ``vmap`` maps only ``t``, or only the cotangent, all ``arrays`` have length 1 in the mapped
    dimension. ``output_lead`` are the batch dimensions of the cotangent, ``()`` without one.
    """
    t, arrays = np.asarray(t), [np.asarray(array) for array in arrays]
    if any(array.dtype != dtype for array in arrays):
        # Callbacks run in threads of JAX, in which a context manager has no effect.
        raise TypeError(
            f"JAX rounded {dtype} to {arrays[0].dtype}. Call `jax.config.update('jax_enable_x64', True)` at the start"
        )
    shape = np.broadcast_shapes(t.shape, output_lead, *(array.shape[:-1] for array in arrays))
    return t, shape, [np.broadcast_to(array, (*shape, array.shape[-1])) for array in arrays]


def _steps(t: np.ndarray, lead: tuple[int, ...]) -> Any:
    """Step numbers, each with the index of its rows."""
    if t.size == 1:
        yield int(t.reshape(())), ...
        return
    t = np.broadcast_to(t, lead)
    for now in np.unique(t):
        yield int(now), t == now
