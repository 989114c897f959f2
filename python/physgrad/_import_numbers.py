"""Functions of traced numbers that CasADi and JAX have and NumPy lacks, or defines otherwise."""

from __future__ import annotations

import math
import sys
from typing import Any

import numpy as np

from ._trace_elements import log1p, power
from ._trace_numbers import Condition, TracedNumber, apply, choose, combine, compare, invert, lift

# The series of `erf` has so many terms that those left out are below the rounding at the bound.
ERF_TERMS, ERF_BOUND = 110, 6.0
# Terms of the continued fraction of `erfc`, whose error at 2 is below the rounding.
ERFC_TERMS = 60


def infinite(a: Any) -> float:
    """The sign of an infinite constant, and otherwise 0."""
    constant = not isinstance(a, (TracedNumber, Condition))
    return math.copysign(1.0, a) if constant and np.isinf(a) else 0.0


def equal(a: Any, b: Any) -> Any:
    for one, other in ((a, b), (b, a)):
        # A comparison that was made a number, and is compared with 0 or 1.
        if (
            isinstance(one, Condition)
            and not isinstance(other, (TracedNumber, Condition))
            and other in (0, 1)
        ):
            return one if other == 1 else invert(one)
        if infinite(one):
            return compare("ge" if one > 0 else "le", other, one)
    a, b = lift(a), lift(b)
    return combine("and", compare("le", a, b), compare("ge", a, b))


def truth(a: Any) -> Any:
    """Whether a number is not 0. NaN is not."""
    return a if isinstance(a, (Condition, bool, np.bool_)) else invert(equal(a, 0.0))


def not_nan(a: Any) -> Any:
    return compare("le", a, a)


def fmax(a: Any, b: Any) -> Any:
    """The larger number, or the one that is not NaN."""
    return extreme("ge", -1.0, a, b)


def fmin(a: Any, b: Any) -> Any:
    """The smaller number, or the one that is not NaN."""
    return extreme("le", 1.0, a, b)


def extreme(op: str, neutral: float, a: Any, b: Any) -> Any:
    for one, other in ((a, b), (b, a)):
        if infinite(one) == neutral:
            return lift(other)
    a, b = lift(a), lift(b)
    first = compare(op, a, b)
    # A constant is not NaN, so a test is left out.
    if b.call.graph.number(b.id) is None:
        first = combine("or", first, invert(not_nan(b)))
    return choose(first, a, b)


def maximum(a: Any, b: Any) -> Any:
    """The larger number, or NaN if one is NaN."""
    return lift(b) if infinite(a) < 0 else lift(a) if infinite(b) < 0 else apply("max", a, b)


def minimum(a: Any, b: Any) -> Any:
    return lift(b) if infinite(a) > 0 else lift(a) if infinite(b) > 0 else apply("min", a, b)


def is_finite(a: Any) -> Any:
    return compare("le", abs(lift(a)), sys.float_info.max)


def negative(a: Any) -> Any:
    """Whether the sign of a number is set, also that of a zero."""
    a = lift(a)
    return combine("or", compare("lt", a, 0.0), compare("lt", 1.0 / a, 0.0))


def copysign(a: Any, b: Any) -> Any:
    size = abs(lift(a))
    return choose(negative(b), -size, size)


def odd(function: Any, x: Any) -> Any:
    """An odd function, from its values at positive arguments."""
    x = lift(x)
    return choose(compare("lt", x, 0.0), -function(-x), function(x))


def asinh(x: Any) -> Any:
    return odd(lambda x: log1p(x + x * (x / (1.0 + np.hypot(1.0, x)))), x)


def acosh(x: Any) -> Any:
    x = lift(x)
    return log1p((x - 1.0) + np.sqrt(x - 1.0) * np.sqrt(x + 1.0))


def atanh(x: Any) -> Any:
    return odd(lambda x: 0.5 * log1p(2.0 * x / (1.0 - x)), x)


def expm1(x: Any) -> Any:
    """exp(x) - 1 = 2 tanh(x / 2) / (1 - tanh(x / 2)) near 0, where the difference would lose digits."""
    x = lift(x)
    return choose(compare("lt", abs(x), 0.5), np.tanh(0.5 * x) * (np.exp(x) + 1.0), np.exp(x) - 1.0)


def cbrt(x: Any) -> Any:
    return odd(lambda x: power(x, 1.0 / 3.0), x)


def logistic(x: Any) -> Any:
    """1 / (1 + exp(-x)), of which the exponentials in use do not overflow."""
    x = lift(x)
    small = np.exp(x)
    return choose(compare("lt", x, 0.0), small / (1.0 + small), 1.0 / (1.0 + np.exp(-x)))


def erf(x: Any) -> Any:
    """2 / sqrt(pi) x exp(-x^2) sum of (2 x^2)^n / (2n + 1)!!, all terms of which are positive.

    Abramowitz and Stegun, 7.1.6. Beyond the bound, erf differs from 1 by less than the rounding.
    """
    x = apply("clip", x, -ERF_BOUND, ERF_BOUND)
    square = x * x
    total: Any = 1.0
    for n in range(ERF_TERMS, 0, -1):
        total = 1.0 + total * (square * (2.0 / (2 * n + 1)))
    return 2.0 / math.sqrt(math.pi) * x * np.exp(-square) * total


def erfc(x: Any) -> Any:
    """1 - erf(x), above 2 by the continued fraction, which keeps small values.

    Abramowitz and Stegun, 7.1.14. Beyond 27, the value is below the smallest number.
    """
    x = lift(x)
    y = apply("clip", x, 2.0, 28.0)
    fraction: Any = y
    for n in range(ERFC_TERMS, 0, -1):
        fraction = y + 0.5 * n / fraction
    above = np.exp(-y * y) / (math.sqrt(math.pi) * fraction)
    return choose(compare("gt", x, 2.0), above, 1.0 - erf(x))
