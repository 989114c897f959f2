"""Measured segments from tables: data frames and CSV files, with the columns of `physgrad identify`."""

from __future__ import annotations

import os
from typing import Any, NamedTuple

import numpy as np

from . import _core
from ._units import factor

_SEGMENT, _TIME = ("segment", "sample"), ("t", "time")


def bare(task: Any) -> Any:
    """The task without its sensor, whose states no measurement contains."""
    parts = task.settings.get("sensor", {})
    return task.replace(sensor=dict.fromkeys(parts)) if parts else task


def is_table(data: Any) -> bool:
    """Whether the data are a path or a data frame, recognized without importing pandas."""
    return isinstance(data, (str, os.PathLike)) or (hasattr(data, "columns") and hasattr(data, "__getitem__"))


class Recordings(NamedTuple):
    """Segments of all data, and what their reading assumes."""

    segments: list[Any]
    """Pairs and dicts as given, and a dict for each segment of a table."""
    notes: list[str]
    scales: dict[str, float]
    """Factor to the unit of the task of each column with a unit."""


def read(
    task: Any, data: Any, params: Any, time: str | None, units: dict[str, Any] | None
) -> Recordings:
    """Reads the data of `identify`. Pairs and dicts remain as they are.

    `params` names the unknown numbers, `time` is the name of the time column, and `units` has the units
    of columns. The program and this function share the rules of tables.
    """
    if is_table(data) or isinstance(data, dict):
        data = [data]
    if isinstance(data, (list, tuple)):
        for place, part in enumerate(data):
            if not (is_table(part) or isinstance(part, (dict, tuple))):
                raise TypeError(
                    f"`data[{place}]` is of type {type(part).__name__}; allowed: a data frame, the path of a CSV "
                    "file, a dict, or a pair, as in [(x, u)]"
                )
    has_tables = isinstance(data, (list, tuple)) and any(map(is_table, data))
    if not has_tables:
        for name, value in (("time", time), ("units", units)):
            if value is not None:
                raise ValueError(f"`{name}` is about columns; the data have no data frame and no CSV file")
        return Recordings(data, [], {})
    scales = _scales(task, units or {}, time)
    labels = ["the data frame"] if len(data) == 1 else [f"data[{place}]" for place in range(len(data))]
    segments: list[Any] = []
    notes: list[str] = []
    seen: set[str] = set()
    for part, label in zip(data, labels):
        if not is_table(part):
            segments.append(part)
            continue
        table = part if isinstance(part, (str, os.PathLike)) else _columns(part, label, time)
        found, remarks, columns = _core.read_table(task, params, table, time, scales)
        segments += found
        notes += remarks
        seen.update(columns)
    for column in sorted(set(scales) - seen):
        raise ValueError(f"`units`: there is no column `{column}`; columns: {', '.join(sorted(seen))}")
    return Recordings(segments, list(dict.fromkeys(notes)), scales)


def _scales(task: Any, units: dict[str, Any], time: str | None) -> dict[str, float]:
    """Factor of each column with a unit."""
    if not isinstance(units, dict):
        raise TypeError(f"`units` is of type {type(units).__name__}; allowed: a dict from columns to units")
    times = (time,) if time else _TIME
    own = task.settings.get("system", {}).get("units", {}) | dict.fromkeys(times, "s")
    return {name: factor(name, unit, own.get(name)) for name, unit in units.items()}


def _columns(frame: Any, name: str, time: str | None) -> tuple[str, list[str], Any]:
    """Name and header of a data frame, and a function that returns its columns."""
    header, columns = _series(frame, name, time)

    def cells(i: int, is_text: bool) -> Any:
        return list(map(str, columns[i])) if is_text else _numbers(name, header[i], columns[i])

    return name, header, cells


def _series(frame: Any, name: str, time: str | None) -> tuple[list[str], list[Any]]:
    """Header and columns of a data frame. An index with the name of a time or segment is a column."""
    header = list(frame.columns)
    for column in header:
        if not isinstance(column, str):
            kind = type(column).__name__
            raise TypeError(f"{name}: the column {column!r} is of type {kind}; allowed: names as texts")
    cells = [frame[column] for column in header]
    index: Any = getattr(frame, "index", None)
    for level, label in enumerate(getattr(index, "names", ())):
        if label in ((time,) if time else _TIME) or label in _SEGMENT:
            header.append(label)
            cells.append(index.get_level_values(level))
    return header, cells


def _numbers(name: str, column: str, values: Any) -> np.ndarray:
    """A column of a data frame as numbers. Missing ones are NaN."""
    dtype = getattr(values, "dtype", None)
    kind = getattr(dtype, "kind", "")
    if kind == "c":
        raise TypeError(f"{name}: the column `{column}` has complex numbers; allowed: real numbers")
    if kind and kind in "mM":
        raise TypeError(
            f"{name}: the column `{column}` has dates or durations; allowed: numbers, as of "
            f"`(frame[\"{column}\"] - begin).dt.total_seconds()`"
        )
    try:
        # Data frames of pandas have own values for missing numbers.
        numbers = values.to_numpy(dtype=float, na_value=np.nan)
    except (AttributeError, TypeError, ValueError):
        try:
            numbers = np.asarray(values, dtype=float)
        except (TypeError, ValueError):
            message = f"{name}: the column `{column}` has values that are no numbers"
            raise TypeError(message) from None
    # Decimals show how far times are rounded: 0.1 in float32 is 0.1, and not 0.10000000149.
    return numbers.astype(np.float32).astype(str).astype(float) if dtype == np.float32 else numbers
