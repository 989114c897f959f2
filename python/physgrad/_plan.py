"""`optimize` and its result: controls that minimize the loss from one initial state."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from . import _core
from ._core import Policy
from ._results import Result, html_table, number, table
from ._rollouts import rollout

if TYPE_CHECKING:
    from numpy.typing import ArrayLike, NDArray

    from ._core import Task
    from ._rollouts import Controller


@dataclasses.dataclass(frozen=True, eq=False, repr=False)
class Plan(Result):
    """Result of `optimize`, for T steps, n states and m controls."""

    task: Task
    u: NDArray[np.float64]
    """Controls, (T, m)."""
    x: NDArray[np.float64]
    """States, (T+1, n)."""
    gains: NDArray[np.float64]
    """Gains K of the feedback u_t + K_t (x - x_t), (T, m, n)."""
    cost: float
    """Running costs plus terminal cost, in the units of the task."""
    costs: NDArray[np.float64]
    """Initial cost, then the cost after each iteration, (iterations + 1,)."""
    iterations: int
    gradient_norm: float
    """Largest absolute component of the projected gradient, cost per unit of control."""
    converged: bool
    stop: str
    """Reason for the end of the search."""
    warnings: list[str]
    """Sentences about a search that may have ended far from a minimum, each also a `UserWarning`."""

    def _facts(self) -> list[tuple[str, str]]:
        return [
            ("cost", number(self.cost)),
            ("initial cost", number(float(self.costs[0]))),
            ("iterations", str(self.iterations)),
            ("largest gradient", number(self.gradient_norm)),
            ("converged", f"{'yes' if self.converged else 'no'}: {self.stop}"),
            ("controls", f"{number(self.u.min())} to {number(self.u.max())}"),
        ]

    def __repr__(self) -> str:
        state = "converged" if self.converged else "not converged"
        steps = f"{self.iterations} iterations"
        return f"<physgrad.Plan of {self.task.name}: cost {number(self.cost)}, {steps}, {state}>"

    def __str__(self) -> str:
        lines = table((f"Plan of {self.task.name}", ""), self._facts())
        return "\n".join([*lines, *(f"warning: {warning}" for warning in self.warnings)])

    def _repr_html_(self) -> str:
        return html_table(f"Plan of {self.task.name}", (), self._facts())


def optimize(
    task: Task,
    start: ArrayLike,
    bounds: Sequence[Sequence[float]] | None = None,
    iterations: int | None = None,
    initial: ArrayLike | Plan | Policy | Controller | None = None,
) -> Plan:
    """Optimizes the controls from one initial state `start`, (start_dim,), as `physgrad optimize` does.

    Computes in f64. `bounds` has the low and high bound of each control, (m, 2). `iterations` is the
    largest number of iterations, 200 by default, up to 1,000,000. Noise has its mean.

    The search begins at `initial`: controls, (T, m); another `Plan`, whose controls it takes; or a
    policy or function as in `rollout`, which acts from `start`. By default, all controls are 0.
    Controls outside of the bounds begin at the nearest bound.

    Raises `ValueError` if an argument is invalid, or if the initial trajectory, the initial cost or a
    derivative is not finite. Ctrl-C raises `KeyboardInterrupt`.
    """
    if isinstance(initial, Plan):
        initial = initial.u
    elif callable(initial):
        _, u = rollout(task, initial, np.asarray(start, float)[None])
        initial = u[0]
    found: dict[str, Any] = _core.optimize(task, start, bounds, iterations, initial)
    return Plan(task=task, **found)
