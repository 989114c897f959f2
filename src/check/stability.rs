//! Linear stability of a time step: spectral radius of its state Jacobian.

use crate::dynamics::inputs::{Inputs, Tangents};
use crate::dynamics::system::System;
use crate::engine::any::AnySystem;
use nalgebra::DMatrix;
use std::fmt;

/// Number of squarings of the Jacobian J, which yield `J^(2³⁰)`.
const SQUARINGS: usize = 30;
/// Margin above 1 within which a multiplier counts as stable. Linear growth, such as a position
/// under a velocity error, yields `(2³⁰)^(1/2³⁰) ≈ 1 + 2e-8`.
const ROUNDING: f64 = 1e-6;

/// Result of [`stability`].
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Stability {
    /// Spectral radius of the Jacobian ∂S/∂x of the step S: the asymptotic growth factor per step
    /// of the fastest growing perturbation. NaN if the Jacobian is non-finite.
    pub multiplier: f64,
    /// State component in which the fastest growing perturbation is largest. For a NaN multiplier,
    /// the first component with a non-finite derivative.
    pub component: usize,
}

impl Stability {
    /// True if no perturbation grows exponentially, up to rounding. False for NaN.
    pub fn is_stable(&self) -> bool {
        self.multiplier <= 1.0 + ROUNDING
    }
}

impl fmt::Display for Stability {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { multiplier, component } = *self;
        if multiplier.is_nan() {
            return write!(
                f,
                "unknown: the derivative of the step is non-finite in state component {component}. Evaluate at a state where the step is \
                 differentiable, or correct the step"
            );
        }
        if self.is_stable() {
            return write!(f, "stable: no perturbation grows exponentially. The largest multiplier per step is {multiplier:.4}");
        }
        write!(
            f,
            "unstable: each step multiplies a perturbation of state component {component} by {multiplier:.4}. Use shorter steps \
             (`Substeps`), an implicit integrator (`ImplicitMidpoint`) or more damping. If steps half as long multiply it by \
             about {:.4}, the physics is unstable, not the step",
            multiplier.sqrt()
        )
    }
}

/// Growth of a perturbation of the state under repeated steps with the Jacobian at `inputs`.
///
/// An explicit step is unstable where the dynamics are too stiff for its length. The perturbation
/// then grows with every step and usually alternates in sign. Stability depends on the state:
/// evaluate it at the closest approach, in contact and at rest.
///
/// The spectral radius follows from Gelfand's formula, `ρ = lim ‖Jᵏ‖^(1/k)`, with 30 squarings of
/// the Jacobian. Unlike power iteration, the formula handles complex eigenvalue pairs and defective
/// matrices. Powers may underflow to 0 for long cascades of equal cells, in which each cell drives
/// the next. The last estimate is then an upper bound. In this case, the multiplier is the smaller
/// of this bound and the spectral radius from an eigenvalue solver. The cost is `state_dim`
/// forward-mode derivatives and at most 30 matrix products. After underflow, it includes the
/// eigenvalues.
/// ```
/// use physgrad::{Inputs, check, tasks::{FrictionScheme, SliderSystem}};
///
/// let slider = SliderSystem { smoothing: 0.01, scheme: FrictionScheme::Explicit, ..SliderSystem::default() };
/// // 1 - dt μ g / ε = -3.905
/// let found = check::stability(&slider, Inputs::new(&[0.0, 0.0], &[0.0]));
/// assert!(!found.is_stable() && (found.multiplier - 3.905).abs() < 1e-6);
/// assert!(check::stability(&SliderSystem::default(), Inputs::new(&[0.0, 0.0], &[0.0])).is_stable());
/// ```
pub fn stability<S: System>(system: &S, inputs: Inputs<'_, f64>) -> Stability {
    of_any(system, inputs)
}

fn of_any(system: &dyn AnySystem<f64>, inputs: Inputs<'_, f64>) -> Stability {
    let n = inputs.x.len();
    let jacobian = jacobian(system, inputs);
    let mut power = jacobian.clone();
    if let Some(at) = power.iter().position(|slope| !slope.is_finite()) {
        return Stability { multiplier: f64::NAN, component: at / n };
    }
    let (mut logarithm, mut share, mut component, mut underflows) = (0.0, 1.0, 0, false);
    for round in 0..=SQUARINGS {
        let largest = power.iter().fold(0.0, |largest: f64, slope| largest.max(slope.abs()));
        if largest == 0.0 {
            // Without underflow, the matrix is nilpotent. Otherwise the last estimate bounds the
            // spectral radius.
            if !underflows {
                return Stability { multiplier: 0.0, component };
            }
            // If J is triangular, the computed eigenvalues of J or of Jᵀ are exact.
            let jacobian = DMatrix::from_row_slice(n, n, &jacobian);
            let largest = [jacobian.transpose(), jacobian].map(|matrix| {
                let sizes = matrix.complex_eigenvalues().map(|value| value.re.hypot(value.im));
                sizes.iter().copied().fold(0.0, f64::max)
            });
            return Stability { multiplier: largest.into_iter().fold(f64::exp(logarithm), f64::min), component };
        }
        logarithm += share * largest.ln();
        share *= 0.5;
        for slope in &mut power {
            let is_zero = *slope == 0.0;
            *slope /= largest;
            underflows |= *slope == 0.0 && !is_zero;
        }
        let weight = |i: usize| power[i * n..(i + 1) * n].iter().map(|slope| slope * slope).sum::<f64>();
        component = (0..n).max_by(|&i, &j| weight(i).total_cmp(&weight(j))).unwrap_or(0);
        if round < SQUARINGS {
            power = square(&power, n, &mut underflows);
        }
    }
    Stability { multiplier: logarithm.exp(), component }
}

