"""Sums, products and extremes of traced numbers along axes, in the order of NumPy."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import numpy as np

from ._trace_elements import check_options, of_numbers
from ._trace_numbers import is_bool, refuse
from ._trace_vectors import as_numbers, finish, plain


def reduce(name: str, value: Any, axis: Any = None, keepdims: bool = False, initial: Any = None) -> Any:
    """Combines the elements along axes, in the order of NumPy."""
    array = plain(value)
    # NumPy counts conditions. Their maximum is a condition.
    of_conditions = name.startswith("logical") or all(map(is_bool, array.flat))
    if name in ("add", "multiply") or not of_conditions:
        array = as_numbers(array)
    axes = axes_of(axis, array.ndim)
    if not axes:
        return finish(array.copy())
    kept = [a for a in range(array.ndim) if a not in axes]
    shape = tuple(1 if a in axes else n for a, n in enumerate(array.shape)) if keepdims else None
    # NumPy adds in pairs along the last axis, and one after the other along others.
    in_pairs = name == "add" and axes == list(range(array.ndim - len(axes), array.ndim))
    moved = array.transpose([*kept, *axes])
    lead = moved.shape[: len(kept)]
    rows = moved.reshape((math.prod(lead), -1))
    out = np.empty(len(rows), dtype=object)
    for i, row in enumerate(rows):
        parts = list(row) if initial is None or initial is np._NoValue else [initial, *row]
        out[i] = combine_all(name, parts, in_pairs)
    return finish(out.reshape(lead if shape is None else shape))


def keeps(keepdims: Any) -> bool:
    """Whether a reduction keeps its axes. NumPy takes 1 for True."""
    return keepdims is not np._NoValue and bool(keepdims)


def axes_of(axis: Any, dimensions: int) -> list[int]:
    """The axes of a reduction, in order. A number without dimensions has none."""
    axes = range(dimensions) if axis is None else axis if isinstance(axis, tuple) else (axis,)
    if dimensions == 0 and axis in (None, 0, -1):
        return []
    found = sorted({int(a) % dimensions for a in axes if -dimensions <= a < dimensions})
    if len(found) != len(axes):
        refuse(
            ValueError, f"the axis {axis} is out of range or twice, for an array of {dimensions} dimensions"
        )
    return found


def combine_all(name: str, parts: list, in_pairs: bool) -> Any:
    if not parts:
        if name in ("add", "multiply"):
            return np.float64(name == "multiply")
        refuse(ValueError, f"np.{name} of no elements has no value")
    function = of_numbers(name)
    if in_pairs and len(parts) >= 8:
        return pairwise_sum(parts)
    total = parts[0]
    for part in parts[1:]:
        total = function(total, part)
    return total


def pairwise_sum(parts: list) -> Any:
    """The sum of 8 or more numbers in the order of NumPy: 8 sums of every 8th, or two halves."""
    n = len(parts)
    if n > 128:
        half = n // 2 - n // 2 % 8
        return pairwise_sum(parts[:half]) + pairwise_sum(parts[half:])
    r = parts[:8]
    for i in range(8, n - n % 8, 8):
        r = [total + part for total, part in zip(r, parts[i : i + 8], strict=True)]
    total = ((r[0] + r[1]) + (r[2] + r[3])) + ((r[4] + r[5]) + (r[6] + r[7]))
    for part in parts[n - n % 8 :]:
        total = total + part
    return total


def total(
    value: Any,
    axis: Any = None,
    dtype: Any = None,
    out: Any = None,
    keepdims: Any = False,
    initial: Any = None,
) -> Any:
    check_options("sum", {"dtype": dtype, "out": out})
    return reduce("add", value, axis, keeps(keepdims), initial)


def mean(value: Any, axis: Any = None, dtype: Any = None, out: Any = None, keepdims: Any = False) -> Any:
    check_options("mean", {"dtype": dtype, "out": out})
    sums = reduce("add", value, axis, keeps(keepdims))
    return sums / float(np.size(value) / max(np.size(sums), 1))


def variance(value: Any, axis: Any = None, ddof: float = 0, keepdims: Any = False) -> Any:
    deviations = finish(plain(value)) - mean(value, axis, keepdims=True)
    sums = reduce("add", deviations * deviations, axis, keeps(keepdims))
    return sums / float(np.size(value) / max(np.size(sums), 1) - ddof)


def reduction(name: str) -> Callable:
    def function(
        value: Any, axis: Any = None, out: Any = None, keepdims: Any = False, initial: Any = None
    ) -> Any:
        check_options(name, {"out": out})
        return reduce(name, value, axis, keeps(keepdims), initial)

    return function


def norm(x: Any, ord: Any = None, axis: Any = None, keepdims: bool = False) -> Any:
    """The Euclidean norm of vectors, the sum and the maximum of absolute values, and the Frobenius norm."""
    array = finish(as_numbers(plain(x)))
    axes = array.ndim if axis is None else 1 if isinstance(axis, int) else len(axis)
    if ord is None or (ord == 2 and axes == 1) or (ord == "fro" and axes == 2):
        return np.sqrt(reduce("add", array * array, axis, keepdims))
    if axes == 1 and ord in (1, math.inf):
        return reduce("add" if ord == 1 else "maximum", abs(array), axis, keepdims)
    refuse(
        TypeError,
        f"np.linalg.norm with ord={ord!r} is not supported; use 2, 1 or np.inf of a vector, or 'fro'",
    )
