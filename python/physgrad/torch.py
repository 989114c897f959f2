"""Differentiable functions of a task for PyTorch.

Each function of this module takes a task and returns a function of tensors::

    step = pg.torch.step(task)
    x = step(x, u, t=t)            # (..., n), (..., m) -> (..., n)

Tensors are on the CPU, all float32 or all float64. Leading dimensions are batch dimensions and
broadcast. ``p`` are the parameters of the rows, shape (..., np), and ``t`` is the step number, an
int that all rows share. Derivatives are the exact ones of the task, of first order, in reverse mode
(``torch.autograd``, ``torch.func.grad``) and in forward mode (``torch.func.jvp``, ``jacfwd``,
``forward_ad``). Errors: ``ValueError`` for a shape, ``TypeError`` for a dtype or a device,
``RuntimeError`` for second derivatives of the physics.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from typing import Any, NamedTuple

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
    operators, handle = _OPERATORS[function.name], _handle(task)
    dims = function.dims(task) | {"p": task.param_dim}

    def call(*tensors: Tensor, p: Tensor | None = None, t: int = 0) -> Tensor:
        if p is not None:
            tensors = (*tensors, p)
        _check(function.name, dims, tensors)
        shape = lead(function.name, {label: tensor.shape for label, tensor in zip(dims, tensors)})
        tensors = [tensor.expand(*shape, tensor.shape[-1]) for tensor in tensors]
        count = len(function.inputs)
        # `torch.compile` traces operators, but not functions with a rule of forward mode.
        call = operators.call if torch.compiler.is_compiling() else operators.differentiable
        return call(*tensors[:count], tensors[count] if p is not None else None, t, handle)

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


class _Operators(NamedTuple):
    """Operators of one function: ``call`` for graphs, ``differentiable`` for all other calls."""

    call: Callable[..., Tensor]
    differentiable: Callable[..., Tensor]


def _arrays(tensors: tuple[Tensor | None, ...]) -> list:
    return [None if tensor is None else tensor.detach().numpy() for tensor in tensors]


def _refuse_second(function: Function, tangents: Iterable[Any]) -> None:
    if any(tangents):
        raise RuntimeError(
            f"`{function.name}` has no second derivatives: the physics is differentiable once, in reverse or forward mode. "
            "`torch.autograd.functional.jvp` differentiates twice for a first derivative; use `torch.func.jvp` instead"
        )


def _refuse_tangents(function: Function, call: Any) -> None:
    """Makes an operator raise for tensors with a tangent, which reach it from a graph only.

    Operators have no rule of forward mode. Without the error, exported and traced graphs would lose
    the tangents. PyTorch has no public function for this.
    """
    autograd = torch._library.autograd.make_autograd_impl(call._opoverload, call)

    def checked(keyset: Any, *arguments: Any, **named: Any) -> Tensor:
        level = torch.autograd.forward_ad._current_level
        tensors = (argument for argument in (*arguments, *named.values()) if isinstance(argument, Tensor))
        if level >= 0 and any(torch._unpack_dual(tensor, level=level).tangent is not None for tensor in tensors):
            raise RuntimeError(
                f"`{function.name}`: exported and traced graphs do not support forward mode through the physics. Call "
                "`torch.func.jvp` and `forward_ad` on the function itself"
            )
        return autograd(keyset, *arguments, **named)

    call._lib.impl(call._name, checked, "Autograd", with_keyset=True, allow_override=True)


def _operators(function: Function) -> _Operators:
    """Registers the operators ``physgrad::NAME``, ``physgrad::NAME_vjp`` and ``physgrad::NAME_jvp``.

    Their arguments are tensors, then the step number and the index of the task. The tensors of a
    call are its inputs and parameters. Those of a vjp have the cotangent of the output in addition,
    and those of a jvp the tangents.
    """
    count = len(function.inputs) + 1
    inputs = ", ".join(f"Tensor {name}" for name in function.inputs) + ", Tensor? p"
    tangents = ", ".join(f"Tensor? {name}_tan" for name in (*function.inputs, "p"))
    outputs = ", ".join(["Tensor"] * count)

    def forward(*arguments: Any) -> Tensor:
        *tensors, t, handle = arguments
        *arrays, p = _arrays(tensors)
        return torch.from_numpy(function.call(_TASKS[handle], arrays, p, t))

    def backward(*arguments: Any) -> tuple[Tensor, ...]:
        *tensors, output_bar, t, handle = arguments
        *arrays, p, bar = _arrays((*tensors, output_bar))
        return tuple(map(torch.from_numpy, function.vjp(_TASKS[handle], arrays, p, t, bar)))

    def push(*arguments: Any) -> Tensor:
        *tensors, t, handle = arguments
        arrays = _arrays(tensors)
        p = arrays[count - 1]
        return torch.from_numpy(function.jvp(_TASKS[handle], arrays[: count - 1], p, t, arrays[count:]))

    def operator(suffix: str, work: Callable, tensors: str, outputs: str) -> Any:
        schema = f"({tensors}, SymInt t, int task) -> {outputs}"
        return torch.library.custom_op(f"physgrad::{function.name}{suffix}", work, mutates_args=(), schema=schema)

    call = operator("", forward, inputs, "Tensor")
    vjp = operator("_vjp", backward, f"{inputs}, Tensor output_bar", f"({outputs})")
    jvp = operator("_jvp", push, f"{inputs}, {tangents}", "Tensor")

    def output_like(*arguments: Any) -> Tensor:
        x, task = arguments[0], _TASKS[arguments[-1]]
        return x.new_empty((*x.shape[:-1], *function.output_shape(task)))

    def inputs_like(*arguments: Any) -> tuple[Tensor, ...]:
        x, task = arguments[0], _TASKS[arguments[-1]]
        return tuple(x.new_empty(shape) for shape in function.shapes(task, tuple(x.shape[:-1])))

    def traced(*arguments: Any) -> Tensor:
        # A graph has no forward mode: without this error, it would lose the tangents.
        if torch.autograd.forward_ad._current_level >= 0 and torch._guards.TracingContext.try_get() is not None:
            raise RuntimeError(
                f"`{function.name}`: `torch.compile` does not support forward mode through the physics. Call "
                "`torch.func.jvp` and `forward_ad` outside of the compiled function"
            )
        return output_like(*arguments)

    call.register_fake(traced)
    vjp.register_fake(inputs_like)
    jvp.register_fake(output_like)

    def save(ctx: Any, inputs: tuple, output: Any) -> None:
        *tensors, ctx.t, ctx.task = inputs
        ctx.save_for_backward(*tensors)
        ctx.save_for_forward(*tensors)

    def bars(ctx: Any, output_bar: Tensor, vjp: Callable) -> tuple:
        *tensors, p = ctx.saved_tensors[:count]
        *bars, p_bar = vjp(*tensors, p, output_bar, ctx.t, ctx.task)
        return (*bars, None if p is None else p_bar)

    class Call(torch.autograd.Function):
        generate_vmap_rule = True
        forward = staticmethod(lambda *arguments: call(*arguments))
        setup_context = staticmethod(save)

        @staticmethod
        def backward(ctx: Any, output_bar: Tensor) -> tuple:
            return (*bars(ctx, output_bar, Vjp.apply), None, None)

        @staticmethod
        def jvp(ctx: Any, *tangents: Any) -> Tensor:
            return Jvp.apply(*ctx.saved_tensors, *tangents[:count], ctx.t, ctx.task)

    class Vjp(torch.autograd.Function):
        """Linear in the cotangent of the output, by which alone it is differentiable."""

        generate_vmap_rule = True
        forward = staticmethod(lambda *arguments: vjp(*arguments))
        setup_context = staticmethod(save)

        @staticmethod
        def backward(ctx: Any, *bars: Any) -> tuple:
            _refuse_second(function, ctx.needs_input_grad[:count])
            output = Jvp.apply(*ctx.saved_tensors[:count], *bars, ctx.t, ctx.task)
            return (*[None] * count, output, None, None)

        @staticmethod
        def jvp(ctx: Any, *tangents: Any) -> tuple:
            _refuse_second(function, (tangent is not None for tangent in tangents[:count]))
            return Vjp.apply(*ctx.saved_tensors[:count], tangents[count], ctx.t, ctx.task)

    class Jvp(torch.autograd.Function):
        """Linear in the tangents of the inputs, by which alone it is differentiable."""

        generate_vmap_rule = True
        forward = staticmethod(lambda *arguments: jvp(*arguments))
        setup_context = staticmethod(save)

        @staticmethod
        def backward(ctx: Any, output_bar: Tensor) -> tuple:
            _refuse_second(function, ctx.needs_input_grad[:count])
            return (*[None] * count, *bars(ctx, output_bar, Vjp.apply), None, None)

        @staticmethod
        def jvp(ctx: Any, *tangents: Any) -> Tensor:
            _refuse_second(function, (tangent is not None for tangent in tangents[:count]))
            return Jvp.apply(*ctx.saved_tensors[:count], *tangents[count:-2], ctx.t, ctx.task)

    # The rule of graphs.
    def save_in_graph(ctx: Any, inputs: tuple, output: Tensor) -> None:
        *tensors, ctx.t, ctx.task = inputs
        ctx.save_for_backward(*tensors)

    call.register_autograd(
        lambda ctx, output_bar: (*bars(ctx, output_bar, vjp), None, None), setup_context=save_in_graph
    )

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

    _refuse_tangents(function, call)
    call.register_vmap(batched(call, 1))
    vjp.register_vmap(batched(vjp, count))
    jvp.register_vmap(batched(jvp, 1))
    return _Operators(call, Call.apply)


_OPERATORS = {function.name: _operators(function) for function in (STEP, OBSERVE, RUNNING_COST, TERMINAL_COST)}
