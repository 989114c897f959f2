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
from functools import partial
from typing import Any, NamedTuple

import numpy as np
import torch
from torch import Tensor

from . import _core
from ._functions import (
    OBSERVE,
    RUNNING_COST,
    STEP,
    TERMINAL_COST,
    Function,
    RolloutFunction,
    TaskFunction,
    lead,
    missing_parameters,
    refuse_noise,
)

__all__ = ["observe", "rollout", "running_cost", "step", "terminal_cost", "transition"]

# Operators take integers, not objects: the handle of a task. Tasks stay in memory, because graphs that
# contain their handle may outlive every other reference.
_TASKS: dict[int, Any] = {}


class _Rows(TaskFunction):
    """A function of rows: inputs, then parameters, and a step number."""

    function: Function

    def __init__(self, task: Any) -> None:
        super().__init__(task)
        _TASKS.setdefault(self.handle, task)

    def _call(self, *tensors: Tensor, p: Tensor | None, t: int = 0) -> Any:
        function, task = self.function, self.task
        dims = function.dims(task) | {"p": task.param_dim}
        if p is not None:
            tensors = (*tensors, p)
        _check(function.name, dims, tensors)
        if isinstance(t, Tensor) or isinstance(t, bool) or not hasattr(t, "__index__"):
            raise TypeError(f"`{function.name}`: `t` is of type {type(t).__name__}; allowed: an int, which all rows share")
        shape = lead(function.name, {label: tensor.shape for label, tensor in zip(dims, tensors)})
        tensors = [tensor.expand(*shape, tensor.shape[-1]) for tensor in tensors]
        count = len(function.inputs)
        return self._operator()(*tensors[:count], tensors[count] if p is not None else None, t, self.handle)

    def _operator(self) -> Callable[..., Any]:
        # `torch.compile` traces operators, but not functions with a rule of forward mode.
        operators = _OPERATORS[self.function.name]
        return operators.call if torch.compiler.is_compiling() else operators.differentiable


class step(_Rows):
    """``step(task)(x, u, p=None, t=0)``, the next states.

    Shapes: x (..., n), u (..., m), p (..., np); result (..., n).
    """

    function = STEP

    def __call__(self, x: Tensor, u: Tensor, p: Tensor | None = None, t: int = 0) -> Tensor:
        """Returns the next states, (..., n)."""
        return self._call(x, u, p=p, t=t)


class observe(_Rows):
    """``observe(task)(x, p=None, t=0)``, the observations of a policy.

    Shapes: x (..., n), p (..., np); result (..., observation_dim).
    """

    function = OBSERVE

    def __call__(self, x: Tensor, p: Tensor | None = None, t: int = 0) -> Tensor:
        """Returns the observations, (..., observation_dim)."""
        return self._call(x, p=p, t=t)


class running_cost(_Rows):
    """``running_cost(task)(x, u, next, p=None, t=0)``, the costs of a step.

    Shapes: x and next (..., n), u (..., m), p (..., np); result (...).
    """

    function = RUNNING_COST

    def __call__(self, x: Tensor, u: Tensor, next: Tensor, p: Tensor | None = None, t: int = 0) -> Tensor:
        """Returns the costs, (...)."""
        return self._call(x, u, next, p=p, t=t)


class terminal_cost(_Rows):
    """``terminal_cost(task)(x, p=None)``, the costs of last states.

    Shapes: x (..., n), p (..., np); result (...).
    """

    function = TERMINAL_COST

    def __call__(self, x: Tensor, p: Tensor | None = None) -> Tensor:
        """Returns the costs, (...)."""
        return self._call(x, p=p)


class transition(_Rows):
    """``transition(task)(x, u, p=None, t=0)``: next states, their observations and the costs of the step.

    One call in place of those of ``step``, ``observe`` and ``running_cost``, in reverse mode only. The
    observation is that of step t + 1, with the parameters of this step. Shapes: x (..., n), u (..., m),
    p (..., np); results (..., n), (..., observation_dim) and (...).
    """

    function = STEP

    def __init__(self, task: Any) -> None:
        refuse_noise(task)
        super().__init__(task)

    def __call__(self, x: Tensor, u: Tensor, p: Tensor | None = None, t: int = 0) -> tuple[Tensor, Tensor, Tensor]:
        """Returns ``(next, y, cost)``."""
        if p is None and self.task.param_dim:
            raise missing_parameters("transition", self.task)
        return self._call(x, u, p=x.new_zeros(0) if p is None else p, t=t)

    def _operator(self) -> Callable[..., Any]:
        return partial(_run, _TRANSITION)


