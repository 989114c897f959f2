//! [`Expansion`]: derivatives of dynamics and costs along a trajectory.
//!
//! Jacobians of the step are exact, by dual numbers. Hessians of the costs are exact, by nested
//! dual numbers. Of the second derivatives of the step, the expansion contains those with respect to
//! two controls ([`curvature`]), and omits the others (Gauss-Newton).

use super::OptimizeError;
use super::curvature;
use super::trajectory::{Problem, Trajectory};
use crate::dynamics::inputs::{Cotangents, Inputs};
use crate::numbers::forward_mode::{Chunk, jacobian};
use crate::numbers::scalar::Dual;
use nalgebra::{DMatrix, DVector};

/// Number of directions of each of the two nested dual numbers.
const CHUNK: usize = 4;

/// Nested dual number for second derivatives.
pub(super) type Second = Dual<Dual<f64, CHUNK>, CHUNK>;

/// Derivatives of one step `x' = S(z)` with respect to z = [x, u].
pub(super) struct StepExpansion {
    /// `∂S/∂z`.
    pub(super) dynamics: DMatrix<f64>,
    /// Gradient of the running cost with respect to z, including the path through the next state.
    pub(super) gradient: DVector<f64>,
    /// Hessian of the running cost with respect to z, including the path through the next state. Of
    /// `∂²S/∂z²`, only the block of the controls contributes: `λᵀ ∂²S/∂u²`, with the gradient λ of
    /// the loss with respect to the next state.
    pub(super) hessian: DMatrix<f64>,
    /// Gradient of the running cost with respect to the next state.
    by_next: DVector<f64>,
}

/// Derivatives along a trajectory.
pub(super) struct Expansion {
    pub(super) steps: Vec<StepExpansion>,
    /// Gradient of the terminal cost.
    pub(super) gradient: DVector<f64>,
    /// Hessian of the terminal cost.
    pub(super) hessian: DMatrix<f64>,
    /// Gradient of the loss with respect to the controls, `[step][control]`.
    pub(super) by_control: Vec<f64>,
    /// Weight of each control in the regularization: `c max_t ‖∂S/∂u_i‖²`, or c for a control without
    /// effect on the state. c is the largest absolute second derivative of the costs. If all are 0,
    /// c is the largest absolute first derivative of the costs.
    pub(super) damping: DVector<f64>,
}

