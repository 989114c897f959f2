"""Types of the compiled module. Shapes: n states, m controls, T steps."""

from collections.abc import Callable, Sequence
from os import PathLike
from typing import Any, Literal, TypedDict, type_check_only

import numpy as np
from numpy.typing import ArrayLike, NDArray

__version__: str

Array = NDArray[np.floating[Any]]

class Divergence(ArithmeticError):
    """A number is not finite."""

    step: int | None
    sample: int | None
    component: int | None
    variable: str
    run: Run

class Task:
    def __init__(self, name: str, **settings: Any) -> None: ...
    def replace(self, **settings: Any) -> Task: ...
    @property
    def name(self) -> str: ...
    @property
    def state_dim(self) -> int: ...
    @property
    def control_dim(self) -> int: ...
    @property
    def param_dim(self) -> int: ...
    @property
    def observation_dim(self) -> int: ...
    @property
    def control_bounds(self) -> list[tuple[float, float]] | None: ...
    @property
    def start_dim(self) -> int: ...
    @property
    def horizon(self) -> int: ...
    @property
    def dt(self) -> float: ...
    @property
    def dtype(self) -> str: ...
    @property
    def state_names(self) -> list[str]: ...
    @property
    def control_names(self) -> list[str]: ...
    @property
    def param_names(self) -> list[str]: ...
    @property
    def observation_names(self) -> list[str]: ...
    @property
    def settings(self) -> dict[str, Any]:
        """All settings, a dict that refuses changes."""
    def starts(self, count: int, seed: int = 0, split: str = "new", dtype: Any = None) -> Array: ...
    def params_at(self, starts: ArrayLike, t: int = 0) -> Array: ...
    def step(self, x: ArrayLike, u: ArrayLike, p: ArrayLike | None = None, t: int = 0) -> Array: ...
    def step_vjp(
        self, x: ArrayLike, u: ArrayLike, next_bar: ArrayLike, p: ArrayLike | None = None, t: int = 0
    ) -> tuple[Array, Array, Array]: ...
    def step_jvp(
        self,
        x: ArrayLike,
        u: ArrayLike,
        x_tan: ArrayLike | None = None,
        u_tan: ArrayLike | None = None,
        p: ArrayLike | None = None,
        p_tan: ArrayLike | None = None,
        t: int = 0,
    ) -> Array: ...
    def observe(self, x: ArrayLike, p: ArrayLike | None = None, t: int = 0) -> Array: ...
    def observe_vjp(
        self, x: ArrayLike, y_bar: ArrayLike, p: ArrayLike | None = None, t: int = 0
    ) -> tuple[Array, Array]: ...
    def running_cost(
        self, x: ArrayLike, u: ArrayLike, next: ArrayLike, p: ArrayLike | None = None, t: int = 0
    ) -> Array: ...
    def running_cost_vjp(
        self,
        x: ArrayLike,
        u: ArrayLike,
        next: ArrayLike,
        cost_bar: ArrayLike,
        p: ArrayLike | None = None,
        t: int = 0,
    ) -> tuple[Array, Array, Array, Array]: ...
    def _advance(self, x: ArrayLike, u: ArrayLike, p: ArrayLike, t: int) -> tuple[Array, Array, Array]: ...
    def terminal_cost(self, x: ArrayLike, p: ArrayLike | None = None) -> Array: ...
    def terminal_cost_vjp(
        self, x: ArrayLike, cost_bar: ArrayLike, p: ArrayLike | None = None
    ) -> tuple[Array, Array]: ...

def task_names() -> list[str]: ...

def picture(
    task: Task, states: ArrayLike, controls: ArrayLike, params: ArrayLike
) -> NDArray[np.uint8]: ...

class Policy:
    theta: NDArray[np.float64]
    def __init__(self, task: Task, seed: int = 0, **settings: Any) -> None: ...
    def __call__(self, y: ArrayLike) -> Array: ...
    def __len__(self) -> int: ...
    def save(self, path: str | PathLike[str]) -> None: ...
    def load(self, path: str | PathLike[str]) -> None: ...
    def copy(self) -> Policy: ...

class Run:
    def __init__(
        self, task: Task, policy: Policy | None = None, threads: int | None = None, **settings: Any
    ) -> None: ...
    @staticmethod
    def load(folder: str | PathLike[str]) -> Run: ...
    def train(
        self, callback: Callable[[dict[str, Any]], Any] | None = None, epochs: int | None = None
    ) -> None: ...
    @property
    def history(self) -> dict[str, NDArray[np.float64]]: ...
    @property
    def policy(self) -> Policy: ...
    @property
    def best_policy(self) -> Policy: ...
    @property
    def task(self) -> Task: ...
    @property
    def is_done(self) -> bool: ...
    @property
    def folder(self) -> Any: ...
    def save(self, folder: str | PathLike[str]) -> None: ...
    def report(self, path: str | PathLike[str]) -> None:
        """Writes the page of `physgrad report` to an HTML file. The run needs no folder."""

@type_check_only
class _Fit(TypedDict):
    """Result of `identify`, for K unknown numbers. A dict.

    All dicts, lists and arrays have the numbers in the order of `params`. Without `params`, and for
    further numbers in the section `fit`, the order is that of the task.
    """

    values: dict[str, float]
    """Fitted numbers by dotted key, in the units of the task."""
    errors: dict[str, float]
    """Standard errors by dotted key. NaN at a bound, and infinite without an estimate."""
    statuses: dict[str, str]
    """What the fit knows about each number, such as "estimated" or "ran away"."""
    robust_errors: NDArray[np.float64]
    """Standard errors that allow for correlated residuals, (K,)."""
    correlations: NDArray[np.float64]
    """Correlations of the values, (K, K)."""
    chi_squared: float
    """Sum of squared residuals, in units of `noise` if given."""
    converged: bool
    undetermined: list[list[str]]
    """Combinations of numbers that the data do not determine."""
    at_bound: list[str]
    """Numbers with the status "at bound": the sum of squares decreases beyond a bound."""
    notes: list[str]
    """What the fit assumes of the data, such as full turns that it removes."""
    warnings: list[str]
    """What limits the result. Each sentence is also a `UserWarning`."""

