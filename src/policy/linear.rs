//! A linear policy, `u = K x + k`.

use super::{Policy, Tensor};
use crate::rng::Rng;
use crate::scalar::Scalar;

/// `u = K x`, or `u = K x + k` with a bias. `θ` is `K` row-major (control_dim × state_dim), then `k`.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Linear {
    state_dim: usize,
    control_dim: usize,
    bias: bool,
}

impl Linear {
    /// `u = K x`.
    pub fn new(state_dim: usize, control_dim: usize) -> Self {
        Self { state_dim, control_dim, bias: false }
    }

    /// `u = K x + k`.
    pub fn with_bias(state_dim: usize, control_dim: usize) -> Self {
        Self { state_dim, control_dim, bias: true }
    }
}

impl Policy for Linear {
    fn state_dim(&self) -> usize {
        self.state_dim
    }

    fn control_dim(&self) -> usize {
        self.control_dim
    }

    fn param_count(&self) -> usize {
        self.control_dim * (self.state_dim + usize::from(self.bias))
    }

    /// All zero: the uncontrolled system.
    fn init(&self, _rng: &mut Rng, theta: &mut [f64]) {
        theta.fill(0.0);
    }

    fn act<T: Scalar>(&self, theta: &[T], x: &[T], u: &mut [T]) {
        let (gain, bias) = theta.split_at(self.control_dim * self.state_dim);
        for (i, (u, row)) in u.iter_mut().zip(gain.chunks_exact(self.state_dim)).enumerate() {
            *u = if self.bias { bias[i] } else { T::zero() };
            for (&k, &x) in row.iter().zip(x) {
                *u += k * x;
            }
        }
    }

    fn tensors(&self) -> Vec<Tensor> {
        let gain = self.control_dim * self.state_dim;
        let mut tensors = vec![Tensor { name: "gain".into(), shape: vec![self.control_dim, self.state_dim], range: 0..gain }];
        if self.bias {
            tensors.push(Tensor { name: "bias".into(), shape: vec![self.control_dim], range: gain..self.param_count() });
        }
        tensors
    }
}
