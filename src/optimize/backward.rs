//! [`BackwardStep`]: gains and changes of the controls, from a backward pass over the expansion of a
//! trajectory.

use super::box_qp::BoxQp;
use super::derivatives::Expansion;
use super::options::Bounds;
use nalgebra::{DMatrix, DVector, SymmetricEigen};

/// Gains, changes of the controls, and predicted decrease of the cost.
pub(super) struct BackwardStep {
    /// Changes of the controls, `[step]`.
    pub(super) changes: Vec<DVector<f64>>,
    /// Gains of the deviations of the state, `[step]`, each `control_dim × state_dim`.
    pub(super) gains: Vec<DMatrix<f64>>,
    /// Slope and second derivative of the cost along the change, by the quadratic model.
    model: [f64; 2],
}

impl BackwardStep {
    /// Decrease of the cost for a fraction `size` of the change, by the quadratic model.
    pub(super) fn predicted(&self, size: f64) -> f64 {
        -size * (self.model[0] + 0.5 * size * self.model[1])
    }
}

/// Computes the step of Gauss-Newton differential dynamic programming. Returns `None` if the
/// regularized Hessian with respect to the free controls is not positive definite at a step.
///
/// v and V are the gradient and the Hessian of the cost-to-go after the step, v' and V' those
/// before it. k is the change of the controls, and K is the gain. S is the step of the system,
/// A = ∂S/∂x, B = ∂S/∂u, z = [x, u], and ρ is the regularization. D is the diagonal matrix of
/// [`Expansion::damping`]. The running cost l depends on z directly and through the next state. L is
/// its Hessian with respect to z. Its block `L_uu` contains `λᵀ ∂²S/∂u²`:
///
/// ```text
/// q = ∂l/∂z + [A B]ᵀ v,    Q = L + [A B]ᵀ V [A B]
/// k = argmin_d dᵀ (Q_uu + ρ D) d / 2 + q_uᵀ d,    low - u <= d <= high - u
/// K = -(Q_uu + ρ D)⁻¹ Q_ux on the free controls, 0 on the others
/// v' = q_x + Kᵀ Q_uu k + Kᵀ q_u + Q_xu k
/// V' = Q_xx + Kᵀ Q_uu K + Kᵀ Q_ux + Q_xu K
/// ```
///
/// If `Q_uu + ρ D` is not positive definite, the absolute eigenvalues of `L_uu` replace its
/// eigenvalues. Source of the recursion: Tassa, Erez and Todorov 2012,
/// doi:10.1109/IROS.2012.6386025, equations 10 and 11. The damping does not depend on the step: at a
/// step where a control saturates, B is small, but a large change of this control is not harmless.
pub(super) fn backward(
    expansion: &Expansion,
    u: &[f64],
    bounds: &Bounds,
    regularization: f64,
) -> Option<BackwardStep> {
    let steps = expansion.steps.len();
    let (mut value, mut value_hessian) = (expansion.gradient.clone(), expansion.hessian.clone());
    let n = value.len();
    let (mut all_changes, mut gains, mut model) =
        (Vec::with_capacity(steps), Vec::with_capacity(steps), [0.0; 2]);
    for (t, step) in expansion.steps.iter().enumerate().rev() {
        let f = &step.dynamics;
        let m = f.ncols() - n;
        let slope = &step.gradient + f.tr_mul(&value);
        let curvature = &step.hessian + f.tr_mul(&(&value_hessian * f));
        let by_u = slope.rows(n, m).into_owned();
        let (mut uu, ux) = (
            curvature.view((n, n), (m, m)).into_owned(),
            curvature.view((n, 0), (m, n)).into_owned(),
        );
        let (damping, changes) = (
            DMatrix::from_diagonal(&(&expansion.damping * regularization)),
            bounds.changes(&u[t * m..][..m]),
        );
        let program = BoxQp::solve(&(&uu + &damping), &by_u, &changes).or_else(|| {
            let lagrangian = step.hessian.view((n, n), (m, m)).into_owned();
            uu += absolute(&lagrangian) - lagrangian;
            BoxQp::solve(&(&uu + &damping), &by_u, &changes)
        })?;
        let gain = program.gains(&ux);
        let change = program.solution;
        let onward = &uu * &change;
        model[0] += change.dot(&by_u);
        model[1] += change.dot(&onward);
        value = slope.rows(0, n) + gain.tr_mul(&(onward + by_u)) + ux.tr_mul(&change);
        let cross = gain.tr_mul(&ux);
        let hessian = curvature.view((0, 0), (n, n))
            + gain.tr_mul(&(uu * &gain))
            + &cross
            + cross.transpose();
        value_hessian = (&hessian + hessian.transpose()) * 0.5;
        all_changes.push(change);
        gains.push(gain);
    }
    all_changes.reverse();
    gains.reverse();
    Some(BackwardStep { changes: all_changes, gains, model })
}

/// Returns the symmetric matrix with the eigenvectors of `matrix` and the absolute values of its
/// eigenvalues.
fn absolute(matrix: &DMatrix<f64>) -> DMatrix<f64> {
    let SymmetricEigen { eigenvectors, eigenvalues } = SymmetricEigen::new(matrix.clone());
    &eigenvectors * DMatrix::from_diagonal(&eigenvalues.abs()) * eigenvectors.transpose()
}
