//! [`Rollout`]: forward pass of a batch of samples.

mod buffer_sizes;
mod columns;
mod unwritten;

use crate::dynamics::cause::Cause;
use crate::dynamics::inputs::Inputs;
use crate::dynamics::number::NoiseNumbers;
use crate::engine::any::AnyTask;
use crate::engine::divergence::{Divergence, Variable};
use crate::engine::pass::Closed;
use crate::numbers::aligned::Aligned;
use crate::numbers::scalar::{Float, LANES, Lane, Lanes, Real, Scalar};
use crate::policy::AnyPolicy;
use crate::policy::{PolicyColumns, PolicyPass, Weights};
use buffer_sizes::BufferSizes;
use columns::scatter;
pub(crate) use columns::{find_non_finite, gather};
use std::ops::Range;
use unwritten::zero_param;

/// Number of steps in a unit. Units divide a rollout; the last one may be shorter.
///
/// One call of the policy sums the parameter gradient over the steps of one unit. Every schedule
/// adds the same sums in the same order, so gradients are bitwise equal.
///
/// A rollout of at most 129 steps is one unit; the horizons of the paper are shorter. The number is
/// odd, so that columns of neighbouring samples map to different cache sets.
pub(crate) const UNIT: usize = 129;

/// End of the error messages about steps that are not stored.
const STORED: &str = "a rollout with a tape stores all steps, one for evaluation only the last";

/// Batch of rollouts. The constructor allocates all buffers.
///
/// A run allocates only in three cases:
///
/// - The run diverges.
/// - A step of a system exceeds its stack buffers.
/// - Some policies and all reverse-mode derivatives allocate in their first call on a thread.
///
/// With a tape, the rollout stores the trajectory and the values that [`Adjoint`](crate::Adjoint)
/// needs. Without a tape ([`Rollout::for_evaluation`]), it stores a single step. Costs and states
/// are bitwise equal in both cases.
#[derive(Debug)]
pub struct Rollout<F: Float> {
    capacity: usize,
    /// Number of samples started, at most `capacity`.
    pub(crate) samples: usize,
    pub(crate) state_dim: usize,
    pub(crate) control_dim: usize,
    pub(crate) observed_dim: usize,
    /// Length of the memory of the policy.
    pub(crate) memory_dim: usize,
    pub(crate) param_dim: usize,
    pub(crate) horizon: usize,
    /// Number of stored steps: the horizon, a multiple of [`UNIT`], or 1. Later steps overwrite
    /// earlier ones.
    pub(crate) kept: usize,
    /// States, `[block][component]`, then memories, `[block][component]`, for each step: a ring
    /// buffer of `kept + 1` steps.
    states: Vec<Lane<F>>,
    /// Controls, `[step][block][component]`, a ring buffer of `kept` steps.
    controls: Vec<Lane<F>>,
    /// Parameters of the initial states, `[block][component]`. With noise, followed by those of each
    /// step, a ring buffer of `kept` steps.
    params: Vec<Lane<F>>,
    /// Numbers drawn anew during a rollout.
    noise: NoiseNumbers,
    /// Key of the noise of each sample. Empty without noise.
    keys: Vec<F>,
    /// Observations of one step, `[block][component]`. Empty if the policy observes the state.
    observations: Vec<Lane<F>>,
    /// Policy inputs, observation and memory, as columns: `[unit][sample][step][component]`. The
    /// columns of a unit are contiguous.
    inputs: Vec<F>,
    /// Policy outputs, control and next memory, as columns.
    outputs: Vec<F>,
    /// Tape of the policy.
    pub(crate) tape: Aligned<F>,
    /// Cost of each sample, `[block]`, without the costs of the current unit.
    pub(crate) costs: Vec<Lane<F>>,
    /// Cost of each sample within the current unit, `[block]`. Sums of sums have smaller rounding
    /// errors on long horizons.
    unit_costs: Vec<Lane<F>>,
}

impl<F: Float> Rollout<F> {
    /// Allocates `samples` rollouts with a tape.
    ///
    /// # Panics
    /// If `samples`, the horizon or the number of state components is 0. If the shapes of task and
    /// policy differ, or the policy trains a parameter that the task lacks.
    pub fn new(task: &dyn AnyTask<F>, policy: &dyn AnyPolicy<F>, samples: usize) -> Self {
        Self::with_steps(task, policy, samples, task.horizon())
    }

