//! [`Affine`]: a map `z = W v + b` with its parameters in θ.

use crate::numbers::rng::Rng;
use crate::numbers::scalar::{Float, Real, Scalar};
use crate::numbers::zip::zip;
use crate::policy::Tensor;
use rand::RngExt;

/// Affine map whose parameters start at index `first` of `θ`.
#[derive(Clone, Copy)]
pub(super) struct Affine {
    pub(super) first: usize,
    pub(super) inputs: usize,
    pub(super) outputs: usize,
}

impl Affine {
    pub(super) fn end(self) -> usize {
        self.first + (self.inputs + 1) * self.outputs
    }

    /// The map whose parameters follow those of this one.
    pub(super) fn then(self, inputs: usize, outputs: usize) -> Self {
        Self { first: self.end(), inputs, outputs }
    }

    /// Row `i` of `Wᵀ`, the weights of input `i`. Row `inputs` is the bias.
    #[inline(always)]
    fn row<W>(self, theta: &[W], i: usize) -> &[W] {
        &theta[self.first + i * self.outputs..][..self.outputs]
    }

    /// Writes `z = W v + b`. Converts parameters by `splat`.
    #[inline(always)]
    pub(super) fn evaluate<'a, W: Copy, T: Scalar>(
        self,
        theta: &[W],
        splat: impl Fn(W) -> T,
        v: impl Iterator<Item = &'a T>,
        z: &mut [T],
    ) {
        for (z, &bias) in zip(z.iter_mut(), self.row(theta, self.inputs)) {
            *z = splat(bias);
        }
        for (i, &v) in v.enumerate() {
            for (z, &weight) in zip(z.iter_mut(), self.row(theta, i)) {
                *z += v * splat(weight);
            }
        }
    }

    /// Component `i` of `Wᵀ z_bar`.
    #[inline(always)]
    pub(super) fn input_bar<R: Real>(self, theta: &[R::Real], i: usize, z_bar: &[R]) -> R {
        zip(self.row(theta, i).iter(), z_bar)
            .fold(R::zero(), |sum, (&weight, &bar)| sum + R::splat(weight) * bar)
    }

    /// Adds `factor·v z_barᵀ` to the gradient with respect to `Wᵀ`, and `factor·z_bar` to the
    /// gradient with respect to the bias.
    pub(super) fn add_gradient<F: Float>(
        self,
        v: impl Iterator<Item = F>,
        z_bar: &[F],
        factor: F,
        theta_bar: &mut [F],
    ) {
        // Without outputs, there are no rows.
        let rows = theta_bar[self.first..self.end()].chunks_exact_mut(self.outputs.max(1));
        for (v, row) in v.chain([F::one()]).zip(rows) {
            let scaled = factor * v;
            for (sum, &bar) in zip(row.iter_mut(), z_bar) {
                *sum += scaled * bar;
            }
        }
    }

    /// Draws Glorot-uniform weights (Glorot and Bengio 2010) and sets the bias to 0.
    pub(super) fn init(self, rng: &mut Rng, theta: &mut [f64]) {
        let limit = (6.0 / (self.inputs + self.outputs) as f64).sqrt();
        let (weights, bias) =
            theta[self.first..self.end()].split_at_mut(self.inputs * self.outputs);
        weights.fill_with(|| rng.random_range(-limit..limit));
        bias.fill(0.0);
    }

    pub(super) fn tensors(self, name: &str) -> [Tensor; 2] {
        let bias = self.first + self.inputs * self.outputs;
        [
            Tensor {
                name: format!("{name}.kernel"),
                shape: vec![self.inputs, self.outputs],
                range: self.first..bias,
            },
            Tensor {
                name: format!("{name}.bias"),
                shape: vec![self.outputs],
                range: bias..self.end(),
            },
        ]
    }
}
