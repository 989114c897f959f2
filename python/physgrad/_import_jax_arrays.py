"""Operations of JAX on whole arrays: those that move elements, sums, and linear algebra.

Operations that only move elements are evaluated by JAX, on the numbers of the elements.
"""

from __future__ import annotations

import functools
import itertools
import math
from collections.abc import Callable
from typing import Any

import numpy as np

from . import _import_numbers as more
from . import _trace_algebra as algebra
from ._import_jax_rules import constants
from ._trace_numbers import Symbol, apply, choose, combine, compare, is_traced, refuse
from ._trace_vectors import finish, plain

INDEX = (
    "an index depends on traced numbers, whose values are not known. Write `jnp.where(condition, a, b)`, and "
    "`pg.table(values)` in place of an index into values over time"
)
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


def first_largest(eqn: Any, values: list) -> list:
    """`argmax` of conditions and of whole numbers, by which `jnp.select` and `jnp.piecewise` choose."""
    if not any(map(is_traced, values)):
        return constants(eqn, values)
    if eqn.invars[0].aval.dtype.kind == "f":
        refuse(TypeError, "`argmax` depends on values that are not known. Write `jnp.where`")
    (axis,) = eqn.params["axes"]
    rows = np.moveaxis(plain(values[0]), axis, -1)
    out = np.empty(rows.shape[:-1], dtype=object)
    for index in np.ndindex(out.shape):
        place, largest = 0, rows[(*index, 0)]
        for i, value in enumerate(rows[index][1:], 1):
            above = compare("gt", value, largest)
            place, largest = choose(above, i, place), choose(above, value, largest)
        out[index] = place
    return [out]


def cholesky(eqn: Any, values: list) -> list:
    """The lower factors of the matrices of the last two axes."""
    if not any(map(is_traced, values)):
        return constants(eqn, values)
    matrices = plain(values[0])
    out = np.empty(matrices.shape, dtype=object)
    for index in np.ndindex(matrices.shape[:-2]):
        out[index] = plain(algebra.cholesky(finish(matrices[index])))
    return [out]


def triangular_solve(eqn: Any, values: list) -> list:
    """Solves with triangular matrices, of which JAX may have the other triangle filled."""
    if not any(map(is_traced, values)):
        return constants(eqn, values)
    p, (matrices, rights) = eqn.params, map(plain, values)
    out = np.empty(rights.shape, dtype=object)
    for index in np.ndindex(rights.shape[:-2]):
        # x A = b is A^T x^T = b^T.
        right = rights[index] if p["left_side"] else rights[index].T
        matrix, lower = matrices[index], p["lower"]
        if p["transpose_a"] == p["left_side"]:
            matrix, lower = matrix.T, not lower
        if p["unit_diagonal"]:
            matrix = matrix.copy()
            np.fill_diagonal(matrix, 1.0)
        found = algebra.substitute(matrix, right, lower)
        out[index] = found if p["left_side"] else found.T
    return [out]


def add(a: Any, b: Any) -> Any:
    return apply("add", a, b) if isinstance(a, Symbol) or isinstance(b, Symbol) else a + b


def mul(a: Any, b: Any) -> Any:
    return apply("mul", a, b) if isinstance(a, Symbol) or isinstance(b, Symbol) else a * b


def logical(op: str) -> Callable:
    return lambda a, b: combine(op, a, b)


# Operations on whole arrays.
ARRAYS: dict[str, Callable] = {
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
    "argmax": first_largest,
    "cholesky": cholesky,
    "triangular_solve": triangular_solve,
}
