"""Linear systems, inverses, determinants and sums of products of traced numbers."""

from __future__ import annotations

import itertools
import math
from typing import Any

import numpy as np

from ._trace_numbers import Symbol, is_traced, refuse
from ._trace_vectors import demote, finish, plain

# Cofactors of larger matrices take too many operations.
LARGEST = 4


def square(matrix: Any, name: str, largest: float = LARGEST) -> np.ndarray:
    array = plain(matrix)
    if array.ndim != 2 or array.shape[0] != array.shape[1] or len(array) == 0:
        refuse(ValueError, f"np.linalg.{name} needs a square matrix, not shape {array.shape}")
    check_size(array, name, largest)
    return array


def check_size(array: np.ndarray, name: str, largest: float = LARGEST) -> None:
    if len(array) > largest:
        refuse(
            TypeError,
            f"np.linalg.{name} of a traced matrix is limited to {largest} rows, not {len(array)}. "
            "Traced values cannot choose pivots. A positive definite matrix has factors of any size: "
            "`L = np.linalg.cholesky(A)` and `np.linalg.solve(L.T, np.linalg.solve(L, b))`, or cho_factor "
            "and cho_solve of JAX. Otherwise, write the elimination that fits the structure of the matrix",
        )


def minor(matrix: np.ndarray, rows: tuple[int, ...], columns: tuple[int, ...]) -> Any:
    """The determinant of some rows and columns, by the first row. Equal minors are one node."""
    if not rows:
        return np.float64(1.0)
    if len(rows) == 1:
        return matrix[rows[0], columns[0]]
    result = None
    for k, column in enumerate(columns):
        term = matrix[rows[0], column] * minor(matrix, rows[1:], columns[:k] + columns[k + 1 :])
        result = term if result is None else result - term if k % 2 else result + term
    return result


def determinant(a: Any) -> Any:
    array = square(a, "det")
    every = tuple(range(len(array)))
    return minor(array, every, every)


def inverse(a: Any) -> Any:
    """The matrix of cofactors, divided by the determinant."""
    array = square(a, "inv")
    n = len(array)
    det = determinant(array)
    out = np.empty((n, n), dtype=object)
    for i, j in np.ndindex(n, n):
        cofactor = minor(array, *(tuple(k for k in range(n) if k != left) for left in (j, i)))
        out[i, j] = (-cofactor if (i + j) % 2 else cofactor) / det
    return finish(out)


def solve(a: Any, b: Any) -> Any:
    """Solves by elimination if the matrix is constant, and otherwise as zeros in it permit."""
    right = plain(b)
    rows = np.shape(a)[-1:]
    if right.ndim not in (1, 2) or right.shape[:1] != rows:
        refuse(
            ValueError,
            f"np.linalg.solve of shapes {np.shape(a)} and {right.shape}: the numbers of rows differ",
        )
    if not is_traced(a):
        return finish(eliminate(np.array(demote(a), dtype=float), right))
    array, columns = square(a, "solve", math.inf), right.reshape(len(right), -1)
    return finish(solve_blocks(array, columns).reshape(right.shape))


def solve_blocks(matrix: np.ndarray, right: np.ndarray) -> np.ndarray:
    """Solves the equations that constants of zero separate from others on their own."""
    used = np.array([[is_used(value) for value in row] for row in matrix])
    out, left = np.empty(right.shape, dtype=object), set(range(len(right)))
    while left:
        block, waiting = set(), [min(left)]
        while waiting:
            i = waiting.pop()
            if i not in block:
                block.add(i)
                waiting += [j for j in left if used[i, j] or used[j, i]]
        rows = sorted(block)
        inner, inner_used = matrix[np.ix_(rows, rows)], used[np.ix_(rows, rows)]
        if not np.triu(inner_used, 1).any() or not np.tril(inner_used, -1).any():
            out[rows] = substitute(inner, right[rows], lower=not np.triu(inner_used, 1).any())
        else:
            out[rows] = by_determinants(inner, right[rows])
        left -= block
    return out


def is_used(value: Any) -> bool:
    return isinstance(value, Symbol) or value != 0.0


def by_determinants(matrix: np.ndarray, right: np.ndarray) -> np.ndarray:
    """Cramer's rule."""
    check_size(matrix, "solve")
    det = determinant(matrix)
    out = np.empty(right.shape, dtype=object)
    for i, j in np.ndindex(out.shape):
        replaced = matrix.copy()
        replaced[:, i] = right[:, j]
        out[i, j] = determinant(replaced) / det
    return out


