"""Gymnasium environments over the tasks.

``pg.gym.make("cart_pole", poles=1)`` returns an ``Env``, ``pg.gym.make_vec("cart_pole", 16)`` a
``VectorEnv``. One call of the physics steps all environments of a ``VectorEnv`` that have equal
step numbers. After ``import physgrad.gym``, the ids ``physgrad/NAME-v0`` work with
``gymnasium.make`` and ``gymnasium.make_vec``.

- An episode has ``horizon`` steps. The last step returns ``truncated``: observations contain no
  clock, so the end is no property of the last state.
- The reward is minus the running cost; the last one also subtracts the terminal cost. The sum of
  the rewards of an episode is therefore minus the loss of its rollout.
- The observation is that of a policy, without normalization.
- The action space is the box from -1 to 1. Action -1 is the control ``low``, action 1 the control
  ``high``; other actions lie on the line between them. Actions are clipped to the box.
- ``info`` of a step is empty, except in the mode ``SAME_STEP`` of a vector environment. There is no
  ``render``.
"""

from __future__ import annotations

import operator
from collections.abc import Sequence
from typing import Any

import gymnasium
import numpy as np
from gymnasium.vector import AutoresetMode
from gymnasium.vector.utils import batch_space

import physgrad as pg

from . import _core

__all__ = ["TaskEnv", "TaskVectorEnv", "make", "make_vec"]


def _opened(task: str | pg.Task, settings: dict[str, Any]) -> pg.Task:
    """The task of this name or path, or this task, with other settings."""
    if isinstance(task, pg.Task):
        return task.replace(**settings) if settings else task
    return pg.task(task, **settings)


def _refuse_rendering(mode: str | None) -> None:
    # `make_vec_env` of Stable-Baselines3 falls back to no rendering after a TypeError.
    if mode is not None:
        raise TypeError(f"`render_mode` is {mode!r}, but environments are not rendered; use `physgrad animate`")


def make(
    name: str | pg.Task,
    *,
    bound: float | Sequence[float] | None = None,
    render_mode: str | None = None,
    **settings: Any,
) -> TaskEnv:
    """Creates an environment over a task, or over ``pg.task(name, **settings)``.

    Controls range from ``-bound`` to ``bound``, one number or one per control, in units of the
    control. Default: ``task.control_bounds``. Raises ``ValueError`` if neither is finite.
    """
    _refuse_rendering(render_mode)
    return TaskEnv(_opened(name, settings), bound)


def make_vec(
    name: str | pg.Task, num_envs: int = 1, *, bound: float | Sequence[float] | None = None, **settings: Any
) -> TaskVectorEnv:
    """Creates ``num_envs`` environments with the mode ``NEXT_STEP``. Other arguments: see ``make``.

    ``TaskVectorEnv`` accepts other modes.
    """
    return TaskVectorEnv(_opened(name, settings), num_envs, bound)


class _Fixed:
    """Attributes that both environments share. Assignments raise an error: they would have no effect."""

    _rows: _Rows

    @property
    def task(self) -> pg.Task:
        """The task."""
        return self._rows.task

    @property
    def low(self) -> np.ndarray:
        """Controls at action -1, shape (control_dim,). A copy that refuses assignments."""
        return _read_only(self._rows.low)

    @property
    def high(self) -> np.ndarray:
        """Controls at action 1, shape (control_dim,). A copy that refuses assignments."""
        return _read_only(self._rows.high)


