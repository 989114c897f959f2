"""Constructors of NumPy for traced numbers.

NumPy offers no hook for `np.array([a, b])` of objects, nor for filling `np.zeros(n)`. While a
function is traced, the constructors below make arrays that hold traced numbers, for code of the
user on the thread of the tracer. All other calls reach NumPy.
"""

from __future__ import annotations

import contextlib
import sys
import threading
from collections.abc import Callable, Iterator
from typing import Any

import numpy as np

from ._trace_errors import PACKAGES
from ._trace_numbers import check_dtype, is_traced
from ._trace_vectors import Array, finish, promote

CONVERTED = ("array", "asarray", "asanyarray", "ascontiguousarray")
FILLED = ("zeros", "ones", "empty", "full", "eye", "identity")
# Two tracers at once would restore each other's functions.
LOCK = threading.RLock()


def converting(original: Callable) -> Callable:
    def convert(value: Any, dtype: Any = None, **options: Any) -> Any:
        copies = original is ORIGINALS["array"] and options.get("copy", True)
        if not is_traced(value) and not isinstance(value, Array):
            result = original(value, dtype=dtype, **options)
            return promote(result) if copies else result
        if dtype is not None:
            check_dtype(dtype)
        if isinstance(value, Array) and options.keys() <= {"copy"}:
            return Array.copy(value) if copies else value
        return finish(original(value, dtype=object, **options))

    return convert


def filling(original: Callable) -> Callable:
    def fill(*args: Any, **options: Any) -> Any:
        if original is ORIGINALS["full"] and is_traced(list(args[1:]) + [options.get("fill_value")]):
            return finish(original(*args, **{"dtype": object, **options}))
        result = original(*args, **options)
        if result.dtype == object:
            result = result.astype(float)
        return promote(result)

    return fill


ORIGINALS = {name: getattr(np, name) for name in CONVERTED + FILLED}
REPLACEMENTS = {
    name: (converting if name in CONVERTED else filling)(original) for name, original in ORIGINALS.items()
}


def for_user(name: str, thread: int) -> Callable:
    """The replacement for code of the user on one thread, and otherwise the function of NumPy."""
    original, replacement = ORIGINALS[name], REPLACEMENTS[name]

    def constructor(*args: Any, **options: Any) -> Any:
        package = sys._getframe(1).f_globals.get("__name__", "").split(".")[0]
        of_user = package not in (*PACKAGES, "scipy") and threading.get_ident() == thread
        return (replacement if of_user else original)(*args, **options)

    return constructor


@contextlib.contextmanager
def constructors() -> Iterator[None]:
    """Replaces the constructors of NumPy, and restores them."""
    with LOCK:
        before = {name: getattr(np, name) for name in ORIGINALS}
        try:
            for name in ORIGINALS:
                setattr(np, name, for_user(name, threading.get_ident()))
            yield
        finally:
            for name, function in before.items():
                setattr(np, name, function)
