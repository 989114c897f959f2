"""Traced numbers and conditions, arrays of them, and the parameters: the arguments of a traced function."""

from __future__ import annotations

import numbers
from collections.abc import Callable, Iterable, Iterator
from typing import Any, NoReturn

import numpy as np

from ._trace_errors import BRANCH, branch_hint, fail, near, value_hint
from ._trace_graph import Graph

# The constructors of NumPy, which are replaced while a function is traced.
ARRAY, ASARRAY = np.array, np.asarray


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


def compare(op: str, *values: Any) -> Condition:
    """A comparison of two numbers."""
    ids = [lift(value).id for value in values]
    return Condition(CALLS[-1], CALLS[-1].graph.apply(op, *ids))


def name(text: str) -> TracedNumber:
    """A number that has a name in the text."""
    return TracedNumber(CALLS[-1], CALLS[-1].graph.add("name", text))


def is_bool(value: Any) -> bool:
    return isinstance(value, (bool, np.bool_, Condition))


def check_call(value: Symbol) -> None:
    if not CALLS or value.call is not CALLS[-1]:
        refuse(
            RuntimeError,
            "a traced number of another call is used here. It was stored in a global, an attribute or a closure. A "
            "function computes with its arguments only; what it remembers must be a state of the system",
        )


def lift(value: Any) -> TracedNumber:
    """A value as a traced number of the present call."""
    if isinstance(value, np.ndarray) and base(value).ndim == 0:
        value = base(value).item()
    if isinstance(value, Symbol):
        check_call(value)
        return value if isinstance(value, TracedNumber) else choose(value, 1.0, 0.0)
    real = isinstance(value, (bool, int, float, np.bool_, np.integer, np.floating))
    if not real or isinstance(value, np.longdouble) and not isinstance(value, float):
        shown = f"complex number {value}" if isinstance(value, (complex, np.complexfloating)) else type(value).__name__
        refuse(TypeError, f"a traced function computes with real numbers of float64, not with {shown}")
    if not np.isfinite(value):
        refuse(
            ValueError,
            f"a constant is {float(value)}. Constants must be finite: leave out infinite bounds, and fill all of np.empty(n)",
        )
    return TracedNumber(CALLS[-1], CALLS[-1].graph.constant(float(value)))


def choose(condition: Any, yes: Any, no: Any) -> Any:
    """`np.where` of one element."""
    if not isinstance(condition, Condition):
        if isinstance(condition, TracedNumber):
            refuse(TypeError, "the condition of np.where is a number; compare it, as in `np.where(a > 0, b, c)`")
        return yes if condition else no
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
            refuse(TypeError, f"`&`, `|` and `~` need comparisons, as in `(a < x) & (x < b)`, not {type(one).__name__}")
        if not isinstance(one, Condition) and is_bool(other):
            return other if bool(one) == (op == "and") else bool(one)
    check_call(a)
    check_call(b)
    return Condition(a.call, a.call.graph.apply(op, a.id, b.id))


def invert(a: Any) -> Any:
    if not isinstance(a, Condition):
        return not a if is_bool(a) else combine("and", a, True)
    check_call(a)
    op, *args = a.call.graph.nodes[a.id]
    return Condition(a.call, args[0] if op == "not" else a.call.graph.apply("not", a.id))


class Operators:
    """Operators and functions of NumPy, by the rules of `_trace_numpy`."""

    def __array_ufunc__(self, function, method, *args, **options):
        from ._trace_numpy import ufunc

        return ufunc(function, method, args, options)

    def __array_function__(self, function, types, args, kwargs):
        from ._trace_numpy import array_function

        return array_function(function, args, kwargs)


