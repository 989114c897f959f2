//! Linear plants and the linear-quadratic regulator, whose optimum follows from Riccati's equation.

mod lqr;
mod riccati;

pub use lqr::Lqr;
pub use riccati::{NoOptimum, Optimum};

use crate::dynamics::inputs::{Cotangents, Inputs, Tangents};
use crate::dynamics::system::System;
use crate::numbers::scalar::{Cotangent, Real, Scalar};
use crate::numbers::zip::zip;
use nalgebra::DMatrix;

/// Linear system in discrete time, with the next state `x' = A x + B u`.
#[derive(Clone, Debug, PartialEq)]
pub struct LinearPlant {
    state_dim: usize,
    control_dim: usize,
    /// Matrix A, row-major, `state_dim × state_dim`.
    a: Vec<f64>,
    /// Matrix B, row-major, `state_dim × control_dim`.
    b: Vec<f64>,
}

impl LinearPlant {
    /// Creates a plant from row-major matrices: A is `state_dim × state_dim`, B is
    /// `state_dim × control_dim`.
    ///
    /// # Panics
    /// If `state_dim` is 0, A is not `state_dim × state_dim`, or the size of B is not a positive
    /// multiple of `state_dim`.
    #[track_caller]
    pub fn new(state_dim: usize, a: Vec<f64>, b: Vec<f64>) -> Self {
        let (n, of_a, of_b) = (state_dim, a.len(), b.len());
        assert!(
            n > 0 && of_a == n * n,
            "A has {of_a} entries for {n} state components; allowed: {}, for at least one component",
            n * n
        );
        assert!(
            of_b > 0 && of_b.is_multiple_of(n),
            "B has {of_b} entries; allowed: a positive multiple of {n}"
        );
        Self { state_dim, control_dim: of_b / n, a, b }
    }

    /// Linearizes the step of a system about the given inputs, with the exact derivatives
    /// `A = ∂x'/∂x` and `B = ∂x'/∂u` of the next state x'. The plant maps deviations from the
    /// inputs to the deviation of the next state.
    ///
    /// # Panics
    /// If the size of `inputs.x` or `inputs.u` differs from that of the system.
    #[track_caller]
    pub fn linearized<S: System>(system: &S, inputs: Inputs<'_, f64>) -> Self {
        let Inputs { x, u, .. } = inputs;
        let (n, m) = (system.state_dim(), system.control_dim());
        assert!(
            x.len() == n && u.len() == m,
            "the system has {n} state and {m} control components, but x has {} and u has {}",
            x.len(),
            u.len()
        );
        let (mut a, mut b, mut column) = (vec![0.0; n * n], vec![0.0; n * m], vec![0.0; n]);
        let unit = |len: usize, i: usize| {
            (0..len).map(|j| f64::from(u8::from(j == i))).collect::<Vec<f64>>()
        };
        for j in 0..n {
            system.jvp(
                inputs,
                Tangents { x: Some(&unit(n, j)), ..Tangents::default() },
                &mut column,
            );
            (0..n).for_each(|i| a[i * n + j] = column[i]);
        }
        for j in 0..m {
            system.jvp(
                inputs,
                Tangents { u: Some(&unit(m, j)), ..Tangents::default() },
                &mut column,
            );
            (0..n).for_each(|i| b[i * m + j] = column[i]);
        }
        Self { state_dim: n, control_dim: m, a, b }
    }

    /// Returns the plant under the policy `u = K x`, with `A + B K` in place of A. K is row-major.
    /// The control of the new plant adds to `K x`.
    ///
    /// # Panics
    /// If K is not `control_dim × state_dim`.
    #[track_caller]
    pub fn closed_by(&self, gain: &[f64]) -> Self {
        let expected = self.control_dim * self.state_dim;
        assert_eq!(gain.len(), expected, "the gain of this plant needs {expected} entries");
        let closed =
            self.a() + self.b() * DMatrix::from_row_slice(self.control_dim, self.state_dim, gain);
        Self { a: row_major(&closed), ..self.clone() }
    }

    /// Returns the largest modulus of the eigenvalues of A, or NaN if A has a non-finite entry. If
    /// the modulus is below 1, the uncontrolled plant is stable.
    pub fn spectral_radius(&self) -> f64 {
        spectral_radius(&self.a())
    }

    fn a(&self) -> DMatrix<f64> {
        DMatrix::from_row_slice(self.state_dim, self.state_dim, &self.a)
    }

    fn b(&self) -> DMatrix<f64> {
        DMatrix::from_row_slice(self.state_dim, self.control_dim, &self.b)
    }
}

/// Returns the largest modulus of the eigenvalues, or NaN for a matrix with a non-finite entry.
fn spectral_radius(matrix: &DMatrix<f64>) -> f64 {
    if matrix.iter().any(|entry| !entry.is_finite()) {
        return f64::NAN;
    }
    matrix
        .complex_eigenvalues()
        .iter()
        .fold(0.0, |largest, value| value.re.hypot(value.im).max(largest))
}

/// Returns the entries of a matrix, row by row.
fn row_major(matrix: &DMatrix<f64>) -> Vec<f64> {
    matrix.transpose().as_slice().to_vec()
}

/// Returns the inner product of a row with a vector.
#[inline(always)]
fn dot<T: Scalar>(row: &[f64], x: &[T]) -> T {
    let mut sum = T::zero();
    for (&entry, &x) in zip(row.iter(), x) {
        sum += x * entry;
    }
    sum
}

/// Adds `Mᵀ next_bar` to `cotangents` for a row-major M with `cotangents.len()` columns.
#[inline(always)]
fn transposed<R: Real, C: Cotangent<R>>(matrix: &[f64], next_bar: &[C], cotangents: &mut [C]) {
    let columns = cotangents.len();
    for j in 0..columns {
        let mut bar = C::null();
        for i in 0..next_bar.len() {
            bar += next_bar[i] * R::from(matrix[i * columns + j]);
        }
        cotangents[j] += bar;
    }
}

impl System for LinearPlant {
    fn state_dim(&self) -> usize {
        self.state_dim
    }

    fn control_dim(&self) -> usize {
        self.control_dim
    }

    #[inline(always)]
    fn step<T: Scalar>(&self, Inputs { x, u, .. }: Inputs<'_, T>, next: &mut [T]) {
        let (n, m) = (self.state_dim, self.control_dim);
        for (i, next) in next.iter_mut().enumerate() {
            *next = dot(&self.a[i * n..][..n], x) + dot(&self.b[i * m..][..m], u);
        }
    }

    #[inline(always)]
    fn vjp<R: Real, C: Cotangent<R>>(
        &self,
        _inputs: Inputs<'_, R>,
        next_bar: &[C],
        cotangents: Cotangents<'_, C>,
    ) {
        for (matrix, bar) in [(&self.a, cotangents.x), (&self.b, cotangents.u)] {
            if let Some(bar) = bar {
                transposed(matrix, next_bar, bar);
            }
        }
    }
}