impl Problem<'_> {
    /// Expands costs and dynamics along a trajectory.
    ///
    /// # Errors
    /// [`OptimizeError::Derivative`] if a derivative is not finite. [`OptimizeError::Stopped`] if
    /// the stop flag is set.
    pub(super) fn expand(&self, trajectory: &Trajectory) -> Result<Expansion, OptimizeError> {
        let (n, m, steps) = (self.n, self.m, self.model.horizon());
        let not_finite = |step| OptimizeError::Derivative { step };
        let expanded = (0..steps).map(|t| {
            self.check_stop()?;
            let step = self.expand_step(trajectory, t);
            let finite =
                [step.dynamics.as_slice(), step.gradient.as_slice(), step.hessian.as_slice()];
            if all_finite(finite) { Ok(step) } else { Err(not_finite(Some(t))) }
        });
        let mut expanded = expanded.collect::<Result<Vec<_>, _>>()?;
        let last = &trajectory.x[steps * n..];
        let mut gradient = DVector::zeros(n);
        self.model.terminal_cost_gradient(last, self.p, gradient.as_mut_slice());
        let p = constants(self.p);
        let hessian = hessian(last, |x| self.model.terminal_cost_by_duals(x, &p));
        if !all_finite([gradient.as_slice(), hessian.as_slice()]) {
            return Err(not_finite(None));
        }
        let largest = |of_step: fn(&StepExpansion) -> f64, terminal: f64| {
            expanded.iter().map(of_step).fold(terminal, f64::max)
        };
        let second = largest(|step| step.hessian.amax(), hessian.amax());
        let curvature = if second > 0.0 {
            second
        } else {
            largest(|step| step.gradient.amax(), gradient.amax())
        };
        let size = |i: usize| {
            expanded
                .iter()
                .map(|step| step.dynamics.column(n + i).norm_squared())
                .fold(0.0, f64::max)
        };
        let sizes = (0..m).map(size).map(|size| curvature * if size > 0.0 { size } else { 1.0 });
        let damping = DVector::from_vec(sizes.collect());
        let by_control = self.add_adjoint(trajectory, &mut expanded, gradient.clone())?;
        Ok(Expansion { steps: expanded, gradient, hessian, by_control, damping })
    }

    /// Returns the gradient with respect to the controls, by the adjoint recursion, and adds
    /// `λᵀ ∂²S/∂u²` to the Hessians of the steps.
    ///
    /// # Errors
    /// [`OptimizeError::Derivative`] with the step whose gradient with respect to state or controls is
    /// not finite. [`OptimizeError::Stopped`] if the stop flag is set.
    fn add_adjoint(
        &self,
        trajectory: &Trajectory,
        steps: &mut [StepExpansion],
        terminal: DVector<f64>,
    ) -> Result<Vec<f64>, OptimizeError> {
        let Self { n, m, .. } = *self;
        let scales = curvature::scales(&trajectory.u, m);
        let (mut adjoint, mut by_control) = (terminal, vec![0.0; steps.len() * m]);
        for (t, step) in steps.iter_mut().enumerate().rev() {
            let both = &step.gradient + step.dynamics.tr_mul(&adjoint);
            if !all_finite([both.as_slice()]) {
                return Err(OptimizeError::Derivative { step: Some(t) });
            }
            let onward = &step.by_next + adjoint;
            let mut block = step.hessian.view_mut((n, n), (m, m));
            block += self.control_curvature(trajectory, t, &step.dynamics, &onward, &scales)?;
            by_control[t * m..][..m].copy_from_slice(&both.as_slice()[n..]);
            adjoint = both.rows(0, n).into_owned();
        }
        Ok(by_control)
    }

    /// Calls `visit(i, column)` with the derivatives of the next state with respect to those
    /// components of z = [x, u] in `wrt`.
    pub(super) fn step_jacobian(
        &self,
        Inputs { x, u, p, t }: Inputs<'_, f64>,
        wrt: std::ops::Range<usize>,
        visit: impl FnMut(usize, &[f64]),
    ) {
        let Self { model, n, m, .. } = *self;
        let step = |all: &[Chunk<f64>], next: &mut [Chunk<f64>]| {
            model.step_by_duals(
                Inputs { x: &all[..n], u: &all[n..n + m], p: &all[n + m..], t },
                next,
            );
        };
        jacobian(&[x, u, p].concat(), wrt, n, step, visit);
    }

    fn expand_step(&self, trajectory: &Trajectory, t: usize) -> StepExpansion {
        let Self { model, p, n, m, .. } = *self;
        let inputs =
            Inputs { x: &trajectory.x[t * n..][..n], u: &trajectory.u[t * m..][..m], p, t };
        let next = &trajectory.x[(t + 1) * n..][..n];
        let mut dynamics = DMatrix::zeros(n, n + m);
        self.step_jacobian(inputs, 0..n + m, |i, column| {
            dynamics.column_mut(i).copy_from_slice(column)
        });
        let (mut gradient, mut next_bar) = (DVector::zeros(n + m), DVector::zeros(n));
        let (x_bar, u_bar) = gradient.as_mut_slice().split_at_mut(n);
        model.running_cost_gradient(
            inputs,
            next,
            Cotangents::of(x_bar, u_bar),
            next_bar.as_mut_slice(),
        );
        gradient += dynamics.tr_mul(&next_bar);
        let second_p = constants(p);
        let of_cost = hessian(&[inputs.x, inputs.u, next].concat(), |all| {
            let inputs = Inputs { x: &all[..n], u: &all[n..n + m], p: &second_p, t };
            model.running_cost_by_duals(inputs, &all[n + m..])
        });
        // Chain rule: z ↦ (z, S(z)) has the Jacobian [I; ∂S/∂z].
        let (z, onward) = (0..n + m, n + m..n + m + n);
        let cross = of_cost.view_range(z.clone(), onward.clone()) * &dynamics;
        let through = dynamics.tr_mul(&of_cost.view_range(onward.clone(), onward)) * &dynamics;
        let hessian = of_cost.view_range(z.clone(), z) + &cross + cross.transpose() + through;
        StepExpansion { dynamics, gradient, hessian, by_next: next_bar }
    }
}

/// Returns the Hessian of `f` at `z`, by nested dual numbers.
fn hessian(z: &[f64], f: impl Fn(&[Second]) -> Second) -> DMatrix<f64> {
    let len = z.len();
    let mut hessian = DMatrix::zeros(len, len);
    let mut inputs = constants(z);
    let in_chunk = |first: usize, i: usize| (first..first + CHUNK).contains(&i).then(|| i - first);
    for row in (0..len).step_by(CHUNK) {
        for column in (row..len).step_by(CHUNK) {
            for (i, (input, &z)) in inputs.iter_mut().zip(z).enumerate() {
                let mut inner = Dual::constant(z);
                in_chunk(column, i).into_iter().for_each(|k| inner.tangents[k] = 1.0);
                *input = Dual::constant(inner);
                in_chunk(row, i).into_iter().for_each(|k| input.tangents[k] = Dual::constant(1.0));
            }
            let value = f(&inputs);
            for i in row..len.min(row + CHUNK) {
                for j in column..len.min(column + CHUNK) {
                    let entry = value.tangents[i - row].tangents[j - column];
                    (hessian[(i, j)], hessian[(j, i)]) = (entry, entry);
                }
            }
        }
    }
    hessian
}

fn constants(values: &[f64]) -> Vec<Second> {
    values.iter().map(|&value| Dual::constant(Dual::constant(value))).collect()
}

fn all_finite<const N: usize>(lists: [&[f64]; N]) -> bool {
    lists.into_iter().flatten().all(|number| number.is_finite())
}
