"""Tasks, policies and runs as HTML, for notebooks."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import numpy as np

from ._results import html_table

if TYPE_CHECKING:
    from ._core import Policy, Run, Task


# Colours of the curves in the chart of a run.
CURVES = {"training": "#0072b2", "test": "#d55e00"}


def table(title: str, rows: Mapping[str, Any]) -> str:
    """A table of names and values. Rows without a value are left out."""
    return html_table(title, (), [(name, str(value)) for name, value in rows.items() if value not in (None, "")])


def value_of(value: Any) -> str:
    """A setting as in a scene, on one line."""
    if isinstance(value, Mapping):
        return ", ".join(f"{key} {value_of(inner)}" for key, inner in value.items())
    if isinstance(value, (list, tuple)):
        return f"[{', '.join(map(value_of, value))}]"
    return f"{value:g}" if isinstance(value, float) else str(value)


def parts(section: Mapping[str, Any]) -> str:
    """Effects or parts with their settings."""
    found = (name + (f" ({value_of(inner)})" if inner else "") for name, inner in section.items())
    return ", ".join(found)


def counted(names: list[str]) -> str:
    """A number of names, and the names if they are few."""
    return f"{len(names)}: {', '.join(names)}" if 0 < len(names) <= 12 else str(len(names))


def task(self: Task) -> str:
    """States, controls, steps and settings of a task."""
    settings, is_own = self.settings, self.name == "equations"
    # The expressions of a system of the user are too long for a table.
    system = settings.get("system", {})
    left_out = ("dt",) if self.model is None else ("dt", "model")
    system = system.get("parameters", {}) if is_own else {k: v for k, v in system.items() if k not in left_out}
    return table(
        f"Task {self.name}",
        {
            "states": counted(self.state_names),
            "controls": counted(self.control_names),
            "parameters": counted(self.param_names) if self.param_dim else None,
            "model": None if self.model is None else repr(self.model).strip("<>"),
            "horizon": f"{self.horizon} steps of {self.dt:g}",
            "precision": self.dtype,
            "integrator": value_of(settings.get("integrator", {})),
            "loss": None if is_own else value_of(settings.get("loss", {})),
            "system": value_of(system),
            **{section: parts(settings.get(section, {})) for section in ("effects", "actuator", "sensor")},
        },
    )


def policy(self: Policy) -> str:
    """Kind, parameters and settings of a policy."""
    settings = dict(self.task.settings["policy"])
    return table(
        f"Policy {settings.pop('kind', 'mlp')}".strip(),
        {
            "task": self.task.name,
            "parameters": len(self),
            "observes": counted(self.task.observation_names),
            "controls": counted(self.task.control_names),
            "trained numbers": ", ".join(f"{name} = {value:.5g}" for name, value in self.numbers.items()),
            **{name: value_of(value) for name, value in settings.items()},
        },
    )


def run(self: Run) -> str:
    """State and settings of a run, and the curves of its losses."""
    settings, history = self.task.settings, self.history
    losses, training = history["test_loss"], settings["training"]
    found = len(losses) > 0
    shown = table(
        f"Run of {self.task.name}",
        {
            "field": settings["field"],
            "epochs": f"{len(losses)} of {settings['epochs']}",
            "seed": settings["seed"],
            "test loss": f"{losses[-1]:.4g}, lowest {np.fmin.reduce(losses):.4g}" if found else None,
            "training time": f"{history['seconds'].sum():.3g} s" if found else None,
            "optimizer": f"{training['optimizer']}, learning rate {training['learning_rate']:g}",
            "samples": f"{training['train_samples']} for training, {training['test_samples']} for tests",
            "policy": repr(self.policy).strip("<>"),
            "folder": self.folder,
        },
    )
    if not found:
        return shown
    legend = ", ".join(f"<span style='color:{color}'>{name}</span>" for name, color in CURVES.items())
    # Texts and axes of the chart are black.
    style = "background:white;color:black;display:inline-block"
    return f"{shown}<div style='{style}'>loss: {legend}<br/>{self._losses()}</div>"
