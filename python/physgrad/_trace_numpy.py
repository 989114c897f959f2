"""Functions of NumPy on arrays of traced numbers: the rule of each, or what to write instead."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from typing import Any

import numpy as np

from . import _trace_algebra as algebra
from ._trace_elements import (
    ELEMENTWISE,
    NUMBERS,
    check_options,
    check_small,
    clip,
    elementwise,
    of_numbers,
    of_traced,
)
from ._trace_errors import ORDER, SEARCH, SELECT, near
from ._trace_numbers import (
    CALLS,
    Condition,
    Operators,
    TracedNumber,
    base,
    choose,
    compare,
    is_bool,
    is_traced,
    lift,
    refuse,
)
from ._trace_reductions import mean, norm, reduce, reduction, total, variance
from ._trace_vectors import Array, as_numbers, demote, finish, of_dtype, plain, promote

EQUAL = (
    "a traced function cannot ask whether numbers are equal. Write "
    "`np.where(np.abs(a - b) < 1e-9, yes, no)`, or `<` and `>`"
)
STEPS = (
    "np.{name} is constant between jumps, so its derivative says nothing, and it has no text. Leave "
    "the rounding out, or write `np.where` with `<`"
)
FINITE = "a rollout ends where a number is not finite, so a function need not ask. Leave np.{name} out"
REFUSED = {
    "equal": EQUAL,
    "not_equal": EQUAL,
    **{
        name: STEPS.format(name=name)
        for name in ("floor", "ceil", "rint", "trunc", "floor_divide", "divmod", "fmod", "modf")
    },
    **{name: FINITE.format(name=name) for name in ("isnan", "isfinite", "isinf")},
}

# Calls with numbers and without options, which are most, need nothing but the rule.
OF_NUMBERS = {
    getattr(np, name): of_traced(name)
    for name in ELEMENTWISE
    if isinstance(getattr(np, name), np.ufunc)
}


def ufunc(_: Any, function: np.ufunc, method: str, *args: Any, **options: Any) -> Any:
    """Evaluates a call or a method of a universal function."""
    if method == "__call__" and not options and NUMBERS.issuperset(map(type, args)):
        if function in OF_NUMBERS:
            return OF_NUMBERS[function](*args)
    name = function.__name__
    out = options.pop("out", None)
    if method == "at":
        refuse(TypeError, f"np.{name}.at is not supported in a traced function; assign the elements")
    if not any(map(is_traced, args)):
        result = promote(getattr(function, method)(*map(demote, args), **demote_all(options)))
    elif name in REFUSED:
        refuse(TypeError, REFUSED[name])
    else:
        check_options(name, options)
        result = traced_ufunc(function, method, args, options)
    return result if out is None else write(out, result)


def demote_all(options: dict) -> dict:
    return {key: demote(value) for key, value in options.items()}


def traced_ufunc(function: np.ufunc, method: str, args: tuple, options: dict) -> Any:
    name = function.__name__
    if name in ("matmul", "vecdot", "matvec", "vecmat"):
        return matmul(*args) if name == "matmul" else unsupported(name)
    # A function of another package may have the name of one of NumPy.
    known = getattr(np, name, None)
    other = known is None and not name.endswith("(vectorized)")
    if other or isinstance(known, np.ufunc) and known is not function:
        instead = f"np.{name}" if known else "it with functions of NumPy"
        refuse(
            TypeError,
            f"`{name}` of another package than NumPy is not supported in a traced function; write {instead}",
        )
    if name not in ELEMENTWISE:
        unsupported(name)
    if method == "__call__":
        return elementwise(of_numbers(name), *args)
    if method == "reduce":
        axis, keepdims = options.get("axis", args[1] if len(args) > 1 else 0), options.get("keepdims", False)
        return reduce(name, args[0], axis, bool(keepdims), options.get("initial"))
    if method == "accumulate":
        array = as_numbers(plain(args[0])) if name in ("add", "multiply") else plain(args[0])
        return finish(getattr(function, method)(array, axis=options.get("axis", 0)))
    if method == "outer":
        a, b = map(plain, args)
        return elementwise(of_numbers(name), a.reshape(a.shape + (1,) * b.ndim), b)
    refuse(TypeError, f"np.{name}.{method} is not supported in a traced function")


def write(out: tuple, result: Any) -> Any:
    """Stores a result in an argument `out`, as `x += 1` does."""
    (target,) = out
    held = base(target) if isinstance(target, np.ndarray) else np.empty(0)
    if held.dtype != object:
        if is_traced(result):
            refuse(
                TypeError,
                "an array of fixed numbers cannot hold traced ones. Begin with `np.zeros(n)` inside "
                "of the function, or "
                "write `a = a + b` in place of `a += b`",
            )
        target[...] = result
        return target
    if np.shape(result) != held.shape and np.broadcast_shapes(np.shape(result), held.shape) != held.shape:
        refuse(ValueError, f"a result of shape {np.shape(result)} does not fit in shape {held.shape}")
    held.view(Array)[...] = result
    return target


def matmul(a: Any, b: Any, out: Any = None) -> Any:
    a, b = factors(a, b)
    if a.ndim == 0 or b.ndim == 0 or a.shape[-1] != b.shape[max(b.ndim - 2, 0)]:
        refuse(ValueError, f"a product of shapes {a.shape} and {b.shape}: the inner dimensions differ")
    return finish(np.matmul(a, b))


def factors(*args: Any, added: bool = True) -> list:
    """Arrays whose products may be added. Those of conditions alone are conditions in NumPy."""
    check_small(args)
    arrays = list(map(plain, args))
    values = [value for array in arrays for value in array.flat]
    if any(map(is_bool, values)):
        if all(map(is_bool, values)):
            if not added:
                return list(map(finish, arrays))
            refuse(
                TypeError,
                "the sum of products of conditions is a condition in NumPy. Multiply one array by 1.0 first",
            )
        arrays = list(map(as_numbers, arrays))
    return arrays


def dot(a: Any, b: Any) -> Any:
    if np.ndim(a) == 0 or np.ndim(b) == 0:
        return np.multiply(a, b)
    if np.ndim(b) > 2:
        refuse(TypeError, "np.dot with three or more dimensions is not supported; use `@`")
    return matmul(a, b)


def where(condition: Any, *branches: Any) -> Any:
    if len(branches) != 2:
        refuse(
            TypeError,
            "the places where a condition holds are not known; give both values: `np.where(condition, a, b)`",
        )
    return elementwise(choose, condition, *branches)


def select(conditions: Any, choices: Any, default: Any = 0.0) -> Any:
    result = default
    for condition, choice in reversed(list(zip(conditions, choices, strict=True))):
        result = where(condition, choice, result)
    return result


def interp(x: Any, xp: Any, fp: Any, left: Any = None, right: Any = None, period: Any = None) -> Any:
    """Linear interpolation between constant places: a tree of np.where."""
    if is_traced(xp) or period is not None:
        refuse(TypeError, "np.interp needs constant places `xp`, and no `period`")
    places, values = np.asarray(demote(xp)), plain(fp)
    if (
        places.ndim != 1
        or places.shape != values.shape
        or len(places) == 0
        or not np.all(np.diff(places) > 0)
    ):
        refuse(ValueError, "np.interp needs places `xp` that increase, and one value each")

    def between(x: Any, low: int, high: int) -> Any:
        if high - low == 1:
            slope = (values[high] - values[low]) / (places[high] - places[low])
            return slope * (x - places[low]) + values[low]
        middle = (low + high) // 2
        return choose(compare("lt", x, places[middle]), between(x, low, middle), between(x, middle, high))

    def of(x: Any) -> Any:
        x, last = lift(x), len(places) - 1
        inner = between(x, 0, last) if last else values[0]
        above = choose(compare("gt", x, places[-1]), values[-1] if right is None else right, values[-1])
        inner = choose(compare("ge", x, places[-1]), above, inner)
        return choose(compare("lt", x, places[0]), values[0] if left is None else left, inner)

    return elementwise(of, x)


def polyval(p: Any, x: Any) -> Any:
    """Horner's rule, from 0, as in NumPy."""
    result = np.zeros(np.shape(x))[()]
    for coefficient in p:
        result = result * x + coefficient
    return result