def substitute(matrix: np.ndarray, right: np.ndarray, lower: bool) -> np.ndarray:
    """Solves with one triangle of a matrix."""
    x, n = right.copy(), len(matrix)
    for i in range(n) if lower else reversed(range(n)):
        for j in range(i) if lower else range(i + 1, n):
            if is_used(matrix[i, j]):
                x[i] = x[i] - matrix[i, j] * x[j]
        x[i] = x[i] / matrix[i, i]
    return x


def cholesky(a: Any) -> Any:
    """The lower factor of a positive definite matrix, of which it reads the lower triangle."""
    matrix = square(a, "cholesky", math.inf)
    out = np.full(matrix.shape, np.float64(0.0), dtype=object)
    for j in range(len(matrix)):
        for i in range(j, len(matrix)):
            rest = matrix[i, j]
            for k in range(j):
                rest = rest - out[i, k] * out[j, k]
            out[i, j] = np.sqrt(rest) if i == j else rest / out[j, j]
    return finish(out)


def eliminate(matrix: np.ndarray, right: np.ndarray) -> np.ndarray:
    """Gauss elimination with the largest pivot of each column."""
    if matrix.ndim != 2 or matrix.shape[0] != matrix.shape[1]:
        refuse(ValueError, f"np.linalg.solve needs a square matrix, not shape {matrix.shape}")
    matrix, x, n = matrix.copy(), right.copy(), len(matrix)
    for k in range(n):
        pivot = k + int(np.argmax(np.abs(matrix[k:, k])))
        if matrix[pivot, k] == 0.0:
            refuse(ValueError, "np.linalg.solve: the matrix is singular")
        for array in (matrix, x):
            array[[k, pivot]] = array[[pivot, k]]
        for i in range(k + 1, n):
            factor = matrix[i, k] / matrix[k, k]
            if factor != 0.0:
                matrix[i, k:] -= factor * matrix[k, k:]
                x[i] = x[i] - factor * x[k]
    for k in reversed(range(n)):
        for i in range(k + 1, n):
            if matrix[k, i] != 0.0:
                x[k] = x[k] - matrix[k, i] * x[i]
        x[k] = x[k] / matrix[k, k]
    return x


def einsum(subscripts: Any, *operands: Any, **_: Any) -> Any:
    """Sums of products by index letters, without an ellipsis."""
    if not isinstance(subscripts, str) or "." in subscripts:
        refuse(TypeError, "np.einsum needs letters as in 'ij,j->i', without an ellipsis")
    inputs, arrow, output = subscripts.replace(" ", "").partition("->")
    letters, arrays = inputs.split(","), [plain(operand) for operand in operands]
    if len(letters) != len(arrays) or any(len(part) != array.ndim for part, array in zip(letters, arrays)):
        refuse(
            ValueError, f"np.einsum: `{subscripts}` does not fit shapes {[array.shape for array in arrays]}"
        )
    if not arrow:
        output = "".join(sorted(letter for letter in set(inputs) - {","} if inputs.count(letter) == 1))
    if len(set(output)) != len(output) or not set(output) <= set(inputs) - {","}:
        refuse(
            ValueError,
            f"np.einsum: the output of `{subscripts}` has an index twice, or one that no input has",
        )
    sizes: dict[str, int] = {}
    for part, array in zip(letters, arrays, strict=True):
        if len(set(zip(part, array.shape))) > len(set(part)):
            refuse(ValueError, f"np.einsum: an index of `{part}` has two sizes in the shape {array.shape}")
        for letter, size in zip(part, array.shape, strict=True):
            known = sizes.get(letter, 1)
            if known != size and 1 not in (known, size):
                refuse(ValueError, f"np.einsum: the index `{letter}` has the sizes {known} and {size}")
            sizes[letter] = size if known == 1 else known
    summed = [letter for letter in sizes if letter not in output]
    out = np.empty(tuple(sizes[letter] for letter in output), dtype=object)
    for index in np.ndindex(out.shape):
        at = dict(zip(output, index, strict=True))
        result = None
        for inner in itertools.product(*(range(sizes[letter]) for letter in summed)):
            at.update(zip(summed, inner, strict=True))
            # A dimension of size 1 is repeated.
            terms = [
                array[tuple(at[k] if n > 1 else 0 for k, n in zip(part, array.shape, strict=True))]
                for part, array in zip(letters, arrays, strict=True)
            ]
            term = math.prod(terms[1:], start=terms[0])
            result = term if result is None else result + term
        out[index] = np.float64(0.0) if result is None else result
    return finish(out)
