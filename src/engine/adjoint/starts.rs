//! [`StartGradients`]: gradients with respect to initial states and parameters, per flow and
//! sample.

use super::exponents::Exponents;
use crate::dynamics::outline::One;
use crate::engine::gradient::Gradient;
use crate::engine::rollout::{Lane, WIDTH};
use crate::numbers::scalar::{Cotangent, CotangentPack, Float, Real};

/// Gradients with respect to `x_0` and p for `K` flows.
///
/// ```text
/// x̄_0 = λ after step 0
/// p̄   = ∂φ/∂p + Σ_t [(∂S/∂p)ᵀ λ + ∂l/∂p + control·(∂y/∂p)ᵀ ȳ]
/// ```
#[derive(Debug)]
pub(super) struct StartGradients<F: Float, const K: usize> {
    /// Gradients, `[sample][flow]`. Components of the initial state precede those of p.
    gradients: Vec<[Gradient<F>; K]>,
    /// Terms of one step, `[block][parameter]`.
    pub(super) terms: Vec<CotangentPack<Lane<F>, K>>,
    /// Terms of the observation of one step, `[flow][block][parameter]`.
    pub(super) observed: [Vec<One<Lane<F>>>; K],
    state_dim: usize,
    param_dim: usize,
}

impl<F: Float, const K: usize> StartGradients<F, K> {
    pub(super) fn new(samples: usize, state_dim: usize, param_dim: usize) -> Self {
        let params = samples.div_ceil(WIDTH) * param_dim;
        Self {
            gradients: (0..samples).map(|_| [(); K].map(|()| Gradient::zeros(state_dim + param_dim))).collect(),
            terms: vec![CotangentPack::null(); params],
            observed: [(); K].map(|()| vec![One::null(); params]),
            state_dim,
            param_dim,
        }
    }

    pub(super) fn bytes_of(samples: usize, state_dim: usize, param_dim: usize) -> usize {
        let gradients = size_of::<[Gradient<F>; K]>() + K * Gradient::<F>::bytes_of(state_dim + param_dim);
        let terms = size_of::<CotangentPack<Lane<F>, K>>() + K * size_of::<One<Lane<F>>>();
        samples * gradients + samples.div_ceil(WIDTH) * param_dim * terms
    }

    pub(super) fn stored_bytes(&self) -> usize {
        let gradients = self.gradients.iter().flatten().map(Gradient::stored_bytes).sum::<usize>();
        let observed = self.observed.iter().map(|observed| size_of_val(&observed[..])).sum::<usize>();
        gradients + size_of_val(&self.gradients[..]) + size_of_val(&self.terms[..]) + observed
    }

    pub(super) fn of(&self, k: usize, sample: usize) -> &Gradient<F> {
        &self.gradients[sample][k]
    }

    /// Sets all gradients to 0.
    pub(super) fn clear(&mut self) {
        self.gradients.iter_mut().flatten().for_each(Gradient::clear);
    }

    /// Terms of one block.
    pub(super) fn of_block(&mut self, block: usize) -> &mut [CotangentPack<Lane<F>, K>] {
        &mut self.terms[block * self.param_dim..][..self.param_dim]
    }

    /// Adds the terms of one step to the gradients with respect to p.
    pub(super) fn add_terms(&mut self, samples: usize, exponents: &Exponents<F, K>) {
        for (sample, gradients) in self.gradients[..samples].iter_mut().enumerate() {
            let terms = &self.terms[sample / WIDTH * self.param_dim..][..self.param_dim];
            for (k, gradient) in gradients.iter_mut().enumerate() {
                for (i, term) in terms.iter().enumerate() {
                    gradient.add_at(self.state_dim + i, term.0[k].lane(sample % WIDTH), exponents.of(k, sample));
                }
            }
        }
    }

    /// Adds the terms of the observation of flow `k`, times `weight`, to the gradients with respect
    /// to p.
    pub(super) fn add_observed(&mut self, k: usize, weight: f64, samples: usize, exponents: &Exponents<F, K>) {
        for (sample, gradients) in self.gradients[..samples].iter_mut().enumerate() {
            let terms = &self.observed[k][sample / WIDTH * self.param_dim..][..self.param_dim];
            for (i, CotangentPack([term])) in terms.iter().enumerate() {
                let part = (*term * weight).lane(sample % WIDTH);
                gradients[k].add_at(self.state_dim + i, part, exponents.of(k, sample));
            }
        }
    }

    /// Sets to 0 the terms of the observation of flow `k` in one lane of a block.
    pub(super) fn cut(&mut self, k: usize, block: usize, lane: usize) {
        for CotangentPack([term]) in &mut self.observed[k][block * self.param_dim..][..self.param_dim] {
            term.set_lane(lane, F::zero());
        }
    }

    /// Adds λ after step 0, and completes the gradients.
    pub(super) fn finish(&mut self, lambda: &[CotangentPack<Lane<F>, K>], samples: usize, exponents: &Exponents<F, K>) {
        for (sample, gradients) in self.gradients[..samples].iter_mut().enumerate() {
            let lambda = &lambda[sample / WIDTH * self.state_dim..][..self.state_dim];
            for (k, gradient) in gradients.iter_mut().enumerate() {
                for (i, bar) in lambda.iter().enumerate() {
                    gradient.add_at(i, bar.0[k].lane(sample % WIDTH), exponents.of(k, sample));
                }
                gradient.normalize();
            }
        }
    }
}
