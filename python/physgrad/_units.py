"""Units of measured columns, as factors to the units of a task."""

from __future__ import annotations

import math
import re
from typing import Any

# Factor to SI units and exponents of the base units. An angle has the base unit rad, so that a degree
# is no metre.
_UNITS: dict[str, tuple[float, dict[str, int]]] = {
    "1": (1.0, {}),
    "%": (0.01, {}),
    "rad": (1.0, {"rad": 1}),
    "deg": (math.pi / 180, {"rad": 1}),
    "°": (math.pi / 180, {"rad": 1}),
    "rev": (2 * math.pi, {"rad": 1}),
    "rpm": (2 * math.pi / 60, {"rad": 1, "s": -1}),
    "s": (1.0, {"s": 1}),
    "min": (60.0, {"s": 1}),
    "h": (3600.0, {"s": 1}),
    "Hz": (1.0, {"s": -1}),
    "m": (1.0, {"m": 1}),
    "g": (1e-3, {"kg": 1}),
    "N": (1.0, {"kg": 1, "m": 1, "s": -2}),
    "J": (1.0, {"kg": 1, "m": 2, "s": -2}),
    "W": (1.0, {"kg": 1, "m": 2, "s": -3}),
    "Pa": (1.0, {"kg": 1, "m": -1, "s": -2}),
    "A": (1.0, {"A": 1}),
    "V": (1.0, {"kg": 1, "m": 2, "s": -3, "A": -1}),
    "K": (1.0, {"K": 1}),
}
_PREFIXES = {"n": 1e-9, "u": 1e-6, "µ": 1e-6, "μ": 1e-6, "m": 1e-3, "c": 1e-2, "k": 1e3, "M": 1e6}
_PREFIXED = ("rad", "s", "Hz", "m", "g", "N", "J", "W", "Pa", "A", "V")
_SUPERSCRIPTS = str.maketrans({"²": "^2", "³": "^3", "·": "*"})


def _symbol(symbol: str) -> tuple[float, dict[str, int]] | None:
    """A unit with or without a prefix. None if it is unknown."""
    if symbol in _UNITS:
        return _UNITS[symbol]
    prefix, rest = symbol[:1], symbol[1:]
    if prefix in _PREFIXES and rest in _PREFIXED:
        factor, base = _UNITS[rest]
        return _PREFIXES[prefix] * factor, base
    return None


def parse(unit: str) -> tuple[float, dict[str, int]] | None:
    """Factor to SI units and exponents of the base units, as of "deg/s" or "kg*m^2". None if unknown.

    Every `/` divides by the one unit behind it.
    """
    factor, base = 1.0, dict[str, int]()
    for sign, text in re.findall(r"(^|[*/])([^*/]*)", unit.replace("**", "^").translate(_SUPERSCRIPTS)):
        match = re.fullmatch(r"\s*([^\s^\d]+|1)\s*(?:\^\s*(-?\d))?\s*", text)
        found = _symbol(match[1]) if match else None
        if match is None or found is None:
            return None
        exponent = int(match[2] or 1) * (-1 if sign == "/" else 1)
        factor *= found[0] ** exponent
        for name, power in found[1].items():
            base[name] = base.get(name, 0) + power * exponent
    return factor, {name: power for name, power in base.items() if power}


def factor(column: str, unit: Any, own: str | None) -> float:
    """Factor from the unit of a column to that of the task.

    `unit` is a text, or a number, which is the factor itself. `own` is the unit in the task; None
    stands for SI units, in which the built-in tasks are written.
    """
    if isinstance(unit, (int, float)) and not isinstance(unit, bool):
        if not (math.isfinite(unit) and unit != 0):
            raise ValueError(
                f"`units`: the factor of `{column}` is {unit}; allowed: a finite number other than 0"
            )
        return float(unit)
    if not isinstance(unit, str):
        kind = type(unit).__name__
        raise TypeError(f"`units`: `{column}` is of type {kind}; allowed: a text, as \"deg/s\", or a factor")
    if unit == own:
        return 1.0
    found = parse(unit)
    if found is None:
        raise ValueError(
            f"`units`: the unit {unit!r} of `{column}` is unknown; allowed: products and quotients of "
            f"{', '.join(_UNITS)} with the prefixes {', '.join(_PREFIXES)}, as in \"deg/s\", or a factor"
        )
    target = (1.0, found[1]) if own is None else parse(own)
    if target is None or target[1] != found[1]:
        raise ValueError(
            f"`units`: {unit!r} of `{column}` does not convert to {own!r}, the unit of the task; "
            "give a factor, as in 0.001"
        )
    return found[0] / target[0]
