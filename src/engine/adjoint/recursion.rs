//! The adjoint recursion: [`reverse_step`] for the physics, [`Recursion::back`] for the loop.
//!
//! [`adjoint`](super) states the equations and defines λ and h. `exponents` scales only cotangents
//! of extreme size. `step_back` traverses the samples. `policy` computes the Jacobian products of
//! the policy. `measure` records norms and growth.

use super::exponents::Exponents;
use super::measure::{GrowthMeters, record_norms};
use super::step_back::StepBack;
use super::{Flow, Pass, PolicyAdjoint};
use crate::dynamics::system::System;
use crate::dynamics::task::Task;
use crate::engine::divergence::{Divergence, Variable};
use crate::engine::rollout::{Lane, Rollout, WIDTH, find_non_finite};
use crate::numbers::scalar::{CotangentPack, Float, Real, Scalar};
use crate::numbers::zip::zip;
use std::ops::Range;

/// Inputs and outputs of one step of the recursion, for one block of samples or one sample.
pub(super) struct Step<'a, R, const K: usize> {
    /// `x_t`, `x_{t+1}` and `u_t`.
    pub(super) x: &'a [R],
    pub(super) next: &'a [R],
    pub(super) u: &'a [R],
    /// λ, read and overwritten.
    pub(super) lambda: &'a mut [CotangentPack<R, K>],
    /// `(∂S/∂x)ᵀ λ`, written.
    pub(super) x_bar: &'a mut [CotangentPack<R, K>],
    /// h, written.
    pub(super) u_bar: &'a mut [CotangentPack<R, K>],
    /// `∂l/∂x` and `∂l/∂u`, written.
    pub(super) cost_x: &'a mut [R],
    pub(super) cost_u: &'a mut [R],
    /// Factor of the cost gradients; see [`Exponents`].
    pub(super) inject: CotangentPack<R, K>,
}

/// Performs one step of the recursion without the policy. Returns Σ|λ| + Σ|h| per flow.
///
/// ```text
/// λ ← λ + ∂l/∂x(x_{t+1}, u_t)
/// h ← (∂S/∂u)ᵀ λ + ∂l/∂u(x_{t+1}, u_t)
/// λ ← physics·(∂S/∂x)ᵀ λ
/// ```
#[inline(always)]
pub(super) fn reverse_step<T: Task, R: Real, const K: usize>(
    task: &T,
    flows: [Flow; K],
    step: Step<'_, R, K>,
) -> CotangentPack<R, K> {
    let Step { x, next, u, lambda, x_bar, u_bar, cost_x, cost_u, inject } = step;
    let system = task.system();
    let mut size = CotangentPack([R::zero(); K]);

    task.stage_cost_gradient(next, u, cost_x, cost_u);
    for (lambda, &cost) in zip(lambda.iter_mut(), &*cost_x) {
        *lambda += inject * cost;
    }

    // Two flows without a physics path are rare: their special case is not compiled.
    if K > 1 || flows.iter().any(|flow| flow.physics) {
        system.vjp(x, u, lambda, x_bar, u_bar);
    } else {
        system.vjp_control(x, u, lambda, u_bar);
    }
    for (u_bar, &cost) in zip(u_bar.iter_mut(), &*cost_u) {
        *u_bar += inject * cost;
        size += u_bar.abs();
    }

    for (lambda, &x_bar) in zip(lambda.iter_mut(), &*x_bar) {
        for (k, flow) in flows.iter().enumerate() {
            lambda.0[k] = if flow.physics { x_bar.0[k] } else { R::zero() };
        }
        size += lambda.abs();
    }
    size
}

/// State of the recursion for `K` flows.
#[derive(Debug)]
pub struct Recursion<F: Float, const K: usize> {
    /// λ, `[block][component]`.
    pub(super) lambda: Vec<CotangentPack<Lane<F>, K>>,
    /// `(∂S/∂x)ᵀ λ`, before the flows select their paths.
    pub(super) x_bar: Vec<CotangentPack<Lane<F>, K>>,
    /// h, `[block][component]`.
    pub(super) u_bar: Vec<CotangentPack<Lane<F>, K>>,
    /// Cost gradients of one block.
    pub(super) cost_x: Vec<Lane<F>>,
    pub(super) cost_u: Vec<Lane<F>>,
    pub(super) exponents: Exponents<F, K>,
    growth: GrowthMeters<K>,
}

impl<F: Float, const K: usize> Recursion<F, K> {
    pub(super) fn new(rollout: &Rollout<F>) -> Self {
        let (n, m) = (rollout.state_dim, rollout.control_dim);
        let blocks = rollout.capacity().div_ceil(WIDTH);
        let columns = |len: usize| vec![CotangentPack([Lane::zero(); K]); len];
        let lanes = |len: usize| vec![Lane::zero(); len];
        Self {
            lambda: columns(blocks * n),
            x_bar: columns(blocks * n),
            u_bar: columns(blocks * m),
            cost_x: lanes(n),
            cost_u: lanes(m),
            exponents: Exponents::new(blocks),
            growth: GrowthMeters::new(rollout.capacity()),
        }
    }

    /// Returns the [`stored_bytes`](Self::stored_bytes) for `n` state and `m` control components.
    pub(super) fn bytes_of(n: usize, m: usize, samples: usize) -> usize {
        let blocks = samples.div_ceil(WIDTH);
        blocks * (2 * n + m) * size_of::<CotangentPack<Lane<F>, K>>()
            + (n + m) * size_of::<Lane<F>>()
            + Exponents::<F, K>::bytes_of(blocks)
            + GrowthMeters::<K>::bytes_of(samples)
    }

