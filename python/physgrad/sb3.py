"""Environments of Stable-Baselines3 over the tasks. ``pg.gym.make_sb3`` creates them."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from stable_baselines3.common.vec_env import VecEnv

from .gym import TaskVectorEnv

__all__ = ["TaskVecEnv"]

# Attributes of a vector environment with one row for each environment.
_PER_ROW = ("state", "params", "key")


class TaskVecEnv(VecEnv):
    """The environments of a ``TaskVectorEnv`` with the mode ``SAME_STEP``.

    The last step of an episode has the ``infos`` "terminal_observation", and
    "TimeLimit.truncated", which is True unless the condition of the task ended the episode: algorithms
    then add their estimate of later rewards. The environments have neither attributes to assign nor
    methods of their own.
    """

    def __init__(self, environments: TaskVectorEnv) -> None:
        self.environments, self.metadata = environments, environments.metadata
        super().__init__(
            environments.num_envs, environments.single_observation_space, environments.single_action_space
        )

    def reset(self) -> np.ndarray:
        """Begins episodes, with the seed of ``seed`` and the options of ``set_options``."""
        y, _ = self.environments.reset(seed=self._seeds[0], options=_joined(self._options))
        self._reset_seeds()
        self._reset_options()
        self.reset_infos = [{} for _ in range(self.num_envs)]
        return y

    def step_async(self, actions: np.ndarray) -> None:
        """Keeps the actions for ``step_wait``."""
        self._actions = actions

    def step_wait(self) -> tuple[np.ndarray, np.ndarray, np.ndarray, list[dict[str, Any]]]:
        """Applies the actions. Returns observations, rewards, ends of episodes, and infos."""
        y, reward, terminated, truncated, info = self.environments.step(self._actions)
        infos: list[dict[str, Any]] = [{} for _ in range(self.num_envs)]
        for row in np.flatnonzero(terminated | truncated):
            final = info["final_obs"][row]
            infos[row] = {"terminal_observation": final, "TimeLimit.truncated": bool(truncated[row])}
        return y, reward.astype(np.float32), terminated | truncated, infos

    def get_images(self) -> Sequence[np.ndarray | None]:
        """Pictures of all environments."""
        return self.environments.render() or [None] * self.num_envs

    def close(self) -> None:
        """Closes the environments."""
        self.environments.close()

    def get_attr(self, attr_name: str, indices: Any = None) -> list[Any]:
        """An attribute of the vector environment, the rows of ``state``, ``params`` and ``key``."""
        value = getattr(self.environments, attr_name)
        is_per_row = attr_name in _PER_ROW and value is not None
        return [value[row] if is_per_row else value for row in self._get_indices(indices)]

    def set_attr(self, attr_name: str, value: Any, indices: Any = None) -> None:
        """Raises an error: attributes do not change."""
        raise AttributeError(f"`{attr_name}` does not change; create other environments with `pg.gym.make_sb3`")

    def env_method(
        self, method_name: str, *method_args: Any, indices: Any = None, **method_kwargs: Any
    ) -> list[Any]:
        """Raises an error: the environments share their methods."""
        raise AttributeError(f"`{method_name}`: the environments have no methods of their own")

    def env_is_wrapped(self, wrapper_class: Any, indices: Any = None) -> list[bool]:
        """False for each environment."""
        return [False for _ in self._get_indices(indices)]


def _joined(options: list[dict[str, Any]]) -> dict[str, np.ndarray]:
    """Options of all environments, as a vector environment takes them."""
    names = set(options[0])
    if any(set(option) != names for option in options):
        raise ValueError("options of the environments have different names; give each environment the same ones")
    return {name: np.stack([option[name] for option in options]) for name in names}
