//! Gain that is optimal at any horizon, by Riccati's equation in discrete time.

use super::{LinearPlant, row_major, spectral_radius};
use crate::dynamics::system::System;
use nalgebra::DMatrix;

/// Optimal control of a [`LinearPlant`] whose steps cost `(x_{t+1}ᵀ Q x_{t+1} + u_tᵀ R u_t)/2`.
///
/// The minimal cost of all steps from the state x is `xᵀ P x / 2`, and the optimal control is
/// `u = K x`. The cost of a step includes the state after the step. In textbooks, the cost includes
/// the state before the step (Bertsekas, Dynamic Programming and Optimal Control, 3.1). Riccati's
/// equation therefore has `W = Q + P` in place of P:
///
/// ```text
/// K = -(R + Bᵀ W B)⁻¹ Bᵀ W A
/// P = Aᵀ W (A + B K) = (A + B K)ᵀ W (A + B K) + Kᵀ R K
/// ```
#[derive(Clone, Debug, PartialEq)]
pub struct Optimum {
    /// Gain K, row-major.
    pub gain: Vec<f64>,
    /// Cost-to-go matrix P, row-major.
    pub cost_to_go: Vec<f64>,
}

/// No solution of Riccati's equation was found.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum NoOptimum {
    /// R is not positive definite.
    #[error(
        "the cost R of controls is not positive definite, so no optimal control exists; use an R with positive eigenvalues"
    )]
    ControlCost,
    /// Q has a negative eigenvalue. `R + Bᵀ W B`, with the W of [`Optimum`], is not positive
    /// definite, or W differs from `Q + P`. In exact arithmetic, both faults require a negative
    /// eigenvalue of Q.
    #[error(
        "the cost decreases without bound for large controls, because the cost Q of states has a negative eigenvalue; \
         use a Q without negative eigenvalues"
    )]
    StateCost,
    /// The control found does not stabilize the plant, although Q has no negative eigenvalue. Also
    /// covers the faults of [`StateCost`](Self::StateCost) for such a Q. Rounding errors may cause
    /// them if no control stabilizes the plant, or if the problem is ill-conditioned.
    #[error(
        "no control makes the plant decay: it has motions without decay that no control reaches or on which the cost does not \
         depend, or the costs differ by too many orders of magnitude for f64"
    )]
    Unstabilizable,
    /// The doubling iteration did not converge, or a matrix to invert was singular: the cost is
    /// unbounded, or the plant decays too slowly.
    #[error(
        "Riccati's equation did not converge in 2^{doublings} steps (the last doubling changed W by {change:.1e} of its size): \
         the plant has motions without decay that no control reaches or on which the cost does not depend, or the cost Q of \
         states has a negative eigenvalue"
    )]
    NotConverged {
        /// Number of doublings of the horizon.
        doublings: usize,
        /// Last change of W, relative to its largest entry.
        change: f64,
    },
}

/// Largest spectral radius of the closed loop. Rounding errors may move the eigenvalue 1 of a
/// motion without decay to a smaller number.
const SLOWEST: f64 = 1.0 - 1e-8;

/// Largest number of doublings of the horizon. Closed loops that decay too slowly for this number
/// yield [`NoOptimum::NotConverged`].
const MAX_DOUBLINGS: usize = 40;

impl Optimum {
    /// Computes the optimum of a plant for the row-major costs Q and R, by doubling the horizon
    /// (Chu, Fan, Lin and Wang 2004, doi:10.1080/00207170410001714988). The initial values are
    /// `A_0 = A`, `G_0 = B R⁻¹ Bᵀ`, `H_0 = Q`:
    ///
    /// ```text
    /// N = (I + G H)⁻¹,   A' = A N A,   G' = G + A N G Aᵀ,   H' = H + Aᵀ H N A → W
    /// ```
    ///
    /// Single steps would need thousands of iterations and accumulate their rounding errors.
    ///
    /// # Errors
    /// Returns [`NoOptimum`] if R or `R + Bᵀ W B` is not positive definite, if the iteration does
    /// not converge, or if the result W differs from `Q + P`. If Q has no negative eigenvalue, also
    /// returns it for a closed loop that does not decay.
    pub(super) fn of(
        plant: &LinearPlant,
        state_cost: &[f64],
        control_cost: &[f64],
    ) -> Result<Self, NoOptimum> {
        let (n, m) = (plant.state_dim(), plant.control_dim());
        let (a, b) = (plant.a(), plant.b());
        let (q, r) = (
            DMatrix::from_row_slice(n, n, state_cost),
            DMatrix::from_row_slice(m, m, control_cost),
        );
        let g = &b * r.clone().cholesky().ok_or(NoOptimum::ControlCost)?.solve(&b.transpose());
        let w = doubled(a.clone(), g, q.clone())?;
        let towards = b.transpose() * &w;
        // The bound on the rounding error of computed eigenvalues grows with n.
        let is_convex = symmetric(q.clone()).symmetric_eigenvalues().min()
            >= -4.0 * n as f64 * f64::EPSILON * q.amax();
        let failure = if is_convex { NoOptimum::Unstabilizable } else { NoOptimum::StateCost };
        let factor = (&r + &towards * &b).cholesky().ok_or(failure.clone())?;
        let gain = -factor.solve(&(towards * &a));
        // The second form of P, a sum of squares, does not amplify rounding errors.
        let closed = a + b * &gain;
        let radius = spectral_radius(&closed);
        let p = symmetric(closed.transpose() * &w * closed + gain.transpose() * r * &gain);
        // Doubling may converge where the recursion of single steps oscillates.
        let residual = (&w - &q - &p).amax();
        if residual.is_nan()
            || residual > 1e-6 * w.amax().max(p.amax())
            || is_convex && radius > SLOWEST
        {
            return Err(failure);
        }
        Ok(Self { gain: row_major(&gain), cost_to_go: row_major(&p) })
    }
}

fn symmetric(matrix: DMatrix<f64>) -> DMatrix<f64> {
    (&matrix + matrix.transpose()) * 0.5
}

/// Computes W from the A, G and H of one step.
fn doubled(
    mut a: DMatrix<f64>,
    mut g: DMatrix<f64>,
    mut h: DMatrix<f64>,
) -> Result<DMatrix<f64>, NoOptimum> {
    let mut change = f64::INFINITY;
    for doublings in 0..MAX_DOUBLINGS {
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
    Err(NoOptimum::NotConverged { doublings: MAX_DOUBLINGS, change })
}
