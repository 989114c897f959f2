//! The gain that is optimal at every horizon: Riccati's equation, in discrete time.

use super::{LinearPlant, row_major};
use crate::dynamics::system::System;
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
    /// A control that costs nothing, or less.
    #[error("the cost R of controls is not positive definite, so that no control is the best: make every eigenvalue positive")]
    Indefinite,
    /// What can be paid has no bound, or the bound is not found.
    #[error(
        "Riccati's equation did not converge in 2^{doublings} steps (the last doubling changed W by {change:.1e} of its size): \
         the plant has motions that do not decay and that no control reaches, or that the cost does not see"
    )]
    NotConverged {
        /// Doublings of the horizon that were done.
        doublings: usize,
        /// The last change, in relation to the largest entry.
        change: f64,
    },
}

/// Doublings after which it is given up: of loops that are slower, f64 does not hold the optimum either.
const MOST: usize = 40;

impl Optimum {
    /// Of a plant and its costs Q and R, row-major, by doubling the horizon (Chu, Fan, Lin and Wang 2004,
    /// doi:10.1080/00207170410001714988), from `A_0 = A`, `G_0 = B R⁻¹ Bᵀ`, `H_0 = Q`:
    ///
    /// ```text
    /// N = (I + G H)⁻¹,   A' = A N A,   G' = G + A N G Aᵀ,   H' = H + Aᵀ H N A → W
    /// ```
    ///
    /// One step at a time would need thousands, and carry the rounding of all that the loop has not forgotten.
    ///
    /// # Errors
    /// [`NoOptimum`].
    pub(super) fn of(plant: &LinearPlant, state_cost: &[f64], control_cost: &[f64]) -> Result<Self, NoOptimum> {
        let (n, m) = (plant.state_dim(), plant.control_dim());
        let (a, b) = (plant.a(), plant.b());
        let (q, r) = (DMatrix::from_row_slice(n, n, state_cost), DMatrix::from_row_slice(m, m, control_cost));
        let g = &b * r.clone().cholesky().ok_or(NoOptimum::Indefinite)?.solve(&b.transpose());
        let w = doubled(a.clone(), g, q)?;
        let towards = b.transpose() * &w;
        let factor = (&r + &towards * &b).cholesky().ok_or(NoOptimum::Indefinite)?;
        let gain = -factor.solve(&(towards * &a));
        // A sum of squares, for which rounding is not amplified.
        let closed = a + b * &gain;
        let p = symmetric(closed.transpose() * w * closed + gain.transpose() * r * &gain);
        Ok(Self { gain: row_major(&gain), cost_to_go: row_major(&p) })
    }
}

fn symmetric(matrix: DMatrix<f64>) -> DMatrix<f64> {
    (&matrix + matrix.transpose()) * 0.5
}

/// W, from the A, G and H of one step.
fn doubled(mut a: DMatrix<f64>, mut g: DMatrix<f64>, mut h: DMatrix<f64>) -> Result<DMatrix<f64>, NoOptimum> {
    let mut change = f64::INFINITY;
    for doublings in 0..MOST {
        let inverse = (DMatrix::identity(a.nrows(), a.nrows()) + &g * &h).try_inverse();
        let inverse = inverse.ok_or(NoOptimum::NotConverged { doublings, change })?;
        let onward = &a * &inverse;
        let more = symmetric(a.transpose() * &h * inverse * &a);
        g += symmetric(&onward * &g * a.transpose());
        a = onward * a;
        change = more.amax() / h.amax().max(f64::MIN_POSITIVE);
        h += more;
        if change < f64::EPSILON {
            return Ok(h);
        }
    }
    Err(NoOptimum::NotConverged { doublings: MOST, change })
}
