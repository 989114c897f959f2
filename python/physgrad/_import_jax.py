"""Functions of `jax.numpy`: JAX writes them as a list of operations on arrays, the jaxpr.

Operations that only move elements are evaluated by JAX, on the numbers of the elements.
"""

from __future__ import annotations

import functools
import inspect
import itertools
import math
import re
from collections.abc import Callable
from typing import Any

import numpy as np

from . import _import_numbers as more
from . import _trace_algebra as algebra
from ._trace_arrays import of_numpy
from ._trace_errors import at_place, begin, name_of, place
from ._trace_numbers import (
    Condition,
    Symbol,
    apply,
    choose,
    combine,
    compare,
    invert,
    is_traced,
    lift,
    refuse,
)
from ._trace_numpy import ELEMENTWISE, log1p, power
from ._trace_vectors import Parameters, finish, plain


def from_jax(function: Callable) -> Callable:
    """A function of `jax.numpy` for `pg.system`, as `pg.system(pg.from_jax(rate), ...)`.

    Arguments are arrays of float64 without names, `x[0]`; `p` has its numbers by name and by order.
    Derivatives are those of the operations: custom rules of derivatives are not used.
    """
    if not callable(function):
        raise TypeError(f"from_jax needs a function, not an object of type {type(function).__name__}")
    return JaxFunction(function)


class JaxParameters(Parameters):
    """The parameters as numbers of JAX, by name, by order, and as one vector."""

    def __jax_array__(self) -> Any:
        import jax.numpy as jnp

        return jnp.concatenate([jnp.ravel(value) for value in self.values()])


class JaxFunction:
    """A function of JAX as a function of traced numbers."""

    def __init__(self, function: Callable) -> None:
        self.function = function
        self.__name__ = getattr(function, "__name__", type(function).__name__)
        self.__signature__ = inspect.signature(function)
        inner = inspect.unwrap(function)
        code = getattr(getattr(inner, "__func__", inner), "__code__", None)
        if code is not None:
            self.__code__ = code

    def __call__(self, *args: Any, **named: Any) -> Any:
        import jax

        with of_numpy(), float64(), at_place(begin(self)):
            leaves, rebuild = numbers_of((*args, *named.values()))
            tree: list = []

            def call(*values: Any) -> list:
                given = rebuild(values)
                result = self.function(
                    *given[: len(args)], **dict(zip(named, given[len(args) :], strict=True))
                )
                flat, found = jax.tree_util.tree_flatten(result)
                tree.append(found)
                return flat

            shapes = [jax.ShapeDtypeStruct(np.shape(leaf), np.float64) for leaf in leaves]
            closed = jax.make_jaxpr(call)(*shapes)
            found = evaluate(closed.jaxpr, closed.consts, leaves)
            # The numbers of a result that do not depend on an argument are constants.
            results = [plain(value) if is_traced(value) else np.asarray(value) for value in found]
            return jax.tree_util.tree_unflatten(
                tree[-1], [finish(v) if v.dtype == object else v[()] for v in results]
            )


def float64() -> Any:
    """A context in which JAX computes in float64."""
    import jax

    if hasattr(jax, "enable_x64"):
        return jax.enable_x64(True)
    # Releases before 0.8.
    from jax.experimental import enable_x64

    return enable_x64()


def numbers_of(arguments: tuple) -> tuple[list, Callable]:
    """Arrays of the numbers of the arguments, and a function that makes arguments of other arrays."""
    leaves: list = []
    for value in arguments:
        parts = value.values() if isinstance(value, Parameters) else [value]
        leaves += [plain(part) if is_traced(part) else np.asarray(part, dtype=float) for part in parts]

    def rebuild(values: tuple) -> list:
        rest, given = iter(values), []
        for value in arguments:
            if isinstance(value, Parameters):
                given.append(JaxParameters({name: next(rest) for name in value.keys()}))
            else:
                given.append(next(rest))
        return given

    return leaves, rebuild


class Missing:
    """A value without equations. Only its use is refused: `solve` of JAX has factors that it needs not."""

    def __init__(self, message: str) -> None:
        self.message = message


def evaluate(jaxpr: Any, consts: Any, args: Any) -> list:
    """The outputs of a list of operations: arrays of objects if traced, and else arrays of constants."""
    known: dict = {}

    def read(atom: Any) -> Any:
        return atom.val if hasattr(atom, "val") else known[atom]

    for variables, values in ((jaxpr.constvars, consts), (jaxpr.invars, args)):
        known.update(zip(variables, values, strict=True))
    for eqn in jaxpr.eqns:
        with at_place(line_of(eqn)):
            results = operation(eqn, [read(atom) for atom in eqn.invars])
        known.update((var, settled(value, var)) for var, value in zip(eqn.outvars, results, strict=True))
    return [read(atom) for atom in jaxpr.outvars]