def filled(value: float) -> Callable:
    def function(
        a: Any,
        dtype: Any = None,
        order: Any = None,
        subok: bool = True,
        shape: Any = None,
        *,
        device: Any = None,
    ) -> Any:
        missing = math.isnan(value) and dtype_like(a, dtype).kind != "f"
        return full_like(a, 0 if missing else value, dtype, order, subok, shape)

    return function


def full_like(
    a: Any,
    fill_value: Any,
    dtype: Any = None,
    order: Any = None,
    subok: bool = True,
    shape: Any = None,
    *,
    device: Any = None,
) -> Any:
    return full(plain(a).shape if shape is None else shape, fill_value, dtype_like(a, dtype))


def dtype_like(a: Any, dtype: Any) -> np.dtype:
    """The dtype of an array that is like another one, whose elements NumPy would have."""
    if dtype is not None:
        return np.dtype(dtype)
    array = plain(a)
    if not is_traced(a) and isinstance(a, (np.ndarray, np.generic, list, tuple)):
        return np.asarray(demote(a)).dtype
    return np.dtype(bool if array.size and all(map(is_bool, array.flat)) else float)


def full(shape: Any, fill_value: Any, dtype: Any = None, order: Any = None, **_: Any) -> Any:
    """np.full, whose own copies would be those of arrays of fixed numbers."""
    if not is_traced(fill_value):
        result = np.full(shape, demote(fill_value), dtype)
        return finish(plain(result)) if result.dtype == np.bool_ else promote(result)[()]
    out = finish(np.broadcast_to(plain(fill_value), shape).copy())
    return out if dtype is None else of_dtype(out, dtype)


