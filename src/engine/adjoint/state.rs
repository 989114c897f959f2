//! [`Recursion`]: the state of the recursion.

use super::cost_gradient::CostGradient;
use super::exponents::Exponents;
use super::given::Given;
use super::measure::GrowthMeters;
use super::starts::StartGradients;
use crate::engine::pass::Pass;
use crate::engine::rollout::Rollout;
use crate::numbers::scalar::{Cotangent, CotangentPack, Float, LANES, Lane, Scalar};

/// State of the recursion for `K` flows.
#[derive(Debug)]
pub struct Recursion<F: Float, const K: usize> {
    /// λ, `[block][component]`.
    pub(super) lambda: Vec<CotangentPack<Lane<F>, K>>,
    /// `(∂S/∂x)ᵀ λ`, without the weights of the flows.
    pub(super) x_bar: Vec<CotangentPack<Lane<F>, K>>,
    /// h and μ, the cotangents of the policy's outputs, `[block][control, memory]`.
    pub(super) u_bar: Vec<CotangentPack<Lane<F>, K>>,
    /// Cost gradients of one block.
    pub(super) cost: CostGradient<Lane<F>>,
    pub(super) exponents: Exponents<F, K>,
    pub(super) growth: GrowthMeters<K>,
    /// Gradients with respect to initial states and parameters, if recorded.
    pub(super) starts: Option<StartGradients<F, K>>,
    /// Cotangents in place of those of the costs.
    pub(super) given: Option<Given<F>>,
}

impl<F: Float, const K: usize> Recursion<F, K> {
    pub(super) fn new(rollout: &Rollout<F>) -> Self {
        let (n, m, memory) = (rollout.state_dim, rollout.control_dim, rollout.memory_dim);
        let blocks = rollout.capacity().div_ceil(LANES);
        let columns = |len: usize| vec![CotangentPack([Lane::zero(); K]); len];
        Self {
            lambda: columns(blocks * n),
            x_bar: columns(blocks * n),
            u_bar: columns(blocks * (m + memory)),
            cost: CostGradient::new(n, m),
            exponents: Exponents::new(blocks),
            growth: GrowthMeters::new(rollout.capacity()),
            starts: None,
            given: None,
        }
    }

    /// Numbers of components of state and control.
    pub(super) fn dims(&self) -> [usize; 2] {
        [self.cost.x.len(), self.cost.u.len()]
    }

    /// Records the gradients with respect to initial states and parameters of up to `samples`
    /// samples.
    pub(super) fn keep_start_gradients(&mut self, samples: usize, param_dim: usize) {
        self.starts = Some(StartGradients::new(samples, self.cost.x.len(), param_dim));
        self.cost.p = vec![Lane::null(); param_dim];
    }

    /// Returns the [`stored_bytes`](Self::stored_bytes) for these numbers of state, control and
    /// memory components, and of parameters if their gradients are recorded.
    pub(super) fn bytes_of(
        [n, m, memory]: [usize; 3],
        params: Option<usize>,
        samples: usize,
    ) -> usize {
        let blocks = samples.div_ceil(LANES);
        blocks * (2 * n + m + memory) * size_of::<CotangentPack<Lane<F>, K>>()
            + CostGradient::<Lane<F>>::bytes_of(n, m)
            + Exponents::<F, K>::bytes_of(blocks)
            + GrowthMeters::<K>::bytes_of(samples)
            + params.map_or(0, |p| {
                StartGradients::<F, K>::bytes_of(samples, n, p) + p * size_of::<Lane<F>>()
            })
    }

    pub(super) fn stored_bytes(&self) -> usize {
        let columns =
            [&self.lambda, &self.x_bar, &self.u_bar].map(|columns| size_of_val(&columns[..]));
        let costs = CostGradient::<Lane<F>>::bytes_of(self.cost.x.len(), self.cost.u.len());
        let starts = self.starts.as_ref().map_or(0, StartGradients::stored_bytes)
            + size_of_val(&self.cost.p[..]);
        let given = self.given.as_ref().map_or(0, Given::stored_bytes);
        let others =
            [costs, self.exponents.stored_bytes(), self.growth.stored_bytes(), starts, given];
        columns.into_iter().chain(others).sum()
    }

    /// Evaluates the gradients of the running cost of one step and block.
    pub(super) fn evaluate_cost(&mut self, pass: &Pass<'_, F>, t: usize, block: usize) {
        if let Some(given) = &self.given {
            return given.write(t, block, &mut self.cost);
        }
        let (rollout, n) = (pass.rollout, pass.rollout.state_dim);
        self.cost.clear();
        let (cotangents, next_bar) = self.cost.requests();
        let next = &rollout.states_at(t + 1)[block * n..][..n];
        pass.closed.task.running_cost_gradient(
            rollout.inputs_of(t, block),
            next,
            cotangents,
            next_bar,
        );
    }

    /// Value and exponent of the gradient with respect to entry `i` of p, for policies with trained
    /// parameters.
    pub(super) fn by_param(&self, k: usize, sample: usize, i: usize) -> (F, i32) {
        self.starts.as_ref().expect("trained parameters have gradients").by_param(k, sample, i)
    }

    /// Growth of λ.
    pub(super) fn growth(&self) -> &GrowthMeters<K> {
        &self.growth
    }
}
