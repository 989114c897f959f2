"""`identify` and its result: physical numbers from measured trajectories."""

from __future__ import annotations

import dataclasses
import html
import itertools
import math
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from . import _core
from ._recordings import bare, read
from ._results import Result, html_table, number, table

if TYPE_CHECKING:
    from matplotlib.figure import Figure
    from numpy.typing import ArrayLike, NDArray

    from ._core import Task


@dataclasses.dataclass(frozen=True, eq=False, repr=False)
class Fit(Result):
    """Result of `identify`, for K unknown numbers, S segments and n states.

    Dicts and arrays have the numbers in the order of `params`. Without `params`, and for further
    numbers in the section `fit` of the scene, the order is that of the task. `print(fit)` shows
    `summary()`. The page "Identification" explains the method, the errors and the statuses.
    """

    task: Task
    """The task of the call. `fitted_task` has the fitted numbers."""
    values: dict[str, float]
    """Fitted numbers by dotted key, in the units of the task."""
    errors: dict[str, float]
    """Standard errors by key. NaN at a bound, and infinite without an estimate."""
    robust_errors: dict[str, float]
    """Standard errors by key that allow for correlated residuals in a segment. Infinite with few
    segments."""
    statuses: dict[str, str]
    """What the fit knows about each number: "estimated", "at bound", "undetermined", "ran away",
    "non-finite derivative", "zero derivative" or "not converged". Only estimated numbers are results."""
    starts: dict[str, float]
    """Initial values by key."""
    bounds: dict[str, tuple[float, float]]
    """Smallest and largest allowed values by key."""
    correlations: NDArray[np.float64]
    """Correlations of the values, (K, K). NaN for a number without an estimate."""
    converged: bool
    """Whether the fit is at a minimum of χ². Otherwise the values are no results."""
    undetermined: list[list[str]]
    """Combinations of numbers that the data do not determine."""
    at_bound: list[str]
    """Numbers with the status "at bound": χ² decreases beyond a bound."""
    undetermined_starts: list[str]
    """States whose initial values the data do not determine."""
    chi_squared: float
    """Sum of the squared residuals, in units of `noise` if it was given."""
    measurements: int
    """Number N of measured values. First rows do not count if they are exact."""
    unknowns: int
    """Number k of combinations of numbers and initial states that the data determine."""
    noise: NDArray[np.float64] | None
    """Standard deviation of the noise of each state, (n,), in the units of the task. None without
    `noise`."""
    window: int
    """Steps of the windows of multiple shooting in this fit. 0 if whole segments had the lower χ²."""
    iterations: int
    simulations: int
    """Simulations of all segments, without those of the Jacobians."""
    jacobians: int
    """Evaluations of the derivatives of all segments."""
    states: list[NDArray[np.float64]]
    """Simulated states of each segment, (steps, n). Angles are continuous."""
    measured: list[NDArray[np.float64]]
    """Measured states of each segment, (steps, n), NaN where missing. Angles that wrap are
    continuous."""
    times: list[NDArray[np.float64]]
    """Times of the steps of each segment, (steps,), in s."""
    notes: list[str]
    """What the fit assumes of the data, such as full turns that it removes."""
    warnings: list[str]
    """What limits the result. Each sentence is also a `UserWarning`."""
    validation: Fit | None
    """With `every` above 1, the fit of the initial states of the other segments, which has no numbers."""

    @property
    def residuals(self) -> list[NDArray[np.float64]]:
        """Measured minus simulated states of each segment, (steps, n), NaN where nothing was measured."""
        return [measured - states for measured, states in zip(self.measured, self.states)]

    @property
    def initial_states(self) -> NDArray[np.float64]:
        """First simulated state of each segment, (S, n)."""
        return np.stack([states[0] for states in self.states])

    @property
    def rms(self) -> dict[str, float]:
        """Root mean square of the residuals of each measured state, in the units of the task."""
        residuals = np.concatenate(self.residuals)
        seen = [bool(np.isfinite(column).any()) for column in residuals.T]
        names = bare(self.task).state_names
        return {name: math.sqrt(np.nanmean(residuals[:, i] ** 2)) for i, name in enumerate(names) if seen[i]}

    @property
    def freedom(self) -> int:
        """Degrees of freedom: N measurements minus k determined unknowns."""
        return max(self.measurements - self.unknowns, 0)

    @property
    def reduced_chi_squared(self) -> float:
        """χ² per degree of freedom, near 1 if `noise` is right. Without `noise`, the variance of the
        residuals."""
        return self.chi_squared / self.freedom if self.freedom else math.nan

    @property
    def aic(self) -> float:
        """Akaike's information criterion up to a constant, N ln(χ²/N) + 2 k, for noise of unknown size.

        Compares models of the same data: lower is better. H. Akaike 1974, doi:10.1109/TAC.1974.1100705;
        K. P. Burnham and D. R. Anderson 2004, doi:10.1177/0049124104268644, for the sum of squares.
        """
        return self._information(2.0)

    @property
    def bic(self) -> float:
        """The Bayesian information criterion up to a constant, N ln(χ²/N) + k ln N, for noise of unknown
        size.

        Compares models of the same data: lower is better. G. Schwarz 1978, doi:10.1214/aos/1176344136.
        """
        return self._information(math.log(self.measurements) if self.measurements else math.nan)

    def _information(self, penalty: float) -> float:
        if not self.measurements or not self.chi_squared > 0:
            return math.nan if not self.measurements else -math.inf
        return self.measurements * math.log(self.chi_squared / self.measurements) + penalty * self.unknowns

    @property
    def fitted_task(self) -> Task:
        """The task with the fitted numbers.

        Raises `ValueError` if one of them is outside of the range of its setting.
        """
        return self.task.replace(settings=dict(self.values))

    def _cells(self, name: str) -> list[str]:
        """Cells of a number in a table: value, error, relative error, initial value, bounds and status."""
        value, error = self.values[name], self.errors[name]
        shown, relative = "", ""
        if math.isfinite(error):
            shown = f"± {number(error, 2)}"
            relative = f"{number(abs(100 * error / value), 2)} %" if value else ""
        robust = self.robust_errors[name]
        low, high = self.bounds[name]
        bounds = f"{number(low)} to {number(high)}" if math.isfinite(low) or math.isfinite(high) else "none"
        spread = f"± {number(robust, 2)}" if math.isfinite(robust) else ""
        start, status = number(self.starts[name]), self.statuses[name]
        return [name, number(value), shown, relative, spread, start, bounds, status]

    _HEADER = ("number", "value", "error", "relative", "robust", "start", "bounds", "status")

    def _facts(self) -> list[tuple[str, str]]:
        return [
            ("converged", "yes" if self.converged else "no: the values are no results"),
            ("segments", str(len(self.states))),
            ("measurements", str(self.measurements)),
            ("determined unknowns", f"{self.unknowns}, initial states included"),
            ("degrees of freedom", str(self.freedom)),
            ("χ²", number(self.chi_squared, 7)),
            ("χ² per degree of freedom", number(self.reduced_chi_squared)),
            ("AIC", f"{self.aic:.1f}"),
            ("BIC", f"{self.bic:.1f}"),
            ("noise", "unknown: equal for all states" if self.noise is None else "given"),
            ("windows", f"{self.window} steps" if self.window else "whole segments"),
            ("iterations", str(self.iterations)),
        ]

    def _correlated(self, above: float) -> list[tuple[str, str, float]]:
        """Pairs of numbers with a correlation above a size, the largest first."""
        names = list(self.values)
        pairs = itertools.combinations(range(len(names)), 2)
        found = [(names[i], names[j], float(self.correlations[i, j])) for i, j in pairs]
        return sorted((pair for pair in found if abs(pair[2]) > above), key=lambda pair: -abs(pair[2]))

    def summary(self, min_correlation: float = 0.1) -> str:
        """The fit as text: sizes, numbers with errors, correlations above `min_correlation`, warnings."""
        width = max(len(name) for name, _ in self._facts())
        lines = [f"Fit of {self.task.name}"]
        lines += [f"  {name.ljust(width)}  {text}" for name, text in self._facts()]
        if self.values:
            # A column without any cell, as that of robust errors of few segments, is left out.
            rows = [self._cells(name) for name in self.values]
            keep = [i for i in range(len(self._HEADER)) if any(row[i] for row in rows)]
            cells = table([self._HEADER[i] for i in keep], [[row[i] for i in keep] for row in rows])
            lines += ["Numbers, with standard errors", *(f"  {line}" for line in cells)]
        pairs = self._correlated(min_correlation)
        if pairs:
            lines.append(f"Correlations above {number(min_correlation)}")
            cells = table(("", "", ""), ((a, b, f"{value:+.3f}") for a, b, value in pairs))
            lines += [f"  {line}" for line in cells[1:]]
        lines += ["Root mean square of the residuals", *self._residual_sizes()]
        if self.validation is not None:
            lines.append(f"Validation: residuals of {len(self.validation.states)} other segments")
            lines += self.validation._residual_sizes()
        return "\n".join([*lines, *self._remarks()])

    def _residual_sizes(self) -> list[str]:
        width = max(map(len, self.rms), default=0)
        return [f"  {name.ljust(width)}  {number(value, 4)}" for name, value in self.rms.items()]

    def _remarks(self) -> list[str]:
        return [*(f"note: {note}" for note in self.notes), *(f"warning: {text}" for text in self.warnings)]

    def __str__(self) -> str:
        return self.summary()

    def __repr__(self) -> str:
        numbers = ", ".join(f"{name} {number(value)}" for name, value in self.values.items())
        state = "converged" if self.converged else "not converged"
        return f"<physgrad.Fit of {self.task.name}: {numbers or 'initial states'}; {state}>"

    def _repr_html_(self) -> str:
        rows = [self._cells(name) for name in self.values]
        facts = html_table("", ("fit", ""), self._facts())
        lines = "".join(f"<p>{html.escape(text)}</p>" for text in self._remarks())
        return html_table(f"Fit of {self.task.name}", self._HEADER, rows) + facts + lines

    def plot(self, segments: Sequence[int] | None = None) -> Figure:
        """Draws measured and simulated states, and below each the residuals. Needs matplotlib.

        Has one column for each of `segments`, by default of the first three, and two rows for each
        measured state. Returns the figure: `fit.plot().savefig("fit.png")`.
        """
        from matplotlib import pyplot

        chosen = list(range(min(3, len(self.states))) if segments is None else segments)
        names = list(bare(self.task).state_names)
        shown = [i for i, name in enumerate(names) if name in self.rms]
        size = (1.0 + 4.0 * len(chosen), 0.6 + 2.4 * len(shown))
        figure = pyplot.figure(figsize=size, layout="constrained")
        axes = figure.subplots(
            2 * len(shown), len(chosen), squeeze=False, sharex="col", height_ratios=[2, 1] * len(shown)
        )
        for column, segment in enumerate(chosen):
            times, residuals = self.times[segment], self.residuals[segment]
            axes[0, column].set_title(f"segment {segment}")
            axes[-1, column].set_xlabel("time in s")
            for row, i in enumerate(shown):
                above, below = axes[2 * row, column], axes[2 * row + 1, column]
                above.plot(times, self.measured[segment][:, i], ".", ms=3, color="0.55", label="measured")
                above.plot(times, self.states[segment][:, i], lw=1.2, color="C0", label="fitted")
                below.axhline(0.0, lw=0.8, color="0.7")
                below.plot(times, residuals[:, i], ".", ms=3, color="C3")
                if column == 0:
                    above.set_ylabel(names[i])
                    below.set_ylabel("residual")
        figure.legend(*axes[0, 0].get_legend_handles_labels(), loc="outside upper right", ncols=2)
        return figure


