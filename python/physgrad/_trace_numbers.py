"""Traced numbers and conditions: numbers whose values are not known while a function is traced."""

from __future__ import annotations

import math
import numbers
from collections.abc import Callable
from typing import Any, NoReturn

import numpy as np

from ._trace_errors import BRANCH, branch_hint, fail, value_hint
from ._trace_graph import Graph


class Call:
    """One call of a function of the user. Numbers of one call are refused in another."""

    def __init__(self, graph: Graph) -> None:
        self.graph = graph
        # A refusal that NumPy or the user may have caught.
        self.refused: Exception | None = None


# The calls that run now, the innermost last.
CALLS: list[Call] = []


def refuse(kind: type[Exception], message: str) -> NoReturn:
    """Raises an error that also counts if the code of the user or NumPy catches it."""
    try:
        fail(kind, message)
    except Exception as error:
        if CALLS and CALLS[-1].refused is None:
            CALLS[-1].refused = error
        raise


def apply(op: str, *values: Any) -> TracedNumber:
    """The result of an operation on numbers."""
    call = CALLS[-1] if CALLS else None
    ids = [lift(value).id for value in values]
    return TracedNumber(call, call.graph.apply(op, *ids))


MIRRORED = {"lt": "gt", "le": "ge", "gt": "lt", "ge": "le"}
# `x < inf` holds where `x <= LARGEST` does, and so on by the sign of the infinite number.
LARGEST = float(np.finfo(float).max)
OF_INFINITE = {("lt", 1.0): "le", ("ge", 1.0): "gt", ("gt", -1.0): "ge", ("le", -1.0): "lt"}


def compare(op: str, a: Any, b: Any) -> Condition:
    """A comparison of two numbers, of which one may be infinite."""
    if is_infinite(a):
        op, a, b = MIRRORED[op], b, a
    if is_infinite(b):
        sign = float(np.sign(b))
        # `x <= inf` holds unless x is NaN, as `x <= x` does, and `x > inf` never holds, as `x > x`.
        op, b = (OF_INFINITE[op, sign], sign * LARGEST) if (op, sign) in OF_INFINITE else (op, a)
    return Condition(CALLS[-1], CALLS[-1].graph.apply(op, lift(a).id, lift(b).id))


def is_infinite(value: Any) -> bool:
    return isinstance(value, (float, np.floating)) and bool(np.isinf(value))


def name(text: str) -> TracedNumber:
    """A number that has a name in the text."""
    return TracedNumber(CALLS[-1], CALLS[-1].graph.add("name", text))


def is_bool(value: Any) -> bool:
    return isinstance(value, (bool, np.bool_, Condition))


def check_call(value: Symbol) -> None:
    if not CALLS or value.call is not CALLS[-1]:
        refuse(
            RuntimeError,
            "a traced number of another call is used here. It was stored in a global, an attribute or "
            "a closure. A "
            "function computes with its arguments only; what it remembers must be a state of the system",
        )


# Types of real numbers. A `bool` is an `int`.
REAL = (float, int, np.bool_, np.integer, np.floating)


def lift(value: Any) -> TracedNumber:
    """A value as a traced number of the present call."""
    if isinstance(value, Symbol):
        check_call(value)
        return value if isinstance(value, TracedNumber) else choose(value, 1.0, 0.0)
    if isinstance(value, np.ndarray) and base(value).ndim == 0:
        return lift(base(value).item())
    if not isinstance(value, REAL) or isinstance(value, np.longdouble) and not isinstance(value, float):
        shown = (
            f"complex number {value}"
            if isinstance(value, (complex, np.complexfloating))
            else type(value).__name__
        )
        refuse(TypeError, f"a traced function computes with real numbers of float64, not with {shown}")
    if not math.isfinite(value):
        refuse(
            ValueError,
            f"a constant is {float(value)}. Constants must be finite: leave out infinite bounds, and "
            "fill all of np.empty(n)",
        )
    return TracedNumber(CALLS[-1], CALLS[-1].graph.constant(float(value)))


