//! [`Linear`]: linear or affine feedback, `u = K y + k`.

use super::{Action, Observed, Policy, PolicyPass, PolicyRecord, Tensor};
use crate::numbers::rng::Rng;
use crate::numbers::scalar::{Float, Scalar};
use crate::numbers::zip::zip;

/// Linear feedback of the observation y, `u = K y`, or affine with a bias, `u = K y + k`.
///
/// `θ` holds `K` (control_dim × observation_dim, row-major), then `k`.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Linear {
    observation_dim: usize,
    control_dim: usize,
    bias: bool,
}

impl Linear {
    /// Linear feedback `u = K y`.
    pub fn new(observation_dim: usize, control_dim: usize) -> Self {
        Self { observation_dim, control_dim, bias: false }
    }

    /// Affine feedback `u = K y + k`.
    pub fn with_bias(observation_dim: usize, control_dim: usize) -> Self {
        Self { observation_dim, control_dim, bias: true }
    }
}

impl Policy for Linear {
    fn observation_dim(&self) -> usize {
        self.observation_dim
    }

    fn control_dim(&self) -> usize {
        self.control_dim
    }

    fn param_count(&self) -> usize {
        self.control_dim * (self.observation_dim + usize::from(self.bias))
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
        let (gain, bias) = theta.split_at(self.control_dim * self.observation_dim);
        for (i, u) in u.iter_mut().enumerate() {
            *u = if self.bias { bias[i] } else { T::zero() };
            for (&k, &x) in zip(gain[i * y.len()..][..y.len()].iter(), y) {
                *u += k * x;
            }
        }
    }

    fn backward<F: Float>(
        &self,
        pass: PolicyPass<F>,
        _tape: &[F],
        u_bar: &[F],
        _tape_bar: &mut [F],
        x_bar: Option<&mut [F]>,
    ) {
        let (n, m) = (self.observation_dim, self.control_dim);
        let Some(x_bar) = x_bar else { return };
        for c in pass.at.iter() {
            let x_bar = &mut x_bar[c * n..][..n];
            x_bar.fill(F::zero());
            for (i, &u_bar) in u_bar[c * m..][..m].iter().enumerate() {
                add_scaled(x_bar, &pass.packed[i * n..][..n], u_bar);
            }
        }
    }

    fn param_gradient<F: Float>(
        &self,
        pass: PolicyPass<F>,
        record: PolicyRecord<F>,
        _scratch: &mut [F],
        theta_bar: &mut [F],
    ) {
        let (n, m) = (self.observation_dim, self.control_dim);
        let (gain_bar, bias_bar) = theta_bar.split_at_mut(m * n);
        for c in pass.at.iter() {
            let weight = record.weight.map_or(F::one(), |w| w[c]);
            for (i, &u_bar) in record.u_bar[c * m..][..m].iter().enumerate() {
                add_scaled(&mut gain_bar[i * n..][..n], &pass.x[c * n..][..n], weight * u_bar);
                if self.bias {
                    bias_bar[i] += weight * u_bar;
                }
            }
        }
    }

    fn tensors(&self) -> Vec<Tensor> {
        let gain = self.control_dim * self.observation_dim;
        let mut tensors = vec![Tensor {
            name: "gain".into(),
            shape: vec![self.control_dim, self.observation_dim],
            range: 0..gain,
        }];
        if self.bias {
            tensors.push(Tensor {
                name: "bias".into(),
                shape: vec![self.control_dim],
                range: gain..self.param_count(),
            });
        }
        tensors
    }
}

/// `y += factor x`.
fn add_scaled<F: Float>(y: &mut [F], x: &[F], factor: F) {
    for (y, &x) in zip(y.iter_mut(), x) {
        *y += factor * x;
    }
}
