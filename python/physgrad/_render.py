"""Pictures of an episode, and a window that shows them."""

from __future__ import annotations

import numpy as np

import physgrad as pg

from . import _core

MODES = ("rgb_array", "human")


class Film:
    """The episode so far of one environment, and the picture of its last state.

    A picture depends on this episode alone. Its view contains all states so far, so it may grow. The
    camera of a cart moves when the cart comes near an edge.
    """

    def __init__(self, task: pg.Task) -> None:
        self._task = task

    def begin(self, x: np.ndarray, p: np.ndarray) -> None:
        """Forgets the episode before. `p` has the parameters of the first step."""
        self._x, self._u, self._p = [x], [], [p]
        self._picture = None

    def add(self, u: np.ndarray, x: np.ndarray, p: np.ndarray) -> None:
        """Adds the control and the parameters of a step, and the state after it."""
        self._u.append(u)
        self._x.append(x)
        # A picture needs parameters for each state. The last state has those of the last step.
        self._p[-1:] = [p, p]
        self._picture = None

    def picture(self) -> np.ndarray:
        """Red, green and blue of every pixel, uint8 of shape (height, width, 3)."""
        if self._picture is None:
            u = np.reshape(self._u, (len(self._u), self._task.control_dim))
            self._picture = _core.picture(self._task, self._x, u, self._p)
        return self._picture.copy()


class Window:
    """A window of pygame, which opens with the first picture."""

    def __init__(self, title: str, fps: int) -> None:
        try:
            import pygame  # noqa: F401
        except ImportError as error:
            from gymnasium.error import DependencyNotInstalled

            message = "`render_mode='human'` shows a window by pygame: run `pip install pygame`"
            raise DependencyNotInstalled(message) from error
        self._title, self._fps, self._screen = title, fps, None

    def show(self, picture: np.ndarray) -> None:
        """Shows a picture, and waits so that pictures follow each other in real time."""
        import pygame

        if self._screen is None:
            pygame.display.init()
            self._screen = pygame.display.set_mode((picture.shape[1], picture.shape[0]))
            pygame.display.set_caption(self._title)
            self._clock = pygame.time.Clock()
        self._screen.blit(pygame.surfarray.make_surface(picture.swapaxes(0, 1)), (0, 0))
        pygame.event.pump()
        self._clock.tick(self._fps)
        pygame.display.flip()

    def close(self) -> None:
        """Closes the window. The next picture opens another one."""
        if self._screen is not None:
            import pygame

            pygame.display.quit()
            self._screen = None
