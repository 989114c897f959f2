//! [`OpenLoop`]: a sequence of controls, for trajectory optimization.

use super::{Action, Observed, Policy, PolicyPass, PolicyRecord, Sizes, Tensor};
use crate::numbers::rng::Rng;
use crate::numbers::scalar::{Float, Scalar};

/// Sequence of controls `u_t = θ[t]`, independent of the observation; `θ` is `[step][control]`.
///
/// Training optimizes the sequence itself: direct single shooting. The controls do not depend on
/// the observation, so flow R equals M, and N equals S. [`optimize`](crate::optimize) contains a
/// method with second derivatives of the costs, for one initial state.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct OpenLoop {
    observation_dim: usize,
    control_dim: usize,
    horizon: usize,
}

impl OpenLoop {
    /// A sequence of controls for `horizon` steps, at least as many as the task has.
    pub fn new(observation_dim: usize, control_dim: usize, horizon: usize) -> Self {
        Self { observation_dim, control_dim, horizon }
    }

    /// Controls of step `t`.
    ///
    /// # Panics
    /// If the sequence is shorter than the rollout.
    fn controls<'a, T>(&self, theta: &'a [T], t: usize) -> &'a [T] {
        let Self { control_dim, horizon, .. } = *self;
        assert!(
            t < horizon,
            "the open-loop policy has controls for {horizon} steps, but the rollout has more"
        );
        &theta[t * control_dim..][..control_dim]
    }
}

impl Policy for OpenLoop {
    fn observation_dim(&self) -> usize {
        self.observation_dim
    }

    fn control_dim(&self) -> usize {
        self.control_dim
    }

    fn param_count(&self) -> usize {
        self.horizon * self.control_dim
    }

    /// Initializes all controls to 0.
    fn init(&self, _rng: &mut Rng, theta: &mut [f64]) {
        theta.fill(0.0);
    }

    fn act<T: Scalar>(
        &self,
        theta: &[T],
        Observed { t, .. }: Observed<'_, T>,
        Action { u, .. }: Action<'_, T>,
    ) {
        u.copy_from_slice(self.controls(theta, t));
    }

    fn tensors(&self) -> Vec<Tensor> {
        vec![Tensor {
            name: "controls".into(),
            shape: vec![self.horizon, self.control_dim],
            range: 0..self.param_count(),
        }]
    }

    fn sizes<F: Float>(&self, _columns: usize) -> Sizes {
        Sizes { packed: self.param_count(), tape: 0, tape_bar: 0, scratch: 0 }
    }

    fn forward<F: Float>(&self, pass: PolicyPass<F>, _tape: &mut [F], u: &mut [F]) {
        for (t, columns) in pass.each_step() {
            for c in columns.iter() {
                u[c * self.control_dim..][..self.control_dim]
                    .copy_from_slice(self.controls(pass.packed, t));
            }
        }
    }

    fn backward<F: Float>(
        &self,
        pass: PolicyPass<F>,
        _tape: &[F],
        _u_bar: &[F],
        _tape_bar: &mut [F],
        x_bar: Option<&mut [F]>,
    ) {
        let Some(x_bar) = x_bar else { return };
        for c in pass.at.iter() {
            x_bar[c * self.observation_dim..][..self.observation_dim].fill(F::zero());
        }
    }

    fn param_gradient<F: Float>(
        &self,
        pass: PolicyPass<F>,
        record: PolicyRecord<F>,
        _scratch: &mut [F],
        theta_bar: &mut [F],
    ) {
        for (t, columns) in pass.each_step() {
            for c in columns.iter() {
                let weight = record.weight.map_or(F::one(), |weight| weight[c]);
                for i in 0..self.control_dim {
                    theta_bar[t * self.control_dim + i] +=
                        weight * record.u_bar[c * self.control_dim + i];
                }
            }
        }
    }
}
