"""Gymnasium environments over the tasks.

``pg.gym.make("cart_pole", poles=1)`` returns an ``Env``, ``pg.gym.make_vec("cart_pole", 16)`` a
``VectorEnv``, and ``pg.gym.make_sb3("cart_pole", 16)`` a ``VecEnv`` of Stable-Baselines3. One call of
the physics steps all environments that have equal step numbers. After ``import physgrad.gym``, the
ids ``physgrad/NAME-v0`` of all presets, such as ``physgrad/half_cheetah_run-v0``, work with
``gymnasium.make`` and ``gymnasium.make_vec``; without an import, ``physgrad.gym:physgrad/NAME-v0`` does.

- An episode has ``horizon`` steps. The last step returns ``truncated``: observations contain no
  clock, so the end is no property of the last state. A task with a condition ``loss.end`` returns
  ``terminated`` in the step after which the condition holds.
- The reward is minus the running cost; the last one also subtracts the terminal cost. The sum of
  the rewards of an episode is therefore minus the loss of its rollout.
- The observation is that of a policy, without normalization.
- The action space is the box from -1 to 1. Action -1 is the control ``low``, action 1 the control
  ``high``; other actions lie on the line between them. Actions are clipped to the box.
- ``info`` of a step is empty, except in the mode ``SAME_STEP`` of a vector environment.
- ``render_mode`` is ``"rgb_array"`` or, for one environment, ``"human"``. Pictures are those of
  ``physgrad animate``.
"""

from __future__ import annotations

import dataclasses
import math
import operator
import re
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import gymnasium
import numpy as np
from gymnasium.utils import seeding
from gymnasium.vector import AutoresetMode
from gymnasium.vector.utils import batch_space

import physgrad as pg

from . import _core, _render

if TYPE_CHECKING:
    from .sb3 import TaskVecEnv

__all__ = ["TaskEnv", "TaskVectorEnv", "make", "make_sb3", "make_vec"]


def _opened(task: str | pg.Task, steps: int | None, settings: dict[str, Any]) -> pg.Task:
    """The task of this name or path, or this task, with other settings and a number of steps."""
    if steps is not None:
        if settings.setdefault("horizon", steps) != steps:
            other = settings["horizon"]
            raise ValueError(f"`max_episode_steps` is {steps}, but `horizon` is {other}; use one of them")
    if isinstance(task, pg.Task):
        return task.replace(**settings) if settings else task
    id = re.fullmatch(r"(?:physgrad\.gym:)?physgrad/(.+)-v\d+", str(task))
    if id is not None:
        raise ValueError(f"`{task}` is an id for `gymnasium.make`; the name is `{id[1]}`")
    return pg.task(task, **settings)


def make(
    name: str | pg.Task,
    *,
    bound: float | Sequence[float] | None = None,
    render_mode: str | None = None,
    max_episode_steps: int | None = None,
    **settings: Any,
) -> TaskEnv:
    """Creates an environment over a task, or over ``pg.task(name, **settings)``.

    Controls range from ``-bound`` to ``bound``, one number or one per control, in units of the
    control. Default: ``task.control_bounds``. Raises ``ValueError`` if neither is finite.
    ``render_mode`` is "rgb_array", "human" or None. ``max_episode_steps`` is another name of the
    setting ``horizon``.
    """
    return TaskEnv(_opened(name, max_episode_steps, settings), bound, render_mode)


def make_vec(
    name: str | pg.Task,
    num_envs: int = 1,
    *,
    bound: float | Sequence[float] | None = None,
    render_mode: str | None = None,
    max_episode_steps: int | None = None,
    **settings: Any,
) -> TaskVectorEnv:
    """Creates ``num_envs`` environments with the mode ``NEXT_STEP``. Other arguments: see ``make``.

    ``TaskVectorEnv`` accepts other modes. ``render_mode`` is "rgb_array" or None.
    """
    task = _opened(name, max_episode_steps, settings)
    return TaskVectorEnv(task, num_envs, bound, render_mode=render_mode)


def make_sb3(
    name: str | pg.Task,
    n_envs: int = 1,
    *,
    bound: float | Sequence[float] | None = None,
    render_mode: str | None = None,
    max_episode_steps: int | None = None,
    **settings: Any,
) -> TaskVecEnv:
    """Creates ``n_envs`` environments for algorithms of Stable-Baselines3. Arguments: see ``make_vec``."""
    from .sb3 import TaskVecEnv

    task = _opened(name, max_episode_steps, settings)
    return TaskVecEnv(TaskVectorEnv(task, n_envs, bound, AutoresetMode.SAME_STEP, render_mode))


