//! [`Step`]: gains and changes of the controls, from a backward pass over the expansion of a
//! trajectory.

use super::box_qp::BoxQp;
use super::derivatives::Expansion;
use super::options::Bounds;
use nalgebra::{DMatrix, DVector};

/// Gains, changes of the controls, and predicted decrease of the cost.
pub(super) struct Step {
    /// Changes of the controls, `[step]`.
    pub(super) changes: Vec<DVector<f64>>,
    /// Gains of the deviations of the state, `[step]`, each `control_dim × state_dim`.
    pub(super) gains: Vec<DMatrix<f64>>,
    /// Slope and second derivative of the cost along the change, by the quadratic model.
    model: [f64; 2],
}

impl Step {
    /// Decrease of the cost for a fraction `size` of the change, by the quadratic model.
    pub(super) fn predicted(&self, size: f64) -> f64 {
        -size * (self.model[0] + 0.5 * size * self.model[1])
    }
}

/// Coefficient of `μ ‖B‖²` in the regularization of the controls.
const CONTROL_SHARE: f64 = 1e-6;

/// Computes the step of Gauss-Newton differential dynamic programming. Returns `None` if the
/// regularized Hessian with respect to the free controls is not positive definite at a step.
///
/// v and V are the gradient and the Hessian of the cost-to-go after the step, v' and V' those
/// before it. k is the change of the controls, and K is the gain. S is the step of the system,
/// A = ∂S/∂x, B = ∂S/∂u, z = [x, u], and μ is the regularization. The running cost l depends on z
/// directly and through the next state:
///
/// ```text
/// q = ∂l/∂z + [A B]ᵀ v,    Q = ∂²l/∂z² + [A B]ᵀ V [A B]
/// k = argmin_d dᵀ (Q_uu + μ BᵀB) d / 2 + q_uᵀ d,    low - u <= d <= high - u
/// K = -(Q_uu + μ BᵀB)⁻¹ (Q_ux + μ BᵀA) on the free controls, 0 on the others
/// v' = q_x + Kᵀ Q_uu k + Kᵀ q_u + Q_xu k
/// V' = Q_xx + Kᵀ Q_uu K + Kᵀ Q_ux + Q_xu K
/// ```
///
/// `regularized` adds a small multiple of the identity to `μ BᵀB`. Source: Tassa, Erez and Todorov
/// 2012, doi:10.1109/IROS.2012.6386025, equations 10 and 11.
pub(super) fn backward(expansion: &Expansion, u: &[f64], bounds: &Bounds, regularization: f64) -> Option<Step> {
    let steps = expansion.steps.len();
    let (mut value, mut value_hessian) = (expansion.gradient.clone(), expansion.hessian.clone());
    let n = value.len();
    let (mut changes, mut gains, mut model) = (Vec::with_capacity(steps), Vec::with_capacity(steps), [0.0; 2]);
    for (t, step) in expansion.steps.iter().enumerate().rev() {
        let f = &step.dynamics;
        let m = f.ncols() - n;
        let slope = &step.gradient + f.tr_mul(&value);
        let curvature = &step.hessian + f.tr_mul(&(&value_hessian * f));
        let by_u = slope.rows(n, m).into_owned();
        let (uu, ux) = (curvature.view((n, n), (m, m)).into_owned(), curvature.view((n, 0), (m, n)).into_owned());
        let regularized = regularized(f, n, regularization);
        let program = BoxQp::solve(&(&uu + regularized.columns(n, m)), &by_u, &bounds.changes(&u[t * m..][..m]))?;
        let gain = program.gains(&(&ux + regularized.columns(0, n)));
        let change = program.solution;
        let onward = &uu * &change;
        model[0] += change.dot(&by_u);
        model[1] += change.dot(&onward);
        value = slope.rows(0, n) + gain.tr_mul(&(onward + by_u)) + ux.tr_mul(&change);
        let cross = gain.tr_mul(&ux);
        let hessian = curvature.view((0, 0), (n, n)) + gain.tr_mul(&(uu * &gain)) + &cross + cross.transpose();
        value_hessian = (&hessian + hessian.transpose()) * 0.5;
        changes.push(change);
        gains.push(gain);
    }
    changes.reverse();
    gains.reverse();
    Some(Step { changes, gains, model })
}

/// Returns `μ Bᵀ [A B]`, plus a multiple of the identity in the columns of the controls:
/// `1e-6 μ ‖B‖²`, or μ if B = 0. The multiple determines controls without effect on the state.
fn regularized(dynamics: &DMatrix<f64>, n: usize, regularization: f64) -> DMatrix<f64> {
    let by_u = dynamics.columns_range(n..);
    let mut product = by_u.tr_mul(dynamics) * regularization;
    let size = by_u.norm_squared();
    let share = regularization * if size > 0.0 { CONTROL_SHARE * size } else { 1.0 };
    (0..by_u.ncols()).for_each(|i| product[(i, n + i)] += share);
    product
}