    /// Allocates `samples` rollouts without a tape, for costs and last states.
    ///
    /// # Panics
    /// As [`new`](Rollout::new).
    pub fn for_evaluation(
        task: &dyn AnyTask<F>,
        policy: &dyn AnyPolicy<F>,
        samples: usize,
    ) -> Self {
        Self::with_steps(task, policy, samples, 1)
    }

    /// Allocates `samples` rollouts that store the last `kept` steps for differentiation.
    #[track_caller]
    #[inline(never)]
    pub(crate) fn with_steps(
        task: &dyn AnyTask<F>,
        policy: &dyn AnyPolicy<F>,
        samples: usize,
        kept: usize,
    ) -> Self {
        let (n, m) = (task.state_dim(), task.control_dim());
        assert!(samples > 0, "a rollout needs at least one sample");
        assert!(task.horizon() > 0, "a rollout needs a horizon of at least one step");
        assert!(n > 0, "a rollout needs a system with at least one state component");
        let observed = task.observed_dim();
        assert_eq!(
            policy.observation_dim(),
            observed,
            "the policy expects {} observed components, but the task has {observed}",
            policy.observation_dim()
        );
        assert_eq!(
            policy.control_dim(),
            m,
            "the policy computes {} controls, but the system has {m}",
            policy.control_dim()
        );
        let params = task.param_dim();
        for param in policy.trained_params() {
            let index = param.index();
            assert!(
                index < params,
                "the policy trains p[{index}], but the task has {params} parameters"
            );
        }
        let sizes = BufferSizes::new(task, policy, samples, kept);
        let zeros = |len: usize| vec![F::zero(); len];
        let lanes = |len: usize| vec![Lane::zero(); len];
        Self {
            capacity: samples,
            samples,
            state_dim: n,
            control_dim: m,
            observed_dim: observed,
            memory_dim: policy.memory_dim(),
            param_dim: params,
            horizon: task.horizon(),
            kept,
            states: lanes(sizes.states),
            controls: lanes(sizes.controls),
            params: lanes(sizes.params),
            noise: task.noise(),
            keys: zeros(sizes.keys),
            observations: lanes(sizes.observations),
            inputs: zeros(sizes.inputs),
            outputs: zeros(sizes.outputs),
            tape: Aligned::zeros(sizes.tape),
            costs: lanes(sizes.costs),
            unit_costs: lanes(sizes.costs),
        }
    }

    /// Number of samples started.
    pub fn samples(&self) -> usize {
        self.samples
    }

    /// Largest number of samples.
    pub fn capacity(&self) -> usize {
        self.capacity
    }

    /// Bytes on the heap, independent of the number of samples started. Without a tape, they are
    /// also independent of the horizon.
    pub fn stored_bytes(&self) -> usize {
        let lanes = [
            &self.states,
            &self.controls,
            &self.params,
            &self.observations,
            &self.costs,
            &self.unit_costs,
        ];
        let lanes = lanes.map(|lanes| size_of_val(&lanes[..]));
        let numbers =
            [&self.inputs, &self.outputs, &self.keys].map(|numbers| size_of_val(&numbers[..]));
        lanes.into_iter().chain(numbers).sum::<usize>()
            + self.noise.stored_bytes()
            + self.tape.stored_bytes()
    }

    /// Returns the [`stored_bytes`](Rollout::stored_bytes) of a rollout that stores `kept` steps.
    #[inline(never)]
    pub fn bytes_of(
        task: &dyn AnyTask<F>,
        policy: &dyn AnyPolicy<F>,
        samples: usize,
        kept: usize,
    ) -> usize {
        BufferSizes::new(task, policy, samples, kept).bytes::<F>()
    }

    /// Numbers per sample in a list of initial states.
    pub(crate) fn start_dim(&self) -> usize {
        self.state_dim + self.param_dim + self.noise.key_dim()
    }

