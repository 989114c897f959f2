"""Solves equations with a symmetric positive definite matrix of any size, by loops that trace."""


def solve(matrix, right):
    """Solves by L D L^T, which needs no pivots. Reads the lower triangle."""
    factors, y, n = matrix.copy(), right.copy(), len(right)
    for i in range(n):
        # First the entries of L D.
        for j in range(i):
            for k in range(j):
                factors[i, j] -= factors[i, k] * factors[j, k]
        for j in range(i):
            scaled = factors[i, j]
            factors[i, j] = scaled * factors[j, j]
            factors[i, i] -= scaled * factors[i, j]
        # The diagonal holds 1 / D.
        factors[i, i] = 1 / factors[i, i]
    for i in range(n):
        for j in range(i):
            y[i] -= y[j] * factors[i, j]
    for i in range(n):
        y[i] *= factors[i, i]
    for i in reversed(range(n)):
        for j in range(i):
            y[j] -= y[i] * factors[i, j]
    return y