def identify(
    task: Task,
    data: Any,
    params: Sequence[str] | dict[str, Any] | None = None,
    noise: ArrayLike | dict[str, float] | None = None,
    *,
    time: str | None = None,
    units: dict[str, str | float] | None = None,
    window: int = 10,
    every: int = 1,
    exact_starts: bool = False,
) -> Fit:
    """Fits physical numbers to measured trajectories, as `physgrad identify` does, in f64.

    `data` is a data frame, the path of a CSV file, a dict, or a list of these and of pairs.

    - A data frame or a file has a column `t` or `time`, or with the name `time`, in s, and columns with
      the names of states, controls and parameters. A column `segment` separates recordings. NaN and
      empty cells are missing. Rows are whole steps apart; if rows are missing, a control keeps its
      value, and a gap in which a control changes begins a new segment. A control without a column is
      0. Other columns are refused. `units` converts columns, as in `{"theta_1": "deg", "x": 0.001}`.
    - A pair has the measured states, (steps, n), and controls, (steps, m), one per state; that of the
      last state has no effect and may be absent.
    - A dict has the states "x", the controls "u", and optionally "t", the time of the first row in s
      since the start of a rollout (default: 0), and "p", a dict of parameters of the task. Time matters
      if the physics depends on it, as with gusts.

    NaN marks a missing state. Angles may wrap as those of an encoder do.

    `params` names the unknown numbers by dotted keys. With a list, as in `["system.arms[0].mass"]`, the
    fit starts from their values in the task. A dict has initial values, as in
    `{"system.pole_mass": 0.2}`, or dicts with "start", "min" and "max". Without `params`, the scene
    names the numbers in its section `fit`.

    `noise` has the standard deviation of the measurement noise of each state in the units of the data,
    (n,), or by name. A state without a measurement needs none: NaN, or no name. Without `noise`, one
    standard deviation holds for all states, estimated from the residuals.

    `window` is the length of the windows of multiple shooting, in steps; 0 takes whole segments.
    `every=2` fits every second segment, and for the others only their initial states, as a
    validation. `exact_starts` takes the first row of each segment as its exact initial state.

    Raises `ValueError` if no number is unknown, if an argument does not fit the task, or if the
    simulation with the initial values diverges, and `MemoryError` if all segments together need more
    than 1 GB, or the fit more than the memory. Ctrl-C raises `KeyboardInterrupt`.
    """
    for name, value, least in (("every", every, 1), ("window", window, 0)):
        if not isinstance(value, int) or value < least:
            raise ValueError(f"`{name}` is {value!r}; allowed: an integer of at least {least}")
    recordings = read(task, data, params, time, units)
    segments, others = recordings.segments, []
    if every > 1:
        segments, others = segments[::every], [part for i, part in enumerate(segments) if i % every]
        if not others:
            raise ValueError(f"`every` is {every}, and no segment remains for validation")
    deviations = _noise(task, noise, recordings.segments, recordings.scales)
    options = {"noise": deviations, "window": window, "exact_starts": exact_starts}
    raw = _core.identify(task, segments, params, **options)
    fit = _fit(task, segments, raw, deviations, recordings.notes)
    if not others:
        return fit
    validation = None
    warnings = fit.warnings
    if fit.converged:
        try:
            # The first rows of these segments are not exact, and all numbers are known.
            fixed = fit.fitted_task
            options |= {"exact_starts": False, "only_starts": True}
            raw = _core.identify(fixed, others, None, **options)
            validation = _fit(fixed, others, raw, deviations, [])
        except ValueError as error:
            warnings = [*warnings, f"there is no validation: {error}"]
    return dataclasses.replace(fit, validation=validation, warnings=warnings)


