//! `M = L D Lᵀ` of a symmetric positive definite matrix, without pivots: Cholesky's factors without square roots.
//!
//! No pivots are needed, and it is backward stable (Higham, Accuracy and Stability of Numerical Algorithms, 10.1): what it
//! solves is exactly solved for a matrix that differs by rounding. There is no branch on a value, so it runs in lanes and on
//! duals.
//!
//! A lower triangle is packed by rows: the entry (i, j), j ≤ i, is at `i (i + 1)/2 + j`.

use crate::numbers::scalar::Scalar;
use std::ops::{Mul, SubAssign};

/// Where row `i` begins.
#[inline(always)]
fn row(i: usize) -> usize {
    i * (i + 1) / 2
}

/// Puts L in place of the triangle of M, and 1/D in place of the diagonal.
#[inline(always)]
pub(super) fn factor<T: Scalar>(matrix: &mut [T], n: usize) {
    for i in 0..n {
        // First the entries of L D.
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

/// Solves `M y = b` in place; `b` is numbers, or cotangents: M is symmetric, and so its own adjoint.
#[inline(always)]
pub(super) fn solve<T: Scalar, V: Copy + SubAssign + Mul<T, Output = V>>(factors: &[T], b: &mut [V]) {
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