class _Shared:
    """Attributes that both environments share. Assignments raise an error: they would have no effect."""

    _rows: _Rows
    _spec: Any = None

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

    @property
    def spec(self) -> Any:
        """The ``EnvSpec`` of ``gymnasium.make``, with the number of steps of an episode, or None."""
        return self._spec

    @spec.setter
    def spec(self, spec: Any) -> None:
        # Gymnasium assigns it, without the number, because no id has one: its wrapper `TimeLimit`
        # would end episodes with a longer `horizon`. Other libraries read the number here.
        self._spec = spec and dataclasses.replace(spec, max_episode_steps=self.task.horizon)


class TaskEnv(_Shared, gymnasium.Env):
    """One environment over ``task``, a ``Task``. See the module for rewards and ends of episodes.

    Attributes, which do not change: ``task``; ``low`` and ``high``, the controls at actions -1 and
    1, shape (control_dim,); ``state``, shape (state_dim,); ``params``, shape (param_dim,); ``key``.
    """

    metadata: dict[str, Any] = {"render_modes": list(_render.MODES), "render_fps": 50}

    def __init__(
        self, task: pg.Task, bound: float | Sequence[float] | None = None, render_mode: str | None = None
    ) -> None:
        _check_mode(render_mode, _render.MODES)
        self.observation_space, self.action_space = _spaces(task)
        self.render_mode = render_mode
        self.metadata = {**self.metadata, "render_fps": _fps(task)}
        self._rows = _Rows(task, *_range(task, bound), 1, render_mode)
        self._window = _render.Window(task.name, _fps(task)) if render_mode == "human" else None

    @property
    def state(self) -> np.ndarray:
        """State, shape (state_dim,). A copy that refuses assignments; see ``reset``."""
        return _read_only(self._rows.x[0])

    @property
    def params(self) -> np.ndarray:
        """Parameters of the episode, shape (param_dim,). A copy that refuses assignments."""
        return _read_only(self._rows.p[0])

    @property
    def key(self) -> int | None:
        """Key of the noise of the episode, or None for a task without noise."""
        return int(self._rows.key[0, 0]) if self._rows.key.size else None

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[np.ndarray, dict]:
        """Draws an initial state and parameters.

        ``options["state"]``, shape (state_dim,), ``options["params"]``, shape (param_dim,), and
        ``options["key"]``, the key of the noise, a whole number below 2^24, replace those drawn.
        Raises ``ValueError`` for other options.
        """
        _check_names(options, {"state", "params", "key"})
        given = {name: _array(name, value) for name, value in (options or {}).items()}
        shapes = {"state": (self.task.state_dim,), "params": (self.task.param_dim,), "key": ()}
        for name, array in given.items():
            _check_shape(name, array, shapes[name])
        everything = np.ones(1, bool)
        given = self._rows.given({name: value[None] for name, value in given.items()}, everything)
        super().reset(seed=seed)
        self._rows.start(everything, self.np_random, given)
        self._show()
        return self._rows.observe()[0], {}

    def step(self, action: np.ndarray) -> tuple[np.ndarray, float, bool, bool, dict]:
        """Applies an action, shape (control_dim,)."""
        rows = self._rows
        if rows.over[0]:
            raise RuntimeError(f"step {rows.t[0]}: the episode has ended or not begun. Call `reset` first")
        action = _array("action", action)
        _check_shape("action", action, rows.high.shape)
        reward = rows.step(action[None])
        if self._window is not None:
            self._show()
        terminated = bool(rows.terminated[0])
        truncated = rows.together == rows.horizon and not terminated
        return rows.observe()[0], float(reward[0]), terminated, truncated, {}

    def _show(self) -> None:
        if self._window is not None:
            self._window.show(self._rows.pictures()[0])

    def render(self) -> np.ndarray | None:
        """The picture of the state, uint8 of shape (height, width, 3). None without the mode "rgb_array".

        In the mode "human", ``reset`` and ``step`` show it in a window.
        """
        if self.render_mode is None:
            message = "has no render mode; create it with `render_mode='rgb_array'`"
            gymnasium.logger.warn(f"{self.task.name} {message}")
        return self._rows.pictures()[0] if self.render_mode == "rgb_array" else None

    def close(self) -> None:
        """Closes the window."""
        if self._window is not None:
            self._window.close()


