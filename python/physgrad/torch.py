"""Differentiable functions of a task for PyTorch.

Each function of this module takes a task and returns a function of tensors::

    step = pg.torch.step(task)
    x = step(x, u, t=t)            # (..., n), (..., m) -> (..., n)

Tensors are on the CPU, all float32 or all float64. Leading dimensions are batch dimensions and
broadcast. ``p`` are the parameters of the rows, shape (..., np), and ``t`` is the step number, an
int that all rows share. Gradients are the exact derivatives of the task (reverse mode, once
differentiable). Errors: ``ValueError`` for a shape, ``TypeError`` for a dtype or a device.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import torch
from torch import Tensor

from ._functions import OBSERVE, RUNNING_COST, STEP, TERMINAL_COST, Function, lead

__all__ = ["observe", "running_cost", "step", "terminal_cost"]

# Operators take integers, not objects: the index of the task in this list. Tasks stay in memory,
# because graphs that contain their index may outlive every other reference.
_TASKS: list[Any] = []


def step(task: Any) -> Callable[..., Tensor]:
    """Returns ``step(x, u, p=None, t=0)``, the next states.

    Shapes: x (..., n), u (..., m), p (..., np); result (..., n).
    """
    return _function(STEP, task)


def observe(task: Any) -> Callable[..., Tensor]:
    """Returns ``observe(x, p=None, t=0)``, the observations of a policy.

    Shapes: x (..., n), p (..., np); result (..., observation_dim).
    """
    return _function(OBSERVE, task)


def running_cost(task: Any) -> Callable[..., Tensor]:
    """Returns ``running_cost(x, u, next, p=None, t=0)``, the costs of a step.

    Shapes: x and next (..., n), u (..., m), p (..., np); result (...).
    """
    return _function(RUNNING_COST, task)


def terminal_cost(task: Any) -> Callable[..., Tensor]:
    """Returns ``terminal_cost(x, p=None)``, the costs of last states.

    Shapes: x (..., n), p (..., np); result (...).
    """
    return _function(TERMINAL_COST, task)


def _function(function: Function, task: Any) -> Callable[..., Tensor]:
    operator, handle = _OPERATORS[function.name], _handle(task)
    dims = function.dims(task) | {"p": task.param_dim}

    def call(*tensors: Tensor, p: Tensor | None = None, t: int = 0) -> Tensor:
        if p is not None:
            tensors = (*tensors, p)
        _check(function.name, dims, tensors)
        shape = lead(function.name, {label: tensor.shape for label, tensor in zip(dims, tensors)})
        tensors = [tensor.expand(*shape, tensor.shape[-1]) for tensor in tensors]
        count = len(function.inputs)
        return operator(*tensors[:count], tensors[count] if p is not None else None, t, handle)

    # One signature per function, so that arguments may be positional or named.
    if function is STEP:
        return lambda x, u, p=None, t=0: call(x, u, p=p, t=t)
    if function is OBSERVE:
        return lambda x, p=None, t=0: call(x, p=p, t=t)
    if function is RUNNING_COST:
        return lambda x, u, next, p=None, t=0: call(x, u, next, p=p, t=t)
    return lambda x, p=None: call(x, p=p)


def _check(name: str, dims: dict[str, int], tensors: tuple[Tensor, ...]) -> None:
    first = tensors[0]
    for (label, size), tensor in zip(dims.items(), tensors):
        if tensor.device.type != "cpu":
            raise TypeError(
                f"`{name}`: `{label}` is on {tensor.device}, but the physics runs on the CPU. Use `{label}.cpu()`"
            )
        if tensor.dtype not in (torch.float32, torch.float64) or tensor.dtype != first.dtype:
            dtypes = ", ".join(f"`{label}` {tensor.dtype}" for label, tensor in zip(dims, tensors))
            raise TypeError(f"`{name}`: dtypes are {dtypes}. Use float32, or float64, for all of them")
        if tensor.dim() == 0 or tensor.shape[-1] != size:
            raise ValueError(f"`{name}`: `{label}` has shape {tuple(tensor.shape)}, but its last dimension must be {size}")


def _handle(task: Any) -> int:
    for handle, known in enumerate(_TASKS):
        if known is task:
            return handle
    _TASKS.append(task)
    return len(_TASKS) - 1


def _arrays(tensors: tuple[Tensor | None, ...]) -> list:
    return [None if tensor is None else tensor.detach().numpy() for tensor in tensors]


def _operator(function: Function) -> Any:
    """Registers the operators ``physgrad::NAME`` and ``physgrad::NAME_vjp``. Returns the first."""
    count = len(function.inputs)
    inputs = ", ".join(f"Tensor {name}" for name in function.inputs)
    outputs = ", ".join(["Tensor"] * (count + 1))

    def forward(*arguments: Any) -> Tensor:
        *tensors, t, handle = arguments
        *arrays, p = _arrays(tensors)
        return torch.from_numpy(function.call(_TASKS[handle], arrays, p, t))

    def backward(*arguments: Any) -> tuple[Tensor, ...]:
        *tensors, output_bar, t, handle = arguments
        *arrays, p, bar = _arrays((*tensors, output_bar))
        return tuple(map(torch.from_numpy, function.vjp(_TASKS[handle], arrays, p, t, bar)))

    call = torch.library.custom_op(
        f"physgrad::{function.name}", forward, mutates_args=(), schema=f"({inputs}, Tensor? p, SymInt t, int task) -> Tensor"
    )
    vjp = torch.library.custom_op(
        f"physgrad::{function.name}_vjp",
        backward,
        mutates_args=(),
        schema=f"({inputs}, Tensor? p, Tensor output_bar, SymInt t, int task) -> ({outputs})",
    )

    @call.register_fake
    def _(*arguments: Any) -> Tensor:
        x, task = arguments[0], _TASKS[arguments[-1]]
        return x.new_empty((*x.shape[:-1], *function.output_shape(task)))

    @vjp.register_fake
    def _(*arguments: Any) -> tuple[Tensor, ...]:
        x, task = arguments[0], _TASKS[arguments[-1]]
        return tuple(x.new_empty(shape) for shape in function.shapes(task, tuple(x.shape[:-1])))

    def setup_context(ctx: Any, inputs: tuple, output: Tensor) -> None:
        *tensors, ctx.t, ctx.task = inputs
        ctx.save_for_backward(*tensors)

    def differentiate(ctx: Any, output_bar: Tensor) -> tuple:
        *tensors, p = ctx.saved_tensors
        *bars, p_bar = vjp(*tensors, p, output_bar, ctx.t, ctx.task)
        return (*bars, None if p is None else p_bar, None, None)

    call.register_autograd(differentiate, setup_context=setup_context)

    def batched(operator: Any, outputs: int) -> Callable:
        """Returns the rule by which ``torch.vmap`` runs all samples as one batch."""

        def rule(info: Any, in_dims: tuple, *arguments: Any) -> tuple:
            def leading(tensor: Any, dim: int | None) -> Any:
                if not isinstance(tensor, Tensor):
                    return tensor
                return tensor.expand(info.batch_size, *tensor.shape) if dim is None else tensor.movedim(dim, 0)

            result = operator(*map(leading, arguments, in_dims))
            return result, 0 if outputs == 1 else (0,) * outputs

        return rule

    call.register_vmap(batched(call, 1))
    vjp.register_vmap(batched(vjp, count + 1))
    return call


_OPERATORS = {function.name: _operator(function) for function in (STEP, OBSERVE, RUNNING_COST, TERMINAL_COST)}
