"""Rollouts of any callable policy, over the functions of a task."""

from __future__ import annotations

import inspect
from collections.abc import Callable
from typing import TYPE_CHECKING, Any

import numpy as np

from . import _core
from ._core import Divergence, Policy

if TYPE_CHECKING:
    from numpy.typing import ArrayLike

    from ._core import Array, Task

    Controller = Callable[..., ArrayLike]


def rollout(task: Task, policy: Policy | Controller, starts: ArrayLike) -> tuple[Array, Array]:
    """Rollouts of a policy from initial states `starts`, (B, start_dim).

    Returns the states, (B, T+1, n), the initial state first, and the controls, (B, T, m), in the dtype
    of `starts`. `policy` is a `Policy`, or a function `f(y)` or `f(y, t)` of the observations of all
    samples, (B, observation_dim), and of the number of the step, which returns the controls, (B, m), or
    (B,) for a single control. A function is called once per step, in order, so it may
    have a memory of its own.

    Raises `Divergence` if a number is not finite, and `MemoryError` if the rollouts do not fit into
    memory. Ctrl-C raises `KeyboardInterrupt`.
    """
    if isinstance(policy, Policy):
        return _core.rollout(task, policy, starts)
    x, u, _ = _simulated(task, policy, starts)
    return x, u


def losses(task: Task, policy: Policy | Controller, starts: ArrayLike) -> Array:
    """Losses, (B,), of rollouts from initial states `starts`: the running costs and the terminal cost.

    Arguments and exceptions are those of `rollout`.
    """
    if isinstance(policy, Policy):
        return _core.losses(task, policy, starts)
    states, controls, starts = _simulated(task, policy, starts)
    found: Array = np.zeros(len(states), states.dtype)
    for t in range(task.horizon):
        x, u, next = states[:, t], controls[:, t], states[:, t + 1]
        p = task.params_at(starts, t)
        found = found + _finite(task.running_cost(x, u, next, p=p, t=t), "cost", t)
    # Noise keeps its last value.
    p = task.params_at(starts, task.horizon - 1)
    return found + _finite(task.terminal_cost(states[:, -1], p=p), "cost", task.horizon)


def _simulated(task: Task, policy: Controller, starts: ArrayLike) -> tuple[Array, Array, Array]:
    """States and controls of rollouts of a function, and the initial states as an array."""
    act = _controller(policy)
    rows: Array = np.asarray(starts)
    rows = np.ascontiguousarray(rows, np.float32 if rows.dtype == np.float32 else np.float64)
    if rows.ndim != 2 or rows.shape[1] != task.start_dim:
        raise ValueError(f"`starts` has the shape {rows.shape}; expected (B, {task.start_dim})")
    count, horizon, n, m = len(rows), task.horizon, task.state_dim, task.control_dim
    states: Array = np.empty((count, horizon + 1, n), rows.dtype)
    controls: Array = np.empty((count, horizon, m), rows.dtype)
    states[:, 0] = _finite(rows[:, :n], "state", 0)
    for t in range(horizon):
        x, p = states[:, t], task.params_at(rows, t)
        found = np.asarray(act(task.observe(x, p=p, t=t), t))
        has_shape = found.shape == (count, m) or (m == 1 and found.shape == (count,))
        if not has_shape or found.dtype.kind not in "fiub":
            raise ValueError(
                f"`policy` returned an array of shape {found.shape} and dtype {found.dtype} at step {t}; "
                f"expected controls of shape ({count}, {m})"
            )
        controls[:, t] = found.reshape(count, m)
        u = _finite(controls[:, t], "control", t)
        states[:, t + 1] = _finite(task.step(x, u, p=p, t=t), "state", t + 1)
    return states, controls, rows


def _controller(policy: Any) -> Callable[[Array, int], Any]:
    """The function as one of observations and step."""
    if not callable(policy):
        kind = type(policy).__name__
        raise TypeError(f"`policy` is of type {kind}; allowed: a `Policy`, or a function f(y) or f(y, t)")
    try:
        parameters = inspect.signature(policy).parameters.values()
    except (TypeError, ValueError):
        return lambda y, t: policy(y)
    positional = [p for p in parameters if p.kind in (p.POSITIONAL_ONLY, p.POSITIONAL_OR_KEYWORD)]
    # An optional second argument other than `t` is a setting of the function.
    second = positional[1:2]
    has_step = any(parameter.default is parameter.empty or parameter.name == "t" for parameter in second)
    return policy if has_step else lambda y, t: policy(y)


def _finite(values: Array, variable: str, step: int) -> Array:
    """The values, (B,) or (B, k). Raises `Divergence` at the first sample with one that is not finite."""
    bad = ~np.isfinite(values)
    if bad.any():
        sample, *component = (int(i) for i in np.argwhere(bad)[0])
        place = f"component {component[0]} of the {variable}" if component else f"the {variable}"
        error = Divergence(f"{place} is not finite in step {step} of sample {sample}")
        error.variable, error.sample = variable, sample
        # A cost has no step, as in rollouts of a `Policy`.
        error.step = step if component else None
        error.component = component[0] if component else None
        raise error
    return values
