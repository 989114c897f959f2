"""Functions of NumPy on numbers, and by elements of arrays of traced numbers."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import numpy as np

from ._trace_graph import MOST_POWER
from ._trace_numbers import (
    Condition,
    Symbol,
    TracedNumber,
    apply,
    check_dtype,
    choose,
    combine,
    compare,
    invert,
    is_bool,
    is_small,
    is_traced,
    lift,
    refuse,
    refuse_small,
)
from ._trace_vectors import Array, finish, names_in, plain


def rule(op: str) -> Callable:
    return lambda *args: apply(op, *args)


def constant(value: Any) -> float | None:
    """The value of a number that is not traced."""
    number = lift(value)
    return number.call.graph.number(number.id)


def add(a: Any, b: Any) -> Any:
    if is_bool(a) and is_bool(b):
        refuse(
            TypeError,
            "the sum of two conditions is `or` for NumPy and a count for Python. Write `|`, or "
            "np.sum(np.array([...]))",
        )
    return apply("add", a, b)


def subtract(a: Any, b: Any) -> Any:
    if is_bool(a) and is_bool(b):
        refuse(TypeError, "NumPy does not subtract conditions; use `^`, or multiply one by 1.0")
    return apply("sub", a, b)


def multiply(a: Any, b: Any) -> Any:
    return combine("and", a, b) if is_bool(a) and is_bool(b) else apply("mul", a, b)


def power(base: Any, exponent: Any) -> Any:
    """A power. Whole constant exponents are repeated multiplications."""
    n = constant(exponent)
    if n is None:
        return apply("pow", base, exponent)
    if n == 0.0:
        return lift(1.0)
    if n == 1.0:
        return lift(base)
    if n == -1.0:
        return apply("div", 1.0, base)
    if n.is_integer() and abs(n) > MOST_POWER:
        refuse(ValueError, f"a whole exponent is {n:.0f}; the largest is {MOST_POWER}")
    base = lift(base)
    return TracedNumber(base.call, base.call.graph.add("power", base.id, repr(n)))


def remainder(a: Any, b: Any) -> Any:
    return apply("mod", a, b)


def clip(a: Any, low: Any = None, high: Any = None) -> Any:
    """`min(max(a, low), high)`. An infinite bound has no effect."""
    low = None if low is None or not is_traced(low) and low == -math.inf else low
    high = None if high is None or not is_traced(high) and high == math.inf else high
    given = [value for value in (a, low, high) if value is not None]
    if all(map(is_bool, given)):
        a = a if low is None else combine("or", a, low)
        return a if high is None else combine("and", a, high)
    if low is not None and high is not None:
        return apply("clip", a, low, high)
    if low is not None:
        return apply("max", a, low)
    return lift(a) if high is None else apply("min", a, high)


def is_nan(a: Any) -> Any:
    return invert(compare("le", a, a))


def log1p(x: Any) -> Any:
    """log(1 + x), for |x| < 0.1 by the series of 2 atanh(x / (2 + x)), which keeps small x."""
    s = x / (2.0 + x)
    z = s * s
    series = 1.0 / 15.0
    for k in (13.0, 11.0, 9.0, 7.0, 5.0, 3.0, 1.0):
        series = series * z + 1.0 / k
    return choose(compare("lt", abs(x), 0.1), 2.0 * s * series, np.log(1.0 + x))


def heaviside(x: Any, at_zero: Any) -> Any:
    at_least = choose(compare("ge", x, 0.0), at_zero, x)
    return choose(compare("lt", x, 0.0), 0.0, choose(compare("gt", x, 0.0), 1.0, at_least))


def logaddexp(a: Any, b: Any) -> Any:
    return apply("max", a, b) + log1p(np.exp(-abs(a - b)))


# Functions of numbers, by the name of the function of NumPy.
ELEMENTWISE: dict[str, Callable] = {
    "add": add,
    "subtract": subtract,
    "multiply": multiply,
    "divide": rule("div"),
    "negative": rule("neg"),
    "positive": lift,
    "conjugate": lift,
    "absolute": rule("abs"),
    "fabs": rule("abs"),
    "sign": rule("sign"),
    "sqrt": rule("sqrt"),
    "exp": rule("exp"),
    "log": rule("log"),
    "sin": rule("sin"),
    "cos": rule("cos"),
    "tan": rule("tan"),
    "arcsin": rule("asin"),
    "arccos": rule("acos"),
    "arctan": rule("atan"),
    "arctan2": rule("atan2"),
    "sinh": rule("sinh"),
    "cosh": rule("cosh"),
    "tanh": rule("tanh"),
    "hypot": rule("hypot"),
    "maximum": rule("max"),
    "minimum": rule("min"),
    "clip": clip,
    "power": power,
    "float_power": power,
    "fmax": lambda a, b: choose(combine("or", compare("ge", a, b), is_nan(b)), a, b),
    "fmin": lambda a, b: choose(combine("or", compare("le", a, b), is_nan(b)), a, b),
    "square": lambda a: power(a, 2.0),
    "reciprocal": lambda a: apply("div", 1.0, a),
    "remainder": remainder,
    "deg2rad": lambda a: a * (math.pi / 180.0),
    "radians": lambda a: a * (math.pi / 180.0),
    "rad2deg": lambda a: a * (180.0 / math.pi),
    "degrees": lambda a: a * (180.0 / math.pi),
    "exp2": lambda a: apply("pow", 2.0, a),
    "log2": lambda a: np.log(a) / math.log(2.0),
    "log10": lambda a: np.log(a) / math.log(10.0),
    "log1p": log1p,
    "expm1": lambda a: np.tanh(a / 2.0) * (np.exp(a) + 1.0),
    "cbrt": lambda a: np.sign(a) * power(abs(a), 1.0 / 3.0),
    "arctanh": lambda a: 0.5 * log1p(2.0 * a / (1.0 - a)),
    "logaddexp": logaddexp,
    "heaviside": heaviside,
    "less": lambda a, b: compare("lt", a, b),
    "less_equal": lambda a, b: compare("le", a, b),
    "greater": lambda a, b: compare("gt", a, b),
    "greater_equal": lambda a, b: compare("ge", a, b),
    "logical_and": lambda a, b: combine("and", a, b),
    "bitwise_and": lambda a, b: combine("and", a, b),
    "logical_or": lambda a, b: combine("or", a, b),
    "bitwise_or": lambda a, b: combine("or", a, b),
    "logical_xor": lambda a, b: combine("and", combine("or", a, b), invert(combine("and", a, b))),
    "bitwise_xor": lambda a, b: combine("and", combine("or", a, b), invert(combine("and", a, b))),
    "logical_not": invert,
    "invert": invert,
}
# These treat conditions, or infinite constants, by rules of their own.
OF_ANY = {"add", "subtract", "multiply", "clip", "less", "less_equal", "greater", "greater_equal"} | {
    name for name in ELEMENTWISE if name.startswith(("logical", "bitwise", "inv"))
}


# Types of single numbers.
NUMBERS = {TracedNumber, Condition, float, int, np.float64}


def elementwise(function: Callable, *args: Any) -> Any:
    """Broadcasts a function of numbers."""
    if isinstance(args[0], Symbol) and NUMBERS.issuperset(map(type, args)):
        return function(*args)
    check_small(args)
    arrays = [plain(arg) for arg in args]
    try:
        elements = np.broadcast(*arrays)
    except ValueError:
        shapes = " and ".join(str(array.shape) for array in arrays)
        refuse(ValueError, f"arrays of shapes {shapes} do not broadcast")
    out = np.empty(elements.shape, dtype=object)
    for i, parts in enumerate(elements):
        out.flat[i] = function(*parts)
    return finish(out, names_of(args))


def check_small(args: Any) -> None:
    """Refuses constants of small types among conditions, for which NumPy computes in these types."""
    small = [arg for arg in args if isinstance(arg, (np.generic, np.ndarray)) and is_small(arg)]
    if small and not any(isinstance(value, TracedNumber) for arg in args for value in plain(arg).flat):
        refuse_small(small[0])


def names_of(args: Any) -> tuple[str, ...] | None:
    """The names that all named arguments share."""
    names = {names_in(arg) for arg in args if isinstance(arg, Array)} - {None}
    return names.pop() if len(names) == 1 else None


def of_traced(name: str) -> Callable:
    """The rule of a function by elements, of which at least one is traced."""
    rule = ELEMENTWISE[name]
    if name in OF_ANY:
        return rule

    def function(*args: Any) -> Any:
        if is_bool(args[0]) and all(map(is_bool, args)):
            if name in OF_CONDITIONS:
                return OF_CONDITIONS[name](*args)
            check_conditions(name, len(args))
        return rule(*map(lift, args))

    return function


# What NumPy computes of conditions as conditions.
OF_CONDITIONS: dict[str, Callable] = {
    "absolute": lambda a: a,
    **dict.fromkeys(("maximum", "fmax"), lambda a, b: combine("or", a, b)),
    **dict.fromkeys(("minimum", "fmin"), lambda a, b: combine("and", a, b)),
}


def check_conditions(name: str, count: int) -> None:
    """Refuses functions that NumPy computes of conditions in a small type."""
    try:
        with np.errstate(all="ignore"):
            found = getattr(np, name)(*[np.True_] * count)
    except TypeError:
        return
    if is_small(found):
        refuse(
            TypeError,
            f"NumPy computes np.{name} of conditions in {found.dtype}; multiply the conditions by 1.0 first",
        )


def of_numbers(name: str) -> Callable:
    """The rule of a function by elements. Computes without tracing if no argument is traced."""
    traced, untraced = of_traced(name), getattr(np, name)
    return lambda *args: (traced if any(map(is_traced, args)) else untraced)(*args)


def check_options(name: str, options: dict) -> None:
    """Refuses options that would change numbers."""
    if options.get("dtype") is not None and not name.startswith("logical"):
        check_dtype(options["dtype"])
    if options.get("out") is not None:
        refuse(TypeError, f"give the argument `out` of np.{name} by its name")
    if options.get("where", True) is not True:
        refuse(TypeError, f"the argument `where` of np.{name} is not supported; use np.where")