@type_check_only
class _Rows(TypedDict):
    x: ArrayLike
    u: ArrayLike

@type_check_only
class _Segment(_Rows, total=False):
    """A measured segment for `identify`."""

    t: float
    p: dict[str, float]

@type_check_only
class _Plan(TypedDict):
    """Result of `optimize`. A dict."""

    u: NDArray[np.float64]
    """Controls, (T, m)."""
    x: NDArray[np.float64]
    """States, (T+1, n)."""
    gains: NDArray[np.float64]
    """Gains of the feedback u_t + K_t (x - x_t), (T, m, n)."""
    cost: float
    """Running costs plus terminal cost, in the units of the task."""
    costs: NDArray[np.float64]
    """Initial cost, then the cost after each iteration, (iterations + 1,)."""
    iterations: int
    gradient_norm: float
    """Largest absolute component of the projected gradient, cost per unit of control."""
    converged: bool
    stop: str
    warnings: list[str]
    """Sentences about a search that may have ended far from a minimum."""
    """Reason for the termination."""

@type_check_only
class _Settings(TypedDict):
    """Columns with one entry per setting, S settings."""

    method: list[str]
    """Integrators; "native" for the scheme of the task."""
    precision: list[str]
    """Names of precisions in scenes: "f32" or "f64"."""
    substeps: NDArray[np.int64]
    """Physics steps per time step, (S,)."""
    trajectory: NDArray[np.float64]
    """Largest error of the states, relative to the largest state, (S,). NaN after a divergence."""
    loss: NDArray[np.float64]
    """Relative errors of the mean loss, (S,)."""
    R: NDArray[np.float64]
    """Relative errors of the gradient R in the Euclidean norm, (S,)."""
    M: NDArray[np.float64]
    """Relative errors of the field M in the Euclidean norm, (S,)."""
    operations: NDArray[np.int64]
    """Operations of one step and its vector-Jacobian product, per sample, (S,)."""
    bytes: NDArray[np.float64]
    """Bytes of a rollout and its adjoints, per step and sample, (S,)."""
    forward_seconds: NDArray[np.float64]
    """Median time of a forward pass, s per step and sample, (S,). NaN after a divergence."""
    gradient_seconds: NDArray[np.float64]
    """Median time of a forward pass with R and M, s per step and sample, (S,). NaN after a
    divergence."""

@type_check_only
class _Cheapest(TypedDict):
    """The fastest setting that reaches a target."""

    method: str
    substeps: int
    precision: str
    error: float
    """Relative error by the metric."""
    seconds: float
    """Time per step and sample, s: forward, or with gradients for the metrics "R" and "M"."""
    task: Task
    """The task with this setting."""

@type_check_only
class _Accuracy(TypedDict):
    """Result of `accuracy`. A dict."""

    settings: _Settings
    reference: dict[str, float]
    """Estimated errors of the reference: "trajectory", "loss", "R" and "M"."""
    cheapest: _Cheapest | None
    """None without a target, or if no setting reaches it."""

def rollout(task: Task, policy: Policy, starts: ArrayLike) -> tuple[Array, Array]: ...
def losses(task: Task, policy: Policy, starts: ArrayLike) -> Array: ...
def gradients(task: Task, policy: Policy, starts: ArrayLike, fields: list[str] | None = None) -> dict[str, Array]: ...
def identify(
    task: Task,
    data: Sequence[tuple[ArrayLike, ArrayLike] | _Segment],
    params: list[str] | dict[str, float | dict[str, float]] | None = None,
    noise: list[float] | None = None,
) -> _Fit:
    """Fits physical numbers to measured trajectories.

    `data` is a list of pairs: measured states, (steps, n), NaN where missing, and controls,
    (steps, m); that of the last state may be absent. A dict in place of a pair has "x", "u", and optionally "t", the time of the first
    row in s, and "p", a dict of parameters of the task. `params` is a list of dotted keys, a dict with initial values, or a dict of dicts
    with "start", "min" and "max". `noise` has the standard deviation of the measurement noise of
    each state, (n,). Results have the numbers in the order of `params`.
    """

def check(task: Task, policy: Policy | None = None) -> str:
    """Checks derivatives against dual numbers, at the parameters of `policy` or random ones.

    Returns a table. Raises `AssertionError` with all failures.
    """

def accuracy(
    task: Task,
    target: float | None = None,
    metric: Literal["trajectory", "loss", "R", "M"] = "trajectory",
    rounds: int = 5,
) -> _Accuracy:
    """Measures errors and costs of all integrators, substeps and precisions of a task.

    Errors are relative to a reference in f64 with small steps. `target` is the largest error of
    the cheapest setting, measured by `metric`. With fewer `rounds` of timing the call ends sooner,
    and times are less certain.
    """

def optimize(
    task: Task,
    start: ArrayLike,
    bounds: list[list[float]] | None = None,
    iterations: int | None = None,
) -> _Plan:
    """Optimizes the controls from one initial state `start`, (start_dim,).

    `bounds` has the low and high bound of each control, (m, 2). `iterations` is the largest number
    of iterations, 200 by default, up to 1,000,000.
    """
