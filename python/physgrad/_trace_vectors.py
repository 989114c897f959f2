"""Arrays of traced numbers, and the parameters: the arguments of a traced function."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from typing import Any, NoReturn

import numpy as np

from ._trace_errors import BRANCH, branch_hint, fail, near
from ._trace_numbers import (
    Operators,
    Symbol,
    TracedNumber,
    base,
    check_dtype,
    is_bool,
    is_small,
    is_traced,
    lift,
    name,
    refuse,
    refuse_small,
)


def plain(value: Any) -> np.ndarray:
    """A value as an array of objects, which shares the memory if the value is one."""
    if isinstance(value, Symbol):
        box = np.empty((), dtype=object)
        box[()] = value
        return box
    array = base(value) if isinstance(value, np.ndarray) else np.asarray(value)
    if array.dtype == object:
        return array
    # Elements keep the arithmetic of NumPy, as 1.0 / 0.0, which Python refuses.
    box = np.empty(array.shape, dtype=object)
    for index in np.ndindex(array.shape):
        box[index] = array[index]
    return box


def truth(value: Any) -> Any:
    """A condition that is assigned to an array. Constants count as NumPy's, not as those of Python."""
    return value if isinstance(value, Symbol) else np.bool_(value)


def element(value: Any) -> Any:
    """An element that is assigned to an array of float64."""
    if isinstance(value, (np.ndarray, list, tuple)):
        refuse(
            ValueError,
            "an array is made of rows of different lengths; join them by np.concatenate or np.hstack",
        )
    return lift(value) if isinstance(value, Symbol) else np.float64(value)


def as_numbers(array: np.ndarray) -> np.ndarray:
    """An array of objects with numbers in place of conditions."""
    if not any(map(is_bool, array.flat)):
        return array
    out = np.empty(array.shape, dtype=object)
    for index in np.ndindex(array.shape):
        out[index] = element(array[index]) if is_bool(array[index]) else array[index]
    return out


def of_dtype(value: Any, dtype: Any) -> Any:
    """Traced numbers or conditions with a dtype of NumPy. Refuses a dtype that would change them."""
    array = plain(value)
    of_conditions = array.size > 0 and all(map(is_bool, array.flat))
    if of_conditions and np.dtype(dtype) == np.bool_:
        return value
    check_dtype(dtype, integers=of_conditions)
    return value if np.dtype(dtype) == object or not of_conditions else finish(as_numbers(array))


def finish(array: Any, names: tuple[str, ...] | None = None) -> Any:
    """The result of an operation on objects: an `Array`, or the only element without dimensions."""
    if not isinstance(array, np.ndarray):
        return array
    array = base(array)
    if array.ndim == 0:
        return array[()]
    # All conditions, or all numbers of float64, whose arithmetic is that of an array of float64.
    # Lists that NumPy joins to arrays have elements without dimensions.
    if not all(isinstance(value, (TracedNumber, np.float64)) for value in array.flat):
        mixed, array = array, np.empty(array.shape, dtype=object)
        for index in np.ndindex(array.shape):
            value = mixed[index]
            array[index] = value.item() if isinstance(value, np.ndarray) and value.ndim == 0 else value
        of_conditions = all(map(is_bool, array.flat))
        if not of_conditions and not any(isinstance(value, TracedNumber) for value in array.flat):
            check_joined(mixed)
        for index in np.ndindex(array.shape):
            array[index] = truth(array[index]) if of_conditions else element(array[index])
    result = array.view(Array)
    if names is not None and result.shape == (len(names),):
        object.__setattr__(result, "_names", names)
    return result


def check_joined(array: np.ndarray) -> None:
    """Refuses conditions that NumPy joins with constants of a small type to an array of that type."""
    constants = [value for value in array.flat if not isinstance(value, Symbol)]
    if len(constants) < array.size and any(isinstance(value, (np.generic, np.ndarray)) for value in constants):
        joined = np.array(constants)
        if is_small(joined):
            refuse_small(joined)


def demote(value: Any) -> Any:
    """A value without traced numbers as NumPy has it outside of a traced function."""
    if isinstance(value, Array):
        array = base(value)
        return np.array(array.tolist(), dtype=bool if all(map(is_bool, array.flat)) and array.size else float)
    return type(value)(map(demote, value)) if type(value) in (list, tuple) else value


def promote(value: Any) -> Any:
    """A new array of float64 that can hold traced numbers."""
    if isinstance(value, np.ndarray) and base(value).dtype == np.float64:
        return plain(value).view(Array)
    return value


def names_in(array: Array) -> tuple[str, ...] | None:
    """The names of the components, also if one of them is `_names`."""
    return object.__getattribute__(array, "_names")