    /// Sets initial states and parameters: for each sample, `state_dim` numbers, then `param_dim`,
    /// then the key of its noise if the task has noise.
    /// The number of samples may be below the capacity.
    ///
    /// # Panics
    /// If `starts` is empty, exceeds the capacity, or is not a whole number of samples.
    #[track_caller]
    #[inline(never)]
    pub fn start(&mut self, starts: &[F]) {
        let (n, params) = (self.state_dim, self.param_dim);
        let each = self.start_dim();
        let samples = starts.len() / each;
        assert!(
            !starts.is_empty() && starts.len().is_multiple_of(each) && samples <= self.capacity,
            "the rollout has a capacity of {} samples of {each} numbers each, but `starts` has {} numbers",
            self.capacity,
            starts.len()
        );
        self.samples = samples;
        let starts_of = starts.chunks_exact(each);
        self.keys.iter_mut().zip(starts_of).for_each(|(key, start)| *key = start[each - 1]);
        for block in 0..self.blocks() {
            let (x, p) =
                (&mut self.states[block * n..][..n], &mut self.params[block * params..][..params]);
            for lane in 0..LANES {
                // Unused lanes repeat the last sample, so they add no non-finite numbers.
                let sample = (block * LANES + lane).min(samples - 1);
                for (number, &start) in x.iter_mut().chain(&mut *p).zip(&starts[sample * each..]) {
                    number.set_lane(lane, start);
                }
            }
        }
        let (states, memories) = (self.blocks() * n, self.blocks() * self.memory_dim);
        self.states[states..][..memories].fill(Lane::zero());
    }

    /// Runs all samples from their initial states. Stops at the first non-finite control, memory or
    /// state. Without a tape, a run overwrites the initial states, so each run requires a
    /// [`start`](Rollout::start).
    ///
    /// # Errors
    /// [`Divergence`] if a control, memory, state or cost is non-finite.
    #[inline(never)]
    pub fn run(
        &mut self,
        task: &dyn AnyTask<F>,
        policy: &dyn AnyPolicy<F>,
        weights: &Weights<F>,
    ) -> Result<(), Divergence> {
        self.clear_costs();
        self.advance(Closed { task, policy, weights }, 0..self.horizon)?;
        self.finish(task)
    }

    /// Replaces the trained entries of the parameters of all samples.
    fn set_trained_params(&mut self, Closed { policy, weights, .. }: Closed<'_, F>) {
        for (param, r) in policy.trained_params().iter().zip(weights.trained(policy)) {
            let value = Lane::splat(F::from_f64(param.value(r.as_())));
            let all = self.blocks() * self.param_dim;
            self.params[..all]
                .iter_mut()
                .skip(param.index())
                .step_by(self.param_dim)
                .for_each(|p| *p = value);
        }
    }

    /// Returns an error if a parameter is NaN, for example because nothing sets it.
    fn check_params(&self) -> Result<(), Divergence> {
        let is_nan = |&(sample, i): &(usize, usize)| {
            let value: f64 =
                self.params[sample / LANES * self.param_dim + i].lane(sample % LANES).as_();
            value.is_nan()
        };
        let all =
            (0..self.samples).flat_map(|sample| (0..self.param_dim).map(move |i| (sample, i)));
        all.into_iter().find(is_nan).map_or(Ok(()), |(sample, component)| {
            Err(Divergence::Forward {
                variable: Variable::Parameter,
                step: 0,
                sample,
                component,
                cause: None,
            })
        })
    }

    /// Runs `steps` from the stored state at their start, and adds their costs.
    pub(crate) fn advance(
        &mut self,
        closed: Closed<'_, F>,
        steps: Range<usize>,
    ) -> Result<(), Divergence> {
        steps.into_iter().try_for_each(|t| self.step(closed, t))
    }

    /// Runs `steps` with storage for one step, which stays in the cache.
    ///
    /// Only the last state is available afterwards; previously stored steps are lost.
    pub(crate) fn pass_over(
        &mut self,
        closed: Closed<'_, F>,
        steps: Range<usize>,
    ) -> Result<(), Divergence> {
        let kept = self.keep_from(steps.start, 1);
        let outcome = self.advance(closed, steps.clone());
        self.keep_from(steps.end, kept);
        outcome
    }

