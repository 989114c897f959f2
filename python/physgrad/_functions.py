"""Functions of a task that other frameworks differentiate: names, arguments, shapes, calls."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from . import _core


class Function(NamedTuple):
    """One function of a task, for rows of a batch.

    Arguments before ``p`` are ``inputs``. The output is "next" (states), "y" (observations) or
    "cost" (one number per row). With ``has_step``, the function has the argument ``t``.
    """

    name: str
    inputs: tuple[str, ...]
    output: str
    has_step: bool

    def dims(self, task: Any) -> dict[str, int]:
        """Number of components by input name."""
        sizes = {"x": task.state_dim, "u": task.control_dim, "next": task.state_dim}
        return {name: sizes[name] for name in self.inputs}

    def output_shape(self, task: Any) -> tuple[int, ...]:
        """Shape of the output of one row."""
        return {"next": (task.state_dim,), "y": (task.observation_dim,)}.get(self.output, ())

    def shapes(self, task: Any, lead: tuple[int, ...]) -> list[tuple[int, ...]]:
        """Shapes of the cotangents of the inputs and of the parameters."""
        return [(*lead, size) for size in (*self.dims(task).values(), task.param_dim)]

    def call(self, task: Any, inputs: list[np.ndarray], p: np.ndarray | None, t: int) -> np.ndarray:
        """Evaluates the function. All arrays have the same leading dimensions."""
        lead, rows = _rows([*inputs, p])
        steps = {"t": t} if self.has_step else {}
        output = getattr(task, self.name)(*rows[:-1], p=rows[-1], **steps)
        return output.reshape(lead + self.output_shape(task))

    def vjp(
        self, task: Any, inputs: list[np.ndarray], p: np.ndarray | None, t: int, output_bar: np.ndarray
    ) -> list[np.ndarray]:
        """Returns the cotangents of the inputs and of the parameters."""
        lead, rows = _rows([*inputs, p])
        output_bar = output_bar.reshape(rows[0].shape[:1] + self.output_shape(task))
        steps = {"t": t} if self.has_step else {}
        bars = getattr(task, f"{self.name}_vjp")(*rows[:-1], output_bar, p=rows[-1], **steps)
        return [bar.reshape(shape) for bar, shape in zip(bars, self.shapes(task, lead), strict=True)]

    def jvp(
        self,
        task: Any,
        inputs: list[np.ndarray],
        p: np.ndarray | None,
        t: int,
        tangents: list[np.ndarray | None],
    ) -> np.ndarray:
        """Returns the tangent of the output, for tangents of the inputs and of the parameters.

        None is a zero tangent. The sums of ``vjp`` are the rows of the Jacobian, one call for each
        component of an observation or a cost.
        """
        if self.name == "step":
            lead, (x, u, p, *tangents) = _rows([*inputs, p, *tangents])
            x_tan, u_tan, p_tan = tangents
            output = task.step_jvp(x, u, x_tan=x_tan, u_tan=u_tan, p=p, p_tan=p_tan, t=t)
            return output.reshape(lead + self.output_shape(task))
        output = np.zeros(inputs[0].shape[:-1] + self.output_shape(task), inputs[0].dtype)
        for component in np.ndindex(self.output_shape(task)):
            one = np.zeros_like(output)
            one[(..., *component)] = 1.0
            bars = self.vjp(task, inputs, p, t, one)
            terms = [(bar * tan).sum(-1) for bar, tan in zip(bars, tangents, strict=True) if tan is not None]
            output[(..., *component)] = sum(terms)
        return output


class TaskFunction:
    """A function of a task, and of a policy. It is equal to, and pickled as, that of an equal task."""

    def __init__(self, task: Any, policy: Any = None, flow: str = "R") -> None:
        self.task, self.policy, self.flow = task, policy, flow
        self.handle: int = _core.handle(task, policy, flow)

    def __reduce__(self) -> tuple:
        return type(self), (self.task, self.policy, self.flow)[: 3 if self.policy is not None else 1]

    def __eq__(self, other: object) -> bool:
        return type(other) is type(self) and other.handle == self.handle

    def __hash__(self) -> int:
        return hash((type(self), self.handle))

    def __repr__(self) -> str:
        return f"{type(self).__module__}.{type(self).__qualname__}({self.task!r})"


class RolloutFunction(TaskFunction):
    """A whole rollout as one function, with its derivative, in reverse mode.

    - ``rollout(task)(u, starts)`` returns the states, (..., T + 1, n), for the controls u, (..., T, m), of
      each sample.
    - ``rollout(task, policy)(theta, starts)`` returns the states and the controls, (..., T, m), of the
      policy with the parameters theta, (P,), instead of its own.

    ``starts``, (..., start_dim), are initial states as of ``task.starts``. The derivative follows the
    paths of ``flow``: "R", the chain rule; "M" without the observation; "N" without the state of the
    physics; "S" without both. A number that is not finite in a rollout of a policy is an error.
    """

    def __init__(self, task: Any, policy: Any = None, flow: str = "R") -> None:
        if policy is None and flow != "R":
            raise ValueError(f"`flow` is {flow!r}, but controls without a policy have no other paths than those of R")
        super().__init__(task, policy, flow)
        # Not `len(policy)` in each call, which PyTorch does not compile.
        self.parameters = 0 if policy is None else len(policy)


def missing_parameters(name: str, task: Any) -> ValueError:
    """The error of a call without the parameters of a task."""
    names = ", ".join(task.param_names)
    return ValueError(f"`{name}`: {task.name} has {task.param_dim} parameters ({names}); pass `p`")


def refuse_noise(task: Any) -> None:
    """Refuses a task with noise for `transition`, whose observation would have that of the step before."""
    if task.start_dim > task.state_dim + task.param_dim:
        raise ValueError(
            f"`transition`: {task.name} has noise, of which an observation has the values of its own step. Use `step`, "
            "`observe` and `running_cost` with `task.params_at`, or `rollout`"
        )


STEP = Function("step", ("x", "u"), "next", has_step=True)
OBSERVE = Function("observe", ("x",), "y", has_step=True)
RUNNING_COST = Function("running_cost", ("x", "u", "next"), "cost", has_step=True)
TERMINAL_COST = Function("terminal_cost", ("x",), "cost", has_step=False)


def lead(name: str, shapes: dict[str, tuple[int, ...]]) -> tuple[int, ...]:
    """Returns the common leading dimensions of arguments, which broadcast."""
    try:
        return np.broadcast_shapes(*(tuple(shape[:-1]) for shape in shapes.values()))
    except ValueError:
        found = ", ".join(f"`{label}` {tuple(shape)}" for label, shape in shapes.items())
        raise ValueError(f"`{name}`: shapes are {found}. Their leading dimensions must be equal, 1 or absent") from None


def _rows(arrays: list[np.ndarray | None]) -> tuple[tuple[int, ...], list[np.ndarray | None]]:
    """Merges the leading dimensions. Returns them and the arrays of shape (rows, components)."""
    lead = arrays[0].shape[:-1]
    count = int(np.prod(lead))
    return lead, [None if array is None else array.reshape(count, array.shape[-1]) for array in arrays]
