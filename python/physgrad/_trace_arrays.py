"""Constructors of NumPy for traced numbers.

NumPy offers no hook for `np.array([a, b])` of objects, nor for filling `np.zeros(n)`. While a
function is traced, the global variables of Python modules that are NumPy, or one of its
constructors, have replacements that make arrays of traced numbers. NumPy itself does not change:
compiled modules write to the memory of the arrays that they construct.
"""

from __future__ import annotations

import contextlib
import functools
import sys
import threading
import types
from collections.abc import Callable, Iterable, Iterator
from typing import Any

import numpy as np

from ._trace_errors import PACKAGES
from ._trace_numbers import is_traced
from ._trace_numpy import FUNCTIONS, full
from ._trace_vectors import Array, demote, finish, of_dtype, promote

CONVERTED = ("array", "asarray", "asanyarray", "ascontiguousarray")
FILLED = ("zeros", "ones", "empty", "full", "eye", "identity")
LIKE = ("zeros_like", "ones_like", "empty_like", "full_like")
# Two tracers at once would restore each other's variables.
LOCK = threading.RLock()
TRACING: list[int] = []


def converting(original: Callable) -> Callable:
    first = "object" if original is np.array else "a"

    def convert(*args: Any, **options: Any) -> Any:
        options = dict(zip((first, "dtype", "order"), args)) | options
        if first not in options or len(args) > 3:
            return original(*args, **options)
        value, dtype = options.pop(first), options.pop("dtype", None)
        copies = original is np.array and options.get("copy", True)
        if not is_traced(value) and not isinstance(value, Array):
            result = original(demote(value), dtype=dtype, **options)
            return promote(result) if copies else result
        if isinstance(value, Array) and options.keys() <= {"copy"}:
            result = Array.copy(value) if copies else value
        else:
            result = finish(original(value, dtype=object, **options))
        return result if dtype is None else of_dtype(result, dtype)

    return convert


def filling(original: Callable) -> Callable:
    def fill(*args: Any, **options: Any) -> Any:
        if original is np.full and is_traced([*args, *options.values()]):
            return full(*args, **options)
        result = original(*args, **options)
        return promote(result.astype(float) if result.dtype == object else result)

    return fill


def like(original: Callable) -> Callable:
    """NumPy asks traced numbers about np.full_like(a, b) only if `a` is an array of them."""

    def fill(*args: Any, **options: Any) -> Any:
        found = is_traced([*args, *options.values()])
        return (FUNCTIONS[original.__name__] if found else original)(*args, **options)

    return fill


def on_the_thread(original: Callable, replacement: Callable) -> Callable:
    """The replacement on the thread of the tracer, and otherwise the function of NumPy."""

    @functools.wraps(original)
    def constructor(*args: Any, **options: Any) -> Any:
        of_tracer = TRACING[-1:] == [threading.get_ident()]
        return (replacement if of_tracer else original)(*args, **options)

    return constructor


REPLACED = {
    name: on_the_thread(getattr(np, name), replacing(getattr(np, name)))
    for names, replacing in ((CONVERTED, converting), (FILLED, filling), (LIKE, like))
    for name in names
}
BY_ORIGINAL = {id(getattr(np, name)): replacement for name, replacement in REPLACED.items()}


class Numpy(types.ModuleType):
    """NumPy with other constructors."""

    def __getattr__(self, name: str) -> Any:
        return getattr(np, name)


NUMPY = Numpy("numpy")
vars(NUMPY).update(REPLACED)
BY_ORIGINAL[id(np)] = NUMPY


def variables(functions: Iterable[Callable]) -> Iterator[dict[str, Any]]:
    """Global variables of the functions, and of the Python modules besides NumPy and its like."""
    for function in functions:
        while isinstance(function, functools.partial):
            function = function.func
        code = getattr(function, "__func__", function)
        code = code if hasattr(code, "__globals__") else getattr(type(function), "__call__", None)
        if hasattr(code, "__globals__"):
            yield code.__globals__
    for name, module in list(sys.modules.items()):
        compiled = str(getattr(module, "__file__", None)).endswith((".so", ".pyd"))
        if (
            type(module) is types.ModuleType
            and not compiled
            and name.split(".")[0] not in (*PACKAGES, "scipy")
        ):
            yield vars(module)


@contextlib.contextmanager
def of_numpy() -> Iterator[None]:
    """Leaves NumPy as it is, for packages that run while a function is traced."""
    TRACING.append(0)
    try:
        yield
    finally:
        TRACING.pop()


@contextlib.contextmanager
def constructors(functions: Iterable[Callable]) -> Iterator[None]:
    """Replaces NumPy in the code of the user, and restores it."""
    with LOCK:
        changed = []
        TRACING.append(threading.get_ident())
        try:
            for scope in variables(functions):
                for name, value in list(scope.items()):
                    replacement = BY_ORIGINAL.get(id(value))
                    if replacement is not None:
                        changed.append((scope, name, value))
                        scope[name] = replacement
            yield
        finally:
            for scope, name, value in reversed(changed):
                scope[name] = value
            TRACING.pop()
