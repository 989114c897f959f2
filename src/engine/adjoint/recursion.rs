//! [`Recursion::back`]: the loop of the adjoint recursion over the steps.
//!
//! [`adjoint`](super) states the equations. λ is the cotangent of the state x, h that of the
//! control u, and μ that of the memory m. S is the physics step, N the policy, y the observation, l
//! the running cost and φ the terminal cost. `K` flows share the loop, and a block holds eight
//! samples.
//!
//! `step_back` calls `reverse_step`, the physics of one step, for every block of samples. `policy` computes the Jacobian
//! products of the policy and the parameter gradient g. `exponents` and `restart` scale cotangents
//! of extreme size, and no others. `starts` sums the gradients with respect to initial states and
//! parameters p. `measure` records norms and growth.

use super::measure::record_norms;
use super::policy::PolicyAdjoint;
use super::restart::Place;
use super::state::Recursion;
use super::step_back::StepBack;
use crate::engine::divergence::{Divergence, Variable};
use crate::engine::flow::Flow;
use crate::engine::pass::Pass;
use crate::engine::rollout::find_non_finite;
use crate::numbers::scalar::{CotangentPack, Float, LANES, Lane, Real, Scalar};
use crate::numbers::zip::zip;
use std::ops::Range;

impl<F: Float, const K: usize> Recursion<F, K> {
    /// Starts the recursion: `λ ← scale ∂φ/∂x_T`, `μ ← 0`. `norms` has one row per flow, or no
    /// rows.
    pub(super) fn begin(&mut self, pass: &Pass<'_, F>, norms: &mut [Vec<f64>]) {
        let Pass { closed, rollout, scale, .. } = *pass;
        let n = rollout.state_dim;
        self.exponents.reset(scale);
        self.growth.reset();
        self.u_bar.fill(CotangentPack([Lane::zero(); K]));
        for (block, x) in rollout.states_at(rollout.horizon).chunks_exact(n).enumerate() {
            self.cost.clear();
            let p_bar = (!self.cost.p.is_empty()).then_some(&mut self.cost.p[..]);
            if self.given.is_none() {
                closed.task.terminal_cost_gradient(
                    x,
                    rollout.params_at(rollout.horizon - 1, block),
                    &mut self.cost.next,
                    p_bar,
                );
            }
            if let Some(starts) = &mut self.starts {
                starts.set_cost(block, &self.cost.p);
            }
            for (lambda, &x_bar) in zip(self.lambda[block * n..][..n].iter_mut(), &self.cost.next) {
                *lambda = CotangentPack([x_bar * Lane::splat(scale); K]);
            }
        }
        if let Some(starts) = &mut self.starts {
            starts.clear();
            starts.add_terms(rollout.samples, scale, &self.exponents);
        }
        record_norms(&self.lambda, &self.exponents, pass, rollout.horizon, norms);
    }