class TaskVectorEnv(_Shared, gymnasium.vector.VectorEnv):
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
        render_mode: str | None = None,
    ) -> None:
        _check_mode(render_mode, _render.MODES[:1])
        self.num_envs = operator.index(num_envs)
        if self.num_envs < 1:
            raise ValueError(f"`num_envs` is {num_envs}; allowed: at least 1")
        self.single_observation_space, self.single_action_space = _spaces(task)
        self.observation_space = batch_space(self.single_observation_space, num_envs)
        self.action_space = batch_space(self.single_action_space, num_envs)
        self.render_mode = render_mode
        self.metadata = {
            "render_modes": list(_render.MODES[:1]),
            "render_fps": _fps(task),
            "autoreset_mode": AutoresetMode(autoreset_mode),
        }
        self._rows = _Rows(task, *_range(task, bound), num_envs, render_mode)
        self._generators: list[np.random.Generator] | None = None

    @property
    def state(self) -> np.ndarray:
        """States, shape (num_envs, state_dim). A copy that refuses assignments; see ``reset``."""
        return _read_only(self._rows.x)

    @property
    def params(self) -> np.ndarray:
        """Parameters, shape (num_envs, param_dim). A copy that refuses assignments."""
        return _read_only(self._rows.p)

    @property
    def key(self) -> np.ndarray | None:
        """Keys of the noise, shape (num_envs,), or None for a task without noise."""
        return _read_only(self._rows.key[:, 0].astype(int)) if self._rows.key.size else None

    def reset(
        self, *, seed: int | Sequence[int | None] | None = None, options: dict[str, Any] | None = None
    ) -> tuple[np.ndarray, dict]:
        """Draws initial states and parameters, of all environments or of those in a mask.

        ``seed`` is one number for all environments, or a list with one for each: an environment
        then has the episodes of a ``TaskEnv`` with its seed, until the next ``reset`` with one number.

        ``options["reset_mask"]`` is the mask, a boolean array of shape (num_envs,).
        ``options["state"]``, shape (num_envs, state_dim), ``options["params"]``, shape (num_envs,
        param_dim), and ``options["key"]``, shape (num_envs,), replace the states, parameters and
        keys of noise drawn; rows outside of the mask have no effect. Raises ``ValueError`` or
        ``TypeError`` for other options or arrays.
        """
        _check_names(options, {"reset_mask", "state", "params", "key"})
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
        self._seed(seed, mask)
        self._rows.start(mask, self._generators or self.np_random, given)
        return self._rows.observe(), {}

    def _seed(self, seed: int | Sequence[int | None] | None, mask: np.ndarray) -> None:
        if seed is None or isinstance(seed, (int, np.integer)):
            self._generators = self._generators if seed is None else None
            super().reset(seed=None if seed is None else int(seed))
            return
        seeds = list(seed)
        if len(seeds) != self.num_envs:
            expected = f"one, or one for each of {self.num_envs} environments"
            raise ValueError(f"`seed` has {len(seeds)} numbers; expected {expected}")
        made = [seeding.np_random(None if seed is None else operator.index(seed))[0] for seed in seeds]
        kept = self._generators or made
        seeded = [selected and seed is not None for selected, seed in zip(mask, seeds)]
        self._generators = [new if own else old for own, new, old in zip(seeded, made, kept)]

    def step(self, actions: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray, dict]:
        """Applies actions, shape (num_envs, control_dim)."""
        mode, rows, infos = self.metadata["autoreset_mode"], self._rows, {}
        if not rows.begun.all():
            which = np.flatnonzero(~rows.begun)
            raise RuntimeError(f"environments {which}: the episode has not begun. Call `reset` first")
        ended = rows.over
        if ended.any() and mode != AutoresetMode.NEXT_STEP:
            which = np.flatnonzero(ended)
            raise RuntimeError(f"environments {which}: the episode has ended. Call `reset` first")
        actions = _array("actions", actions)
        _check_shape("actions", actions, (self.num_envs, len(rows.high)))
        reward = rows.step(actions, ~ended if ended.any() else None)
        terminated = rows.terminated & ~ended
        truncated = (rows.t == rows.horizon) & ~ended & ~terminated
        last = terminated | truncated
        if mode == AutoresetMode.SAME_STEP and last.any():
            final, y = np.full(self.num_envs, None, object), rows.observe()
            for row in np.flatnonzero(last):
                final[row] = y[row]
            infos = {"final_obs": final, "_final_obs": last, "final_info": {}, "_final_info": last}
            ended = last
        if ended.any():
            rows.start(ended, self._generators or self.np_random)
        return rows.observe(), reward, terminated, truncated, infos

    def render(self) -> tuple[np.ndarray, ...] | None:
        """Pictures of all states, uint8 of shape (height, width, 3) each. None without a render mode."""
        return tuple(self._rows.pictures()) if self.render_mode is not None else None