def settled(value: Any, variable: Any) -> Any:
    """A result without traced numbers as an array of constants."""
    if isinstance(value, Missing) or is_traced(value) or getattr(value, "dtype", None) != object:
        return value
    return np.array(value.tolist(), dtype=variable.aval.dtype)


def line_of(eqn: Any) -> str:
    """File and line of the user, which JAX notes for each operation; else the present place."""
    try:
        from jax._src import source_info_util

        found = re.match(r"(.+?):(\d+)", source_info_util.summarize(eqn.source_info))
    except (ImportError, AttributeError):  # not a public part of JAX
        found = None
    return f"{name_of(found[1])}:{found[2]}" if found else place()


def operation(eqn: Any, values: list) -> list:
    """The results of one operation."""
    name, params = eqn.primitive.name, eqn.params
    if name == "custom_linear_solve":
        return linear_solve(params, values)
    missing = [value for value in values if isinstance(value, Missing)]
    if missing:
        refuse(TypeError, missing[0].message)
    known = OF_JAX.get(params.get("name")) if name in INLINED and any(map(is_traced, values)) else None
    if known is not None and is_of_jax(known[0], eqn):
        return [elementwise(known[1], values)]
    if name in INLINED:
        inner = next(params[key] for key in ("jaxpr", "call_jaxpr", "fun_jaxpr") if key in params)
        return evaluate(getattr(inner, "jaxpr", inner), getattr(inner, "consts", ()), values)
    if name in STRUCTURED:
        return STRUCTURED[name](eqn, values)
    if name.startswith("random_"):
        refuse(
            TypeError,
            "a function must not draw random numbers. Use pg.uniform and its like in `params`, or draw "
            "constants before",
        )
    if "callback" in name:
        refuse(TypeError, f"`{name}` calls Python, whose result is not an operation. Write it with jax.numpy")
    if not any(map(is_traced, values)):
        return constants(eqn, values)
    if name in MOVES:
        return moved(eqn, values)
    if name in RULES:
        return [elementwise(lambda *a: RULES[name](eqn, *a), values, eqn)]
    if name in ("lu", "cholesky", "qr", "eigh", "svd", "triangular_solve"):
        return [Missing(DECOMPOSED.format(name=name))] * len(eqn.outvars)
    return refuse(
        TypeError, REFUSED.get(name, f"`{name}` of JAX is not supported; write it with other functions")
    )


def constants(eqn: Any, values: list) -> list:
    """Evaluates an operation on constants by JAX."""
    import jax.numpy as jnp

    found = eqn.primitive.bind(*map(jnp.asarray, values), **eqn.params)
    return [np.asarray(v) for v in (found if eqn.primitive.multiple_results else [found])]


def is_of_jax(reference: Callable, eqn: Any) -> bool:
    """Whether a function inside is the one of JAX, and not another of the same name."""
    import jax

    try:
        own = jax.make_jaxpr(reference())(*(v.aval for v in eqn.invars)).jaxpr.eqns
    except Exception:
        # The function of the same name takes other arguments, so it is another one.
        return False
    return len(own) == 1 and str(own[0].params.get("jaxpr")) == str(eqn.params.get("jaxpr"))


def jnp_function(name: str) -> Callable:
    def get() -> Callable:
        import jax.numpy as jnp

        return getattr(jnp, name)

    return get


# Functions of JAX whose operations have no equations, and their rules. Infinite constants and bits
# of numbers occur in them.
OF_JAX: dict[str, tuple[Callable, Callable]] = {
    "remainder": (jnp_function("remainder"), lambda a, b: apply("mod", a, b)),
    "hypot": (jnp_function("hypot"), lambda a, b: apply("hypot", a, b)),
    "copysign": (jnp_function("copysign"), more.copysign),
    "signbit": (jnp_function("signbit"), more.negative),
}
INLINED = frozenset(
    "jit pjit closed_call core_call custom_jvp_call custom_vjp_call custom_vjp_call_jaxpr remat remat2 "
    "checkpoint".split()
)


