//! The adjoint recursion: [`reverse_step`] for the physics, [`Recursion::back`] for the loop.
//!
//! [`adjoint`](super) states the equations. λ is the cotangent of the state x, h that of the
//! control u, and μ that of the memory m. S is the physics step, N the policy, y the observation, l
//! the running cost and φ the terminal cost. `K` flows share the loop, and a block holds eight
//! samples.
//!
//! `step_back` calls [`reverse_step`] for every block of samples. `policy` computes the Jacobian
//! products of the policy and the parameter gradient g. `exponents` and `restart` scale cotangents
//! of extreme size, and no others. `starts` sums the gradients with respect to initial states and
//! parameters p. `measure` records norms and growth.

use super::exponents::Exponents;
use super::given::Given;
use super::measure::{GrowthMeters, record_norms};
use super::policy::PolicyAdjoint;
use super::restart::Place;
use super::starts::StartGradients;
use super::step_back::StepBack;
use crate::dynamics::inputs::{Cotangents, Inputs};
use crate::dynamics::system::System;
use crate::dynamics::task::Task;
use crate::engine::divergence::{Divergence, Variable};
use crate::engine::flow::Flow;
use crate::engine::pass::Pass;
use crate::engine::rollout::{Rollout, find_non_finite};
use crate::numbers::scalar::{Cotangent, CotangentPack, Float, LANES, Lane, Real, Scalar};
use crate::numbers::zip::zip;
use std::ops::Range;

/// Inputs and outputs of one step of the recursion, for one block of samples.
pub(super) struct Step<'a, R, const K: usize> {
    /// Inputs `x_t`, `u_t`, `p`, `t`.
    pub(super) inputs: Inputs<'a, R>,
    /// Next state `x_{t+1}`.
    pub(super) next: &'a [R],
    /// λ, read and overwritten.
    pub(super) lambda: &'a mut [CotangentPack<R, K>],
    /// `(∂S/∂x)ᵀ λ`, written unless the only flow has no path through the physics.
    pub(super) x_bar: &'a mut [CotangentPack<R, K>],
    /// h, written.
    pub(super) u_bar: &'a mut [CotangentPack<R, K>],
    /// `(∂S/∂p)ᵀ λ`, written if requested.
    pub(super) p_bar: Option<&'a mut [CotangentPack<R, K>]>,
    /// μ, the cotangent of the memory after the step.
    pub(super) memory_bar: &'a [CotangentPack<R, K>],
    /// Gradients of the running cost, written unless given.
    pub(super) cost: &'a mut CostGradient<R>,
    /// True if `cost` is given.
    pub(super) is_given: bool,
    /// Factor of the cost gradients; see [`Exponents`].
    pub(super) inject: CotangentPack<R, K>,
}

/// Gradients of the running cost of one step, for one block of samples. Before the first step,
/// `next` and `p` hold the gradient of the terminal cost.
#[derive(Debug)]
pub(super) struct CostGradient<R> {
    /// `∂l/∂x_{t+1}`.
    pub(super) next: Vec<R>,
    /// `∂l/∂x_t`.
    pub(super) x: Vec<R>,
    /// `∂l/∂u_t`.
    pub(super) u: Vec<R>,
    /// `∂l/∂p`. Empty if not requested.
    pub(super) p: Vec<R>,
}

impl<R: Real> CostGradient<R> {
    fn new(n: usize, m: usize) -> Self {
        let nulls = |len: usize| vec![R::null(); len];
        Self { next: nulls(n), x: nulls(n), u: nulls(m), p: Vec::new() }
    }

    fn bytes_of(n: usize, m: usize) -> usize {
        (2 * n + m) * size_of::<R>()
    }

    /// All gradients, concatenated.
    pub(super) fn values(&self) -> impl Iterator<Item = &R> {
        self.next.iter().chain(&self.x).chain(&self.u).chain(&self.p)
    }

