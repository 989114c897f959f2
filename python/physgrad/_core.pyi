"""Types of the compiled module. Shapes: n states, m controls, T steps.


`identify`, `optimize` and `accuracy` return the attributes of the public results as dicts.
"""

import pathlib
from collections.abc import Callable, Mapping, Sequence
from typing import Any, Literal

import numpy as np
from numpy.typing import ArrayLike, DTypeLike, NDArray
from typing_extensions import Unpack

from ._model import Model
from ._types import FieldName, LongFieldName, Path, Precision, RunSettings, Section, TrainingSettings

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
    """A task: system, horizon, costs and the distribution of initial states.

    Array methods accept B samples at once, one per row: states `x`, (B, n), controls `u`, (B, m), and
    parameters `p`, (B, param_dim). They compute in float32 if all arguments are arrays of float32, and
    otherwise in float64. `t` is the number of the step.
    """

    def __init__(
        self,
        name: Path,
        *,
        horizon: int = ...,
        precision: Precision = ...,
        field: FieldName | LongFieldName = ...,
        epochs: int = ...,
        seed: int = ...,
        tags: Sequence[str] = ...,
        log: Sequence[Literal["jsonl", "tensorboard"]] = ...,
        effects: Section = ...,
        actuator: Section = ...,
        sensor: Section = ...,
        integrator: Section = ...,
        loss: Section = ...,
        equations: Section = ...,
        policy: Section = ...,
        training: TrainingSettings = ...,
        system: Section = ...,
        vary: Section = ...,
        fit: Mapping[str, float | Mapping[str, float]] = ...,
        settings: Section = ...,
        **system_settings: Any,
    ) -> None: ...
    def replace(
        self,
        *,
        horizon: int = ...,
        precision: Precision = ...,
        field: FieldName | LongFieldName = ...,
        epochs: int = ...,
        seed: int = ...,
        tags: Sequence[str] = ...,
        log: Sequence[Literal["jsonl", "tensorboard"]] = ...,
        effects: Section = ...,
        actuator: Section = ...,
        sensor: Section = ...,
        integrator: Section = ...,
        loss: Section = ...,
        equations: Section = ...,
        policy: Section = ...,
        training: TrainingSettings = ...,
        system: Section = ...,
        vary: Section = ...,
        fit: Mapping[str, float | Mapping[str, float]] = ...,
        settings: Section = ...,
        **system_settings: Any,
    ) -> Task:
        """Copy with other settings, given as in `physgrad.task`. A dict changes only its keys."""
    @property
    def name(self) -> str: ...
    @property
    def state_dim(self) -> int: ...
    @property
    def ended(self) -> int | None: ...
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
    @property
    def model(self) -> Model | None:
        """Names and numbers of the model of a robot from a file. None for other tasks."""
    @property
    def _model(self) -> tuple[str, dict[str, list[str]], dict[str, Any], list[str]] | None: ...
    def starts(
        self,
        count: int,
        seed: int = 0,
        split: Literal["new", "train", "test"] = "new",
        dtype: DTypeLike | None = None,
    ) -> Array:
        """Draws initial states, (count, start_dim): the state, parameters, and a key of noise if any."""
    def params_at(self, starts: ArrayLike, t: int = 0) -> Array:
        """Parameters, (B, param_dim), of the rollouts from `starts`, (B, start_dim), at step `t`."""
    def step(self, x: ArrayLike, u: ArrayLike, p: ArrayLike | None = None, t: int = 0) -> Array:
        """Next states, (B, n), of states `x`, (B, n), and controls `u`, (B, m)."""
    def step_vjp(
        self, x: ArrayLike, u: ArrayLike, next_bar: ArrayLike, p: ArrayLike | None = None, t: int = 0
    ) -> tuple[Array, Array, Array]:
        """Products of `next_bar`, (B, n), with the transposed Jacobians of `step`: (x_bar, u_bar, p_bar)."""
    def step_jvp(
        self,
        x: ArrayLike,
        u: ArrayLike,
        x_tan: ArrayLike | None = None,
        u_tan: ArrayLike | None = None,
        p: ArrayLike | None = None,
        p_tan: ArrayLike | None = None,
        t: int = 0,
    ) -> Array:
        """Products of the Jacobians of `step` with tangents of the shapes of x, u and p: (B, n)."""
    def observe(self, x: ArrayLike, p: ArrayLike | None = None, t: int = 0) -> Array:
        """Observations, (B, observation_dim), of states `x`, (B, n)."""
    def observe_vjp(
        self, x: ArrayLike, y_bar: ArrayLike, p: ArrayLike | None = None, t: int = 0
    ) -> tuple[Array, Array]:
        """Products of `y_bar`, (B, observation_dim), with the transposed Jacobians of `observe`: (x_bar, p_bar)."""
    def running_cost(
        self, x: ArrayLike, u: ArrayLike, next: ArrayLike, p: ArrayLike | None = None, t: int = 0
    ) -> Array:
        """Costs, (B,), of steps from `x`, (B, n), with `u`, (B, m), to `next`, (B, n)."""
    def running_cost_vjp(
        self,
        x: ArrayLike,
        u: ArrayLike,
        next: ArrayLike,
        cost_bar: ArrayLike,
        p: ArrayLike | None = None,
        t: int = 0,
    ) -> tuple[Array, Array, Array, Array]:
        """Gradients of the running costs times `cost_bar`, (B,): (x_bar, u_bar, next_bar, p_bar)."""
    def terminal_cost(self, x: ArrayLike, p: ArrayLike | None = None) -> Array:
        """Costs, (B,), of last states `x`, (B, n)."""
    def terminal_cost_vjp(
        self, x: ArrayLike, cost_bar: ArrayLike, p: ArrayLike | None = None
    ) -> tuple[Array, Array]:
        """Gradients of the terminal costs times `cost_bar`, (B,): (x_bar, p_bar)."""
    def transition(
        self, x: ArrayLike, u: ArrayLike, p: ArrayLike | None = None, t: int = 0
    ) -> tuple[Array, Array, Array]: ...
    def transition_vjp(
        self,
        x: ArrayLike,
        u: ArrayLike,
        next: ArrayLike,
        next_bar: ArrayLike,
        y_bar: ArrayLike,
        cost_bar: ArrayLike,
        p: ArrayLike | None = None,
        t: int = 0,
    ) -> tuple[Array, Array, Array]: ...
    def _repr_html_(self) -> str: ...
    @staticmethod
    def _of(task: str, **settings: Any) -> Task: ...