def _check_mode(mode: str | None, allowed: Sequence[str]) -> None:
    if mode is not None and mode not in allowed:
        raise ValueError(f"`render_mode` is {mode!r}; allowed: {', '.join(map(repr, allowed))}, None")


def _fps(task: pg.Task) -> int:
    """Pictures per second in real time."""
    return max(round(1.0 / task.dt), 1)


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

    def __init__(
        self, task: pg.Task, low: np.ndarray, high: np.ndarray, count: int, render_mode: str | None
    ) -> None:
        self.task, self.low, self.high, self.horizon = task, low, high, task.horizon
        self.middle, self.half = 0.5 * low + 0.5 * high, 0.5 * high - 0.5 * low
        self.x = np.zeros((count, task.state_dim), task.dtype)
        self.p = np.zeros((count, task.param_dim), task.dtype)
        self.key = np.zeros((count, task.start_dim - task.state_dim - task.param_dim), task.dtype)
        # The step number of all rows, or None if they differ.
        self.together: int | None = task.horizon
        self._t = np.full(count, task.horizon)
        # Observations of the states, if `step` has computed them.
        self._observed: np.ndarray | None = None
        self.begun = np.zeros(count, bool)
        self.films = [] if render_mode is None else [_render.Film(task) for _ in range(count)]

    @property
    def t(self) -> np.ndarray:
        """Step numbers of the rows. A copy."""
        return self._t.copy() if self.together is None else np.full(len(self.x), self.together)

    @t.setter
    def t(self, t: np.ndarray) -> None:
        self._t, self.together = t, int(t[0]) if (t == t[0]).all() else None

    @property
    def terminated(self) -> np.ndarray:
        """Whether the condition of the task has ended the episode of each row."""
        ended = self.task.ended
        return np.zeros(len(self.x), bool) if ended is None else self.x[:, ended] != 0

    @property
    def over(self) -> np.ndarray:
        """Whether the episode of each row has ended, at the horizon or before."""
        return (self.t >= self.horizon) | self.terminated

    def given(self, arrays: dict[str, Any], mask: np.ndarray) -> dict[str, np.ndarray]:
        """Checks states, parameters and keys that a caller gives for the rows in ``mask``."""
        checked = {}
        for name, array in arrays.items():
            array = _array(name, array)
            if array.dtype.kind not in "fiu":
                raise TypeError(f"`{name}` is an array of {array.dtype}; expected numbers")
            if name == "key":
                array = self._checked_key(array, mask)
            own = {"state": self.x, "params": self.p, "key": self.key}[name]
            _check_shape(name, array, own.shape)
            with np.errstate(over="ignore"):
                checked[name] = array.astype(own.dtype)
            if not np.isfinite(checked[name][mask]).all():
                raise ValueError(f"`{name}` is not finite in {own.dtype}")
        # An observation checks the ranges of the parameters, such as those of drawn masses.
        if "params" in checked:
            self.task.observe(checked.get("state", self.x)[mask], p=checked["params"][mask])
        return checked

    def _checked_key(self, key: np.ndarray, mask: np.ndarray) -> np.ndarray:
        if not self.key.size:
            raise ValueError(f"`key` is the key of noise, but the task {self.task.name} has no noise")
        _check_shape("key", key, self.begun.shape)
        for value in key[mask]:
            if not 0 <= value < 2**24 or value != np.floor(value):
                raise ValueError(f"`key` is {value}; allowed: a whole number from 0 to {2**24 - 1}")
        return key[:, None]

    def start(
        self,
        mask: np.ndarray,
        rng: np.random.Generator | list[np.random.Generator],
        given: dict[str, np.ndarray] | None = None,
    ) -> None:
        """Draws initial states of the rows in ``mask``. Those in ``given`` replace them.

        ``rng`` is one generator for all rows, or a list with one for each.
        """
        if isinstance(rng, list):
            starts = np.concatenate([self._drawn(1, rng[row]) for row in np.flatnonzero(mask)])
        else:
            starts = self._drawn(int(mask.sum()), rng)
        states, params = self.task.state_dim, self.task.param_dim
        self.x[mask] = starts[:, :states]
        self.p[mask] = starts[:, states : states + params]
        self.key[mask] = starts[:, states + params :]
        self.t, self.begun[mask], self._observed = np.where(mask, 0, self.t), True, None
        for name, array in (given or {}).items():
            {"state": self.x, "params": self.p, "key": self.key}[name][mask] = array[mask]
        if self.films:
            p = self._params(slice(None), 0)
            for row in np.flatnonzero(mask):
                self.films[row].begin(self.x[row].copy(), p[row].copy())

    def _drawn(self, count: int, rng: np.random.Generator) -> np.ndarray:
        return self.task.starts(count, seed=int(rng.integers(2**63)))

    def _params(self, rows: np.ndarray | slice, t: int) -> np.ndarray:
        """Parameters of these rows at step `t`, with the noise of this step."""
        if not self.key.size:
            return self.p[rows]
        starts = np.concatenate([self.x[rows], self.p[rows], self.key[rows]], axis=1)
        return self.task.params_at(starts, t)

    def step(self, actions: np.ndarray, mask: np.ndarray | None = None) -> np.ndarray:
        """Steps the rows in ``mask``, or all. Returns rewards, 0 for other rows."""
        u = self._controls(actions, mask)
        if mask is None and self.together is not None:
            # All rows are at one step, as the row of a single environment is.
            p = self._params(_ALL, self.together)
            self.x, cost, y = self._advanced(_ALL, u, p, self.together)
            self.together += 1
            # Noise has other values at the next step, which an observation may contain.
            self._observed = None if self.key.size else y
        else:
            mask = np.ones(len(self.x), bool) if mask is None else mask
            t, cost, after, p = self.t, np.zeros(len(self.x)), self.x.copy(), self.p.copy()
            for number in np.unique(t[mask]):
                rows = mask & (t == number)
                p[rows] = self._params(rows, int(number))
                after[rows], cost[rows], _ = self._advanced(rows, u[rows], p[rows], int(number))
            # An error above leaves the states and step numbers of all rows unchanged.
            self.x, self.t, self._observed = after, t + mask, None
        for row, film in enumerate(self.films):
            if mask is None or mask[row]:
                film.add(u[row], self.x[row].copy(), p[row].copy())
        if self.together is None or self.together == self.horizon:
            last = (self.t == self.horizon) & (True if mask is None else mask)
            if last.any():
                p = self._params(last, self.horizon - 1)
                cost[last] += self.task.terminal_cost(self.x[last], p=p)
        return 0.0 - cost

    def _controls(self, actions: np.ndarray, mask: np.ndarray | None) -> np.ndarray:
        if actions.dtype.kind not in "biuf":
            raise TypeError(f"the action is an array of {actions.dtype}; expected numbers")
        if not _is_finite(actions):
            bad = ~np.isfinite(actions) & (True if mask is None else mask[:, None])
            if bad.any():
                raise ValueError(f"environment {np.argwhere(bad)[0][0]}: the action is not finite")
        clipped = np.minimum(np.maximum(actions, -1.0), 1.0)
        return (self.middle + self.half * clipped).astype(self.x.dtype)

    def _advanced(
        self, rows: np.ndarray | slice, u: np.ndarray, p: np.ndarray, t: int
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """States after step `t` of these rows, costs of the step, and observations of the states."""
        following, y, cost = self.task.transition(self.x[rows], u, p, t)
        if not _is_finite(following):
            row, component = np.argwhere(~np.isfinite(following))[0]
            raise FloatingPointError(
                f"environment {np.arange(len(self.x))[rows][row]}, step {t}: "
                f"`{self.task.state_names[component]}` is not finite. Use a smaller `bound`, or more substeps"
            )
        return following, cost.astype(float), y

    def observe(self) -> np.ndarray:
        """Observations, shape (rows, observation_dim)."""
        if self._observed is not None:
            return self._observed
        if self.together is not None:
            return self.task.observe(self.x, self._params(_ALL, self.together), self.together)
        y = np.empty((len(self.x), self.task.observation_dim), self.x.dtype)
        for t in np.unique(self._t):
            rows = self._t == t
            y[rows] = self.task.observe(self.x[rows], p=self._params(rows, int(t)), t=int(t))
        return y

    def pictures(self) -> list[np.ndarray]:
        """Pictures of all rows."""
        if not self.begun.all():
            raise RuntimeError("the episode has not begun. Call `reset` first")
        return [film.picture() for film in self.films]


_ALL = slice(None)


def _is_finite(array: np.ndarray) -> bool:
    # NumPy takes several times as long for few elements.
    if array.size <= 32:
        return all(map(math.isfinite, array.ravel().tolist()))
    return bool(np.isfinite(array).all())


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


# `gymnasium.make` looks here for the modes that it implements itself, such as "rgb_array_list".
make.metadata = TaskEnv.metadata


def _register() -> None:
    # A task of the user's own crate has no preset.
    for name in {*_core.task_names(), *pg.presets()}:
        gymnasium.register(
            f"physgrad/{name}-v0",
            entry_point="physgrad.gym:make",
            vector_entry_point="physgrad.gym:make_vec",
            kwargs={"name": name},
        )


_register()