class Symbol(Operators):
    """A number or a condition whose value is not known while the function is traced."""

    __slots__ = ("call", "id")
    # NumPy calls these operators for `constant * traced` too.
    __array_priority__ = 1000.0
    shape, ndim, size = (), 0, 1

    def __init__(self, call: Call, id: int) -> None:
        self.call, self.id = call, id

    def _value(self, *_: Any) -> NoReturn:
        refuse(TypeError, f"the value of a traced number is not known while the function is traced. {value_hint()}")

    __float__ = __int__ = __index__ = __complex__ = __round__ = __floor__ = __ceil__ = __trunc__ = _value

    def _same(self, *_: Any, **__: Any) -> Any:
        return self

    __copy__ = __deepcopy__ = __pos__ = copy = item = conj = conjugate = _same
    __hash__ = object.__hash__

    def __repr__(self) -> str:
        from ._trace_graph import Text

        text = Text(self.call.graph, [self.id], ())
        return " with ".join([text.shown[self.id][0], *(f"{name} = {part}" for name, part in text.define.items())])

    def __format__(self, _: str) -> str:
        return repr(self)


def operator(function: np.ufunc) -> tuple[Callable, Callable]:
    """A binary operator and its reflected form."""
    return lambda a, b: function(a, b), lambda a, b: function(b, a)


for method, function in {
    "add": np.add, "sub": np.subtract, "mul": np.multiply, "truediv": np.true_divide, "floordiv": np.floor_divide,
    "mod": np.remainder, "pow": np.power, "matmul": np.matmul, "and": np.bitwise_and, "or": np.bitwise_or,
    "xor": np.bitwise_xor, "lshift": np.left_shift, "rshift": np.right_shift, "divmod": np.divmod,
}.items():  # fmt: skip
    forward, reflected = operator(function)
    setattr(Symbol, f"__{method}__", forward)
    setattr(Symbol, f"__r{method}__", reflected)
for method, function in {
    "lt": np.less, "le": np.less_equal, "gt": np.greater, "ge": np.greater_equal, "eq": np.equal, "ne": np.not_equal
}.items():  # fmt: skip
    setattr(Symbol, f"__{method}__", operator(function)[0])
for method, function in {"neg": np.negative, "abs": np.absolute, "invert": np.invert}.items():
    setattr(Symbol, f"__{method}__", lambda a, function=function: function(a))


class TracedNumber(Symbol):
    __slots__ = ()
    __hash__ = object.__hash__

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
for method in ("sqrt", "exp", "exp2", "expm1", "log", "log2", "log10", "log1p", "sin", "cos", "tan", "arcsin", "arccos",
               "arctan", "sinh", "cosh", "tanh", "arctan2", "hypot", "cbrt", "deg2rad", "rad2deg", "radians", "degrees",
               "logaddexp"):  # fmt: skip
    setattr(TracedNumber, method, lambda *args, function=getattr(np, method): function(*args))


class Condition(Symbol):
    """A comparison of traced numbers."""

    __slots__ = ()
    __hash__ = object.__hash__

    def __bool__(self) -> bool:
        refuse(TypeError, BRANCH.format(what="a comparison of traced numbers", hint=branch_hint()))

    def astype(self, dtype: Any, **_: Any) -> Any:
        if np.dtype(dtype) == bool:
            return self
        check_dtype(dtype, integers=True)
        return lift(self)


def check_dtype(dtype: Any, integers: bool = False) -> None:
    """Refuses a dtype that would change numbers."""
    kind = np.dtype(dtype)
    if kind != np.float64 and kind != object and not (integers and kind.kind in "iu"):
        refuse(TypeError, f"a traced number is a float64, not a {kind}. Leave out the dtype: `precision` selects it")


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


def plain(value: Any) -> np.ndarray:
    """A value as an array of objects of the class of NumPy, which shares the memory of an array of objects."""
    if isinstance(value, Symbol):
        box = np.empty((), dtype=object)
        box[()] = value
        return box
    array = base(value) if isinstance(value, np.ndarray) else ASARRAY(value)
    if array.dtype == object:
        return array
    # Elements keep the arithmetic of NumPy, as 1.0 / 0.0, which Python refuses.
    box = np.empty(array.shape, dtype=object)
    for index in np.ndindex(array.shape):
        box[index] = array[index]
    return box


