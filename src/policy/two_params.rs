//! Policies with few parameters, for plots of gradient fields over `θ`.

use super::{Action, Observed, Policy};
use crate::numbers::rng::Rng;
use crate::numbers::scalar::Scalar;

/// Policy `u = θ₁ x² + θ₂ x`, with `θ = [θ₁, θ₂]` and an observation of one component x.
///
/// Source: Figure 1 of "Stabilizing Backpropagation Through Time to Learn Complex Physics" (ICLR
/// 2024).
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Quadratic;

impl Policy for Quadratic {
    fn observation_dim(&self) -> usize {
        1
    }

    fn control_dim(&self) -> usize {
        1
    }

    fn param_count(&self) -> usize {
        2
    }

    /// Initializes all parameters to 0: the uncontrolled system.
    fn init(&self, _rng: &mut Rng, theta: &mut [f64]) {
        theta.fill(0.0);
    }

    fn act<T: Scalar>(
        &self,
        theta: &[T],
        Observed { y, .. }: Observed<'_, T>,
        Action { u, .. }: Action<'_, T>,
    ) {
        u[0] = (theta[0] * y[0] + theta[1]) * y[0];
    }
}

/// Open-loop control `u = θ`, equal at all steps; one parameter per control.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Constant {
    observation_dim: usize,
    control_dim: usize,
}

impl Constant {
    /// Creates an open-loop control for a task with these dimensions.
    pub fn new(observation_dim: usize, control_dim: usize) -> Self {
        Self { observation_dim, control_dim }
    }
}

impl Policy for Constant {
    fn observation_dim(&self) -> usize {
        self.observation_dim
    }

    fn control_dim(&self) -> usize {
        self.control_dim
    }

    fn param_count(&self) -> usize {
        self.control_dim
    }

    /// Initializes all parameters to 0: the uncontrolled system.
    fn init(&self, _rng: &mut Rng, theta: &mut [f64]) {
        theta.fill(0.0);
    }

    fn act<T: Scalar>(
        &self,
        theta: &[T],
        _observed: Observed<'_, T>,
        Action { u, .. }: Action<'_, T>,
    ) {
        u.copy_from_slice(theta);
    }
}