def elementwise(function: Callable, values: list, eqn: Any = None) -> Any:
    """Applies a function of numbers. Elements without traced arguments are evaluated by JAX."""
    arrays = np.broadcast_arrays(*map(plain, values))
    out = np.empty(arrays[0].shape, dtype=object)
    fixed = None
    for index in np.ndindex(out.shape):
        args = [array[index] for array in arrays]
        if eqn is not None and not any(isinstance(a, Symbol) for a in args):
            fixed = folded(eqn, values) if fixed is None else fixed
            out[index] = fixed[index]
        else:
            out[index] = function(*args)
    return out


def folded(eqn: Any, values: list) -> np.ndarray:
    """The results of an operation, in which traced elements are replaced by ones."""
    given = []
    for value, atom in zip(values, eqn.invars, strict=True):
        elements = [1 if isinstance(v, Symbol) else v for v in plain(value).flat]
        given.append(np.array(elements, dtype=atom.aval.dtype).reshape(np.shape(value)))
    return constants(eqn, given)[0]


def rule(name: str) -> Callable:
    return lambda _, *args: ELEMENTWISE[name](*map(lift, args))


def of(function: Callable) -> Callable:
    """A rule without parameters."""
    return lambda _, *args: function(*args)


def whole(eqn: Any) -> bool:
    """Whether the numbers of an operation are integers."""
    return eqn.invars[0].aval.dtype.kind in "iu"


def divide(eqn: Any, a: Any, b: Any) -> Any:
    if whole(eqn):
        refuse(TypeError, "an integer division rounds, which equations do not have; divide floating numbers")
    return apply("div", a, b)


def bits(op: str) -> Callable:
    def function(eqn: Any, a: Any, b: Any) -> Any:
        if whole(eqn):
            refuse(TypeError, "bits of traced integers are not known; use comparisons with `&` and `|`")
        return combine(op, a, b)

    return function


def xor(eqn: Any, a: Any, b: Any) -> Any:
    both = bits("and")(eqn, a, b)
    return combine("and", combine("or", a, b), invert(both))


def differs(a: Any, b: Any) -> Any:
    return invert(more.equal(a, b))


def convert(eqn: Any, a: Any) -> Any:
    """A change of type. Conditions stay conditions, which count as 0 and 1."""
    old, new = eqn.invars[0].aval.dtype, eqn.params["new_dtype"]
    if new == np.bool_:
        return more.truth(a)
    if new.kind in "iu" and old.kind == "f":
        refuse(
            TypeError,
            "a change to integers rounds, which equations do not have. Leave out `astype` and `int`",
        )
    if new.kind not in "iu" and new != np.float64:
        refuse(
            TypeError, f"a traced number is a float64, not {new}. Leave out the dtype: `precision` selects it"
        )
    return a


def select(_: Any, which: Any, *cases: Any) -> Any:
    """The case of a condition or of a whole number."""
    if not isinstance(which, Symbol):
        return cases[int(which)]
    if isinstance(which, Condition):
        return choose(which, cases[1], cases[0])
    result = cases[-1]
    for i in range(len(cases) - 2, -1, -1):
        result = choose(compare("lt", which, i + 0.5), cases[i], result)
    return result


def signed_power(eqn: Any, a: Any) -> Any:
    return power(lift(a), float(eqn.params["y"]))


