"""Functions of NumPy on traced numbers: by elements, reductions, and functions that move elements."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import numpy as np

from . import _trace_algebra as algebra
from ._trace_errors import ORDER, SEARCH, SELECT, near
from ._trace_graph import MOST_POWER
from ._trace_numbers import (
    CALLS,
    Condition,
    TracedNumber,
    apply,
    base,
    check_dtype,
    choose,
    combine,
    compare,
    invert,
    is_bool,
    is_traced,
    lift,
    refuse,
)
from ._trace_vectors import Array, demote, finish, plain, promote


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


def elementwise(function: Callable, *args: Any) -> Any:
    """Broadcasts a function of numbers."""
    check_small(args)
    arrays = [plain(arg) for arg in args]
    try:
        arrays = np.broadcast_arrays(*arrays)
    except ValueError:
        shapes = " and ".join(str(array.shape) for array in arrays)
        refuse(ValueError, f"arrays of shapes {shapes} do not broadcast")
    out = np.empty(arrays[0].shape, dtype=object)
    for index in np.ndindex(out.shape):
        out[index] = function(*(array[index] for array in arrays))
    return finish(out, names_of(args))


def check_small(args: Any) -> None:
    """Refuses constants of float32 among conditions, for which NumPy computes in float32."""
    small = any(getattr(arg, "dtype", None) in (np.float16, np.float32) for arg in args if not is_traced(arg))
    if small and not any(isinstance(value, TracedNumber) for arg in args for value in plain(arg).flat):
        refuse(
            TypeError,
            "NumPy computes conditions and float32 constants in float32; make the constants float64",
        )


def names_of(args: Any) -> tuple[str, ...] | None:
    """The names that all named arguments share."""
    names = {arg._names for arg in args if isinstance(arg, Array) and arg._names is not None}
    return names.pop() if len(names) == 1 else None


def of_numbers(name: str) -> Callable:
    """The rule of a function by elements. Computes without tracing if no argument is traced."""
    traced, untraced = ELEMENTWISE[name], getattr(np, name)

    def function(*args: Any) -> Any:
        if not any(map(is_traced, args)):
            return untraced(*args)
        return traced(*(args if name in OF_ANY else map(lift, args)))

    return function


def ufunc(function: np.ufunc, method: str, args: tuple, options: dict) -> Any:
    """Evaluates a call or a method of a universal function."""
    name = function.__name__
    options = dict(options)
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


def check_options(name: str, options: dict) -> None:
    """Refuses options that would change numbers."""
    if options.get("dtype") is not None and not name.startswith("logical"):
        check_dtype(options["dtype"])
    if options.get("out") is not None:
        refuse(TypeError, f"give the argument `out` of np.{name} by its name")
    if options.get("where", True) is not True:
        refuse(TypeError, f"the argument `where` of np.{name} is not supported; use np.where")


def traced_ufunc(function: np.ufunc, method: str, args: tuple, options: dict) -> Any:
    name = function.__name__
    if name in ("matmul", "vecdot", "matvec", "vecmat"):
        return matmul(*args) if name == "matmul" else unsupported(name)
    # A function of another package may have the name of one of NumPy.
    known = getattr(np, name, None)
    if name not in ELEMENTWISE or isinstance(known, np.ufunc) and known is not function:
        unsupported(name)
    if method == "__call__":
        return elementwise(of_numbers(name), *args)
    if method == "reduce":
        axis, keepdims = options.get("axis", args[1] if len(args) > 1 else 0), options.get("keepdims", False)
        return reduce(name, args[0], axis, bool(keepdims), options.get("initial"))
    if method == "accumulate":
        return finish(getattr(function, method)(plain(args[0]), axis=options.get("axis", 0)))
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


def reduce(name: str, value: Any, axis: Any = None, keepdims: bool = False, initial: Any = None) -> Any:
    """Combines the elements along axes, in the order of NumPy."""
    array = plain(value)
    if name in ("add", "multiply", "maximum", "minimum"):
        array = plain(elementwise(lambda a: lift(a) if isinstance(a, Condition) else a, array))
    axes = axes_of(axis, array.ndim)
    if not axes:
        return finish(array.copy())
    kept = [a for a in range(array.ndim) if a not in axes]
    shape = tuple(1 if a in axes else n for a, n in enumerate(array.shape)) if keepdims else None
    # NumPy adds in pairs along the last axis, and one after the other along others.
    in_pairs = name == "add" and axes == list(range(array.ndim - len(axes), array.ndim))
    moved = array.transpose([*kept, *axes])
    lead = moved.shape[: len(kept)]
    rows = moved.reshape((math.prod(lead), -1))
    out = np.empty(len(rows), dtype=object)
    for i, row in enumerate(rows):
        parts = list(row) if initial is None or initial is np._NoValue else [initial, *row]
        out[i] = combine_all(name, parts, in_pairs)
    return finish(out.reshape(lead if shape is None else shape))


def axes_of(axis: Any, dimensions: int) -> list[int]:
    """The axes of a reduction, in order. A number without dimensions has none."""
    axes = range(dimensions) if axis is None else axis if isinstance(axis, tuple) else (axis,)
    if dimensions == 0 and axis in (None, 0, -1):
        return []
    found = sorted({int(a) % dimensions for a in axes if -dimensions <= a < dimensions})
    if len(found) != len(axes):
        refuse(
            ValueError, f"the axis {axis} is out of range or twice, for an array of {dimensions} dimensions"
        )
    return found


def combine_all(name: str, parts: list, in_pairs: bool) -> Any:
    if not parts:
        if name in ("add", "multiply"):
            return np.float64(name == "multiply")
        refuse(ValueError, f"np.{name} of no elements has no value")
    function = of_numbers(name)
    if in_pairs and len(parts) >= 8:
        return pairwise_sum(parts)
    total = parts[0]
    for part in parts[1:]:
        total = function(total, part)
    return total


def pairwise_sum(parts: list) -> Any:
    """The sum of 8 or more numbers in the order of NumPy: 8 sums of every 8th, or two halves."""
    n = len(parts)
    if n > 128:
        half = n // 2 - n // 2 % 8
        return pairwise_sum(parts[:half]) + pairwise_sum(parts[half:])
    r = parts[:8]
    for i in range(8, n - n % 8, 8):
        r = [total + part for total, part in zip(r, parts[i : i + 8], strict=True)]
    total = ((r[0] + r[1]) + (r[2] + r[3])) + ((r[4] + r[5]) + (r[6] + r[7]))
    for part in parts[n - n % 8 :]:
        total = total + part
    return total


def matmul(a: Any, b: Any, out: Any = None) -> Any:
    check_small((a, b))
    a, b = plain(a), plain(b)
    if a.ndim == 0 or b.ndim == 0 or a.shape[-1] != b.shape[max(b.ndim - 2, 0)]:
        refuse(ValueError, f"a product of shapes {a.shape} and {b.shape}: the inner dimensions differ")
    return finish(np.matmul(a, b))


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


def total(
    value: Any,
    axis: Any = None,
    dtype: Any = None,
    out: Any = None,
    keepdims: Any = False,
    initial: Any = None,
) -> Any:
    check_options("sum", {"dtype": dtype, "out": out})
    return reduce("add", value, axis, keepdims is True, initial)


def mean(value: Any, axis: Any = None, dtype: Any = None, out: Any = None, keepdims: Any = False) -> Any:
    check_options("mean", {"dtype": dtype, "out": out})
    sums = reduce("add", value, axis, keepdims is True)
    return sums / float(np.size(value) / max(np.size(sums), 1))


def variance(value: Any, axis: Any = None, ddof: float = 0, keepdims: Any = False) -> Any:
    deviations = finish(plain(value)) - mean(value, axis, keepdims=True)
    sums = reduce("add", deviations * deviations, axis, keepdims is True)
    return sums / float(np.size(value) / max(np.size(sums), 1) - ddof)


def reduction(name: str) -> Callable:
    def function(
        value: Any, axis: Any = None, out: Any = None, keepdims: Any = False, initial: Any = None
    ) -> Any:
        check_options(name, {"out": out})
        return reduce(name, value, axis, keepdims is True, initial)

    return function


def norm(x: Any, ord: Any = None, axis: Any = None, keepdims: bool = False) -> Any:
    """The Euclidean norm of vectors, the sum and the maximum of absolute values, and the Frobenius norm."""
    array = finish(plain(x))
    axes = array.ndim if axis is None else 1 if isinstance(axis, int) else len(axis)
    if ord is None or (ord == 2 and axes == 1) or (ord == "fro" and axes == 2):
        return np.sqrt(reduce("add", array * array, axis, keepdims))
    if axes == 1 and ord in (1, math.inf):
        return reduce("add" if ord == 1 else "maximum", abs(array), axis, keepdims)
    refuse(
        TypeError,
        f"np.linalg.norm with ord={ord!r} is not supported; use 2, 1 or np.inf of a vector, or 'fro'",
    )


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
        array: Any, dtype: Any = None, order: Any = None, subok: bool = True, shape: Any = None
    ) -> Any:
        return promote(np.full(np.shape(array) if shape is None else shape, value))[()]

    return function


def full_like(array: Any, value: Any, **_: Any) -> Any:
    return finish(np.broadcast_to(plain(value), np.shape(array)).copy())


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
    "cholesky": lambda a, upper=False: algebra.cholesky(a).T if upper else algebra.cholesky(a),
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

# Functions that change their first argument.
IN_PLACE = frozenset("copyto put place putmask fill_diagonal put_along_axis".split())


def strip(value: Any) -> Any:
    """Arguments of a function of NumPy that treats arrays of objects."""
    if type(value) in (list, tuple):
        return type(value)(map(strip, value))
    return plain(value) if isinstance(value, (Array, TracedNumber, Condition)) else value


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
    if name in FUNCTIONS and not (constants and name in ("solve", "inv", "det", "cholesky", "norm", "interp")):
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
    if name in OF_OBJECTS:
        return restore(function(*map(strip, args), **{key: strip(value) for key, value in kwargs.items()}))
    if constants:
        return promote(function(*map(demote, args), **demote_all(kwargs)))
    return unsupported(name)


SORTED = f"The order of traced numbers is not known. {ORDER}"
# What to write in place of functions that compare values.
OF_VALUES = {
    **dict.fromkeys(("argmin", "argmax", "nanargmin", "nanargmax", "argwhere", "nonzero"), SELECT),
    **dict.fromkeys(("searchsorted", "digitize"), SEARCH),
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
