"""`Model`: the parts and numbers of a robot from a model file."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

from ._notebook import counted, table, value_of
from ._results import Result

if TYPE_CHECKING:
    from ._core import Task


@dataclasses.dataclass(frozen=True, eq=False, repr=False)
class Model(Result):
    """The model of a task from an MJCF or URDF file, with names as in settings and expressions."""

    name: str
    bodies: list[str]
    """Without the world."""
    joints: list[str]
    sites: list[str]
    shapes: list[str]
    actuators: list[str]
    numbers: Mapping[str, Any]
    """Numbers that may be set, drawn, trained or fitted, by their keys: those of the task, otherwise of the file."""
    remarks: list[str]
    """What the file has and what does not act, one sentence each."""

    def _counts(self) -> str:
        kinds = {kind: getattr(self, kind) for kind in KINDS} | {"numbers": self.numbers}
        return ", ".join(f"{len(names)} {kind if len(names) != 1 else SINGULAR[kind]}" for kind, names in kinds.items())

    def __repr__(self) -> str:
        return f"<physgrad.Model {self.name}: {self._counts()}>"

    def _repr_html_(self) -> str:
        """Parts and numbers for a notebook."""
        parts = table(f"Model {self.name}", {kind: counted(getattr(self, kind)) for kind in KINDS})
        remarks = " ".join(self.remarks)
        numbers = {key: value_of(value) for key, value in self.numbers.items()}
        return parts + table("Numbers", numbers | {"remarks": remarks})


KINDS = ("bodies", "joints", "sites", "shapes", "actuators")
SINGULAR = {
    "bodies": "body",
    "joints": "joint",
    "sites": "site",
    "shapes": "shape",
    "actuators": "actuator",
    "numbers": "number",
}


def model(self: Task) -> Model | None:
    """The model of a robot from a file, with the names of its parts and its numbers. None for other tasks."""
    if self._model is None:
        return None
    name, parts, numbers, remarks = self._model
    return Model(name=name, **parts, numbers=numbers, remarks=remarks)