    pub(super) fn stored_bytes(&self) -> usize {
        let columns = [&self.lambda, &self.x_bar, &self.u_bar].map(|columns| size_of_val(&columns[..]));
        let costs = [&self.cost_x, &self.cost_u].map(|costs| size_of_val(&costs[..]));
        let others = [self.exponents.stored_bytes(), self.growth.stored_bytes()];
        columns.into_iter().chain(costs).chain(others).sum()
    }

    /// Starts the recursion: `λ ← scale ∂φ/∂x_T`. `norms` has one row per flow, or none.
    pub(super) fn begin(&mut self, pass: &Pass<'_, F>, norms: &mut [Vec<f64>]) {
        let Pass { task, rollout, scale, .. } = *pass;
        let n = rollout.state_dim;
        self.exponents.reset(scale);
        self.growth.reset();
        for (lambda, x) in zip(self.lambda.chunks_exact_mut(n), rollout.states_at(rollout.horizon).chunks_exact(n)) {
            task.terminal_cost_gradient(x, &mut self.cost_x);
            for (lambda, &x_bar) in zip(lambda.iter_mut(), &self.cost_x) {
                *lambda = CotangentPack([x_bar * Lane::splat(scale); K]);
            }
        }
        record_norms(&self.lambda, &self.exponents, pass, rollout.horizon, norms);
    }

    /// Runs the recursion (see [`adjoint`](super)) backwards through `steps`, for all flows at
    /// once. `task` must be `pass.task`.
    pub(super) fn back(
        &mut self,
        pass: &Pass<'_, F>,
        task: &dyn StepBack<F, K>,
        flows: [Flow; K],
        steps: Range<usize>,
        policy: &mut PolicyAdjoint<F>,
        norms: &mut [Vec<f64>],
    ) -> Result<(), Divergence> {
        for t in steps.rev() {
            self.before_step(pass, t);
            // λ, h ← `reverse_step`, in each block of samples.
            let in_range = task.step_back(flows, pass.rollout, t, self);
            if !in_range {
                let rescaled = self.exponents.rescale(flows, pass, &mut self.lambda, &mut self.u_bar);
                rescaled.map_err(|_| self.divergence(pass, flows, t))?;
            }
            for (k, flow) in flows.into_iter().enumerate() {
                policy.set_controls_bar(k, pass.rollout.columns(t), &self.u_bar, &self.exponents);
                if flow.control {
                    // λ ← λ + (∂N/∂x)ᵀ h
                    policy.linearize_inputs(pass, k, t);
                    policy.add_inputs_bar(k, pass.rollout, t, &mut self.lambda);
                }
            }
            self.after_step(pass, t, norms);
        }
        Ok(())
    }

    /// Prepares step `t`: raises exponents too low for its cost gradients, and measures growth.
    fn before_step(&mut self, pass: &Pass<'_, F>, t: usize) {
        let Pass { task, rollout, scale, measured, .. } = *pass;
        if !measured && !self.exponents.any_low() {
            return;
        }
        let (n, m) = (rollout.state_dim, rollout.control_dim);
        for block in 0..rollout.samples.div_ceil(WIDTH) {
            let (next, u) = (&rollout.states_at(t + 1)[block * n..][..n], &rollout.controls_at(t)[block * m..][..m]);
            task.stage_cost_gradient(next, u, &mut self.cost_x, &mut self.cost_u);
            let lambda = &mut self.lambda[block * n..][..n];
            self.exponents.raise(block, scale, lambda, [&self.cost_x, &self.cost_u]);
            if measured {
                let samples = block * WIDTH..rollout.samples.min((block + 1) * WIDTH);
                self.growth.before(samples, lambda, &self.cost_x, &self.exponents.blocks[block]);
            }
        }
        self.exponents.update_low();
    }

    /// Measures growth and norms after step `t`.
    fn after_step(&mut self, pass: &Pass<'_, F>, t: usize, norms: &mut [Vec<f64>]) {
        if pass.measured {
            self.growth.after(pass.rollout, &self.lambda, &self.exponents);
        }
        record_norms(&self.lambda, &self.exponents, pass, t, norms);
    }

    /// Returns the growth of the cotangents.
    pub(super) fn growth(&self) -> &GrowthMeters<K> {
        &self.growth
    }

    /// Finds the first flow, and its first sample, with a non-finite state or control cotangent.
    #[cold]
    fn divergence(&self, pass: &Pass<'_, F>, flows: [Flow; K], step: usize) -> Divergence {
        let Pass { task, rollout, .. } = *pass;
        let find = |columns: &[CotangentPack<Lane<F>, K>], n: usize, k: usize| {
            find_non_finite(columns, n, rollout.samples, |c, lane| c.0[k].lane(lane))
        };
        let state = |k: usize| find(&self.lambda, rollout.state_dim, k).map(|place| (k, Variable::State, place));
        let control = |k: usize| find(&self.u_bar, rollout.control_dim, k).map(|place| (k, Variable::Control, place));
        let first = (0..K).find_map(|k| state(k).or_else(|| control(k)));
        let (k, variable, (sample, component)) = first.expect("the probe found a non-finite value");
        let of = |lanes: &[Lane<F>], n: usize| -> Vec<F> {
            lanes[sample / WIDTH * n..][..n].iter().map(|number| number.lane(sample % WIDTH)).collect()
        };
        let (x, u) = (of(rollout.states_at(step), rollout.state_dim), of(rollout.controls_at(step), rollout.control_dim));
        Divergence::Cotangent { flow: flows[k], variable, step, sample, component, cause: task.diagnose(&x, &u) }
    }
}
