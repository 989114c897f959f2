//! The linear solve in a step of Crank and Nicolson.

use super::system::Pair;
use crate::scalar::Scalar;
use std::ops::{Add, Mul, Neg, Sub};

/// What a solve with [`Elimination`] can be applied to: numbers, and cotangents in several columns.
pub(super) trait Vector<T>:
    Copy + Add<Output = Self> + Sub<Output = Self> + Neg<Output = Self> + Mul<T, Output = Self>
{
}

impl<T, V> Vector<T> for V where V: Copy + Add<Output = V> + Sub<Output = V> + Neg<Output = V> + Mul<T, Output = V> {}

/// `A = I + i dt/2 H`, eliminated: complex symmetric, with `-ib` beside the diagonal.
pub(super) struct Elimination<'a, T> {
    b: T,
    /// One over the pivot of each row.
    per_pivot: &'a mut [Pair<T>],
}

impl<'a, T: Scalar> Elimination<'a, T> {
    /// With `H = -D₂ + diag(potential)`. Writes to `per_pivot`, a place for each row.
    #[inline(always)]
    pub(super) fn new(dt: f64, dx: f64, potential: &[T], per_pivot: &'a mut [Pair<T>]) -> Self {
        let off_diagonal = 0.5 * dt / (dx * dx);
        let (b, kinetic, half_dt) = (T::lift(off_diagonal), T::lift(2.0 * off_diagonal), T::lift(0.5 * dt));
        let b_squared = b * b;
        let (mut q_re, mut q_im) = (T::zero(), T::zero());
        for (per_pivot, &v) in per_pivot.iter_mut().zip(potential) {
            let re = T::one() + b_squared * q_re;
            let im = kinetic + half_dt * v + b_squared * q_im;
            let per_square = T::one() / (re * re + im * im);
            (q_re, q_im) = (re * per_square, -(im * per_square));
            *per_pivot = (q_re, q_im);
        }
        Self { b, per_pivot }
    }

    /// `y ← A⁻¹ rhs`, both with real and imaginary parts in turn.
    #[inline(always)]
    pub(super) fn solve<V: Vector<T>>(&self, rhs: &[V], y: &mut [V]) {
        let b = self.b;
        // Forward: s_j = (rhs_j + ib s_{j-1}) / p_j.
        let mut before: Option<Pair<V>> = None;
        for ((rhs, y), &(q_re, q_im)) in rhs.chunks_exact(2).zip(y.chunks_exact_mut(2)).zip(self.per_pivot.iter()) {
            let (mut re, mut im) = (rhs[0], rhs[1]);
            if let Some((s_re, s_im)) = before {
                (re, im) = (re - s_im * b, im + s_re * b);
            }
            let s = (re * q_re - im * q_im, re * q_im + im * q_re);
            (y[0], y[1]) = s;
            before = Some(s);
        }
        // Back: y_j = s_j + ib y_{j+1} / p_j.
        let mut after: Option<Pair<V>> = None;
        for (y, &(q_re, q_im)) in y.chunks_exact_mut(2).zip(self.per_pivot.iter()).rev() {
            if let Some((y_re, y_im)) = after {
                let (re, im) = (q_re * b, q_im * b);
                y[0] = y[0] - (y_re * im + y_im * re);
                y[1] = y[1] + (y_re * re - y_im * im);
            }
            after = Some((y[0], y[1]));
        }
    }

    /// Becomes the elimination of the conjugate, which is the adjoint because A is symmetric.
    #[inline(always)]
    pub(super) fn conjugate(&mut self) {
        self.b = -self.b;
        for (_, im) in self.per_pivot.iter_mut() {
            *im = -*im;
        }
    }
}