    /// Sets all entries to the initial value of a sum.
    #[inline(always)]
    fn clear(&mut self) {
        for values in [&mut self.next, &mut self.x, &mut self.u, &mut self.p] {
            clear(values);
        }
    }

    /// Cotangents to which [`Task::running_cost_gradient`] adds.
    #[inline(always)]
    fn requests(&mut self) -> (Cotangents<'_, R>, &mut [R]) {
        let p = (!self.p.is_empty()).then_some(&mut self.p[..]);
        (Cotangents { x: Some(&mut self.x), u: Some(&mut self.u), p }, &mut self.next)
    }
}

/// Sets all cotangents to the initial value of a sum. Inlined, unlike `fill`.
#[inline(always)]
fn clear<R, C: Cotangent<R>>(cotangents: &mut [C]) {
    for bar in cotangents {
        *bar = C::null();
    }
}

/// Performs one step of the recursion without the policy. Returns Σ|λ| + Σ|h| + Σ|μ| per flow and
/// sample.
///
/// ```text
/// λ ← λ + ∂l/∂x_{t+1}
/// h ← (∂S/∂u)ᵀ λ + ∂l/∂u_t
/// p̄ ← (∂S/∂p)ᵀ λ                        if requested
/// λ ← physics·(∂S/∂x)ᵀ λ + ∂l/∂x_t
/// ```
#[inline(always)]
pub(super) fn reverse_step<T: Task, R: Real, const K: usize>(
    task: &T,
    flows: [Flow; K],
    step: Step<'_, R, K>,
) -> CotangentPack<R, K> {
    let Step { inputs, next, lambda, x_bar, u_bar, mut p_bar, memory_bar, cost, is_given, inject } =
        step;
    let mut size = CotangentPack([R::zero(); K]);

    if !is_given {
        cost.clear();
        let (cotangents, next_bar) = cost.requests();
        task.running_cost_gradient(inputs, next, cotangents, next_bar);
    }
    for (lambda, &cost) in zip(lambda.iter_mut(), &cost.next) {
        *lambda += inject * cost;
    }

    clear(u_bar);
    if let Some(p_bar) = &mut p_bar {
        clear(p_bar);
    }
    // Two flows without a physics path are rare: their special case is not compiled.
    if K > 1 || flows.iter().any(|flow| flow.physics != 0.0) {
        clear(x_bar);
        task.system().vjp(inputs, lambda, Cotangents { x: Some(x_bar), u: Some(u_bar), p: p_bar });
    } else {
        task.system().vjp(inputs, lambda, Cotangents { x: None, u: Some(u_bar), p: p_bar });
    }
    for (u_bar, &cost) in zip(u_bar.iter_mut(), &cost.u) {
        *u_bar += inject * cost;
        size += u_bar.abs();
    }
    for memory_bar in memory_bar {
        size += memory_bar.abs();
    }
    for ((lambda, &x_bar), &cost) in zip(zip(lambda.iter_mut(), &*x_bar), &cost.x) {
        for (k, flow) in flows.iter().enumerate() {
            lambda.0[k] = weighted(x_bar.0[k], flow.physics);
        }
        *lambda += inject * cost;
        size += lambda.abs();
    }
    size
}

/// Multiplies a cotangent by the weight of its path. A weight of 0 also removes non-finite numbers.
#[inline(always)]
pub(super) fn weighted<R: Scalar>(bar: R, weight: f64) -> R {
    if weight == 0.0 { R::zero() } else { bar * weight }
}

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
    growth: GrowthMeters<K>,
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

    /// Value and exponent of the gradient with respect to entry `i` of p, for policies with trained
    /// parameters.
    pub(super) fn by_param(&self, k: usize, sample: usize, i: usize) -> (F, i32) {
        self.starts.as_ref().expect("trained parameters have gradients").by_param(k, sample, i)
    }

    /// Growth of λ.
    pub(super) fn growth(&self) -> &GrowthMeters<K> {
        &self.growth
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
