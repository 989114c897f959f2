"""Measured segments from tables: data frames and CSV files, with the columns of `physgrad identify`."""

from __future__ import annotations

import csv
import math
import os
import re
from collections.abc import Iterator
from typing import Any, NamedTuple

import numpy as np

from ._units import factor

# Limits and tolerances are those of `physgrad identify`.
_OFF_GRID = 1e-3
"""Largest distance of a time from a step that counts as rounding, relative to the time step."""
_COARSEST = 0.2
"""Largest decimal unit of the times that counts as their rounding, relative to the time step."""
_SPARSE = 1000
"""Smallest number of steps between all rows that shows times in another unit than s."""
_ASTRAY = 100
"""Smallest distance of two rows that shows a wrong time, in medians times the number of rows."""
_MOST_BYTES = 1e9
_FAR_APART = "give the time in s, or its unit, as in units={\"t\": \"ms\"}; or set the time step `dt`"

_SEGMENT, _TIME = ("segment", "sample"), ("t", "time")


def setting(task: Any, key: str) -> Any:
    """Value of the setting with a dotted key, as in "system.arms[0].mass". None if there is none."""
    value = task.settings
    for name, index in re.findall(r"([^.\[\]]+)|\[(\d+)\]", key):
        try:
            value = value[name] if name else value[int(index)]
        except (KeyError, IndexError, TypeError):
            return None
    return value


def bare(task: Any) -> Any:
    """The task without its sensor, whose states no measurement contains."""
    parts = task.settings.get("sensor", {})
    return task.replace(sensor=dict.fromkeys(parts)) if parts else task


def is_table(data: Any) -> bool:
    """Whether the data are a path or a data frame, recognized without importing pandas."""
    return isinstance(data, (str, os.PathLike)) or (hasattr(data, "columns") and hasattr(data, "__getitem__"))


class _Table(NamedTuple):
    """Columns of numbers, NaN where missing, and names of the segments."""

    name: str
    """For messages: the path, or "the data frame"."""
    columns: dict[str, np.ndarray]
    segments: list[str]
    """The segment of each row; empty texts without such a column."""
    decimals: float
    """Smallest decimal unit of the times in the table."""
    lines: list[int] | None
    """Line of each row of a file."""
    numbers: list[int] | None = None
    """Number of each row of a frame, if some are left out."""

    def row(self, i: int) -> str:
        """Place of a row, for messages."""
        if self.lines:
            return f"{self.name}:{self.lines[i]}"
        return f"{self.name}, row {self.numbers[i] if self.numbers else i}"

    def only(self, rows: np.ndarray) -> _Table:
        """The table with these rows."""
        return self._replace(
            columns={name: column[rows] if len(column) else column for name, column in self.columns.items()},
            segments=[self.segments[i] for i in rows],
            lines=[self.lines[i] for i in rows] if self.lines else None,
            numbers=rows.tolist(),
        )


class Recordings(NamedTuple):
    """Segments of all data, and what their reading assumes."""

    segments: list[Any]
    """Pairs and dicts as given, and a dict for each segment of a table."""
    notes: list[str]
    scales: dict[str, float]
    """Factor to the unit of the task of each column with a unit."""


class _Names:
    """Names of the columns that a task knows."""

    def __init__(self, task: Any, unknown: list[str]) -> None:
        measured = bare(task)
        self.dt = measured.dt
        self.states, self.controls = list(measured.state_names), list(measured.control_names)
        own = [name for name in measured.param_names if not _is(setting(measured, name), "noise")]
        # The fit replaces numbers in `params` and in the section `fit`.
        fixed = [name for name in own if not _is(setting(measured, name), "start")]
        self.params = [name for name in fixed if name not in unknown]
        applied = [f"{name}_applied" for name in self.controls] if measured.settings.get("actuator") else []
        self.applied = dict(zip(applied, self.controls))
        sensed = [name for name in task.state_names if name not in self.states]
        self.ignored = {"step", *applied, *sensed, *unknown, *measured.param_names} - set(self.params)
        self.units = measured.settings.get("system", {}).get("units", {})


