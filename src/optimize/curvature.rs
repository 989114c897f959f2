//! Second derivatives of a step with respect to its controls, for controls that saturate smoothly.
//!
//! Where a control saturates with a slope s, `BᵀB` falls as s², but the Hessian of a cost of the
//! saturated control is negative of order s. `λᵀ ∂²S/∂u²` compensates it.
//!
//! The derivatives are differences of the exact Jacobian B. Nested dual numbers would be exact, but
//! every step would be compiled for one more scalar type. Differences suffice: they change the model
//! of the cost, thus the rate of convergence, but neither gradient nor cost. A step that is linear in
//! its controls has differences of exactly 0.

use super::OptimizeError;
use super::trajectory::{Problem, Trajectory};
use crate::dynamics::inputs::Inputs;
use nalgebra::{DMatrix, DVector};

/// Largest magnitude of each control over all steps, or 1 for a control that is always 0.
pub(super) fn scales(u: &[f64], m: usize) -> Vec<f64> {
    let largest =
        |i: usize| u.iter().skip(i).step_by(m).fold(0.0, |largest: f64, u| largest.max(u.abs()));
    (0..m).map(largest).map(|largest| if largest > 0.0 { largest } else { 1.0 }).collect()
}

impl Problem<'_> {
    /// Returns `λᵀ ∂²S/∂u²` at step `t`. `dynamics` is ∂S/∂z.
    ///
    /// Each entry is the smaller one of the differences to both sides, or 0 if their signs differ.
    /// A kink within the difference, or at u itself, thus contributes nothing.
    ///
    /// # Errors
    /// [`OptimizeError::Stopped`] if the stop flag is set.
    pub(super) fn control_curvature(
        &self,
        trajectory: &Trajectory,
        t: usize,
        dynamics: &DMatrix<f64>,
        lambda: &DVector<f64>,
        scales: &[f64],
    ) -> Result<DMatrix<f64>, OptimizeError> {
        let Self { p, n, m, .. } = *self;
        let (x, mut u) = (&trajectory.x[t * n..][..n], trajectory.u[t * m..][..m].to_vec());
        let here = dynamics.columns(n, m).tr_mul(lambda);
        let mut curvature = DMatrix::zeros(m, m);
        for i in 0..m {
            let old = u[i];
            let mut differences = [DVector::zeros(m), DVector::zeros(m)];
            for (difference, side) in differences.iter_mut().zip([1.0, -1.0]) {
                self.check_stop()?;
                u[i] = old + side * f64::EPSILON.sqrt() * scales[i].max(old.abs());
                self.step_jacobian(Inputs { x, u: &u, p, t }, n..n + m, |j, column| {
                    let there: f64 =
                        lambda.iter().zip(column).map(|(lambda, slope)| lambda * slope).sum();
                    difference[j - n] = (there - here[j - n]) / (u[i] - old);
                });
            }
            u[i] = old;
            let [above, below] = differences;
            for j in 0..m {
                let is_smooth = above[j] * below[j] > 0.0 && (above[j] + below[j]).is_finite();
                curvature[(j, i)] = match (is_smooth, above[j].abs() < below[j].abs()) {
                    (false, _) => 0.0,
                    (true, true) => above[j],
                    (true, false) => below[j],
                };
            }
        }
        Ok((&curvature + curvature.transpose()) * 0.5)
    }
}
