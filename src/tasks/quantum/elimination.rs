//! Linear solve of a Cayley factor: one per step of Crank-Nicolson, two per step of Padé.

use super::system::{Pair, PerPoint};
use crate::numbers::scalar::Scalar;
use std::ops::{Add, Mul, Neg, Sub};

/// Real or imaginary part of a wave at a grid point: a number, or its cotangents of several flows.
pub(super) trait Vector<T>:
    Copy + Add<Output = Self> + Sub<Output = Self> + Neg<Output = Self> + Mul<T, Output = Self>
{
}

impl<T, V> Vector<T> for V where
    V: Copy + Add<Output = V> + Sub<Output = V> + Neg<Output = V> + Mul<T, Output = V>
{
}

/// Successive pivots of `A = I + i dt/2 (H + shift)` with `H = -D₂ + diag(V)`. D₂ is the second
/// difference over dx².
pub(super) struct Pivots<T> {
    /// `dt / (2 dx²)`: the off-diagonal entries of A are `-ib`.
    b: T,
    /// `b²`.
    b_squared: T,
    /// Imaginary part of the diagonal of A without V.
    kinetic: T,
    /// `dt / 2`.
    half_dt: T,
    /// Reciprocal pivot of the previous row; 0 before the first row.
    per_pivot: Pair<T>,
}

impl<T: Scalar> Pivots<T> {
    #[inline(always)]
    pub(super) fn new(dt: f64, dx: f64, shift: f64) -> Self {
        let off_diagonal = 0.5 * dt / (dx * dx);
        let kinetic = 2.0 * off_diagonal + 0.5 * dt * shift;
        let (b, kinetic, half_dt) = (T::from(off_diagonal), T::from(kinetic), T::from(0.5 * dt));
        Self { b, b_squared: b * b, kinetic, half_dt, per_pivot: (T::zero(), T::zero()) }
    }

    /// Returns the reciprocal pivot of the next row, whose potential is `v`.
    #[inline(always)]
    fn next(&mut self, v: T) -> Pair<T> {
        let (q_re, q_im) = self.per_pivot;
        let re = T::one() + self.b_squared * q_re;
        let im = self.kinetic + self.half_dt * v + self.b_squared * q_im;
        let per_square = T::one() / (re * re + im * im);
        self.per_pivot = (re * per_square, -(im * per_square));
        self.per_pivot
    }
}

/// Row-by-row elimination of A, in progress.
pub(super) struct Rows<'a, T> {
    pivots: Pivots<T>,
    per_pivot: &'a mut PerPoint<Pair<T>>,
}

impl<'a, T: Scalar> Rows<'a, T> {
    #[inline(always)]
    pub(super) fn new(
        pivots: Pivots<T>,
        grid: usize,
        per_pivot: &'a mut PerPoint<Pair<T>>,
    ) -> Self {
        per_pivot.reserve(grid);
        Self { pivots, per_pivot }
    }

    /// Eliminates the next row, in which the potential is `v`.
    #[inline(always)]
    pub(super) fn push(&mut self, v: T) {
        self.per_pivot.push(self.pivots.next(v));
    }

    /// Returns the complete elimination. Requires that every row has been pushed.
    #[inline(always)]
    pub(super) fn elimination(self) -> Elimination<'a, T> {
        Elimination { b: self.pivots.b, per_pivot: self.per_pivot }
    }
}

/// Complete elimination of A, which is complex symmetric with off-diagonal entries `-ib`.
pub(super) struct Elimination<'a, T> {
    /// `dt / (2 dx²)`; negated for the conjugate.
    b: T,
    /// Reciprocal pivot of each row.
    per_pivot: &'a mut [Pair<T>],
}

impl<T: Scalar> Elimination<'_, T> {
    /// Computes `y ← A⁻¹ rhs`. In both slices, real and imaginary parts alternate.
    #[inline(always)]
    pub(super) fn solve<V: Vector<T>>(&self, rhs: &[V], y: &mut [V]) {
        let (b, n) = (self.b, self.per_pivot.len());
        let (rhs, y, per_pivot) = (
            &rhs.as_chunks::<2>().0[..n],
            &mut y.as_chunks_mut::<2>().0[..n],
            &self.per_pivot[..n],
        );
        // The first row of each pass precedes the loop. Scalar variables, not arrays, carry the
        // values of a row to the next. Other forms make compilers shuffle lanes.
        // Forward, with the pivots p_j: s_j = (rhs_j + ib s_{j-1}) / p_j.
        let (q_re, q_im) = per_pivot[0];
        let (mut s_re, mut s_im) =
            (rhs[0][0] * q_re - rhs[0][1] * q_im, rhs[0][0] * q_im + rhs[0][1] * q_re);
        (y[0][0], y[0][1]) = (s_re, s_im);
        for j in 1..n {
            let (q_re, q_im) = per_pivot[j];
            let (re, im) = (rhs[j][0] - s_im * b, rhs[j][1] + s_re * b);
            (s_re, s_im) = (re * q_re - im * q_im, re * q_im + im * q_re);
            (y[j][0], y[j][1]) = (s_re, s_im);
        }
        // Backward: y_j = s_j + ib y_{j+1} / p_j.
        let (mut y_re, mut y_im) = (s_re, s_im);
        for j in (0..n - 1).rev() {
            let (q_re, q_im) = per_pivot[j];
            let (f_re, f_im) = (q_re * b, q_im * b);
            (y_re, y_im) =
                (y[j][0] - (y_re * f_im + y_im * f_re), y[j][1] + (y_re * f_re - y_im * f_im));
            (y[j][0], y[j][1]) = (y_re, y_im);
        }
    }

    /// Converts to the elimination of the conjugate of A, which is the adjoint because A is
    /// symmetric.
    #[inline(always)]
    pub(super) fn conjugate(&mut self) {
        self.b = -self.b;
        for (_, im) in self.per_pivot.iter_mut() {
            *im = -*im;
        }
    }
}