    /// Changes the number of stored steps to `kept` and moves the state at step `t` into place.
    ///
    /// Returns the previous number.
    fn keep_from(&mut self, t: usize, kept: usize) -> usize {
        let from = self.slot(t);
        let before = std::mem::replace(&mut self.kept, kept);
        let to = self.slot(t).start;
        self.states.copy_within(from, to);
        before
    }

    /// Sets all costs to 0.
    pub(crate) fn clear_costs(&mut self) {
        self.costs.fill(Lane::zero());
        self.unit_costs.fill(Lane::zero());
    }

    /// Adds the costs of the current unit.
    fn add_unit_costs(&mut self) {
        for (sum, unit) in self.costs.iter_mut().zip(&mut self.unit_costs) {
            *sum += std::mem::replace(unit, Lane::zero());
        }
    }

    /// Adds the terminal costs. Returns an error if a cost is non-finite.
    pub(crate) fn finish(&mut self, task: &dyn AnyTask<F>) -> Result<(), Divergence> {
        self.add_unit_costs();
        let last = self.slot(self.horizon).start;
        let n_params = self.param_dim;
        let params = self.param_slot(self.horizon - 1).start;
        for (block, x) in self.states[last..][..self.blocks() * self.state_dim]
            .chunks_exact(self.state_dim)
            .enumerate()
        {
            let params = &self.params[params + block * n_params..][..n_params];
            self.costs[block] += task.terminal_cost(x, params);
        }
        let bad = (0..self.samples).find(|&sample| !self.cost(sample).as_().is_finite());
        bad.map_or(Ok(()), |sample| Err(Divergence::Cost { sample }))
    }

    /// Runs step `t`, and adds its cost.
    fn step(&mut self, closed: Closed<'_, F>, t: usize) -> Result<(), Divergence> {
        if t == 0 {
            self.set_trained_params(closed);
            self.check_params()?;
        }
        self.draw_noise(closed.task, t);
        self.observe(closed.task, t);
        self.act(closed, t);
        if !self.integrate(closed.task, t) {
            return Err(self.located(closed.task, t));
        }
        if (t + 1).is_multiple_of(UNIT) {
            self.add_unit_costs();
        }
        Ok(())
    }

    /// Writes the parameters of step `t`, if they differ between steps.
    fn draw_noise(&mut self, task: &dyn AnyTask<F>, t: usize) {
        if self.noise.is_empty() {
            return;
        }
        let (slot, params) = (self.param_slot(t), self.param_dim);
        let (constant, steps) = self.params.split_at_mut(slot.len());
        let now = &mut steps[slot.start - constant.len()..][..slot.len()];
        now.copy_from_slice(constant);
        for (block, now) in now.chunks_exact_mut(params).enumerate() {
            for lane in 0..LANES {
                let sample = (block * LANES + lane).min(self.samples - 1);
                let set = |i: usize, value| now[i].set_lane(lane, F::from_f64(value));
                self.noise.at(self.keys[sample].as_(), task.first_step() + t, set);
            }
        }
    }

    /// Writes the inputs of the policy at step `t`: the observations and the memories.
    fn observe(&mut self, task: &dyn AnyTask<F>, t: usize) {
        let (observed, memory_dim) = (self.observed_dim, self.memory_dim);
        let (at, blocks, now) = (self.columns(t), self.blocks(), self.slot(t));
        let p = self.param_slot(t);
        let (x, memory) = self.states[now].split_at(blocks * self.state_dim);
        let seen = match task.own_observation() {
            None => x,
            Some(_) => {
                let y = &mut self.observations[..blocks * observed];
                task.observe(Inputs { x, u: &[], p: &self.params[p], t }, y);
                &*y
            }
        };
        let input_dim = observed + memory_dim;
        gather(seen, Real::lane, observed, at, &mut self.inputs, (0, input_dim));
        gather(memory, Real::lane, memory_dim, at, &mut self.inputs, (observed, input_dim));
    }

