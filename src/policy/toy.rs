//! Policies of two parameters or so, whose vector fields can be drawn.

use super::Policy;
use crate::numbers::rng::Rng;
use crate::numbers::scalar::Scalar;

/// The policy of the paper's figure 1, `u = θ₁ x² + θ₂ x`, of one state component. `θ` is `[θ₁, θ₂]`.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Quadratic;

impl Policy for Quadratic {
    fn state_dim(&self) -> usize {
        1
    }

    fn control_dim(&self) -> usize {
        1
    }

    fn param_count(&self) -> usize {
        2
    }

    /// All zero: the uncontrolled system.
    fn init(&self, _rng: &mut Rng, theta: &mut [f64]) {
        theta.fill(0.0);
    }

    fn act<T: Scalar>(&self, theta: &[T], x: &[T], u: &mut [T]) {
        u[0] = (theta[0] * x[0] + theta[1]) * x[0];
    }
}

/// Open loop, `u = θ` whatever the state: as many parameters as controls.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Constant {
    state_dim: usize,
    control_dim: usize,
}

impl Constant {
    /// `u = θ`, for a system of so many states and controls.
    pub fn new(state_dim: usize, control_dim: usize) -> Self {
        Self { state_dim, control_dim }
    }
}

impl Policy for Constant {
    fn state_dim(&self) -> usize {
        self.state_dim
    }

    fn control_dim(&self) -> usize {
        self.control_dim
    }

    fn param_count(&self) -> usize {
        self.control_dim
    }

    /// All zero: the uncontrolled system.
    fn init(&self, _rng: &mut Rng, theta: &mut [f64]) {
        theta.fill(0.0);
    }

    fn act<T: Scalar>(&self, theta: &[T], _x: &[T], u: &mut [T]) {
        u.copy_from_slice(theta);
    }
}
