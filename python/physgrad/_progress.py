"""The progress of a training, as one line of a terminal or a notebook."""

from __future__ import annotations

import importlib
import multiprocessing
import sys
import threading
import time
import warnings
from collections.abc import Callable
from typing import Any

Record = dict[str, float]


def is_watched() -> bool:
    """Returns whether somebody sees a line that changes: in a terminal or a notebook. Other threads and
    processes, of which several may train at once, have no line."""
    if threading.current_thread() is not threading.main_thread() or multiprocessing.parent_process():
        return False
    shell = sys.modules.get("IPython")
    if shell is not None and getattr(shell.get_ipython(), "kernel", None) is not None:
        return True
    try:
        return sys.stderr.isatty()
    except (AttributeError, OSError, ValueError):
        # None, another object, or a closed stream.
        return False


class Line:
    """A line of standard error that rewrites itself at most ten times per second."""

    def __init__(self, total: int) -> None:
        self.total, self.done, self.width = total, 0, 0
        self.start, self.shown, self.loss = time.monotonic(), 0.0, ""

    def update(self) -> None:
        self.done += 1
        now = time.monotonic()
        if now - self.shown >= 0.1:
            self.shown = now
            self.show("")

    def set_postfix_str(self, loss: str, refresh: bool = True) -> None:
        self.loss = loss

    def show(self, end: str) -> None:
        seconds = f"{time.monotonic() - self.start:.0f} s"
        text = ", ".join(filter(None, (f"epoch {self.done}/{self.total}", self.loss, seconds)))
        # Spaces cover the rest of a longer text.
        print(f"\r{text:<{self.width}}", end=end, file=sys.stderr, flush=True)
        self.width = len(text)

    def close(self) -> None:
        self.show("\n")


def bar(total: int) -> Any:
    """A bar of tqdm if it is installed, and otherwise a line, before the first of `total` epochs."""
    try:
        with warnings.catch_warnings():
            # Without ipywidgets, tqdm warns in notebooks and then writes text.
            warnings.simplefilter("ignore")
            tqdm = importlib.import_module("tqdm.auto").tqdm
    except ImportError:
        return Line(total)
    return tqdm(total=total, unit="epoch")


class Progress:
    """A callback of a training that shows its progress, before it calls another callback."""

    def __init__(self, total: int, callback: Callable[[Record], object] | None) -> None:
        self.callback: Callable[[Record], object] | None = callback
        self.bar: Any = None
        self.show(lambda: setattr(self, "bar", bar(total)))

    def __call__(self, record: Record) -> object:
        if self.bar is not None:
            self.bar.set_postfix_str(f"test loss {record['test_loss']:.4g}", refresh=False)
            self.show(self.bar.update)
        return None if self.callback is None else self.callback(record)

    def close(self) -> None:
        if self.bar is not None:
            self.show(self.bar.close)

    def show(self, draw: Callable[[], object]) -> None:
        """Draws, and never again after an error: a stream that is closed or full ends no training."""
        try:
            draw()
        except (AttributeError, OSError, ValueError):
            self.bar = None
