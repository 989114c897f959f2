"""Functions of `jax.numpy`: JAX writes them as a list of operations on arrays, the jaxpr."""

from __future__ import annotations

import inspect
import re
from collections.abc import Callable
from typing import Any

import numpy as np

from . import _trace_algebra as algebra
from ._import_jax_arrays import ARRAYS, MOVES, moved
from ._import_jax_rules import RULES, constants, elementwise, rule_of_jax, select
from ._trace_arrays import of_numpy
from ._trace_errors import at_place, begin, name_of, place
from ._trace_numbers import is_traced, refuse
from ._trace_vectors import Parameters, finish, plain

INLINED = frozenset(
    "jit pjit closed_call core_call custom_jvp_call custom_vjp_call custom_vjp_call_jaxpr remat remat2 "
    "checkpoint".split()
)


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
            check_missing(found)
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


def check_missing(values: list) -> None:
    for value in values:
        if isinstance(value, Missing):
            refuse(TypeError, value.message)


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
    check_missing(values)
    if name in INLINED:
        rule = rule_of_jax(eqn) if any(map(is_traced, values)) else None
        if rule is not None:
            return [rule(*values)]
        inner = next(params[key] for key in ("jaxpr", "call_jaxpr", "fun_jaxpr") if key in params)
        return evaluate(getattr(inner, "jaxpr", inner), getattr(inner, "consts", ()), values)
    if name in LOOPS:
        return LOOPS[name](eqn, values)
    if name in ARRAYS:
        return ARRAYS[name](eqn, values)
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
    if name in ("lu", "qr", "eigh", "svd"):
        return [Missing(DECOMPOSED.format(name=name))] * len(eqn.outvars)
    return refuse(
        TypeError, REFUSED.get(name, f"`{name}` of JAX is not supported; write it with other functions")
    )


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
    return [plain(algebra.solve(finish(matrix), finish(plain(right).ravel()))).reshape(np.shape(right))]


LOOPS: dict[str, Callable] = {"scan": scan, "while": loop, "cond": branches}
WHILE = (
    "the number of turns of this loop depends on traced numbers. Write a loop of fixed length, as "
    "`lax.fori_loop(0, 10, ...)`, with `jnp.where` inside"
)
JUMPS = (
    "`{name}` jumps, so its derivative says nothing, and equations do not have it. Leave the rounding out, "
    "or write `jnp.where` with `<`"
)
DECOMPOSED = (
    "`{name}` of a traced matrix is not supported, nor are functions that need it. Write `jnp.linalg.solve` "
    "or `det`, for at most 4 rows, `cho_factor` and `cho_solve` for a positive definite matrix, or the "
    "elimination that fits the structure of the matrix"
)
REFUSED = {
    **{name: JUMPS.format(name=name) for name in ("floor", "ceil", "round")},
    "rem": "`rem` jumps, and equations do not have it. For an angle, write `jnp.arctan2(jnp.sin(a), "
    "jnp.cos(a))`",
    "sort": "`sort` depends on values that are not known. Write `jnp.maximum` and `jnp.minimum`",
    "argmin": "`argmin` depends on values that are not known. Write `jnp.where`",
    "conv_general_dilated": "a convolution is not supported; write it as a product with a matrix",
    "debug_print": "values are not known when a function is traced; leave `jax.debug.print` out",
    "bitcast_convert_type": "the bits of a traced number are not known; compare it, as in `a < 0`",
}
