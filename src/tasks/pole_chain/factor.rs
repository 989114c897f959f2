//! Factorization `M = L D Lᵀ` of symmetric positive definite matrices: Cholesky's method without
//! square roots.
//!
//! The method needs no pivoting and is backward stable (Higham, Accuracy and Stability of Numerical
//! Algorithms, 10.1). The computed solution is exact for a matrix that differs from M by rounding
//! errors. The code does not branch on values, so it works with lanes and dual numbers.
//!
//! Lower triangles are packed by rows: the entry (i, j), j ≤ i, has the index `i (i + 1)/2 + j`.

use crate::numbers::scalar::Scalar;
use std::ops::{Mul, SubAssign};

/// Returns the index at which row `i` begins.
#[inline(always)]
fn row(i: usize) -> usize {
    i * (i + 1) / 2
}

/// Replaces the strict lower triangle of M by that of L, and the diagonal by 1/D.
#[inline(always)]
pub(in crate::tasks) fn factor<T: Scalar>(matrix: &mut [T], n: usize) {
    for i in 0..n {
        // Computes the entries of L D first.
        for j in 0..i {
            let mut entry = matrix[row(i) + j];
            for k in 0..j {
                entry -= matrix[row(i) + k] * matrix[row(j) + k];
            }
            matrix[row(i) + j] = entry;
        }
        let mut pivot = matrix[row(i) + i];
        for j in 0..i {
            let scaled = matrix[row(i) + j];
            let entry = scaled * matrix[row(j) + j];
            pivot -= scaled * entry;
            matrix[row(i) + j] = entry;
        }
        matrix[row(i) + i] = T::one() / pivot;
    }
}

/// Solves `M y = b` in place. `b` holds numbers or cotangents: M is symmetric, hence its own
/// adjoint.
#[inline(always)]
pub(in crate::tasks) fn solve<T: Scalar, V: Copy + SubAssign + Mul<T, Output = V>>(
    factors: &[T],
    b: &mut [V],
) {
    let n = b.len();
    for i in 0..n {
        for j in 0..i {
            let known = b[j];
            b[i] -= known * factors[row(i) + j];
        }
    }
    for i in 0..n {
        b[i] = b[i] * factors[row(i) + i];
    }
    for i in (0..n).rev() {
        let known = b[i];
        for j in 0..i {
            b[j] -= known * factors[row(i) + j];
        }
    }
}