    /// Writes the controls of step `t`, and the memories after it.
    fn act(&mut self, Closed { policy, weights, .. }: Closed<'_, F>, t: usize) {
        let (m, memory_dim) = (self.control_dim, self.memory_dim);
        let (at, blocks, next) = (self.columns(t), self.blocks(), self.slot(t + 1));
        let inputs = &self.inputs[..self.samples * self.kept * (self.observed_dim + memory_dim)];
        let pass = PolicyPass::new(weights.packed(), at, inputs).at_steps(t..t + 1);
        policy.forward(pass, &mut self.tape, &mut self.outputs);
        let controls = &mut self.controls[blocks * m * (t % self.kept)..][..blocks * m];
        scatter(&self.outputs, (0, m + memory_dim), m, at, controls);
        let next_memory = &mut self.states[next][blocks * self.state_dim..];
        scatter(&self.outputs, (m, m + memory_dim), memory_dim, at, next_memory);
    }

    /// Writes the states after step `t`, and adds its costs to those of the unit. Returns whether
    /// controls, states and memories are finite.
    fn integrate(&mut self, task: &dyn AnyTask<F>, t: usize) -> bool {
        let (now, next, p) = (self.slot(t), self.slot(t + 1), self.param_slot(t));
        let (states, controls) = (self.blocks() * self.state_dim, self.blocks() * self.control_dim);
        // The two slots are adjacent, or the first and the last of the ring.
        let (now, next) = if now.start < next.start {
            let (before, after) = self.states.split_at_mut(next.start);
            (&before[now], &mut after[..next.len()])
        } else {
            let (before, after) = self.states.split_at_mut(now.start);
            (&after[..now.len()], &mut before[next])
        };
        let (next, next_memory) = next.split_at_mut(states);
        let u = &self.controls[controls * (t % self.kept)..][..controls];
        let inputs = Inputs { x: &now[..states], u, p: &self.params[p], t };
        let finite = task.step_forward(inputs, next, &mut self.unit_costs);
        let (memory_dim, samples) = (self.memory_dim, self.samples);
        finite && find_non_finite(next_memory, memory_dim, samples, Real::lane).is_none()
    }

    /// First non-finite number of step `t`, with its cause.
    #[cold]
    fn located(&self, task: &dyn AnyTask<F>, t: usize) -> Divergence {
        let find = |lanes: &[Lane<F>], dim| find_non_finite(lanes, dim, self.samples, Real::lane);
        let x = self.states_at(t);
        let start = if t == 0 { find(x, self.state_dim) } else { None };
        if let Some((sample, component)) = start {
            let variable = Variable::State;
            return Divergence::Forward { variable, step: 0, sample, component, cause: None };
        }
        let next_memory = &self.carried_at(t + 1)[x.len()..];
        let control = find(self.controls_at(t), self.control_dim);
        let memory = find(next_memory, self.memory_dim);
        let state = || find(self.states_at(t + 1), self.state_dim);
        // In the order of `Divergence::order`: the first sample of a step.
        let first = control
            .map(|place| (Variable::Control, t, place))
            .into_iter()
            .chain(memory.map(|place| (Variable::Memory, t, place)))
            .min_by_key(|&(.., (sample, _))| sample)
            .or_else(|| state().map(|place| (Variable::State, t + 1, place)));
        let (variable, step, (sample, component)) =
            first.expect("`step_forward` returns false only for a non-finite value");
        let is_state = matches!(variable, Variable::State);
        let cause = if is_state { self.cause(task, t, sample) } else { None };
        Divergence::Forward { variable, step, sample, component, cause }
    }

    /// Cause of a non-finite state of `sample` after step `t`.
    fn cause(&self, task: &dyn AnyTask<F>, t: usize, sample: usize) -> Option<Cause> {
        self.diagnosis(task, t, sample).or_else(|| {
            zero_param(task, self.inputs_of(t, sample / LANES), sample % LANES)
                .map(Cause::ZeroParam)
        })
    }

    /// Cause of a non-finite number of `sample` in step `t` or its derivatives, if the system knows
    /// it.
    pub(crate) fn diagnosis(
        &self,
        task: &dyn AnyTask<F>,
        t: usize,
        sample: usize,
    ) -> Option<Cause> {
        // The sample in all lanes.
        let of = |lanes: &[Lane<F>]| -> Vec<Lane<F>> {
            lanes.iter().map(|number| Lanes([number.lane(sample % LANES); LANES])).collect()
        };
        let [x, u, p] = self.inputs_of(t, sample / LANES).lists().map(of);
        let cause = task.diagnose(Inputs { x: &x, u: &u, p: &p, t })?;
        let largest: f64 = x.iter().map(|x| x.lane(0).to_f64().abs()).fold(0.0, f64::max);
        let overflows = largest.powi(4) > F::MAX;
        let grown = overflows && matches!(cause, Cause::Effect(_) | Cause::Rate(_));
        Some(if grown { Cause::Grown(largest) } else { cause })
    }