def _noise(task: Task, noise: Any, data: Any, scales: dict[str, float]) -> Any:
    """Standard deviations of the states in the units of the task, 1 for a state without a measurement.

    The compiled module refuses what has another type or length.
    """
    names = list(bare(task).state_names)
    if isinstance(noise, dict):
        for name in noise:
            if name not in names:
                raise ValueError(f"`noise`: {name!r} is no state; states: {', '.join(names)}")
        noise = [noise.get(name, math.nan) for name in names]
    if not isinstance(noise, (list, tuple, np.ndarray)) or len(noise) != len(names):
        return noise
    try:
        deviations = [float(value) * abs(scales.get(name, 1.0)) for name, value in zip(names, noise)]
    except (TypeError, ValueError):
        raise TypeError(f"`noise` is {noise!r}; allowed: numbers, and NaN for an unmeasured state") from None
    for i, name in enumerate(names):
        if math.isnan(deviations[i]):
            if any(np.isfinite(np.asarray(_states(part), float)[:, i]).any() for part in data):
                raise ValueError(
                    f"`noise` has no number for {name}, which the data measure; give a positive number"
                )
            deviations[i] = 1.0
    return deviations


def _states(part: Any) -> Any:
    """Measured states of a pair or a dict."""
    return part["x"] if isinstance(part, dict) else part[0]