class TaskEnv(_Fixed, gymnasium.Env):
    """One environment over ``task``, a ``Task``. See the module for rewards and ends of episodes.

    Attributes, which do not change: ``task``; ``low`` and ``high``, the controls at actions -1 and
    1, shape (control_dim,); ``state``, shape (state_dim,); ``params``, shape (param_dim,).
    """

    metadata: dict[str, Any] = {"render_modes": []}

    def __init__(self, task: pg.Task, bound: float | Sequence[float] | None = None) -> None:
        self.observation_space, self.action_space = _spaces(task)
        self._rows = _Rows(task, *_range(task, bound), 1)

    @property
    def state(self) -> np.ndarray:
        """State, shape (state_dim,). A copy that refuses assignments; see ``reset``."""
        return _read_only(self._rows.x[0])

    @property
    def params(self) -> np.ndarray:
        """Parameters of the episode, shape (param_dim,). A copy that refuses assignments."""
        return _read_only(self._rows.p[0])

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[np.ndarray, dict]:
        """Draws an initial state and parameters.

        ``options["state"]``, shape (state_dim,), and ``options["params"]``, shape (param_dim,),
        replace those drawn. Raises ``ValueError`` for other options.
        """
        _check_names(options, {"state", "params"})
        given = {name: _array(name, value) for name, value in (options or {}).items()}
        for name, size in (("state", self.task.state_dim), ("params", self.task.param_dim)):
            if name in given:
                _check_shape(name, given[name], (size,))
        given = {name: value[None] for name, value in given.items()}
        everything = np.ones(1, bool)
        given = self._rows.given(given, everything)
        super().reset(seed=seed)
        self._rows.start(everything, self.np_random, given)
        return self._rows.observe()[0], {}

    def step(self, action: np.ndarray) -> tuple[np.ndarray, float, bool, bool, dict]:
        """Applies an action, shape (control_dim,)."""
        if self._rows.t[0] >= self.task.horizon:
            raise RuntimeError(f"step {self._rows.t[0]}: the episode has ended or not begun. Call `reset` first")
        action = _array("action", action)
        _check_shape("action", action, self._rows.high.shape)
        reward, truncated = self._rows.step(action[None], np.ones(1, bool))
        return self._rows.observe()[0], float(reward[0]), False, bool(truncated[0]), {}


class TaskVectorEnv(_Fixed, gymnasium.vector.VectorEnv):
    """``num_envs`` environments over ``task``, stepped together. See the module and ``TaskEnv``.

    ``autoreset_mode`` is that of Gymnasium. With ``NEXT_STEP``, the default, the step after the
    last one of an episode ignores its action and returns the first observation of the next
    episode. With ``SAME_STEP``, the last step of an episode returns this observation, and
    ``infos["final_obs"]`` holds the last observations. With ``DISABLED``, call ``reset`` with
    ``options={"reset_mask": mask}``.
    """

    def __init__(
        self,
        task: pg.Task,
        num_envs: int = 1,
        bound: float | Sequence[float] | None = None,
        autoreset_mode: AutoresetMode = AutoresetMode.NEXT_STEP,
    ) -> None:
        self.num_envs = operator.index(num_envs)
        if self.num_envs < 1:
            raise ValueError(f"`num_envs` is {num_envs}; allowed: at least 1")
        self.single_observation_space, self.single_action_space = _spaces(task)
        self.observation_space = batch_space(self.single_observation_space, num_envs)
        self.action_space = batch_space(self.single_action_space, num_envs)
        self.metadata = {"render_modes": [], "autoreset_mode": AutoresetMode(autoreset_mode)}
        self._rows = _Rows(task, *_range(task, bound), num_envs)

    @property
    def state(self) -> np.ndarray:
        """States, shape (num_envs, state_dim). A copy that refuses assignments; see ``reset``."""
        return _read_only(self._rows.x)

    @property
    def params(self) -> np.ndarray:
        """Parameters, shape (num_envs, param_dim). A copy that refuses assignments."""
        return _read_only(self._rows.p)

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[np.ndarray, dict]:
        """Draws initial states and parameters, of all environments or of those in a mask.

        ``options["reset_mask"]`` is the mask, a boolean array of shape (num_envs,).
        ``options["state"]``, shape (num_envs, state_dim), and ``options["params"]``, shape
        (num_envs, param_dim), replace the states and parameters drawn; rows outside of the mask
        have no effect. Raises ``ValueError`` or ``TypeError`` for other options or arrays.
        """
        _check_names(options, {"reset_mask", "state", "params"})
        options = dict(options or {})
        mask = options.pop("reset_mask", np.ones(self.num_envs, bool))
        _refuse_masked("reset_mask", mask)
        if not isinstance(mask, np.ndarray) or mask.dtype != np.bool_:
            kind = f"an array of {mask.dtype}" if isinstance(mask, np.ndarray) else f"of type {type(mask).__name__}"
            raise TypeError(f"`reset_mask` is {kind}; expected an array of bool, shape ({self.num_envs},)")
        _check_shape("reset_mask", mask, (self.num_envs,))
        if not mask.any():
            raise ValueError("`reset_mask` selects no environment; at least one must be True")
        given = self._rows.given(options, mask)
        super().reset(seed=seed)
        self._rows.start(mask, self.np_random, given)
        return self._rows.observe(), {}

    def step(self, actions: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray, dict]:
        """Applies actions, shape (num_envs, control_dim)."""
        mode, rows, infos = self.metadata["autoreset_mode"], self._rows, {}
        if not rows.begun.all():
            which = np.flatnonzero(~rows.begun)
            raise RuntimeError(f"environments {which}: the episode has not begun. Call `reset` first")
        ended = rows.t >= self.task.horizon
        if ended.any() and mode != AutoresetMode.NEXT_STEP:
            which = np.flatnonzero(ended)
            raise RuntimeError(f"environments {which}: the episode has ended. Call `reset` first")
        actions = _array("actions", actions)
        _check_shape("actions", actions, (self.num_envs, len(self._rows.high)))
        reward, truncated = rows.step(actions, ~ended)
        if mode == AutoresetMode.SAME_STEP and truncated.any():
            final, y = np.full(self.num_envs, None, object), rows.observe()
            for row in np.flatnonzero(truncated):
                final[row] = y[row]
            infos = {"final_obs": final, "_final_obs": truncated, "final_info": {}, "_final_info": truncated}
            ended = truncated
        if ended.any():
            rows.start(ended, self.np_random)
        return rows.observe(), reward, np.zeros(self.num_envs, bool), truncated, infos