def limit(
    a: Any, a_min: Any = None, a_max: Any = None, out: Any = None, *, min: Any = None, max: Any = None
) -> Any:
    check_options("clip", {"out": out})
    return elementwise(clip, a, a_min if min is None else min, a_max if max is None else max)


def around(*_: Any, **__: Any) -> Any:
    refuse(TypeError, STEPS.format(name="round"))


# Functions of arrays, by their name.
FUNCTIONS: dict[str, Callable] = {
    "where": where,
    "select": select,
    "dot": dot,
    "sum": total,
    "mean": mean,
    "var": variance,
    "std": lambda *args, **options: np.sqrt(variance(*args, **options)),
    "norm": norm,
    "interp": interp,
    "polyval": polyval,
    "prod": reduction("multiply"),
    "max": reduction("maximum"),
    "min": reduction("minimum"),
    "amax": reduction("maximum"),
    "amin": reduction("minimum"),
    "any": reduction("logical_or"),
    "all": reduction("logical_and"),
    "clip": limit,
    "zeros_like": filled(0.0),
    "ones_like": filled(1.0),
    "empty_like": filled(math.nan),
    "full_like": full_like,
    "solve": algebra.solve,
    "inv": algebra.inverse,
    "det": algebra.determinant,
    "cholesky": lambda a, upper=False: algebra.cholesky(np.transpose(a)).T if upper else algebra.cholesky(a),
    "einsum": algebra.einsum,
    "around": around,
    "round": around,
    "round_": around,
    "copy": lambda a, order="K", subok=False: finish(plain(a).copy()),
    "real": lambda a: a,
    "shape": lambda a: plain(a).shape,
    "ndim": lambda a: plain(a).ndim,
    "size": lambda a, axis=None: plain(a).size if axis is None else plain(a).shape[axis],
}
# Functions that move elements, or add and multiply them: those of NumPy on arrays of objects.
OF_OBJECTS = frozenset(
    "append array_split atleast_1d atleast_2d atleast_3d block broadcast_arrays broadcast_to "
    "column_stack concatenate cross "
    "cumprod cumsum delete diag diagonal diff dsplit dstack expand_dims flip fliplr flipud hsplit "
    "hstack inner insert kron "
    "moveaxis outer permute_dims ravel repeat reshape roll rollaxis rot90 split squeeze stack "
    "swapaxes take tensordot tile "
    "trace transpose tril triu vdot vsplit vstack matrix_transpose unstack convolve".split()
)