def choose(condition: Any, yes: Any, no: Any) -> Any:
    """`np.where` of one element."""
    if not isinstance(condition, Condition):
        if isinstance(condition, TracedNumber):
            refuse(
                TypeError, "the condition of np.where is a number; compare it, as in `np.where(a > 0, b, c)`"
            )
        chosen = yes if condition else no
        if is_bool(yes) and is_bool(no):
            return chosen if isinstance(chosen, Condition) else np.bool_(chosen)
        # NumPy gives both the same type.
        return lift(chosen) if isinstance(chosen, Symbol) else np.float64(chosen)
    check_call(condition)
    if is_bool(yes) and is_bool(no):
        return (condition & yes) | (~condition & no)
    return apply_where(condition, lift(yes), lift(no))


def apply_where(condition: Condition, yes: TracedNumber, no: TracedNumber) -> TracedNumber:
    return TracedNumber(condition.call, condition.call.graph.apply("where", condition.id, yes.id, no.id))


def combine(op: str, a: Any, b: Any) -> Any:
    """`a and b` or `a or b`. A constant decides, or has no effect."""
    for one, other in ((a, b), (b, a)):
        if not is_bool(one):
            refuse(
                TypeError,
                f"`&`, `|` and `~` need comparisons, as in `(a < x) & (x < b)`, not {type(one).__name__}",
            )
        if not isinstance(one, Condition) and is_bool(other):
            found = other if bool(one) == (op == "and") else one
            return found if isinstance(found, Condition) else np.bool_(found)
    check_call(a)
    check_call(b)
    return Condition(a.call, a.call.graph.apply(op, a.id, b.id))


def invert(a: Any) -> Any:
    if not isinstance(a, Condition):
        return np.bool_(not a) if is_bool(a) else combine("and", a, True)
    check_call(a)
    op, *args = a.call.graph.nodes[a.id]
    return Condition(a.call, args[0] if op == "not" else a.call.graph.apply("not", a.id))


class Operators:
    """Operators and functions of NumPy, by the rules that `_trace_numpy` gives to this class."""

    __slots__ = ()


LOOKED_UP = (
    "a traced number or a condition is looked up in a dict or a set, or is an argument of a function with a "
    "cache. Its value is not known while the function is traced. Write `np.where(condition, a, b)` in place "
    "of the lookup, and leave the cache out"
)


class Symbol(Operators):
    """A number or a condition whose value is not known while the function is traced."""

    __slots__ = ("call", "id")
    # NumPy calls these operators for `constant * traced` too.
    __array_priority__ = 1000.0
    shape, ndim, size = (), 0, 1

    def __init__(self, call: Call, id: int) -> None:
        self.call, self.id = call, id

    def _value(self, *_: Any, index: bool = False) -> NoReturn:
        refuse(
            TypeError,
            f"the value of a traced number is not known while the function is traced. {value_hint(index)}",
        )

    def __index__(self) -> NoReturn:
        self._value(index=True)

    __float__ = __int__ = __complex__ = __round__ = __floor__ = __ceil__ = __trunc__ = _value

    def _same(self, *_: Any, **__: Any) -> Any:
        return self

    __copy__ = __deepcopy__ = __pos__ = copy = item = conj = conjugate = _same

    def __hash__(self) -> int:
        refuse(TypeError, LOOKED_UP)

    def __repr__(self) -> str:
        from ._trace_graph import Text

        text = Text(self.call.graph, [self.id], ())
        return " with ".join(
            [text.shown[self.id][0], *(f"{name} = {part}" for name, part in text.define.items())]
        )

    def __format__(self, _: str) -> str:
        return repr(self)


def operator(function: np.ufunc) -> tuple[Callable, Callable]:
    """A binary operator and its reflected form."""
    return lambda a, b: function(a, b), lambda a, b: function(b, a)