    /// Policy columns of step `t`, one per sample.
    pub(crate) fn columns(&self, t: usize) -> PolicyColumns {
        if self.kept < UNIT {
            return PolicyColumns { first: t % self.kept, step: self.kept, count: self.samples };
        }
        let unit = t / UNIT * UNIT;
        // The comparison avoids a division per step if everything is stored.
        let place = if unit < self.kept { unit } else { unit % self.kept };
        let step = UNIT.min(self.horizon - unit);
        PolicyColumns { first: place * self.samples + t - unit, step, count: self.samples }
    }

    /// Units of `steps` in reverse order. `steps` must start at the start of a unit.
    pub(crate) fn units(steps: Range<usize>) -> impl Iterator<Item = Range<usize>> {
        steps.clone().step_by(UNIT).rev().map(move |first| first..steps.end.min(first + UNIT))
    }

    /// Policy columns of `samples` at the steps of a unit.
    pub(crate) fn columns_of(&self, unit: &Range<usize>, samples: Range<usize>) -> PolicyColumns {
        let PolicyColumns { first, step, .. } = self.columns(unit.start);
        debug_assert_eq!(step, unit.len(), "the unit {unit:?} does not have {step} steps");
        PolicyColumns::range(first + samples.start * step..first + samples.end * step)
    }

    /// Policy inputs, as columns.
    pub(crate) fn inputs(&self) -> &[F] {
        &self.inputs[..self.samples * self.kept * (self.observed_dim + self.memory_dim)]
    }

    fn blocks(&self) -> usize {
        self.samples.div_ceil(LANES)
    }

    /// Range of the states and memories at step `t` in `states`.
    fn slot(&self, t: usize) -> Range<usize> {
        let len = self.blocks() * (self.state_dim + self.memory_dim);
        let slot = t % (self.kept + 1);
        slot * len..(slot + 1) * len
    }

    /// States of all samples at step `t`, in blocks of [`LANES`].
    pub(crate) fn states_at(&self, t: usize) -> &[Lane<F>] {
        &self.states[self.slot(t).start..][..self.blocks() * self.state_dim]
    }

    /// States and memories of all samples at step `t`, from which a rollout continues.
    pub(crate) fn carried_at(&self, t: usize) -> &[Lane<F>] {
        &self.states[self.slot(t)]
    }

    /// Mutable [`carried_at`](Self::carried_at).
    pub(crate) fn carried_at_mut(&mut self, t: usize) -> &mut [Lane<F>] {
        let range = self.slot(t);
        &mut self.states[range]
    }

    /// Controls of all samples at step `t`, in blocks of [`LANES`].
    pub(crate) fn controls_at(&self, t: usize) -> &[Lane<F>] {
        let len = self.blocks() * self.control_dim;
        &self.controls[len * (t % self.kept)..][..len]
    }

    /// Range of the parameters of step `t` in `params`.
    fn param_slot(&self, t: usize) -> Range<usize> {
        let len = self.blocks() * self.param_dim;
        let slot = if self.noise.is_empty() { 0 } else { 1 + t % self.kept };
        slot * len..(slot + 1) * len
    }

    /// Parameters of block `block` at step `t`.
    pub(crate) fn params_at(&self, t: usize, block: usize) -> &[Lane<F>] {
        &self.params[self.param_slot(t).start + block * self.param_dim..][..self.param_dim]
    }

    /// Returns the parameters of a sample at step `t`, with the values of trained entries and of
    /// noise. Without noise, they are equal at all steps.
    ///
    /// # Panics
    /// If that step is not stored, or there is no such sample.
    pub fn params_at_step(&self, t: usize, sample: usize) -> impl Iterator<Item = F> {
        self.params_at(t, sample / LANES).iter().map(move |p| p.0[sample % LANES])
    }