def task_names() -> list[str]: ...
def operation_names() -> list[str]: ...
def handle(task: Task, policy: Policy | None = None, flow: str = "R") -> int: ...
def operation(handle: int, name: str, t: int, inputs: list[Array], outputs: list[Array]) -> None: ...

xla_handler: int
def presets() -> dict[str, str]:
    """Names of the presets that `task` opens, each with a line about it."""

def picture(
    task: Task, states: ArrayLike, controls: ArrayLike, params: ArrayLike
) -> NDArray[np.uint8]: ...

class Policy:
    """The policy of a task, with its parameters θ."""

    def __init__(
        self,
        task: Task,
        seed: int = 0,
        *,
        kind: str = ...,
        bounds: bool | Sequence[Sequence[float]] = ...,
        base: Section = ...,
        **policy_settings: Any,
    ) -> None: ...
    @property
    def theta(self) -> NDArray[np.float64]:
        """The parameters, (len(policy),). An assignment replaces all of them; elements refuse changes."""
    @theta.setter
    def theta(self, theta: ArrayLike) -> None: ...
    @property
    def numbers(self) -> dict[str, float]:
        """Values of the trained numbers, such as gains, by their keys, in their units."""
    @property
    def task(self) -> Task:
        """The task of the policy, with its settings in the section `policy`."""
    def __call__(self, y: ArrayLike) -> Array:
        """Controls, (B, m), for observations `y`, (B, observation_dim)."""
    def __len__(self) -> int: ...
    def save(self, path: Path) -> None:
        """Writes a policy file in the safetensors format."""
    def load(self, path: Path) -> None:
        """Replaces the parameters by those of a policy file."""
    def copy(self) -> Policy: ...
    def _repr_html_(self) -> str: ...

class Run:
    """A training of a policy."""

    def __init__(
        self,
        task: Task,
        policy: Policy | None = None,
        threads: int | None = None,
        **settings: Unpack[RunSettings],
    ) -> None: ...
    @staticmethod
    def load(folder: Path) -> Run: ...
    def train(
        self, callback: Callable[[dict[str, float]], object] | None = None, epochs: int | None = None
    ) -> None:
        """Trains up to the last epoch. A callback that returns False stops after its epoch."""
    @property
    def history(self) -> dict[str, NDArray[np.float64]]:
        """Numbers of every epoch, (epochs,): "epoch", "loss", "train_loss", "test_loss" and others."""
    @property
    def policy(self) -> Policy: ...
    @property
    def best_policy(self) -> Policy: ...
    @property
    def task(self) -> Task: ...
    @property
    def is_done(self) -> bool: ...
    @property
    def folder(self) -> pathlib.Path | None: ...
    def save(self, folder: Path) -> None: ...
    def report(self, path: Path) -> None:
        """Writes the page of `physgrad report` to an HTML file. The run needs no folder."""
    def _losses(self) -> str: ...
    def _repr_html_(self) -> str: ...

def rollout(task: Task, policy: Policy, starts: ArrayLike) -> tuple[Array, Array]: ...
def losses(task: Task, policy: Policy, starts: ArrayLike) -> Array: ...
def gradients(
    task: Task,
    policy: Policy,
    starts: ArrayLike,
    fields: Sequence[FieldName | LongFieldName] | None = None,
) -> dict[str, Array]: ...
def identify(
    task: Task,
    data: Any,
    params: Any = None,
    noise: Any = None,
    window: int = 10,
    exact_starts: bool = False,
    only_starts: bool = False,
) -> dict[str, Any]: ...
def read_table(
    task: Task, params: Any, table: Any, time: str | None, factors: dict[str, float]
) -> tuple[list[dict[str, Any]], list[str], list[str]]: ...
def check(task: Task, policy: Policy | None = None) -> str:
    """Checks derivatives against dual numbers, at the parameters of `policy` or random ones.

    Returns a table and notes. Raises `AssertionError` with all failures and the notes.
    """

def accuracy(task: Task, target: float | None = None, metric: str = "trajectory", rounds: int = 5) -> dict[str, Any]: ...
def optimize(
    task: Task, start: Any, bounds: Any = None, iterations: int | None = None, initial: Any = None
) -> dict[str, Any]: ...