def _is(value: Any, kind: str) -> bool:
    return isinstance(value, dict) and kind in value


def read(
    task: Any, data: Any, unknown: list[str], time: str | None, units: dict[str, Any] | None
) -> Recordings:
    """Reads the data of `identify`. Pairs and dicts remain as they are.

    `unknown` are the keys in `params`, `time` is the name of the time column, and `units` has the
    units of columns.
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
    names = _Names(task, unknown)
    scales = _scales(names, units or {}, time)
    labels = ["the data frame"] if len(data) == 1 else [f"data[{place}]" for place in range(len(data))]
    parts = [_open(part, label, names, time) if is_table(part) else part for part, label in zip(data, labels)]
    seen = {column for part in parts if isinstance(part, _Table) for column in part.columns}
    for column in sorted(set(scales) - seen):
        raise ValueError(f"`units`: there is no column `{column}`; columns: {', '.join(sorted(seen))}")
    segments: list[Any] = []
    notes: list[str] = []
    for part in parts:
        if isinstance(part, _Table):
            segments.extend(_segments(part, names, scales, time, notes))
        else:
            segments.append(part)
    return Recordings(segments, list(dict.fromkeys(notes)), scales)


def _scales(names: _Names, units: dict[str, Any], time: str | None) -> dict[str, float]:
    """Factor of each column with a unit."""
    if not isinstance(units, dict):
        raise TypeError(f"`units` is of type {type(units).__name__}; allowed: a dict from columns to units")
    times = (time,) if time else _TIME
    own = names.units | dict.fromkeys(times, "s")
    return {name: factor(name, unit, own.get(name)) for name, unit in units.items()}


def _open(part: Any, name: str, names: _Names, time: str | None) -> _Table:
    """Columns of a file or a data frame."""
    if isinstance(part, (str, os.PathLike)):
        name = os.fspath(part)
        header, cells, lines = _cells(name)
    else:
        header, cells, lines = *_series(part, name, time), None
    _check_header(name, header, names, time)
    columns: dict[str, np.ndarray] = {}
    segments: list[str] = [""] * (len(cells[0]) if cells else 0)
    table = _Table(name, columns, segments, math.inf, lines)
    decimals = math.inf
    for column, values in zip(header, cells):
        if column in _SEGMENT and column not in (*names.states, *names.controls):
            segments[:] = map(str, values)
        elif column in names.ignored:
            columns[column] = np.empty(0)
        else:
            columns[column] = _numbers(table, column, values)
            if column == _time(header, time):
                decimals = min((_decimal(str(value)) for value in values), default=math.inf)
    return table._replace(decimals=decimals)


def _time(header: list[str], time: str | None) -> str | None:
    """Name of the time column, if it is there."""
    return next((name for name in ((time,) if time else _TIME) if name in header), None)


def _check_header(name: str, header: list[str], names: _Names, time: str | None) -> None:
    """Refuses columns that are missing, unknown or given twice."""
    known = [*names.states, *names.controls, *names.params]
    allowed = {*known, *names.ignored, *_SEGMENT, *((time,) if time else _TIME)}
    for column in header:
        if column not in allowed:
            if ";" in column or "\t" in column:
                raise ValueError(f"{name}: the columns are separated by semicolons or tabs; allowed: commas")
            shown = f"unknown column `{column}`" if column else "a column without a name"
            listed = ", ".join(["segment", time or "t", *known])
            raise ValueError(f"{name}: {shown}; leave it out; allowed: {listed}")
    for group in ([column] for column in known), [_SEGMENT, (time,) if time else _TIME]:
        for same in group:
            if sum(column in same for column in header) > 1:
                listed = "` or `".join(same)
                raise ValueError(f"{name}: several columns are `{listed}`; leave out all but one")
    if _time(header, time) is None:
        raise ValueError(f"{name}: there is no column `{time or 't'}` with the time in s")
    if not set(header) & set(names.states):
        raise ValueError(f"{name}: there is no column of a state; states: {', '.join(names.states)}")
    for applied, control in names.applied.items():
        if applied in header and control not in header:
            raise ValueError(
                f"{name}: the column `{control}` is missing; `{applied}` is the output of the actuator, "
                f"which the simulation computes from `{control}`. Add this column, or remove the actuator"
            )


def _cells(path: str) -> tuple[list[str], list[list[str]], list[int]]:
    """Header, columns and line numbers of a CSV file. Lines with `#` before the header are comments."""
    rows: list[list[str]] = []
    lines: list[int] = []
    with open(path, encoding="utf-8-sig", newline="") as file:
        reader = csv.reader(file, strict=True, skipinitialspace=True)
        try:
            for cells in reader:
                if not cells or (not rows and cells[0].lstrip().startswith("#")):
                    continue
                place = f"{path}:{reader.line_num}"
                if cells[0].lstrip().startswith("#"):
                    raise ValueError(f"{place}: comments are allowed before the header only")
                if rows and len(cells) != len(rows[0]):
                    raise ValueError(f"{place}: the row has {len(cells)} cells; expected {len(rows[0])}")
                rows.append([cell.strip() for cell in cells])
                lines.append(reader.line_num)
        except (UnicodeDecodeError, csv.Error) as error:
            raise ValueError(f"{path} is no CSV file in UTF-8: {error}") from None
    if len(rows) < 2:
        raise ValueError(f"{path} has no samples")
    return rows[0], [list(column) for column in zip(*rows[1:])], lines[1:]


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
    if not len(frame):
        raise ValueError(f"{name} has no samples")
    return header, cells


def _numbers(table: _Table, column: str, values: Any) -> np.ndarray:
    """A column as numbers. Empty cells are NaN."""
    if isinstance(values, list):
        try:
            if any("_" in cell for cell in values):
                raise ValueError
            numbers = np.array([cell or "nan" for cell in values]).astype(float)
        except ValueError:
            row, cell = next((i, cell) for i, cell in enumerate(values) if cell and not _is_number(cell))
            raise ValueError(f"{table.row(row)}: `{cell[:40]}` in column `{column}` is not a number") from None
    else:
        kind = getattr(getattr(values, "dtype", None), "kind", "")
        if kind == "c":
            raise TypeError(f"{table.name}: the column `{column}` has complex numbers; allowed: real numbers")
        if kind and kind in "mM":
            raise TypeError(
                f"{table.name}: the column `{column}` has dates or durations; allowed: numbers, as of "
                f"`(frame[\"{column}\"] - begin).dt.total_seconds()`"
            )
        try:
            # Data frames of pandas have own values for missing numbers.
            numbers = values.to_numpy(dtype=float, na_value=np.nan)
        except (AttributeError, TypeError, ValueError):
            try:
                numbers = np.asarray(values, dtype=float)
            except (TypeError, ValueError):
                message = f"{table.name}: the column `{column}` has values that are no numbers"
                raise TypeError(message) from None
    if np.isinf(numbers).any():
        place = table.row(int(np.isinf(numbers).argmax()))
        raise ValueError(f"{place}: `{column}` is infinite; leave the cell of a missing sample empty")
    return numbers


def _is_number(cell: str) -> bool:
    # Python reads 1_0 as 10.
    if "_" in cell:
        return False
    try:
        float(cell)
    except ValueError:
        return False
    return True


def _decimal(number: str) -> float:
    """Value of the last digit of a number, for instance 0.001 for three decimals."""
    digits, _, exponent = number.lower().partition("e")
    decimals = digits.partition(".")[2]
    # Floats of data frames show a digit that tables omit: 1.0 is 1.
    places = len(decimals) if decimals != "0" else 0
    return 10.0 ** (int(exponent or 0) - places) if digits[-1:].isdigit() else math.inf


def _segments(
    table: _Table, names: _Names, scales: dict[str, float], time: str | None, notes: list[str]
) -> Iterator[dict[str, Any]]:
    """The segments of a table, one row per step."""
    column = _time(list(table.columns), time)
    assert column is not None
    scale = scales.get(column, 1.0)
    rounding = scale * table.decimals
    grid = _Grid(names.dt, rounding if rounding <= _COARSEST * names.dt else 0.0)

    def matrix(of: list[str]) -> np.ndarray:
        missing = np.full(len(table.segments), np.nan)
        parts = [scales.get(name, 1.0) * table.columns.get(name, missing) for name in of]
        return np.stack(parts, axis=-1) if parts else np.empty((rows, 0))

    # A row without states and controls, as a frame has after `reindex`, is a missing row.
    told = np.flatnonzero(~np.isnan(matrix([*names.states, *names.controls])).all(axis=1))
    if 0 < len(told) < len(table.segments):
        table = table.only(told)
    rows = len(table.segments)
    times = scale * table.columns[column]
    if np.isnan(times).any():
        row = table.row(int(np.isnan(times).argmax()))
        raise ValueError(f"{row}: the time is missing; give every row a time in s")
    x, u = matrix(names.states), matrix(names.controls)
    _check_controls(table, names, u, notes)
    begins = [i for i in range(rows) if i == 0 or table.segments[i] != table.segments[i - 1]]
    seen: set[str] = set()
    for i in begins:
        key = table.segments[i]
        if key in seen:
            raise ValueError(
                f"{table.row(i)}: the rows of segment {key} are not contiguous; sort the rows by segment"
            )
        seen.add(key)
    parts = [slice(a, b) for a, b in zip(begins, [*begins[1:], rows])]
    steps = [_steps(table, part, times, grid) for part in parts]
    _check_distances(table, parts, steps, names)
    given = [name for name in names.params if name in table.columns]
    gaps = []
    for part, step in zip(parts, steps):
        p = {name: _constant(table, name, part) * scales.get(name, 1.0) for name in given}
        held = _held(u[part])
        for i, name in enumerate(names.controls):
            if name in table.columns and len(held) > 1 and np.isnan(u[part, i]).all():
                key = table.segments[part.start] or "0"
                notes.append(f"{name} has no value in segment {key}, and is taken as 0 there")
        for a, b in _pieces(step, held, notes):
            if a > 0:
                gaps.append(part.start + a)
            first = part.start + a
            yield {
                "x": _spread(step[a:b], x[part][a:b]),
                "u": np.repeat(held[a:b], _lengths(step[a:b]), axis=0),
                "t": grid.snapped(times[first]),
                "p": p,
            }
    if gaps:
        which = "1 row" if len(gaps) == 1 else f"{len(gaps)} rows"
        notes.append(
            f"a new segment begins at {which} after a gap in which a control changes "
            f"(first: {table.row(gaps[0])})"
        )


class _Grid(NamedTuple):
    """Time grid of a task."""

    dt: float
    rounding: float
    """Largest error of a distance between two times by their decimals, s."""

    def steps(self, begin: float, times: np.ndarray) -> np.ndarray:
        """Numbers of steps after `begin`, NaN where it is no integer."""
        steps = (times - begin) / self.dt
        doubles = 4 * np.finfo(float).eps * np.maximum(abs(begin), np.abs(times))
        tolerance = max(self.rounding, _OFF_GRID * self.dt) + doubles
        return np.where(np.abs(steps - np.rint(steps)) * self.dt < tolerance, np.rint(steps), np.nan)

    def snapped(self, time: float) -> float:
        """The time of the step at this time, or the time itself between two steps."""
        step = float(self.steps(0.0, np.array(time)))
        return time if math.isnan(step) else step * self.dt


def _steps(table: _Table, part: slice, times: np.ndarray, grid: _Grid) -> np.ndarray:
    """Numbers of steps of the rows of a segment after its first row."""
    steps = grid.steps(times[part.start], times[part])
    off = np.isnan(steps)
    if off.any():
        row = part.start + int(off.argmax())
        raise ValueError(
            f"{table.row(row)}: the time {times[row]:.12g} s is not a later step of {grid.dt} s; "
            "resample, or set `dt`"
        )
    early = np.diff(steps) < 1
    if early.any():
        row = part.start + 1 + int(early.argmax())
        raise ValueError(
            f"{table.row(row)}: the time {times[row]:.12g} s is not later than in the row before; "
            "sort the rows by time"
        )
    return steps


def _median(distances: np.ndarray) -> int:
    """Median number of steps between rows, 1 for a single row."""
    return int(np.sort(distances)[len(distances) // 2]) if len(distances) else 1


def _check_distances(table: _Table, parts: list[slice], steps: list[np.ndarray], names: _Names) -> None:
    """Refuses times in another unit than s, wrong times, and segments that are too long."""
    distances = [np.diff(step) for step in steps]
    least = min((float(distance.min()) for distance in distances if len(distance)), default=0.0)
    if least >= _SPARSE:
        apart = f"{least:.6g} or more steps of {names.dt} s apart"
        raise ValueError(f"{table.name}: all rows are {apart}; {_FAR_APART}")
    for part, distance in zip(parts, distances):
        far = distance > _ASTRAY * (len(distance) + 1) * _median(distance)
        if far.any():
            place = int(far.argmax())
            row = table.row(part.start + 1 + place)
            raise ValueError(
                f"{row}: the row is {int(distance[place])} steps of {names.dt} s after the row before, far more "
                "than the median of its segment; correct its time, or begin another segment there"
            )
    total = sum(step[-1] + 1 for step in steps)
    if total * 8 * (len(names.states) + len(names.controls)) > _MOST_BYTES:
        raise MemoryError(f"{table.name}: the segments have {int(total)} steps of {names.dt} s; {_FAR_APART}")


def _check_controls(table: _Table, names: _Names, u: np.ndarray, notes: list[str]) -> None:
    """Refuses an empty column of a control, and notes controls that are 0."""
    missing = [name for name in names.controls if name not in table.columns]
    if missing:
        what, are = ("column", "is") if len(missing) == 1 else ("columns", "are")
        notes.append(f"there is no {what} {', '.join(missing)}, which {are} taken as 0 in all rows")
    for i, name in enumerate(names.controls):
        if name in table.columns and len(u) > 1 and np.isnan(u[:, i]).all():
            raise ValueError(
                f"{table.name}: the column `{name}` is empty; give the control of every row, or zeros if it "
                "was 0"
            )


def _constant(table: _Table, name: str, part: slice) -> float:
    """Value of a parameter in a segment."""
    values = table.columns[name][part]
    values = values[~np.isnan(values)]
    if not len(values):
        raise ValueError(
            f"{table.row(part.start)}: the column `{name}` has no value in this segment; give it in every "
            "segment, or leave out the column, so that all segments have the nominal value"
        )
    if (values != values[0]).any():
        raise ValueError(
            f"{table.row(part.start)}: `{name}` changes in this segment; a parameter is constant in a segment"
        )
    return float(values[0])


def _held(u: np.ndarray) -> np.ndarray:
    """Controls that keep their last value, 0 before the first."""
    rows = np.where(np.isnan(u), -1, np.arange(len(u))[:, None])
    last = np.maximum.accumulate(rows, axis=0)
    return np.where(last < 0, 0.0, np.take_along_axis(u, np.maximum(last, 0), axis=0))


def _pieces(steps: np.ndarray, held: np.ndarray, notes: list[str]) -> list[tuple[int, int]]:
    """Ranges of rows without a gap in which a control changes: its values there are unknown."""
    distances = np.diff(steps)
    median = _median(distances)
    changes = (held[1:] != held[:-1]).any(axis=1)
    if median > 1 and (changes & (distances > 1)).any():
        notes.append(
            f"the rows are {median} steps apart, and the fit holds each control over these steps; this is "
            "right only if the experiment held it too, and not if rows were left out"
        )
    cuts = (np.flatnonzero(changes & (distances >= 2 * median)) + 1).tolist()
    return list(zip([0, *cuts], [*cuts, len(steps)]))


def _lengths(steps: np.ndarray) -> np.ndarray:
    """Number of steps from each row to the next, 1 for the last."""
    return np.diff(steps, append=steps[-1] + 1).astype(int)


def _spread(steps: np.ndarray, rows: np.ndarray) -> np.ndarray:
    """Rows at their steps, NaN at the others."""
    spread = np.full((int(steps[-1] - steps[0]) + 1, rows.shape[1]), np.nan)
    spread[(steps - steps[0]).astype(int)] = rows
    return spread