    /// Inputs of step `t` for block `block`.
    pub(crate) fn inputs_of(&self, t: usize, block: usize) -> Inputs<'_, Lane<F>> {
        let (n, m) = (self.state_dim, self.control_dim);
        let (x, u) = (&self.states_at(t)[block * n..][..n], &self.controls_at(t)[block * m..][..m]);
        Inputs { x, u, p: self.params_at(t, block), t }
    }

    /// States, parameters and time of step `t` for all blocks, concatenated.
    pub(crate) fn observed_at(&self, t: usize) -> Inputs<'_, Lane<F>> {
        Inputs { x: self.states_at(t), u: &[], p: &self.params[self.param_slot(t)], t }
    }

    /// Returns true if all steps are stored.
    pub(crate) fn has_tape(&self) -> bool {
        self.kept == self.horizon
    }

    /// Cost of `sample`.
    ///
    /// # Panics
    /// If there is no such sample.
    #[track_caller]
    pub fn cost(&self, sample: usize) -> F {
        assert!(
            sample < self.samples,
            "there is no sample {sample}: the rollout has {}",
            self.samples
        );
        self.costs[sample / LANES].lane(sample % LANES)
    }

    /// Number of steps of the episode of a sample after a run. None if the episodes of the task cannot
    /// end.
    ///
    /// # Panics
    /// If there is no such sample.
    #[track_caller]
    pub fn length(&self, task: &dyn AnyTask<F>, sample: usize) -> Option<usize> {
        let steps = self.state(self.horizon, sample, task.ended()?).as_();
        Some(if steps == 0.0 { self.horizon } else { steps as usize })
    }

    /// Appends all states and controls, `[sample][step][component]`, of a rollout with a tape.
    pub(crate) fn append(&self, states: &mut Vec<F>, controls: &mut Vec<F>) {
        let copy =
            |numbers: &mut Vec<F>, width: usize, steps, at: fn(&Self, usize) -> &[Lane<F>]| {
                let (first, each) = (numbers.len(), steps * width);
                numbers.resize(first + self.samples * each, F::zero());
                for t in 0..steps {
                    let lanes = at(self, t);
                    let samples = numbers[first..].chunks_exact_mut(each.max(1));
                    for (sample, numbers) in samples.enumerate() {
                        let block = &lanes[sample / LANES * width..][..width];
                        for (number, lanes) in numbers[t * width..][..width].iter_mut().zip(block) {
                            *number = lanes.lane(sample % LANES);
                        }
                    }
                }
            };
        copy(states, self.state_dim, self.horizon + 1, Self::states_at);
        copy(controls, self.control_dim, self.horizon, Self::controls_at);
    }

    /// Component `i` of the state of `sample` at step `t`, from 0 (initial state) to `horizon`.
    ///
    /// # Panics
    /// If that step is not stored, or there is no such sample or component. Without a tape, only
    /// the last two states are stored.
    #[track_caller]
    pub fn state(&self, t: usize, sample: usize, i: usize) -> F {
        let Self { horizon, kept, .. } = *self;
        assert!(
            t <= horizon && t + kept >= horizon,
            "the state at step {t} of {horizon} is not stored: {STORED}"
        );
        assert!(
            sample < self.samples && i < self.state_dim,
            "there is no state component {i} of sample {sample}"
        );
        self.states_at(t)[(sample / LANES) * self.state_dim + i].lane(sample % LANES)
    }

    /// Component `i` of the control of `sample` at step `t`, `t < horizon`.
    ///
    /// # Panics
    /// If that step is not stored, or there is no such sample or component. Without a tape, only
    /// the last control is stored.
    #[track_caller]
    pub fn control(&self, t: usize, sample: usize, i: usize) -> F {
        let Self { horizon, kept, .. } = *self;
        assert!(
            t < horizon && t + kept >= horizon,
            "the control at step {t} of {horizon} is not stored: {STORED}"
        );
        assert!(
            sample < self.samples && i < self.control_dim,
            "there is no control {i} of sample {sample}"
        );
        self.controls_at(t)[(sample / LANES) * self.control_dim + i].lane(sample % LANES)
    }
}