RULES: dict[str, Callable] = {
    "add": rule("add"),
    "add_any": rule("add"),
    "sub": rule("subtract"),
    "mul": rule("multiply"),
    "div": divide,
    "neg": rule("negative"),
    "abs": rule("absolute"),
    "sign": rule("sign"),
    "max": of(more.maximum),
    "min": of(more.minimum),
    "clamp": lambda _, low, a, high: more.minimum(more.maximum(a, low), high),
    "sqrt": rule("sqrt"),
    "rsqrt": of(lambda a: 1.0 / np.sqrt(lift(a))),
    "cbrt": of(more.cbrt),
    "square": rule("square"),
    "integer_pow": signed_power,
    "pow": of(lambda a, b: power(lift(a), b)),
    "exp": rule("exp"),
    "exp2": rule("exp2"),
    "expm1": of(more.expm1),
    "log": rule("log"),
    "log1p": of(lambda a: log1p(lift(a))),
    "logistic": of(more.logistic),
    "erf": of(more.erf),
    **{name: rule(name) for name in ("sin", "cos", "tan", "sinh", "cosh", "tanh")},
    "asin": rule("arcsin"),
    "acos": rule("arccos"),
    "atan": rule("arctan"),
    "atan2": rule("arctan2"),
    "asinh": of(more.asinh),
    "acosh": of(more.acosh),
    "atanh": of(more.atanh),
    "lt": of(functools.partial(compare, "lt")),
    "le": of(functools.partial(compare, "le")),
    "gt": of(functools.partial(compare, "gt")),
    "ge": of(functools.partial(compare, "ge")),
    "eq": of(more.equal),
    "ne": of(differs),
    "and": bits("and"),
    "or": bits("or"),
    "xor": xor,
    "not": lambda eqn, a: invert(a) if not whole(eqn) else bits("and")(eqn, a, a),
    "is_finite": of(more.is_finite),
    "select_n": select,
    "convert_element_type": convert,
    "stop_gradient": of(lambda a: a if isinstance(a, Condition) else apply("detach", a)),
}
# Operations that move elements, and which of their operands have the elements. Others are indices.
MOVES = {
    **dict.fromkeys(
        "broadcast_in_dim reshape transpose squeeze expand_dims slice dynamic_slice gather rev copy copy_p "
        "split tile unstack".split(),
        (0,),
    ),
    "concatenate": None,
    "stack": None,
    "pad": (0, 1),
    "dynamic_update_slice": (0, 1),
    "scatter": (0, 2),
    "optimization_barrier": None,
}


def moved(eqn: Any, values: list) -> list:
    """Moves elements: JAX evaluates the operation on their numbers."""
    name, params = eqn.primitive.name, dict(eqn.params)
    places = range(len(values)) if MOVES[name] is None else MOVES[name]
    if any(is_traced(value) for i, value in enumerate(values) if i not in places):
        refuse(IndexError, INDEX)
    if params.get("update_jaxpr") is not None:
        refuse(TypeError, "`.at[].apply` is not supported; assign the value by `.at[].set`")
    fill = params.get("fill_value")
    if fill is not None:
        params["fill_value"] = -1
    pool: list = []
    given = list(values)
    for i in places:
        array = plain(values[i])
        given[i] = np.arange(len(pool), len(pool) + array.size).reshape(array.shape)
        pool += list(array.flat)
    results = []
    for ids in constants(eqn_with(eqn, params), given):
        if fill is None and ids.size and (ids.min() < 0 or ids.max() >= len(pool)):
            refuse(IndexError, "an index is outside of its array")
        out = np.empty(ids.shape, dtype=object)
        for index in np.ndindex(out.shape):
            out[index] = fill if ids[index] < 0 else pool[ids[index]]
        results.append(out)
    return results


class eqn_with:
    """An operation with other parameters."""

    def __init__(self, eqn: Any, params: dict) -> None:
        self.primitive, self.params = eqn.primitive, params


def scattered(function: Callable, neutral: float, mark: float) -> Callable:
    """`.at[].add` and its like: JAX tells the places of each update, by a mark among neutral ones."""

    def scatter(eqn: Any, values: list) -> list:
        if not any(map(is_traced, values)):
            return constants(eqn, values)
        operand, indices, updates = values
        if is_traced(indices):
            refuse(IndexError, INDEX)
        out, parts = plain(operand).copy(), plain(updates)
        for index in np.ndindex(parts.shape):
            marks = np.full(parts.shape, neutral)
            marks[index] = mark
            (found,) = constants(eqn, [np.full(out.shape, neutral), indices, marks])
            for hit in zip(*np.nonzero(found != neutral), strict=True):
                out[hit] = function(out[hit], parts[index])
        return [out]

    return scatter


def reduced(function: Callable, start: Any) -> Callable:
    """A reduction along axes, one element after the other."""

    def reduce(eqn: Any, values: list) -> list:
        if not any(map(is_traced, values)):
            return constants(eqn, values)
        array, axes = plain(values[0]), eqn.params["axes"]
        kept = [a for a in range(array.ndim) if a not in axes]
        moved = array.transpose([*kept, *axes])
        out = np.empty(moved.shape[: len(kept)], dtype=object)
        for index in np.ndindex(out.shape):
            parts = list(plain(moved[index]).flat)
            out[index] = functools.reduce(function, parts) if parts else start
        return [out]

    return reduce