# Those that count conditions, and those that add products or differences.
OF_SUMS = frozenset(("cumsum", "cumprod", "trace"))
OF_PRODUCTS = frozenset(("inner", "vdot", "tensordot", "convolve", "cross", "outer", "kron"))

# Functions that change their first argument.
IN_PLACE = frozenset("copyto put place putmask fill_diagonal put_along_axis".split())


def strip(value: Any) -> Any:
    """Arguments of a function of NumPy that treats arrays of objects."""
    if type(value) in (list, tuple):
        return type(value)(map(strip, value))
    return plain(value) if isinstance(value, (Array, TracedNumber, Condition)) else value


def leaves(value: Any) -> Iterator:
    """The arrays and numbers in lists of any nesting."""
    if type(value) in (list, tuple):
        for part in value:
            yield from leaves(part)
    else:
        yield value


def restore(value: Any) -> Any:
    return type(value)(map(restore, value)) if type(value) in (list, tuple) else finish(value)


def array_function(function: Callable, args: tuple, kwargs: dict) -> Any:
    """Evaluates a function of NumPy with at least one traced argument, or an array that could hold one."""
    if kwargs.get("out") is not None:
        return write((kwargs["out"],), array_function(function, args, {**kwargs, "out": None}))
    name = function.__name__
    if name in IN_PLACE:
        refuse(
            TypeError,
            f"np.{name} changes an array in place, which is not supported in a traced function; assign "
            "the elements",
        )
    constants = not any(map(is_traced, args)) and not any(map(is_traced, kwargs.values()))
    if name in FUNCTIONS and not (
        constants and name in ("solve", "inv", "det", "cholesky", "norm", "interp")
    ):
        options = {
            key: value
            for key, value in kwargs.items()
            if value is not np._NoValue and (key, value) != ("out", None)
        }
        try:
            return FUNCTIONS[name](*args, **options)
        except TypeError as error:
            if CALLS[-1].refused is not None or "argument" not in str(error):
                raise
            refuse(
                TypeError, f"np.{name} with these arguments is not supported in a traced function: {error}"
            )
    if name in OF_OBJECTS and not constants:
        check_small(list(leaves(args)))
    if name in OF_SUMS and not constants:
        args = (*(as_numbers(plain(arg)) for arg in args[:1]), *args[1:])
    elif name in OF_PRODUCTS and not constants:
        args = (*factors(*args[:2], added=name not in ("outer", "kron")), *args[2:])
    if name in OF_OBJECTS:
        return restore(function(*map(strip, args), **{key: strip(value) for key, value in kwargs.items()}))
    if constants:
        return promote(function(*map(demote, args), **demote_all(kwargs)))
    return unsupported(name)


SORTED = f"The order of traced numbers is not known. {ORDER}"
# What to write in place of functions that compare values, and of others.
OF_VALUES = {
    **dict.fromkeys(("argmin", "argmax", "nanargmin", "nanargmax", "argwhere", "nonzero"), SELECT),
    **dict.fromkeys(("searchsorted", "digitize"), SEARCH),
    **dict.fromkeys(
        ("fft", "ifft", "rfft", "irfft"),
        "Write the transform as products with constant matrices of cosines and sines",
    ),
    **dict.fromkeys(("sort", "argsort", "partition", "argpartition", "lexsort", "unique", "median"), SORTED),
}


def unsupported(name: str) -> Any:
    if name in OF_VALUES:
        refuse(TypeError, f"np.{name} is not supported in a traced function. {OF_VALUES[name]}")
    if name.endswith("(vectorized)"):
        refuse(
            TypeError,
            "np.vectorize and np.frompyfunc are not supported in a traced function; call the function "
            "for each element",
        )
    known = sorted({*ELEMENTWISE, *FUNCTIONS, *OF_OBJECTS} - {"solve", "inv", "det", "cholesky", "norm"})
    refuse(
        TypeError,
        f"np.{name} is not supported in a traced "
        f"function{near(name, known, 0.65) or '; write it with other functions'}",
    )


# NumPy calls these for operators and functions of traced numbers and their arrays.
setattr(Operators, "__array_ufunc__", ufunc)
setattr(
    Operators,
    "__array_function__",
    lambda _, function, types, args, kwargs: array_function(function, args, kwargs),
)