    /// Runs the recursion (see [`adjoint`](super)) backwards through `steps`, for all flows at
    /// once. `task` must be `pass.closed.task`.
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
            let at_t = flows.map(|flow| flow.at(t));
            // λ, h ← `reverse_step`, in each block of samples.
            let in_range = task.step_back(at_t, pass.rollout, t, self);
            if let Some(starts) = &mut self.starts {
                starts.add_terms(pass.rollout.samples, pass.scale, &self.exponents);
            }
            if !in_range {
                let rescaled =
                    self.exponents.rescale(flows, pass, &mut self.lambda, &mut self.u_bar);
                rescaled.map_err(|_| self.divergence(pass, flows, t))?;
                self.restart_small(pass, t, Place::BeforePolicy);
            }
            for (k, flow) in at_t.into_iter().enumerate() {
                policy.set_controls_bar(k, pass.rollout.columns(t), &self.u_bar, &self.exponents);
                // `Adjoint::back` makes the same choice for the whole unit, without weights per
                // step.
                if policy.through_inputs(flows[k]) {
                    // ȳ, m̄ ← (∂N/∂(y, m))ᵀ (h, μ)
                    policy.linearize_inputs(pass, k, t);
                }
                if flow.control != 0.0 {
                    // λ ← λ + control·(∂y/∂x)ᵀ ȳ
                    let (lambda, starts) = (&mut self.lambda, self.starts.as_mut());
                    policy.add_inputs_bar(k, flow, pass, t, lambda, starts);
                }
                // μ ← memory·m̄
                policy.set_memory_bar(k, flow, pass.rollout.columns(t), &mut self.u_bar);
            }
            self.after_step(pass, flows, at_t, t, norms);
            if !in_range {
                self.exponents.clear_shifts();
            }
        }
        Ok(())
    }

    /// Prepares step `t`: raises exponents too low for its cost gradients. If `pass.measured`,
    /// records ‖λ + ∂l/∂x_{t+1}‖².
    fn before_step(&mut self, pass: &Pass<'_, F>, t: usize) {
        let Pass { rollout, scale, measured, .. } = *pass;
        let low = self.exponents.any_low();
        if !measured && !low {
            return;
        }
        let n = rollout.state_dim;
        for block in 0..rollout.samples.div_ceil(LANES) {
            self.evaluate_cost(pass, t, block);
            let lambda = &mut self.lambda[block * n..][..n];
            let outputs = rollout.control_dim + rollout.memory_dim;
            let u_bar = &mut self.u_bar[block * outputs..][..outputs];
            if low {
                self.exponents.raise(block, scale, lambda, u_bar, &self.cost);
            }
            if measured {
                let samples = block * LANES..rollout.samples.min((block + 1) * LANES);
                self.growth.before(samples, lambda, &self.cost.next, &self.exponents.blocks[block]);
            }
        }
        self.exponents.update();
    }

    /// Measures growth and norms after step `t`. Cuts adjoints that have grown by more than `cut`.
    /// Adds the effect of p on the observation. After step 0, completes the gradients with respect
    /// to initial states and p.
    fn after_step(
        &mut self,
        pass: &Pass<'_, F>,
        flows: [Flow; K],
        at_t: [Flow; K],
        t: usize,
        norms: &mut [Vec<f64>],
    ) {
        let samples = pass.rollout.samples;
        if pass.measured {
            self.growth.after(pass.rollout, &self.lambda, &self.exponents, flows, t);
        }
        for (k, flow) in flows.into_iter().enumerate() {
            for sample in if flow.cut.is_some() { 0..samples } else { 0..0 } {
                if flow.cut.is_some_and(|decades| self.growth.reset_if_grown(k, sample, decades)) {
                    self.restart(pass, k, sample, t, Place::Cut);
                }
            }
            if let Some(starts) = &mut self.starts
                && at_t[k].control != 0.0
                && pass.closed.task.own_observation().is_some()
            {
                starts.add_observed(k, at_t[k].control, samples, &self.exponents);
            }
        }
        if self.exponents.any {
            self.restart_small(pass, t, Place::AfterPolicy);
        }
        record_norms(&self.lambda, &self.exponents, pass, t, norms);
        if let (0, Some(starts)) = (t, &mut self.starts) {
            starts.finish(&self.lambda, pass.rollout.samples, &self.exponents);
        }
    }

    /// Finds the first sample with a non-finite cotangent, and the first such flow of this sample.
    /// Cotangents of the state precede those of control and memory.
    #[cold]
    fn divergence(&self, pass: &Pass<'_, F>, flows: [Flow; K], step: usize) -> Divergence {
        let (task, rollout) = (pass.closed.task, pass.rollout);
        let find = |columns: &[CotangentPack<Lane<F>, K>], n: usize, k: usize| {
            find_non_finite(columns, n, rollout.samples, |c, lane| c.0[k].lane(lane))
        };
        let state = |k: usize| {
            find(&self.lambda, rollout.state_dim, k).map(|place| (k, Variable::State, place))
        };
        let outputs = rollout.control_dim + rollout.memory_dim;
        let output = |k: usize| {
            find(&self.u_bar, outputs, k).map(|(sample, i)| {
                match i.checked_sub(rollout.control_dim) {
                    None => (k, Variable::Control, (sample, i)),
                    Some(i) => (k, Variable::Memory, (sample, i)),
                }
            })
        };
        let all = (0..K).flat_map(|k| state(k).into_iter().chain(output(k)));
        let first = all.min_by_key(|&(.., (sample, _))| sample);
        let (k, variable, (sample, component)) =
            first.expect("`rescale` fails only for non-finite cotangents");
        let cause = rollout.diagnosis(task, step, sample);
        Divergence::Cotangent { flow: flows[k], variable, step, sample, component, cause }
    }
}