def _fit(task: Task, data: Any, raw: dict[str, Any], noise: Any, notes: list[str]) -> Fit:
    """The result from the dict of the compiled module."""
    names, states = list(raw["values"]), list(bare(task).state_names)
    begins = [float(part.get("t", 0.0)) if isinstance(part, dict) else 0.0 for part in data]
    return Fit(
        task=task,
        values=raw["values"],
        errors=raw["errors"],
        robust_errors=dict(zip(names, raw["robust_errors"].tolist())),
        statuses=raw["statuses"],
        starts=raw["starts"],
        bounds=raw["bounds"],
        correlations=raw["correlations"],
        converged=raw["converged"],
        undetermined=raw["undetermined"],
        at_bound=raw["at_bound"],
        undetermined_starts=[states[i] for i in raw["undetermined_starts"]],
        chi_squared=raw["chi_squared"],
        measurements=raw["measurements"],
        unknowns=raw["unknowns"],
        noise=None if noise is None else np.array(noise, float),
        window=raw["window"],
        iterations=raw["iterations"],
        simulations=raw["simulations"],
        jacobians=raw["jacobians"],
        states=raw["states"],
        measured=raw["measured"],
        times=[begin + task.dt * np.arange(len(x), dtype=np.float64) for begin, x in zip(begins, raw["states"])],
        notes=[*notes, *raw["notes"]],
        warnings=raw["warnings"],
        validation=None,
    )