for method, function in {
    "add": np.add,
    "sub": np.subtract,
    "mul": np.multiply,
    "truediv": np.true_divide,
    "floordiv": np.floor_divide,
    "mod": np.remainder,
    "pow": np.power,
    "matmul": np.matmul,
    "and": np.bitwise_and,
    "or": np.bitwise_or,
    "xor": np.bitwise_xor,
    "lshift": np.left_shift,
    "rshift": np.right_shift,
    "divmod": np.divmod,
}.items():
    forward, reflected = operator(function)
    setattr(Symbol, f"__{method}__", forward)
    setattr(Symbol, f"__r{method}__", reflected)
for method, function in {
    "lt": np.less,
    "le": np.less_equal,
    "gt": np.greater,
    "ge": np.greater_equal,
    "eq": np.equal,
    "ne": np.not_equal,
}.items():
    setattr(Symbol, f"__{method}__", operator(function)[0])
for method, function in {"neg": np.negative, "abs": np.absolute, "invert": np.invert}.items():
    setattr(Symbol, f"__{method}__", lambda a, function=function: function(a))


class TracedNumber(Symbol):
    __slots__ = ()

    def __bool__(self) -> bool:
        refuse(TypeError, BRANCH.format(what="a traced number", hint=branch_hint()))

    def astype(self, dtype: Any, **_: Any) -> TracedNumber:
        check_dtype(dtype)
        return self

    def clip(self, *args: Any, **options: Any) -> Any:
        return np.clip(self, *args, **options)

    def sum(self) -> TracedNumber:
        return self

    T = real = property(lambda self: self)


# np.isscalar asks for this.
numbers.Real.register(TracedNumber)
# Loops of NumPy over arrays of objects call methods of the elements.
for method in (
    "sqrt",
    "exp",
    "exp2",
    "expm1",
    "log",
    "log2",
    "log10",
    "log1p",
    "sin",
    "cos",
    "tan",
    "arcsin",
    "arccos",
    "arctan",
    "sinh",
    "cosh",
    "tanh",
    "arctan2",
    "hypot",
    "cbrt",
    "deg2rad",
    "rad2deg",
    "radians",
    "degrees",
    "logaddexp",
):
    setattr(TracedNumber, method, lambda *args, function=getattr(np, method): function(*args))


class Condition(Symbol):
    """A comparison of traced numbers."""

    __slots__ = ()

    def __bool__(self) -> bool:
        refuse(TypeError, BRANCH.format(what="a comparison of traced numbers", hint=branch_hint()))

    def astype(self, dtype: Any, **_: Any) -> Any:
        if np.dtype(dtype) == np.bool_:
            return self
        check_dtype(dtype, integers=True)
        return lift(self)


def check_dtype(dtype: Any, integers: bool = False) -> None:
    """Refuses a dtype that would change numbers. Integers of less than 64 bits overflow soon."""
    kind = np.dtype(dtype)
    if kind != np.float64 and kind != object and not (integers and kind in (np.int64, int)):
        refuse(
            TypeError,
            f"a traced number is a float64, not a {kind}. Leave out the dtype: `precision` selects it",
        )


def is_small(value: Any) -> bool:
    """Whether a constant is of fewer bits than a float64 or an `int`, or without negative numbers."""
    kind = base(value).dtype if isinstance(value, np.ndarray) else value.dtype
    full = {"i": np.dtype(int), "f": np.dtype(float)}
    return kind.kind == "u" or kind.kind in full and kind.itemsize < full[kind.kind].itemsize


def refuse_small(value: Any) -> NoReturn:
    kind = value.dtype
    refuse(TypeError, f"NumPy computes conditions and {kind} constants in {kind}; make the constants float64")


def base(array: np.ndarray) -> np.ndarray:
    """An array of the class of NumPy. Attributes of an `Array` may be the names of states."""
    return np.ndarray.view(array, np.ndarray)


def is_traced(value: Any) -> bool:
    """Whether a value is or contains a traced number or a condition."""
    if isinstance(value, np.ndarray):
        value = base(value)
        return value.dtype == object and any(isinstance(element, Symbol) for element in value.flat)
    if isinstance(value, (list, tuple)):
        return any(map(is_traced, value))
    return isinstance(value, Symbol)
