"""What the results of `identify`, `optimize` and `accuracy` share: dicts, and tables of notebooks."""

from __future__ import annotations

import dataclasses
import html
from collections.abc import Iterable, Sequence
from typing import Any

import numpy as np

from ._core import Task


def plain(value: Any) -> Any:
    """The value as dicts, lists, texts and numbers of Python. A task becomes its settings."""
    if isinstance(value, Result):
        return value.to_dict()
    if isinstance(value, Task):
        return plain(value.settings)
    if isinstance(value, np.ndarray):
        return value.tolist()
    if isinstance(value, np.generic):
        return value.item()
    if isinstance(value, dict):
        return {key: plain(part) for key, part in value.items()}
    if isinstance(value, (list, tuple)):
        return [plain(part) for part in value]
    return value


class Result:
    """A result with attributes."""

    def to_dict(self) -> dict[str, Any]:
        """All attributes as dicts, lists, texts and numbers of Python, for instance for JSON."""
        fields = dataclasses.fields(self)  # type: ignore[arg-type]
        return {field.name: plain(getattr(self, field.name)) for field in fields}


def number(value: float, digits: int = 6) -> str:
    """A number with this many significant digits."""
    return f"{value:.{digits}g}"


def table(header: Sequence[str], rows: Iterable[Sequence[str]]) -> list[str]:
    """Lines of a table of text, the first column left and the others right."""
    lines = [list(header), *map(list, rows)]
    widths = [max(len(line[i]) for line in lines) for i in range(len(header))]
    padded = ([line[0].ljust(widths[0]), *map(str.rjust, line[1:], widths[1:])] for line in lines)
    return ["  ".join(cells).rstrip() for cells in padded]


def html_table(caption: str, header: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    """A table for notebooks, with names in the first column. An empty header has no line."""
    left = "style='text-align:left'"

    def line(tag: str, cells: Sequence[str]) -> str:
        first = f"<th {left}>{html.escape(cells[0])}</th>"
        return f"<tr>{first}{''.join(f'<{tag} {left}>{html.escape(cell)}</{tag}>' for cell in cells[1:])}</tr>"

    top = line("th", header) if header else ""
    body = "".join(line("td", cells) for cells in rows)
    return f"<table><caption {left}><b>{html.escape(caption)}</b></caption>{top}{body}</table>"