class rollout(RolloutFunction):
    __doc__ = RolloutFunction.__doc__

    def __init__(self, task: Any, policy: Any = None, flow: str = "R") -> None:
        super().__init__(task, policy, flow)
        _TASKS.setdefault(self.handle, task)

    def __call__(self, first: Tensor, starts: Tensor) -> Any:
        """Returns the states, or states and controls of a policy."""
        task = self.task
        if self.policy is not None:
            _check("rollout", {"theta": self.parameters, "starts": task.start_dim}, (first, starts))
            return _run(_ROLLOUT, first, starts, self.handle)
        _check("rollout", {"u": task.control_dim, "starts": task.start_dim}, (first, starts))
        if first.dim() < 2:
            raise ValueError(f"`rollout`: `u` has shape {tuple(first.shape)}, but its last dimensions must be steps and {task.control_dim}")
        batch = lead("rollout", {"u": first.shape[:-1], "starts": starts.shape})
        first, starts = first.expand(*batch, *first.shape[-2:]), starts.expand(*batch, starts.shape[-1])
        return _run(_STATES, first, starts, self.handle)


def _check(name: str, dims: dict[str, int], tensors: tuple[Tensor, ...]) -> None:
    first = tensors[0]
    for (label, size), tensor in zip(dims.items(), tensors):
        if not isinstance(tensor, Tensor):
            hint = f". Use `torch.from_numpy({label})`" if isinstance(tensor, np.ndarray) else ""
            raise TypeError(f"`{name}`: `{label}` is of type {type(tensor).__name__}; allowed: a tensor{hint}")
        if tensor.device.type != "cpu":
            raise TypeError(
                f"`{name}`: `{label}` is on {tensor.device}, but the physics runs on the CPU. Use `{label}.cpu()`"
            )
        if tensor.dtype not in (torch.float32, torch.float64) or tensor.dtype != first.dtype:
            dtypes = ", ".join(f"`{label}` {tensor.dtype}" for label, tensor in zip(dims, tensors))
            raise TypeError(f"`{name}`: dtypes are {dtypes}. Use float32, or float64, for all of them")
        if tensor.dim() == 0 or tensor.shape[-1] != size:
            raise ValueError(f"`{name}`: `{label}` has shape {tuple(tensor.shape)}, but its last dimension must be {size}")


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


def _of_handle(handle: int) -> Any:
    """The task of this handle, which may be that of a graph of another process."""
    if handle not in _TASKS:
        raise RuntimeError(
            "the graph is one of a task that this process does not know. Create the function first, as in `pg.torch.step(task)`"
        )
    return _TASKS[handle]


def _run(operators: _Operators, *arguments: Any) -> Any:
    """Calls the operator in a graph, and otherwise the differentiable function."""
    return (operators.call if torch.compiler.is_compiling() else operators.differentiable)(*arguments)


def _refuse_tangents(name: str, call: Any) -> None:
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
                f"`{name}`: exported and traced graphs do not support forward mode through the physics. Call "
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
        return torch.from_numpy(function.call(_of_handle(handle), arrays, p, t))

    def backward(*arguments: Any) -> tuple[Tensor, ...]:
        *tensors, output_bar, t, handle = arguments
        *arrays, p, bar = _arrays((*tensors, output_bar))
        return tuple(map(torch.from_numpy, function.vjp(_of_handle(handle), arrays, p, t, bar)))

    def push(*arguments: Any) -> Tensor:
        *tensors, t, handle = arguments
        arrays = _arrays(tensors)
        p = arrays[count - 1]
        return torch.from_numpy(function.jvp(_of_handle(handle), arrays[: count - 1], p, t, arrays[count:]))

    def operator(suffix: str, work: Callable, tensors: str, outputs: str) -> Any:
        schema = f"({tensors}, SymInt t, int task) -> {outputs}"
        return torch.library.custom_op(f"physgrad::{function.name}{suffix}", work, mutates_args=(), schema=schema)

    call = operator("", forward, inputs, "Tensor")
    vjp = operator("_vjp", backward, f"{inputs}, Tensor output_bar", f"({outputs})")
    jvp = operator("_jvp", push, f"{inputs}, {tangents}", "Tensor")

    def output_like(*arguments: Any) -> Tensor:
        x, task = arguments[0], _of_handle(arguments[-1])
        return x.new_empty((*x.shape[:-1], *function.output_shape(task)))

    def inputs_like(*arguments: Any) -> tuple[Tensor, ...]:
        x, task = arguments[0], _of_handle(arguments[-1])
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

    _refuse_tangents(function.name, call)
    call.register_vmap(batched(call, 1))
    vjp.register_vmap(batched(vjp, count))
    jvp.register_vmap(batched(jvp, 1))
    return _Operators(call, Call.apply)


_OPERATORS = {function.name: _operators(function) for function in (STEP, OBSERVE, RUNNING_COST, TERMINAL_COST)}


