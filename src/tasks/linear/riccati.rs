//! The gain that is optimal at every horizon: Riccati's equation, in discrete time.

use super::{LinearPlant, row_major};
use crate::system::System;
use nalgebra::DMatrix;

/// What is best for a [`LinearPlant`] whose steps cost `(x_{t+1}ᵀ Q x_{t+1} + u_tᵀ R u_t)/2`.
///
/// The least that can still be paid after `x` is `xᵀ P x / 2`, and the control to it is `u = K x`. Since a step pays for the
/// state that it leads to, Riccati's equation has `W = Q + P` where textbooks, which pay for the state that a step begins
/// with, have P (Bertsekas, Dynamic Programming and Optimal Control, 3.1):
///
/// ```text
/// K = -(R + Bᵀ W B)⁻¹ Bᵀ W A
/// P = Aᵀ W (A + B K) = (A + B K)ᵀ W (A + B K) + Kᵀ R K
/// ```
#[derive(Clone, Debug, PartialEq)]
pub struct Optimum {
    /// K, row-major.
    pub gain: Vec<f64>,
    /// P, row-major.
    pub cost_to_go: Vec<f64>,
}

/// Riccati's equation has no solution that was found.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum NoOptimum {
    /// A control that costs nothing and does nothing, or a negative cost.
    #[error(
        "R + Bᵀ W B is not positive definite, so that no control is the best: make the cost of controls positive definite and \
         that of states positive semidefinite"
    )]
    Indefinite,
    /// What can be paid has no bound, or the bound is not found.
    #[error(
        "Riccati's equation did not converge in {steps} steps (the last changed P by {change:.1e} of its size): the plant has \
         motions that do not decay and that no control reaches, or that the cost does not see"
    )]
    NotConverged {
        /// Steps taken.
        steps: usize,
        /// The last change, in relation to the largest entry.
        change: f64,
    },
}

/// Steps after which the iteration is given up: of loops that take longer, f64 does not hold the optimum either.
const MOST: usize = 200_000;
/// Changes below this, in relation to the largest entry, are rounding.
const ROUNDING: f64 = 1e-15;

impl Optimum {
    /// Of a plant and its costs Q and R, row-major: the limit of the recursion for finite horizons, from `P = 0`.
    ///
    /// # Errors
    /// [`NoOptimum`].
    pub(super) fn of(plant: &LinearPlant, state_cost: &[f64], control_cost: &[f64]) -> Result<Self, NoOptimum> {
        let (n, m) = (plant.state_dim(), plant.control_dim());
        let (a, b) = (plant.a(), plant.b());
        let (q, r) = (DMatrix::from_row_slice(n, n, state_cost), DMatrix::from_row_slice(m, m, control_cost));
        let mut p = DMatrix::zeros(n, n);
        let mut change = f64::INFINITY;
        for _ in 0..MOST {
            let w = &q + &p;
            let towards = b.transpose() * &w;
            let factor = (&r + &towards * &b).cholesky().ok_or(NoOptimum::Indefinite)?;
            let gain = -factor.solve(&(towards * &a));
            if change <= ROUNDING {
                return Ok(Self { gain: row_major(&gain), cost_to_go: row_major(&p) });
            }
            // A sum of squares, for which rounding is not amplified; and symmetric to the last bit.
            let closed = &a + &b * &gain;
            let next = closed.transpose() * w * closed + gain.transpose() * &r * &gain;
            let next = (&next + next.transpose()) * 0.5;
            change = (&next - &p).amax() / next.amax().max(f64::MIN_POSITIVE);
            p = next;
        }
        Err(NoOptimum::NotConverged { steps: MOST, change })
    }
}