class Array(Operators, np.ndarray):
    """An array of float64 numbers, of which some are traced. Components of a vector may have names."""

    __array_priority__ = 1001.0
    _names: tuple[str, ...] | None = None
    # Whether this is an argument of the function, and not a copy.
    _given = False

    def __getattribute__(self, name: str) -> Any:
        names = names_in(self)
        if names is not None and name in names:
            return np.ndarray.__getitem__(self, names.index(name))
        return super().__getattribute__(name)

    def __getattr__(self, name: str) -> NoReturn:
        if name.startswith("__"):
            raise AttributeError(name)
        fail(AttributeError, Array._unknown(self, name))

    def _unknown(self, name: str) -> str:
        if names_in(self) is None:
            return f"this array has no `{name}`; names are those of x, u, next and their copies"
        return f"there is no `{name}`{near(name, names_in(self))}"

    def __setattr__(self, name: str, value: Any) -> None:
        names = names_in(self)
        if names is not None and name in names:
            if object.__getattribute__(self, "_given"):
                refuse(
                    AttributeError,
                    f"`{name}` is assigned in an argument of the function, which would not change the "
                    f"system. Assign to a copy: `y = x.copy()`, then `y.{name} = ...`, and use `y`",
                )
            self[names.index(name)] = value
        elif hasattr(np.ndarray, name):
            super().__setattr__(name, value)
        else:
            refuse(AttributeError, Array._unknown(self, name))

    def _index(self, key: Any) -> Any:
        if (
            isinstance(key, str)
            or isinstance(key, list)
            and key
            and all(isinstance(part, str) for part in key)
        ):
            for part in [key] if isinstance(key, str) else key:
                if names_in(self) is None or part not in names_in(self):
                    refuse(LookupError, Array._unknown(self, part))
            names = names_in(self)
            return names.index(key) if isinstance(key, str) else [names.index(part) for part in key]
        if is_traced(key):
            refuse(
                IndexError,
                "an index depends on traced numbers, whose values are not known. Write "
                "`np.where(condition, a, b)` in "
                "place of a mask, and `pg.table(values)` or `np.interp` in place of an index into an array",
            )
        return demote(key)

    def __getitem__(self, key: Any) -> Any:
        index = Array._index(self, key)
        result = super().__getitem__(index)
        whole = index is Ellipsis or isinstance(index, slice) and index == slice(None)
        return finish(result, names_in(self)) if whole else result

    def __setitem__(self, key: Any, value: Any) -> None:
        index, values, target = Array._index(self, key), plain(value), base(self)
        of_conditions = target.size > 0 and all(map(is_bool, target.flat))
        if of_conditions and not all(map(is_bool, values.flat)):
            refuse(TypeError, "an array of conditions is assigned a number; assign a comparison")
        boxed = np.empty(values.shape, dtype=object)
        for place in np.ndindex(values.shape):
            boxed[place] = truth(values[place]) if of_conditions else element(values[place])
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

    def fill(self, value: Any) -> None:
        self[...] = value

    def put(self, *_: Any, **__: Any) -> NoReturn:
        refuse(TypeError, "`put` is not supported in a traced function; assign the elements")

    def copy(self, order: str = "C") -> Array:
        copied = base(self).copy(order)
        return finish(copied, names_in(self)) if copied.ndim else copied.view(Array)

    def __copy__(self) -> Array:
        return Array.copy(self)

    def __deepcopy__(self, _: Any) -> Array:
        return Array.copy(self)

    def astype(self, dtype: Any, **_: Any) -> Any:
        if not is_traced(self):
            return promote(demote(self).astype(dtype))
        return finish(of_dtype(Array.copy(self), dtype), names_in(self))

    def dot(self, other: Any) -> Any:
        return np.dot(self, other)

    def argmin(self, *args: Any, **options: Any) -> Any:
        return np.argmin(self, *args, **options)

    def argmax(self, *args: Any, **options: Any) -> Any:
        return np.argmax(self, *args, **options)

    def argsort(self, *args: Any, **options: Any) -> Any:
        return np.argsort(self, *args, **options)

    def item(self, *index: Any) -> Any:
        return of_python(base(self).item(*index))

    def tolist(self) -> Any:
        return of_python(base(self).tolist())


def of_python(value: Any) -> Any:
    """Constant conditions as those of Python, in lists of any nesting."""
    if isinstance(value, list):
        return list(map(of_python, value))
    return bool(value) if isinstance(value, np.bool_) else value


def vector(names: Iterable[str], prefix: str = "") -> Array:
    """An array of traced numbers with names."""
    names = tuple(names)
    box = np.empty(len(names), dtype=object)
    box[:] = [name(prefix + label) for label in names]
    result = finish(box, names)
    object.__setattr__(result, "_given", True)
    return result


def values_in(parameters: Parameters) -> dict[str, Any]:
    """The values by name, also if a name is `_values`."""
    return object.__getattribute__(parameters, "_values")


class Parameters:
    """The parameters of a function: traced numbers, and constant arrays, by name or in their order."""

    def __init__(self, values: dict[str, Any], used: set[str] | None = None, dt: Any = None) -> None:
        object.__setattr__(self, "_values", values)
        # Receives the names that the function reads.
        object.__setattr__(self, "_used", set() if used is None else used)
        # The time step is no parameter: it has a name, and no place in the order.
        if dt is not None:
            object.__setattr__(self, "dt", dt)

    def __getattribute__(self, name: str) -> Any:
        values = values_in(self)
        if name not in values:
            return object.__getattribute__(self, name)
        object.__getattribute__(self, "_used").add(name)
        return values[name]

    def __getattr__(self, name: str) -> NoReturn:
        if name.startswith("__"):
            raise AttributeError(name)
        fail(AttributeError, f"there is no parameter `{name}`{near(name, values_in(self))}")

    def __getitem__(self, key: Any) -> Any:
        if isinstance(key, str):
            if key not in values_in(self) and (key != "dt" or key not in vars(self)):
                refuse(LookupError, f"there is no parameter `{key}`{near(key, values_in(self))}")
            return getattr(self, key)
        return list(values_in(self).values())[key]

    def __setattr__(self, name: str, value: Any) -> NoReturn:
        refuse(AttributeError, f"the parameter `{name}` does not change; use a variable of another name")

    __setitem__ = __setattr__

    def __iter__(self) -> Iterator:
        return iter(values_in(self).values())

    def __len__(self) -> int:
        return len(values_in(self))

    def __contains__(self, name: str) -> bool:
        return name in values_in(self)

    def keys(self) -> Iterable[str]:
        return values_in(self).keys()

    def values(self) -> Iterable[Any]:
        return values_in(self).values()

    def items(self) -> Iterable[tuple[str, Any]]:
        return values_in(self).items()
