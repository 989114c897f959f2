"""`accuracy` and its result: errors and costs of integrators, step sizes and precisions."""

from __future__ import annotations

import dataclasses
from typing import TYPE_CHECKING, Any, Literal

from . import _core
from ._results import Result, html_table, number, table

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    from ._core import Task


@dataclasses.dataclass(frozen=True, eq=False)
class Setting(Result):
    """The fastest setting that reaches a target of `accuracy`."""

    method: str
    """Integrator; "native" for the scheme of the task."""
    substeps: int
    """Physics steps per time step."""
    precision: str
    """"f32" or "f64"."""
    error: float
    """Relative error by the metric."""
    seconds: float
    """Time per step and sample, s: forward, or with gradients for the metrics "R" and "M"."""
    task: Task
    """The task with this setting."""


@dataclasses.dataclass(frozen=True, eq=False, repr=False)
class Accuracy(Result):
    """Result of `accuracy`, for S settings."""

    task: Task
    settings: dict[str, list[str] | NDArray[np.int64] | NDArray[np.float64]]
    """Columns with one entry per setting, for instance for `pandas.DataFrame(found.settings)`.

    "method", integrators, and "precision" are lists of texts. The others are arrays, (S,): "substeps"
    per time step; the relative errors "trajectory", "loss", "R" and "M", NaN if the rollout diverges;
    "operations" of a step and its vector-Jacobian product, per sample; "bytes" of a rollout and its
    adjoints, and the medians "forward_seconds" and "gradient_seconds", per step and sample."""
    reference: dict[str, float]
    """Estimated errors of the reference: "trajectory", "loss", "R" and "M". Smaller errors of a setting
    are below its resolution."""
    cheapest: Setting | None
    """The cheapest setting with an error of at most the target: the one with the fewest operations among
    those whose times overlap with the fastest one's. None without a target, or if no setting reaches
    it."""

    _HEADER = (
        *("method", "substeps", "precision", "trajectory", "loss", "R", "M"),
        *("forward_seconds", "gradient_seconds"),
    )

    def _cells(self) -> list[list[str]]:
        columns = [self.settings[name] for name in self._HEADER]
        return [[cell if isinstance(cell, str) else number(cell, 3) for cell in row] for row in zip(*columns)]

    def __repr__(self) -> str:
        found = self.cheapest
        best = f"; cheapest: {found.method}, {found.substeps} substeps, {found.precision}" if found else ""
        return f"<physgrad.Accuracy of {self.task.name}: {len(self.settings['method'])} settings{best}>"

    def __str__(self) -> str:
        return "\n".join([repr(self), *table(self._HEADER, self._cells())])

    def _repr_html_(self) -> str:
        return html_table(repr(self).strip("<>"), self._HEADER, self._cells())


def accuracy(
    task: Task,
    target: float | None = None,
    metric: Literal["trajectory", "loss", "R", "M"] = "trajectory",
    rounds: int = 5,
) -> Accuracy:
    """Errors and costs of all integrators, substeps and precisions, as `physgrad accuracy` measures them.

    Simulates the task with the S settings of the program, and times each `rounds` times on one thread,
    in 5 to 30 s. With fewer rounds it ends sooner, and times are less certain. Errors are relative to a
    reference in f64 with small steps. The policy has the initial parameters of the task, with a
    nonzero output layer. `target` is the largest error of the cheapest setting, and `metric` the error
    that it refers to.

    Raises `ValueError` if an argument is invalid, if the reference diverges, or if the task does not
    support other time steps. Ctrl-C raises `KeyboardInterrupt`. A simulation that has begun still runs
    to its end, on another thread.
    """
    found: dict[str, Any] = _core.accuracy(task, target, metric, rounds)
    cheapest = found["cheapest"]
    return Accuracy(task=task, **found | {"cheapest": None if cheapest is None else Setting(**cheapest)})