def accumulated(function: Callable) -> Callable:
    def accumulate(eqn: Any, values: list) -> list:
        if not any(map(is_traced, values)):
            return constants(eqn, values)
        axis, back = eqn.params["axis"], eqn.params["reverse"]
        rows = np.moveaxis(plain(values[0]), axis, 0)[:: -1 if back else 1]
        out = np.empty(rows.shape, dtype=object)
        for index in np.ndindex(rows.shape[1:]):
            column = itertools.accumulate((rows[(i, *index)] for i in range(len(rows))), function)
            for i, value in enumerate(column):
                out[(i, *index)] = value
        return [np.moveaxis(out[:: -1 if back else 1], 0, axis)]

    return accumulate


def dot_general(eqn: Any, values: list) -> list:
    """Sums of products, over the batch, then the other axes of the left and of the right operand."""
    if not any(map(is_traced, values)):
        return constants(eqn, values)
    (summed, batch), sides = eqn.params["dimension_numbers"], []
    for side, value in enumerate(values):
        array = plain(value)
        own = [a for a in range(array.ndim) if a not in summed[side] and a not in batch[side]]
        order = [*batch[side], *own, *summed[side]]
        sides.append((array.transpose(order), [array.shape[a] for a in own]))
    (left, rows), (right, columns) = sides
    lead = left.shape[: len(batch[0])]
    out = np.empty((*lead, *rows, *columns), dtype=object)
    for b in np.ndindex(lead):
        for i, j in itertools.product(np.ndindex(*rows), np.ndindex(*columns)):
            pairs = zip(plain(left[b + i]).flat, plain(right[b + j]).flat, strict=True)
            terms = [mul(x, y) for x, y in pairs]
            out[b + i + j] = functools.reduce(add, terms) if terms else 0.0
    return [out]


def scan(eqn: Any, values: list) -> list:
    """A loop of fixed length, unrolled."""
    p, closed = eqn.params, eqn.params["jaxpr"]
    consts, rest = values[: p["num_consts"]], values[p["num_consts"] :]
    carry, rows = rest[: p["num_carry"]], rest[p["num_carry"] :]
    order = range(p["length"])
    stacked: dict[int, list] = {}
    for i in reversed(order) if p["reverse"] else order:
        found = evaluate(closed.jaxpr, closed.consts, [*consts, *carry, *(row[i] for row in map(held, rows))])
        carry, stacked[i] = found[: p["num_carry"]], found[p["num_carry"] :]
    shapes = [v.aval for v in eqn.outvars[p["num_carry"] :]]
    return [*carry, *(stack([stacked[i][k] for i in order], aval) for k, aval in enumerate(shapes))]


def held(value: Any) -> np.ndarray:
    """An array whose rows are arrays."""
    return plain(value)[:, ...] if is_traced(value) else np.asarray(value)


def stack(rows: list, aval: Any) -> np.ndarray:
    if not any(map(is_traced, rows)):
        return np.array(rows, dtype=aval.dtype).reshape(aval.shape)
    out = np.empty(aval.shape, dtype=object)
    for i, row in enumerate(rows):
        out[i] = plain(row)[()] if np.ndim(row) == 0 else plain(row)
    return out


def loop(eqn: Any, values: list) -> list:
    """A loop whose turns are known, because its condition does not depend on traced numbers."""
    p = eqn.params
    first, second = p["cond_nconsts"], p["cond_nconsts"] + p["body_nconsts"]
    of_cond, of_body, carry = values[:first], values[first:second], values[second:]
    while True:
        (again,) = evaluate(p["cond_jaxpr"].jaxpr, p["cond_jaxpr"].consts, [*of_cond, *carry])
        if is_traced(again):
            refuse(TypeError, WHILE)
        if not again:
            return carry
        carry = evaluate(p["body_jaxpr"].jaxpr, p["body_jaxpr"].consts, [*of_body, *carry])


def branches(eqn: Any, values: list) -> list:
    """All branches, and the choice of one."""
    which, *args = values
    cases = eqn.params["branches"]
    if not is_traced(which):
        case = cases[int(which)]
        return evaluate(case.jaxpr, case.consts, args)
    found = [evaluate(case.jaxpr, case.consts, args) for case in cases]
    index = plain(which)[()]
    return [
        elementwise(lambda *cases: select(eqn, index, *cases), list(outputs))
        for outputs in zip(*found, strict=True)
    ]


