"""Types of settings and fields, for annotations."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from os import PathLike
from typing import Any, Literal, TypedDict

Path = str | PathLike[str]
Precision = Literal["f32", "f64"]
FieldName = Literal["R", "M", "N", "S", "C", "P", "F", "MR", "RM"]
LongFieldName = Literal[
    "combined",
    "regular",
    "modified",
    "network",
    "stopped",
    "projected",
    "conflict_free",
    "modified_signed",
    "regular_scaled",
]
Section = Mapping[str, Any]
"""Settings of a section. `{}` adds an effect or a part with its defaults, and None removes one."""


class TrainingSettings(TypedDict, total=False):
    """Settings of the section `training`."""

    batch: int
    train_samples: int
    test_samples: int
    shuffle: bool
    resample: bool
    optimizer: Literal["adam", "sgd", "momentum", "rmsprop", "adagrad", "adadelta"]
    learning_rate: float
    decay: Literal["constant", "cosine", "exponential"]
    decay_end: float
    warm_up: int
    discount: float
    control: float
    truncation: int
    cut: float
    average: float
    estimator: Literal["exact", "first_order", "zeroth_order", "inverse_variance", "alpha_order"]
    noise: float
    pairs: int
    tolerance: float
    clip: Literal["none", "value", "norm"]
    clip_limit: float
    max_skipped: int
    memory: str


class RunSettings(TrainingSettings, total=False):
    """Settings of a training: those of its section, those outside of sections, and other sections."""

    horizon: int
    precision: Precision
    field: FieldName | LongFieldName
    epochs: int
    seed: int
    tags: Sequence[str]
    log: Sequence[Literal["jsonl", "tensorboard"]]
    system: Section
    effects: Section
    actuator: Section
    sensor: Section
    integrator: Section
    loss: Section
    window: Section
    equations: Section
    training: TrainingSettings
    vary: Section
    fit: Mapping[str, float | Mapping[str, float]]
    settings: Section