/// Frobenius norm of the state Jacobian ∂S/∂x. Infinite if an entry is NaN.
#[cfg(feature = "program")]
pub(crate) fn jacobian_norm<S: System>(system: &S, inputs: Inputs<'_, f64>) -> f64 {
    let norm = jacobian(system, inputs).iter().map(|slope| slope * slope).sum::<f64>().sqrt();
    if norm.is_nan() { f64::INFINITY } else { norm }
}

/// ∂S/∂x in row-major order.
fn jacobian(system: &dyn AnySystem<f64>, inputs: Inputs<'_, f64>) -> Vec<f64> {
    let n = inputs.x.len();
    let (mut matrix, mut x_tan, mut column) = (vec![0.0; n * n], vec![0.0; n], vec![0.0; n]);
    for j in 0..n {
        x_tan[j] = 1.0;
        system.jvp(inputs, Tangents { x: Some(&x_tan), ..Tangents::default() }, &mut column);
        x_tan[j] = 0.0;
        for i in 0..n {
            matrix[i * n + j] = column[i];
        }
    }
    matrix
}

/// Square of a matrix. Sets `underflows` if a product of two nonzero entries is 0.
fn square(matrix: &[f64], n: usize, underflows: &mut bool) -> Vec<f64> {
    let mut product = vec![0.0; n * n];
    for i in 0..n {
        for k in 0..n {
            let factor = matrix[i * n + k];
            for j in 0..n {
                let term = factor * matrix[k * n + j];
                *underflows |= term == 0.0 && factor != 0.0 && matrix[k * n + j] != 0.0;
                product[i * n + j] += term;
            }
        }
    }
    product
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::numbers::scalar::Scalar;

    /// `x_{t+1} = A x_t`.
    struct Linear<const N: usize>([[f64; N]; N]);

    impl<const N: usize> System for Linear<N> {
        fn state_dim(&self) -> usize {
            N
        }
        fn control_dim(&self) -> usize {
            0
        }
        fn step<T: Scalar>(&self, Inputs { x, .. }: Inputs<'_, T>, next: &mut [T]) {
            for (next, row) in next.iter_mut().zip(&self.0) {
                *next = row.iter().zip(x).fold(T::zero(), |sum, (&a, &x)| sum + T::from(a) * x);
            }
        }
    }

    fn of<const N: usize>(matrix: [[f64; N]; N]) -> Stability {
        stability(&Linear(matrix), Inputs::new(&[0.0; N], &[]))
    }

    /// A chain of cells, each driven by the one before.
    fn cascade<const N: usize>(own: f64, driven: f64) -> [[f64; N]; N] {
        std::array::from_fn(|i| {
            std::array::from_fn(|j| {
                if i == j {
                    own
                } else if i == j + 1 {
                    driven
                } else {
                    0.0
                }
            })
        })
    }

    fn near_within(found: Stability, expected: f64, tolerance: f64) {
        assert!((found.multiplier - expected).abs() < tolerance, "{found:?}");
    }

    #[test]
    fn spectral_radii_are_correct_for_complex_defective_and_nilpotent_matrices() {
        let near = |found, expected| near_within(found, expected, 1e-7);
        near(of([[0.5, 0.0, 0.0], [0.0, -3.0, 0.0], [0.0, 0.0, 2.0]]), 3.0);
        assert_eq!(of([[0.5, 0.0, 0.0], [0.0, -3.0, 0.0], [0.0, 0.0, 2.0]]).component, 1);
        // Rotation by 1 rad, scaled by 2: complex eigenvalues.
        let (sin, cos) = (2.0 * f64::sin(1.0), 2.0 * f64::cos(1.0));
        near(of([[cos, -sin], [sin, cos]]), 2.0);
        // Strongly non-normal, defective and nilpotent matrices.
        near(of([[0.9, 1e6], [0.0, 0.8]]), 0.9);
        near(of([[1.0, 0.1], [0.0, 1.0]]), 1.0);
        near(of([[0.0, 1.0], [0.0, 0.0]]), 0.0);
        near(of([[0.0]]), 0.0);
        // Cascades of equal cells. The powers underflow to 0 with 30 and 100 cells.
        near_within(of(cascade::<25>(-1.5, 2.5)), 1.5, 1e-6);
        near_within(of(cascade::<30>(-1.5, 2.5)), 1.5, 1e-12);
        near_within(of(cascade::<100>(0.98, 1.0)), 0.98, 1e-12);
        // Powers that underflow before the exponent reaches the number of cells.
        near_within(of(cascade::<65>(1.5, 1e6)), 1.5, 1e-12);
        near_within(of(cascade::<129>(1.5, 2500.0)), 1.5, 1e-12);
        near(of(cascade::<129>(0.0, 2500.0)), 0.0);
        assert_eq!(of(cascade::<30>(-1.5, 2.5)).component, 29);
        assert!(of(cascade::<60>(1.0, 0.01)).is_stable());
        assert!(of([[1.0, 0.1], [0.0, 1.0]]).is_stable() && !of([[1.001]]).is_stable());
        assert!(of([[1.0, f64::NAN], [0.0, 1.0]]).multiplier.is_nan() && !of([[f64::INFINITY]]).is_stable());
    }
}