def linear_solve(params: dict, values: list) -> list:
    """`jnp.linalg.solve`, whose matrix is that of the products with unit vectors."""
    lengths, matvec = params["const_lengths"], params["jaxprs"].matvec
    (right,) = values[sum(lengths) :]
    pool = [v for value in values[: lengths.matvec] for v in plain(value).flat]
    # Random numbers in place of the elements tell which element of the matrix is which.
    marks = np.random.default_rng(0).normal(size=len(pool))
    given, used = [], 0
    for value in values[: lengths.matvec]:
        given.append(marks[used : used + np.size(value)].reshape(np.shape(value)))
        used += np.size(value)
    found = {0.0: np.float64(0.0), **dict(zip(marks, pool, strict=True))}
    matrix = np.empty((np.size(right),) * 2, dtype=object)
    for j, unit in enumerate(np.eye(np.size(right))):
        (column,) = evaluate(matvec.jaxpr, matvec.consts, [*given, unit.reshape(np.shape(right))])
        for i, mark in enumerate(np.ravel(column)):
            if mark not in found:
                refuse(
                    TypeError, "a linear system is solved whose matrix is not an array; use jnp.linalg.solve"
                )
            matrix[i, j] = found[mark]
    return [solve_blocks(matrix, plain(right).ravel()).reshape(np.shape(right))]


def solve_blocks(matrix: np.ndarray, right: np.ndarray) -> np.ndarray:
    """Solves the equations that belong together by constants of zero, as those of one column each."""
    out = np.empty(len(right), dtype=object)
    left = set(range(len(right)))
    while left:
        block, waiting = set(), [min(left)]
        while waiting:
            i = waiting.pop()
            if i in block:
                continue
            block.add(i)
            waiting += [j for j in left if linked(matrix[i, j]) or linked(matrix[j, i])]
        rows = sorted(block)
        inner = finish(matrix[np.ix_(rows, rows)])
        out[rows] = plain(algebra.solve(inner, finish(right[rows])))
        left -= block
    return out


def linked(value: Any) -> bool:
    return isinstance(value, Symbol) or value != 0.0


def add(a: Any, b: Any) -> Any:
    return apply("add", a, b) if isinstance(a, Symbol) or isinstance(b, Symbol) else a + b


def mul(a: Any, b: Any) -> Any:
    return apply("mul", a, b) if isinstance(a, Symbol) or isinstance(b, Symbol) else a * b


def logical(op: str) -> Callable:
    return lambda a, b: combine(op, a, b)


STRUCTURED: dict[str, Callable] = {
    "reduce_sum": reduced(add, 0.0),
    "reduce_prod": reduced(mul, 1.0),
    "reduce_max": reduced(more.maximum, -math.inf),
    "reduce_min": reduced(more.minimum, math.inf),
    "reduce_and": reduced(logical("and"), True),
    "reduce_or": reduced(logical("or"), False),
    "cumsum": accumulated(add),
    "cumprod": accumulated(mul),
    "cummax": accumulated(more.maximum),
    "cummin": accumulated(more.minimum),
    "scatter-add": scattered(add, 0.0, 1.0),
    "scatter-mul": scattered(mul, 1.0, 2.0),
    "scatter-min": scattered(more.minimum, 0.0, -1.0),
    "scatter-max": scattered(more.maximum, 0.0, 1.0),
    "dot_general": dot_general,
    "scan": scan,
    "while": loop,
    "cond": branches,
}
INDEX = (
    "an index depends on traced numbers, whose values are not known. Write `jnp.where(condition, a, b)`, and "
    "`pg.table(values)` in place of an index into values over time"
)
WHILE = (
    "the number of turns of this loop depends on traced numbers. Write a loop of fixed length, as "
    "`lax.fori_loop(0, 10, ...)`, with `jnp.where` inside"
)
JUMPS = (
    "`{name}` jumps, so its derivative says nothing, and equations do not have it. Leave the rounding out, "
    "or write `jnp.where` with `<`"
)
DECOMPOSED = (
    "`{name}` of a traced matrix is not supported. Write `jnp.linalg.solve`, for at most 4 rows, or the "
    "elimination that fits the structure of the matrix"
)
REFUSED = {
    **{name: JUMPS.format(name=name) for name in ("floor", "ceil", "round")},
    "rem": "`rem` jumps, and equations do not have it. For an angle, write `jnp.arctan2(jnp.sin(a), "
    "jnp.cos(a))`",
    "sort": "`sort` depends on values that are not known. Write `jnp.maximum` and `jnp.minimum`",
    "argmax": "`argmax` depends on values that are not known. Write `jnp.where`",
    "argmin": "`argmin` depends on values that are not known. Write `jnp.where`",
    "conv_general_dilated": "a convolution is not supported; write it as a product with a matrix",
    "bitcast_convert_type": "the bits of a traced number are not known; compare it, as in `a < 0`",
}
