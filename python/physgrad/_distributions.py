"""Values of parameters and initial states that are drawn, trained, or change over time."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np


def finite(what: str, *values: Any) -> list[float]:
    """Numbers as floats."""
    for value in values:
        if (
            isinstance(value, (bool, np.bool_, str))
            or not np.isscalar(value)
            or np.iscomplexobj(value)
            or not np.isfinite(value)
        ):
            raise ValueError(f"{what}: {value!r} is not a finite number")
    return [float(value) for value in values]


def uniform(low: float, high: float) -> dict[str, list[float]]:
    """A number drawn evenly between `low` and `high`, for each sample."""
    low, high = finite("pg.uniform", low, high)
    if low > high:
        raise ValueError(f"pg.uniform: low {low} is above high {high}")
    return {"uniform": [low, high]}


def normal(mean: float, deviation: float) -> dict[str, list[float]]:
    """A number drawn from the normal distribution, for each sample."""
    mean, deviation = finite("pg.normal", mean, deviation)
    if deviation < 0:
        raise ValueError(f"pg.normal: the deviation {deviation} is negative")
    return {"normal": [mean, deviation]}


def log_uniform(low: float, high: float) -> dict[str, list[float]]:
    """A positive number whose logarithm is drawn evenly, for each sample."""
    low, high = finite("pg.log_uniform", low, high)
    if not 0 < low <= high:
        raise ValueError(f"pg.log_uniform: needs 0 < low <= high, not {low} and {high}")
    return {"log_uniform": [low, high]}


def choice(values: Sequence[float]) -> dict[str, list[float]]:
    """One of these numbers, drawn for each sample."""
    if isinstance(values, str) or not isinstance(values, (Sequence, np.ndarray)):
        kind = type(values).__name__
        raise TypeError(f"pg.choice: {values!r} is of type {kind}; allowed: a list of numbers")
    found = finite("pg.choice", *values)
    if not found:
        raise ValueError("pg.choice: there are no values")
    return {"choice": found}


def noise(deviation: float, mean: float = 0.0, hold: int = 1) -> dict[str, float]:
    """Normal noise: a number drawn anew every `hold` steps, for each sample."""
    deviation, mean = finite("pg.noise", deviation, mean)
    if deviation < 0:
        raise ValueError(f"pg.noise: the deviation {deviation} is negative")
    if isinstance(hold, bool) or not isinstance(hold, (int, np.integer)) or hold < 1:
        raise ValueError(f"pg.noise: hold={hold!r} is not a number of steps, 1 or more")
    return {"noise": deviation, "mean": mean, "hold": int(hold)}


def trained(start: float, min: float | None = None, max: float | None = None) -> dict[str, float]:
    """A number that a training changes, from `start`, within bounds."""
    bounds = {
        name: finite("pg.trained", value)[0]
        for name, value in (("min", min), ("max", max))
        if value is not None
    }
    (start,) = finite("pg.trained", start)
    if not bounds.get("min", start) <= start <= bounds.get("max", start):
        raise ValueError(f"pg.trained: the start {start} is outside of its bounds")
    return {"start": start, **bounds}


class table:
    """A value over time, one number per step. A function receives the number of its step."""

    def __init__(self, values: Sequence[float]) -> None:
        if isinstance(values, str):
            raise TypeError(f"pg.table: {values!r} is text; allowed: a list of numbers, one per step")
        array = np.asarray(values)
        if array.ndim != 1 or len(array) == 0:
            raise ValueError(f"pg.table: needs a list of numbers, one per step, not shape {array.shape}")
        self.values = finite("pg.table", *array)