def element(value: Any) -> Any:
    """An element that is assigned to an array of float64."""
    return lift(value) if isinstance(value, Symbol) else np.float64(value)


def finish(array: Any, names: tuple[str, ...] | None = None) -> Any:
    """The result of an operation on arrays of objects: an `Array`, or its only element without dimensions."""
    if not isinstance(array, np.ndarray):
        return array
    array = base(array)
    if array.ndim == 0:
        return array[()]
    # All conditions, or all numbers of float64, whose arithmetic is that of an array of float64. Lists that NumPy
    # joins to arrays have elements without dimensions.
    if not all(isinstance(value, (TracedNumber, np.float64)) for value in array.flat):
        mixed, array = array, np.empty(array.shape, dtype=object)
        for index in np.ndindex(array.shape):
            value = mixed[index]
            array[index] = value.item() if isinstance(value, np.ndarray) and value.ndim == 0 else value
        if not all(map(is_bool, array.flat)):
            for index in np.ndindex(array.shape):
                array[index] = element(array[index])
    result = array.view(Array)
    if names is not None and result.shape == (len(names),):
        object.__setattr__(result, "_names", names)
    return result


def demote(value: Any) -> Any:
    """A value without traced numbers as NumPy has it outside of a traced function."""
    if isinstance(value, Array):
        array = base(value)
        return ARRAY(array.tolist(), dtype=bool if all(map(is_bool, array.flat)) and array.size else float)
    return type(value)(map(demote, value)) if type(value) in (list, tuple) else value


def promote(value: Any) -> Any:
    """A new array of float64 that can hold traced numbers."""
    if isinstance(value, np.ndarray) and base(value).dtype == np.float64 and value.ndim > 0:
        return plain(value).view(Array)
    return value


