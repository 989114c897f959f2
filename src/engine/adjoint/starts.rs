//! [`StartGradients`]: gradients with respect to initial states and parameters, per flow and
//! sample.

use super::exponents::Exponents;
use crate::dynamics::outline::One;
use crate::engine::gradient::Gradient;
use crate::numbers::scalar::{Cotangent, CotangentPack, Float, LANES, Lane, Real};

/// Gradients with respect to `x_0` and p for `K` flows.
///
/// ```text
/// x̄_0 = λ after step 0
/// p̄   = ∂φ/∂p + Σ_t [(∂S/∂p)ᵀ λ + ∂l/∂p + control·(∂y/∂p)ᵀ ȳ]
/// ```
#[derive(Debug)]
pub(super) struct StartGradients<F: Float, const K: usize> {
    /// Complete gradients, `[sample][flow]`. Components of the initial state precede those of p.
    gradients: Vec<[Gradient<F>; K]>,
    /// Gradients with respect to p, `[sample][flow]`, with an exponent for each component.
    sums: Vec<[Gradient<F>; K]>,
    /// `(∂S/∂p)ᵀ λ` of one step, `[block][parameter]`.
    terms: Vec<CotangentPack<Lane<F>, K>>,
    /// `∂l/∂p` of one step, or `∂φ/∂p`, `[block][parameter]`.
    costs: Vec<Lane<F>>,
    /// Terms of the observation of one step, `[flow][block][parameter]`.
    pub(super) observed: [Vec<One<Lane<F>>>; K],
    state_dim: usize,
    param_dim: usize,
}

impl<F: Float, const K: usize> StartGradients<F, K> {
    pub(super) fn new(samples: usize, state_dim: usize, param_dim: usize) -> Self {
        let params = samples.div_ceil(LANES) * param_dim;
        let gradients =
            |len: usize| (0..samples).map(|_| [(); K].map(|()| Gradient::zeros(len))).collect();
        Self {
            gradients: gradients(state_dim + param_dim),
            sums: gradients(param_dim),
            costs: vec![Lane::null(); params],
            terms: vec![CotangentPack::null(); params],
            observed: [(); K].map(|()| vec![One::null(); params]),
            state_dim,
            param_dim,
        }
    }

    pub(super) fn bytes_of(samples: usize, state_dim: usize, param_dim: usize) -> usize {
        let gradients = 2 * size_of::<[Gradient<F>; K]>()
            + K * Gradient::<F>::bytes_of(state_dim + 2 * param_dim);
        let terms = size_of::<CotangentPack<Lane<F>, K>>()
            + size_of::<Lane<F>>()
            + K * size_of::<One<Lane<F>>>();
        samples * gradients + samples.div_ceil(LANES) * param_dim * terms
    }

    pub(super) fn stored_bytes(&self) -> usize {
        let gradients = self.gradients.iter().chain(&self.sums);
        let gradients = gradients
            .flatten()
            .map(|gradient| size_of_val(gradient) + gradient.stored_bytes())
            .sum::<usize>();
        let observed =
            self.observed.iter().map(|observed| size_of_val(&observed[..])).sum::<usize>();
        gradients + size_of_val(&self.terms[..]) + size_of_val(&self.costs[..]) + observed
    }

    pub(super) fn of(&self, k: usize, sample: usize) -> &Gradient<F> {
        &self.gradients[sample][k]
    }

    /// Value and exponent of the gradient with respect to entry `i` of p.
    pub(super) fn by_param(&self, k: usize, sample: usize, i: usize) -> (F, i32) {
        self.sums[sample][k].part(i)
    }

    /// Sets gradients, sums and terms to 0. Keeps the gradients of the cost and the observation.
    pub(super) fn clear(&mut self) {
        self.gradients.iter_mut().chain(&mut self.sums).flatten().for_each(Gradient::clear);
        self.terms.fill(CotangentPack::null());
    }

    /// Terms of one block.
    pub(super) fn of_block(&mut self, block: usize) -> &mut [CotangentPack<Lane<F>, K>] {
        &mut self.terms[block * self.param_dim..][..self.param_dim]
    }

    /// Stores the gradient of the cost of one block with respect to p.
    #[inline(always)]
    pub(super) fn set_cost(&mut self, block: usize, p_bar: &[Lane<F>]) {
        self.costs[block * self.param_dim..][..self.param_dim].copy_from_slice(p_bar);
    }

    /// Adds the terms of one step, and `scale` times the gradient of its cost, to the gradients
    /// with respect to p. The gradient of the cost has no exponent, because it may be far smaller
    /// than λ.
    pub(super) fn add_terms(&mut self, samples: usize, scale: F, exponents: &Exponents<F, K>) {
        for (sample, sums) in self.sums[..samples].iter_mut().enumerate() {
            let (first, lane) = (sample / LANES * self.param_dim, sample % LANES);
            for (k, sum) in sums.iter_mut().enumerate() {
                for i in 0..self.param_dim {
                    let (term, cost) = (
                        self.terms[first + i].0[k].lane(lane),
                        scale * self.costs[first + i].lane(lane),
                    );
                    match exponents.of(k, sample) {
                        0 => sum.add_at(i, term + cost, 0),
                        exponent => {
                            sum.add_at(i, term, exponent);
                            sum.add_at(i, cost, 0);
                        }
                    }
                }
            }
        }
    }

    /// Adds the terms of the observation of flow `k`, times `weight`, to the gradients with respect
    /// to p.
    pub(super) fn add_observed(
        &mut self,
        k: usize,
        weight: f64,
        samples: usize,
        exponents: &Exponents<F, K>,
    ) {
        for (sample, sums) in self.sums[..samples].iter_mut().enumerate() {
            let terms = &self.observed[k][sample / LANES * self.param_dim..][..self.param_dim];
            for (i, CotangentPack([term])) in terms.iter().enumerate() {
                let part = (*term * weight).lane(sample % LANES);
                sums[k].add_at(i, part, exponents.of(k, sample));
            }
        }
    }

    /// Sets to 0 the terms of the observation of flow `k` in one lane of a block.
    pub(super) fn cut(&mut self, k: usize, block: usize, lane: usize) {
        for CotangentPack([term]) in
            &mut self.observed[k][block * self.param_dim..][..self.param_dim]
        {
            term.set_lane(lane, F::zero());
        }
    }

    /// Adds λ after step 0, and completes the gradients.
    pub(super) fn finish(
        &mut self,
        lambda: &[CotangentPack<Lane<F>, K>],
        samples: usize,
        exponents: &Exponents<F, K>,
    ) {
        for (sample, gradients) in self.gradients[..samples].iter_mut().enumerate() {
            let lambda = &lambda[sample / LANES * self.state_dim..][..self.state_dim];
            for (k, gradient) in gradients.iter_mut().enumerate() {
                for (i, bar) in lambda.iter().enumerate() {
                    gradient.add_at(i, bar.0[k].lane(sample % LANES), exponents.of(k, sample));
                }
                for i in 0..self.param_dim {
                    let (value, exponent) = self.sums[sample][k].part(i);
                    gradient.add_at(self.state_dim + i, value, exponent);
                }
                gradient.normalize();
            }
        }
    }
}