def _check_names(options: dict[str, Any] | None, allowed: set[str]) -> None:
    unknown = sorted(map(str, set(options or {}) - allowed))
    if unknown:
        raise ValueError(f"`options` has {', '.join(map(repr, unknown))}; allowed: {', '.join(sorted(allowed))}")


def _read_only(array: np.ndarray) -> np.ndarray:
    """A copy that refuses assignments, which would have no effect."""
    copy = array.copy()
    copy.flags.writeable = False
    return copy


def _refuse_masked(name: str, value: Any) -> None:
    if isinstance(value, np.ma.MaskedArray):
        raise ValueError(f"`{name}` is a masked array; fill it, as in `{name}.filled(numpy.nan)`")


def _array(name: str, value: Any) -> np.ndarray:
    """The array of an argument. Refuses a masked one, whose mask would be lost."""
    for part in (value, *value) if isinstance(value, (list, tuple)) else (value,):
        _refuse_masked(name, part)
    return np.asarray(value)


def _check_shape(name: str, array: np.ndarray, expected: tuple[int, ...]) -> None:
    if array.shape != expected:
        raise ValueError(f"`{name}` has the shape {array.shape}; expected {expected}")


class _Rows:
    """States of several rollouts, which may be at different steps."""

    def __init__(self, task: pg.Task, low: np.ndarray, high: np.ndarray, count: int) -> None:
        self.task, self.low, self.high = task, low, high
        self.middle, self.half = 0.5 * low + 0.5 * high, 0.5 * high - 0.5 * low
        self.x = np.zeros((count, task.state_dim), task.dtype)
        self.p = np.zeros((count, task.param_dim), task.dtype)
        self.key = np.zeros((count, task.start_dim - task.state_dim - task.param_dim), task.dtype)
        self.t = np.full(count, task.horizon)
        self.begun = np.zeros(count, bool)

    def given(self, arrays: dict[str, Any], mask: np.ndarray) -> dict[str, np.ndarray]:
        """Checks states and parameters that a caller gives for the rows in ``mask``."""
        checked = {}
        for name, array in arrays.items():
            array = _array(name, array)
            own = {"state": self.x, "params": self.p}[name]
            if array.dtype.kind not in "fiu":
                raise TypeError(f"`{name}` is an array of {array.dtype}; expected numbers")
            _check_shape(name, array, own.shape)
            with np.errstate(over="ignore"):
                checked[name] = array.astype(own.dtype)
            if not np.isfinite(checked[name][mask]).all():
                raise ValueError(f"`{name}` is not finite in {own.dtype}")
        # An observation checks the ranges of the parameters, such as those of drawn masses.
        if "params" in checked:
            self.task.observe(checked.get("state", self.x)[mask], p=checked["params"][mask])
        return checked

    def start(self, mask: np.ndarray, rng: np.random.Generator, given: dict[str, np.ndarray] | None = None) -> None:
        """Draws initial states of the rows in ``mask``. Those in ``given`` replace them."""
        starts = self.task.starts(int(mask.sum()), seed=int(rng.integers(2**63)))
        self.x[mask] = starts[:, : self.task.state_dim]
        states, params = self.task.state_dim, self.task.param_dim
        self.p[mask] = starts[:, states : states + params]
        self.key[mask] = starts[:, states + params :]
        self.t[mask], self.begun[mask] = 0, True
        for name, array in (given or {}).items():
            {"state": self.x, "params": self.p}[name][mask] = array[mask]

    def _params(self, rows: np.ndarray, t: int) -> np.ndarray:
        """Parameters of these rows at step `t`, with the noise of this step."""
        if not self.key.size:
            return self.p[rows]
        starts = np.concatenate([self.x[rows], self.p[rows], self.key[rows]], axis=1)
        return self.task.params_at(starts, t)

    def step(self, actions: np.ndarray, mask: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Steps the rows in ``mask``. Returns rewards, 0 for other rows, and the rows that end."""
        bad = mask[:, None] & ~np.isfinite(actions)
        if bad.any():
            raise ValueError(f"environment {np.argwhere(bad)[0][0]}: the action is not finite")
        u = (self.middle + self.half * np.clip(actions, -1.0, 1.0)).astype(self.x.dtype)
        cost, after = np.zeros(len(self.x)), self.x.copy()
        for t in np.unique(self.t[mask]):
            rows = mask & (self.t == t)
            x, controls, p = self.x[rows], u[rows], self._params(rows, int(t))
            following = self.task.step(x, controls, p=p, t=int(t))
            cost[rows] = self.task.running_cost(x, controls, following, p=p, t=int(t))
            self._check(following, rows, t)
            after[rows] = following
        # An error above leaves the states and step numbers of all rows unchanged.
        self.x = after
        self.t[mask] += 1
        last = mask & (self.t == self.task.horizon)
        if last.any():
            p = self._params(last, self.task.horizon - 1)
            cost[last] += self.task.terminal_cost(self.x[last], p=p)
        return 0.0 - cost, last

    def _check(self, following: np.ndarray, rows: np.ndarray, t: int) -> None:
        if not np.isfinite(following).all():
            row, component = np.argwhere(~np.isfinite(following))[0]
            raise FloatingPointError(
                f"environment {np.flatnonzero(rows)[row]}, step {t}: `{self.task.state_names[component]}` is not finite. "
                "Use a smaller `bound`, or more substeps"
            )

    def observe(self) -> np.ndarray:
        """Observations, shape (rows, observation_dim)."""
        y = np.empty((len(self.x), self.task.observation_dim), self.x.dtype)
        for t in np.unique(self.t):
            rows = self.t == t
            y[rows] = self.task.observe(self.x[rows], p=self._params(rows, int(t)), t=int(t))
        return y


def _spaces(task: pg.Task) -> tuple[gymnasium.spaces.Box, gymnasium.spaces.Box]:
    """Spaces of observations and actions."""
    observations = gymnasium.spaces.Box(-np.inf, np.inf, (task.observation_dim,), np.dtype(task.dtype).type)
    return observations, gymnasium.spaces.Box(-1.0, 1.0, (task.control_dim,), np.float32)


def _range(task: pg.Task, bound: float | Sequence[float] | None) -> tuple[np.ndarray, np.ndarray]:
    """Controls at the actions -1 and 1, shape (control_dim,) each."""
    if bound is None:
        low, high = np.array(task.control_bounds or [(-np.inf, np.inf)] * task.control_dim).T.reshape(2, -1)
        if not np.isfinite([low, high]).all():
            raise ValueError(f"the task {task.name} has no bounds of its controls: pass `bound`, the control at action 1")
        return low, high
    bound = _array("bound", bound).astype(float)
    if bound.ndim > 1 or bound.size not in (1, task.control_dim) or not (np.isfinite(bound) & (bound > 0)).all():
        raise ValueError(f"`bound` is {bound.tolist()}: use one positive number, or {task.control_dim}, one per control")
    bound = np.broadcast_to(bound, (task.control_dim,))
    return -bound, bound


def _register() -> None:
    for name in _core.task_names():
        gymnasium.register(
            f"physgrad/{name}-v0",
            entry_point="physgrad.gym:make",
            vector_entry_point="physgrad.gym:make_vec",
            kwargs={"name": name},
        )


_register()