class Array(Operators, np.ndarray):
    """An array of float64 numbers, of which some are traced. Components of a vector may have names."""

    __array_priority__ = 1001.0
    _names: tuple[str, ...] | None = None

    def __getattribute__(self, name: str) -> Any:
        names = object.__getattribute__(self, "_names")
        if names is not None and name in names:
            return np.ndarray.__getitem__(self, names.index(name))
        return super().__getattribute__(name)

    def __getattr__(self, name: str) -> NoReturn:
        if name.startswith("__"):
            raise AttributeError(name)
        fail(AttributeError, self._unknown(name))

    def _unknown(self, name: str) -> str:
        if self._names is None:
            return f"this array has no `{name}`; names are those of x, u, next and their copies"
        return f"there is no `{name}`{near(name, self._names)}"

    def __setattr__(self, name: str, value: Any) -> None:
        if self._names is not None and name in self._names:
            self[self._names.index(name)] = value
        elif hasattr(np.ndarray, name):
            super().__setattr__(name, value)
        else:
            fail(AttributeError, self._unknown(name))

    def _index(self, key: Any) -> Any:
        if isinstance(key, str) or isinstance(key, list) and key and all(isinstance(part, str) for part in key):
            for part in [key] if isinstance(key, str) else key:
                if self._names is None or part not in self._names:
                    refuse(LookupError, self._unknown(part))
            return self._names.index(key) if isinstance(key, str) else [self._names.index(part) for part in key]
        if is_traced(key):
            refuse(
                IndexError,
                "an index depends on traced numbers, whose values are not known. Write `np.where(condition, a, b)` in "
                "place of a mask, and `pg.table(values)` or `np.interp` in place of an index into an array",
            )
        return demote(key)

    def __getitem__(self, key: Any) -> Any:
        index = self._index(key)
        result = super().__getitem__(index)
        whole = index is Ellipsis or isinstance(index, slice) and index == slice(None)
        return finish(result, self._names) if whole else result

    def __setitem__(self, key: Any, value: Any) -> None:
        index, values, target = self._index(key), plain(value), base(self)
        of_conditions = target.size > 0 and all(map(is_bool, target.flat))
        if of_conditions and not all(map(is_bool, values.flat)):
            refuse(TypeError, "an array of conditions is assigned a number; assign a comparison")
        boxed = np.empty(values.shape, dtype=object)
        for place in np.ndindex(values.shape):
            boxed[place] = values[place] if of_conditions else element(values[place])
        # An array in one place would become an element of its own.
        if np.ndim(target[index]) == 0 and boxed.ndim > 0:
            if boxed.size != 1:
                refuse(ValueError, f"an element of an array is assigned an array of shape {boxed.shape}")
            boxed = boxed.reshape(())
        target[index] = boxed if boxed.ndim else boxed[()]

    def __iter__(self) -> Iterator:
        return iter([self[i] for i in range(len(self))])

    def __bool__(self) -> bool:
        if is_traced(self):
            refuse(TypeError, BRANCH.format(what="an array of traced numbers", hint=branch_hint()))
        return bool(demote(self))

    def __pow__(self, exponent: Any) -> Any:
        # The operator of arrays takes square roots where np.power takes powers.
        half = isinstance(exponent, float) and exponent == 0.5
        return np.sqrt(self) if half else np.power(self, exponent)

    def copy(self, order: str = "C") -> Array:
        return finish(base(self).copy(order), self._names)

    def __copy__(self) -> Array:
        return Array.copy(self)

    def __deepcopy__(self, _: Any) -> Array:
        return Array.copy(self)

    def astype(self, dtype: Any, **_: Any) -> Any:
        if not is_traced(self):
            return promote(demote(self).astype(dtype))
        if not all(map(is_bool, base(self).flat)):
            check_dtype(dtype)
        elif np.dtype(dtype) != bool:
            check_dtype(dtype, integers=True)
            return finish(plain([element(value) for value in base(self).flat])).reshape(base(self).shape)
        return finish(base(self).copy(), self._names)

    def dot(self, other: Any) -> Any:
        return np.dot(self, other)

    def item(self, *index: Any) -> Any:
        return base(self).item(*index)


def vector(names: Iterable[str], prefix: str = "") -> Array:
    """An array of traced numbers with names."""
    names = tuple(names)
    box = np.empty(len(names), dtype=object)
    box[:] = [name(prefix + label) for label in names]
    return finish(box, names)


class Parameters:
    """The parameters of a function: traced numbers, and constant arrays, by name or in their order."""

    def __init__(self, values: dict[str, Any]) -> None:
        object.__setattr__(self, "_values", values)

    def __getattribute__(self, name: str) -> Any:
        values = object.__getattribute__(self, "_values")
        return values[name] if name in values else object.__getattribute__(self, name)

    def __getattr__(self, name: str) -> NoReturn:
        if name.startswith("__"):
            raise AttributeError(name)
        fail(AttributeError, f"there is no parameter `{name}`{near(name, self._values)}")

    def __getitem__(self, key: Any) -> Any:
        if isinstance(key, str):
            if key not in self._values:
                refuse(LookupError, f"there is no parameter `{key}`{near(key, self._values)}")
            return self._values[key]
        return list(self._values.values())[key]

    def __setattr__(self, name: str, value: Any) -> NoReturn:
        refuse(AttributeError, f"the parameter `{name}` does not change; use a variable of another name")

    __setitem__ = __setattr__

    def __iter__(self) -> Iterator:
        return iter(self._values.values())

    def __len__(self) -> int:
        return len(self._values)

    def __contains__(self, name: str) -> bool:
        return name in self._values

    def keys(self) -> Iterable[str]:
        return self._values.keys()

    def values(self) -> Iterable[Any]:
        return self._values.values()

    def items(self) -> Iterable[tuple[str, Any]]:
        return self._values.items()