def _operation(
    name: str, count: int, made: int, shapes_of: Callable[..., list], *, saved: int, has_step: bool = False
) -> _Operators:
    """Registers the operators ``physgrad::NAME`` and ``physgrad::NAME_vjp`` of an operation in reverse mode.

    Their arguments are ``count`` tensors, then the step number, if the operation has one, and the handle
    of the task. ``shapes_of`` returns the shapes of the outputs, of which there are ``made``. The
    derivative needs the first ``saved`` of them.
    """
    tensors = ", ".join(f"Tensor input_{i}" for i in range(count))
    others = "SymInt t, int task" if has_step else "int task"

    def run(operation: str, tensors: Iterable[Tensor], shapes: list, t: int, handle: int) -> tuple[Tensor, ...]:
        arrays = [tensor.detach().contiguous().numpy() for tensor in tensors]
        found = [np.empty(shape, arrays[0].dtype) for shape in shapes]
        _core.operation(handle, operation, t, arrays, found)
        return tuple(map(torch.from_numpy, found))

    def unpacked(arguments: tuple) -> tuple:
        return (*arguments[:-2], arguments[-2], arguments[-1]) if has_step else (*arguments[:-1], 0, arguments[-1])

    def forward(*arguments: Any) -> tuple[Tensor, ...]:
        *inputs, t, handle = unpacked(arguments)
        return run(name, inputs, shapes_of(_of_handle(handle), *inputs), t, handle)

    def backward(*arguments: Any) -> tuple[Tensor, ...]:
        *inputs, t, handle = unpacked(arguments)
        return run(f"{name}_vjp", inputs, [tensor.shape for tensor in inputs[:count]], t, handle)

    bars = ", ".join(f"Tensor bar_{i}" for i in range(saved + made))
    returned = "Tensor" if made == 1 else f"({', '.join(['Tensor'] * made)})"
    first = forward if made > 1 else lambda *arguments: forward(*arguments)[0]
    operator = partial(torch.library.custom_op, mutates_args=())
    call = operator(f"physgrad::{name}", first, schema=f"({tensors}, {others}) -> {returned}")
    vjp = operator(
        f"physgrad::{name}_vjp", backward, schema=f"({tensors}, {bars}, {others}) -> ({', '.join(['Tensor'] * count)})"
    )

    def like(*arguments: Any) -> Any:
        *inputs, _, handle = unpacked(arguments)
        found = tuple(inputs[0].new_empty(shape) for shape in shapes_of(_of_handle(handle), *inputs))
        return found if made > 1 else found[0]

    call.register_fake(like)
    vjp.register_fake(lambda *arguments: tuple(tensor.new_empty(tensor.shape) for tensor in arguments[:count]))

    def save(ctx: Any, inputs: tuple, output: Any) -> None:
        found = output if made > 1 else (output,)
        ctx.save_for_backward(*inputs[:count], *found[:saved])
        ctx.others, ctx.shapes = inputs[count:], [tensor.shape for tensor in found]

    def differentiate(ctx: Any, bars: tuple, vjp: Callable) -> tuple:
        tensors = ctx.saved_tensors
        given = [tensors[0].new_zeros(shape) if bar is None else bar for bar, shape in zip(bars, ctx.shapes)]
        return (*vjp(*tensors, *given, *ctx.others), *[None] * len(ctx.others))

    def refuse(order: str) -> Callable:
        def refused(*_: Any) -> Any:
            raise RuntimeError(f"`{name}` has no {order}: it is differentiable once, in reverse mode")

        return refused

    class Vjp(torch.autograd.Function):
        generate_vmap_rule = True
        forward = staticmethod(lambda *arguments: vjp(*arguments))
        setup_context = staticmethod(lambda ctx, inputs, output: None)
        backward = staticmethod(refuse("second derivatives"))
        jvp = staticmethod(refuse("second derivatives"))

    class Call(torch.autograd.Function):
        generate_vmap_rule = True
        forward = staticmethod(lambda *arguments: call(*arguments))
        setup_context = staticmethod(save)
        backward = staticmethod(lambda ctx, *bars: differentiate(ctx, bars, Vjp.apply))
        jvp = staticmethod(refuse("forward mode"))

    # The rules of graphs.
    call.register_autograd(lambda ctx, *bars: differentiate(ctx, bars, vjp), setup_context=save)
    vjp.register_autograd(refuse("second derivatives"), setup_context=lambda ctx, inputs, output: None)
    _refuse_tangents(name, call)
    return _Operators(call, Call.apply)


def _of_transition(task: Any, x: Tensor, *others: Tensor) -> list:
    batch = x.shape[:-1]
    return [(*batch, task.state_dim), (*batch, task.observation_dim), batch]


def _of_states(task: Any, u: Tensor, starts: Tensor) -> list:
    return [(*starts.shape[:-1], u.shape[-2] + 1, task.state_dim)]


def _of_rollout(task: Any, theta: Tensor, starts: Tensor) -> list:
    batch, steps = starts.shape[:-1], task.horizon
    return [(*batch, steps + 1, task.state_dim), (*batch, steps, task.control_dim)]


_TRANSITION = _operation("transition", 3, 3, _of_transition, saved=1, has_step=True)
_STATES = _operation("states", 2, 1, _of_states, saved=1)
_ROLLOUT = _operation("rollout", 2, 2, _of_rollout, saved=0)
