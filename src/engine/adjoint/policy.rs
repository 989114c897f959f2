//! Policy part of the reverse pass: cotangents, buffers and parameter gradients.

use super::exponents::Exponents;
use super::starts::StartGradients;
use crate::dynamics::outline::One;
use crate::engine::any::AnyTask;
use crate::engine::flow::Flow;
use crate::engine::gradient::Gradient;
use crate::engine::pass::{Closed, Pass};
use crate::engine::rollout::gather;
use crate::numbers::aligned::Aligned;
use crate::numbers::extended::{exponent_of, scaled};
use crate::numbers::scalar::{Cotangent, CotangentPack, Float, LANES, Lane, Real, Scalar};
use crate::numbers::zip::zip;
use crate::policy::AnyPolicy;
use crate::policy::{PolicyColumns, PolicyPass, PolicyRecord};
use std::ops::Range;

/// Policy part of the reverse pass.
#[derive(Debug)]
pub(super) struct PolicyAdjoint<F> {
    control_dim: usize,
    memory_dim: usize,
    /// Cotangents of the policy's outputs, h and μ, per flow, as policy columns.
    pub(super) controls_bar: Vec<Vec<F>>,
    /// Tape of the policy's backward pass, per flow, or one for all flows if `linearized`.
    pub(super) tape_bar: Vec<Aligned<F>>,
    /// Cotangents of the policy's inputs, or `∂N/∂y` if `linearized`, as policy columns. Empty if
    /// no flow has a path through the inputs.
    pub(super) inputs_bar: Vec<F>,
    /// Cotangents of the observations of one step, `[block][component]`. Empty if the policy
    /// observes the state, or if no flow has a path through the inputs.
    observed_bar: Vec<One<Lane<F>>>,
    /// Cotangents of the states of one step through the observations, `[block][component]`. Empty
    /// if `observed_bar` is empty.
    states_bar: Vec<One<Lane<F>>>,
    observed_dim: usize,
    /// True if the policy is linearized for all steps of a unit at once.
    pub(super) linearized: bool,
    /// Cotangents of the only policy output, all equal to 1, if `linearized`.
    pub(super) ones: Vec<F>,
    pub(super) scratch: Aligned<F>,
    /// Exponent of each column, per flow. All 0 unless `scaled`.
    exponents: Vec<Vec<i32>>,
    /// True if some exponent may differ from 0.
    scaled: bool,
    /// Weight of each column, if some exponent is not 0.
    weights: Vec<F>,
    /// Parameter gradient of the columns of one call, before its addition to a sum with exponents.
    part: Vec<F>,
}

/// Dimensions and buffer lengths of the policy part.
///
/// Lengths are in lanes for `observed_bar` and `states_bar`, in numbers for the others.
pub(super) struct PolicyBufferSizes {
    control_dim: usize,
    memory_dim: usize,
    flows: usize,
    controls_bar: usize,
    tapes: usize,
    tape_bar: usize,
    inputs_bar: usize,
    observed_dim: usize,
    observed_bar: usize,
    states_bar: usize,
    linearized: bool,
    ones: usize,
    scratch: usize,
    columns: usize,
    params: usize,
}

impl PolicyBufferSizes {
    pub(super) fn new<F: Float>(
        task: &dyn AnyTask<F>,
        policy: &dyn AnyPolicy<F>,
        samples: usize,
        kept: usize,
        flows: &[Flow],
    ) -> Self {
        let columns = samples * kept;
        let (inputs, outputs, memory_dim) =
            (policy.input_dim(), policy.output_dim(), policy.memory_dim());
        let sizes = policy.sizes(columns);
        // With one output, ∂N/∂y and the cotangents of all layers are known up to the factor h
        // before the loop. One linearization, in matrix products over all steps of a unit, then
        // suffices for all flows. Several outputs would require one linearization each.
        let through_inputs =
            flows.iter().any(|flow| flow.control != 0.0 || flow.memory != 0.0 && memory_dim > 0);
        let linearized = outputs == 1 && through_inputs;
        let (blocks, observed) =
            (samples.div_ceil(LANES), through_inputs && task.own_observation().is_some());
        Self {
            control_dim: policy.control_dim(),
            memory_dim,
            flows: flows.len(),
            controls_bar: columns * outputs,
            tapes: if linearized { 1 } else { flows.len() },
            tape_bar: sizes.tape_bar,
            inputs_bar: if through_inputs { columns * inputs } else { 0 },
            observed_dim: policy.observation_dim(),
            observed_bar: if observed { blocks * policy.observation_dim() } else { 0 },
            states_bar: if observed { blocks * task.state_dim() } else { 0 },
            linearized,
            ones: if linearized { columns } else { 0 },
            scratch: sizes.scratch,
            columns,
            params: policy.param_count(),
        }
    }

    pub(super) fn bytes<F: Float>(&self) -> usize {
        let numbers = self.flows * self.controls_bar
            + self.inputs_bar
            + self.ones
            + self.columns
            + self.params;
        let vectors = self.flows * size_of::<Vec<F>>() + numbers * size_of::<F>();
        let tapes = self.tapes * (size_of::<Aligned<F>>() + Aligned::<F>::bytes_of(self.tape_bar));
        let scaled = self.flows * (size_of::<Vec<i32>>() + self.columns * size_of::<i32>());
        let lanes = (self.observed_bar + self.states_bar) * size_of::<One<Lane<F>>>();
        lanes + vectors + tapes + Aligned::<F>::bytes_of(self.scratch) + scaled
    }
}

impl<F: Float> PolicyAdjoint<F> {
    pub(super) fn new(sizes: &PolicyBufferSizes) -> Self {
        let zeros = |len: usize| vec![F::zero(); len];
        Self {
            control_dim: sizes.control_dim,
            memory_dim: sizes.memory_dim,
            controls_bar: (0..sizes.flows).map(|_| zeros(sizes.controls_bar)).collect(),
            tape_bar: (0..sizes.tapes).map(|_| Aligned::zeros(sizes.tape_bar)).collect(),
            inputs_bar: zeros(sizes.inputs_bar),
            observed_bar: vec![One::null(); sizes.observed_bar],
            states_bar: vec![One::null(); sizes.states_bar],
            observed_dim: sizes.observed_dim,
            linearized: sizes.linearized,
            ones: vec![F::one(); sizes.ones],
            scratch: Aligned::zeros(sizes.scratch),
            exponents: vec![vec![0; sizes.columns]; sizes.flows],
            scaled: false,
            weights: zeros(sizes.columns),
            part: zeros(sizes.params),
        }
    }

    pub(super) fn stored_bytes(&self) -> usize {
        let flat = [&self.inputs_bar, &self.ones, &self.weights, &self.part]
            .map(|flat| size_of_val(&flat[..]));
        let tapes = size_of_val(&self.tape_bar[..])
            + self.tape_bar.iter().map(Aligned::stored_bytes).sum::<usize>();
        let nested = nested_bytes(&self.controls_bar) + tapes + nested_bytes(&self.exponents);
        let lanes = size_of_val(&self.observed_bar[..]) + size_of_val(&self.states_bar[..]);
        lanes + flat.into_iter().sum::<usize>() + self.scratch.stored_bytes() + nested
    }

    /// Sets the exponents of all columns to 0.
    pub(super) fn reset_exponents(&mut self) {
        if std::mem::take(&mut self.scaled) {
            self.exponents.iter_mut().for_each(|exponents| exponents.fill(0));
        }
    }

    /// Sets the exponents of these columns to 0. The columns must be contiguous.
    pub(super) fn reset_exponents_of(&mut self, at: PolicyColumns) {
        if self.scaled {
            self.exponents.iter_mut().for_each(|exponents| exponents[at.as_range()].fill(0));
        }
    }

    /// Returns true if `flow` has a path through the policy's inputs.
    pub(super) fn through_inputs(&self, flow: Flow) -> bool {
        flow.control != 0.0 || flow.memory != 0.0 && self.memory_dim > 0
    }

    /// Stores h and μ of flow `k` at the columns of one step, with their exponents.
    pub(super) fn set_controls_bar<const K: usize>(
        &mut self,
        k: usize,
        at: PolicyColumns,
        u_bar: &[CotangentPack<Lane<F>, K>],
        exponents: &Exponents<F, K>,
    ) {
        let outputs = self.control_dim + self.memory_dim;
        gather(
            u_bar,
            |h, lane| h.0[k].lane(lane),
            outputs,
            at,
            &mut self.controls_bar[k],
            (0, outputs),
        );
        if exponents.any {
            self.scaled = true;
            for (sample, c) in at.iter().enumerate() {
                self.exponents[k][c] = exponents.of(k, sample);
            }
        }
    }

    /// Evaluates the cotangents of the policy's inputs of flow `k` at step `t`, unless
    /// `linearized`.
    pub(super) fn linearize_inputs(&mut self, pass: &Pass<'_, F>, k: usize, t: usize) {
        if !self.linearized {
            self.backward(pass, k, pass.rollout.columns(t), t..t + 1, true);
        }
    }

    /// Adds `control·(∂y/∂x)ᵀ ȳ` at step `t` to λ of flow `k`. Evaluates `(∂y/∂p)ᵀ ȳ` if gradients
    /// with respect to p are recorded.
    pub(super) fn add_inputs_bar<const K: usize>(
        &mut self,
        k: usize,
        flow: Flow,
        pass: &Pass<'_, F>,
        t: usize,
        lambda: &mut [CotangentPack<Lane<F>, K>],
        starts: Option<&mut StartGradients<F, K>>,
    ) {
        let (task, rollout) = (pass.closed.task, pass.rollout);
        let observed = 0..self.observed_dim;
        if task.own_observation().is_none() {
            let weight = F::from_f64(flow.control);
            return self.each_input_bar(k, rollout.columns(t), observed, |i, lane, bar| {
                lambda[i].0[k].0[lane] += bar * weight
            });
        }
        let mut observed_bar = std::mem::take(&mut self.observed_bar);
        self.each_input_bar(k, rollout.columns(t), observed, |i, lane, bar| {
            observed_bar[i].0[0].0[lane] = bar
        });
        let states_bar = &mut self.states_bar[..rollout.states_at(t).len()];
        states_bar.fill(One::null());
        let params_bar = starts.map(|starts| {
            starts.observed[k].fill(One::null());
            &mut starts.observed[k][..]
        });
        task.observe_back(rollout.observed_at(t), &observed_bar, states_bar, params_bar);
        for (lambda, &CotangentPack([bar])) in zip(lambda.iter_mut(), &*states_bar) {
            lambda.0[k] += bar * flow.control;
        }
        self.observed_bar = observed_bar;
    }

    /// Writes `memory·m̄`, μ of flow `k` before the step, into `u_bar`, `[block][control, memory]`.
    pub(super) fn set_memory_bar<const K: usize>(
        &mut self,
        k: usize,
        flow: Flow,
        at: PolicyColumns,
        u_bar: &mut [CotangentPack<Lane<F>, K>],
    ) {
        let (m, memory, observed) = (self.control_dim, self.memory_dim, self.observed_dim);
        if memory == 0 {
            return;
        }
        if flow.memory == 0.0 {
            let memories = u_bar.chunks_exact_mut(m + memory).flat_map(|block| &mut block[m..]);
            return memories.for_each(|bar| bar.0[k] = Lane::zero());
        }
        let weight = F::from_f64(flow.memory);
        self.each_input_bar(k, at, observed..observed + memory, |i, lane, bar| {
            u_bar[i / memory * (m + memory) + m + i % memory].0[k].0[lane] = bar * weight;
        });
    }

    /// Calls `visit(i, lane, bar)` with the cotangents of the policy inputs `range` in the columns
    /// `at`. `i` is an index of `[block][component]`, with the components of the range.
    fn each_input_bar(
        &self,
        k: usize,
        at: PolicyColumns,
        range: Range<usize>,
        mut visit: impl FnMut(usize, usize, F),
    ) {
        let n = self.observed_dim + self.memory_dim;
        for block in 0..at.count.div_ceil(LANES) {
            for lane in 0..LANES {
                let sample = (block * LANES + lane).min(at.count - 1);
                let c = at.first + sample * at.step;
                // If linearized, `inputs_bar` contains ∂N/∂y without the factor h.
                let factor = if self.linearized { self.controls_bar[k][c] } else { F::one() };
                for (i, &input_bar) in self.inputs_bar[c * n..][range.clone()].iter().enumerate() {
                    visit(block * range.len() + i, lane, input_bar * factor);
                }
            }
        }
    }

    /// Adds the contribution of the columns to the parameter gradient of flow `k`.
    pub(super) fn add_param_gradient(
        &mut self,
        k: usize,
        policy: &dyn AnyPolicy<F>,
        pass: PolicyPass<F>,
        tape: &[F],
        theta_bar: &mut Gradient<F>,
    ) {
        let range = pass.at.as_range();
        let one_exponent =
            !self.scaled || self.exponents[k][range.clone()].iter().all(|&exponent| exponent == 0);
        let exponent = if one_exponent { 0 } else { self.weigh(k, range, policy.output_dim()) };
        let h = &self.controls_bar[k];
        let (u_bar, tape_bar, plain_weight) = if self.linearized {
            (&self.ones, &self.tape_bar[0], Some(&h[..]))
        } else {
            (h, &self.tape_bar[k], None)
        };
        let weight = if one_exponent { plain_weight } else { Some(&self.weights[..]) };
        let record = PolicyRecord { tape, u_bar, tape_bar, weight };
        match theta_bar.unscaled_sum() {
            Some(sum) if one_exponent => {
                policy.param_gradient(pass, record, &mut self.scratch, sum)
            }
            _ => {
                self.part.fill(F::zero());
                policy.param_gradient(pass, record, &mut self.scratch, &mut self.part);
                theta_bar.add_part(&self.part, exponent);
            }
        }
    }

    /// Weights columns of different exponents such that the largest cotangent is about 1. Columns
    /// whose cotangents are all 0 have the weight 0.
    ///
    /// Returns the common exponent of the weighted columns.
    fn weigh(&mut self, k: usize, columns: Range<usize>, m: usize) -> i32 {
        let (h, exponents) = (&self.controls_bar[k], &self.exponents[k]);
        let leading = |c: usize| {
            let largest = h[c * m..][..m].iter().map(|h| h.as_().abs()).fold(0.0, f64::max);
            // The bound keeps the weight of a column with tiny cotangents finite.
            (largest > 0.0).then(|| exponents[c] + exponent_of(largest).max(-100))
        };
        let largest = columns.clone().filter_map(leading).max().unwrap_or(0);
        for c in columns {
            let own = if self.linearized { h[c] } else { F::one() };
            self.weights[c] =
                if leading(c).is_none() { F::zero() } else { scaled(own, exponents[c] - largest) };
        }
        largest
    }

    /// Runs the policy's backward pass of flow `k` for the columns `at`.
    ///
    /// Evaluates the cotangents of the inputs only if `through_inputs`.
    pub(super) fn backward(
        &mut self,
        pass: &Pass<'_, F>,
        k: usize,
        at: PolicyColumns,
        steps: Range<usize>,
        through_inputs: bool,
    ) {
        let (Closed { policy, weights, .. }, rollout) = (pass.closed, pass.rollout);
        let columns = PolicyPass::new(weights.packed(), at, rollout.inputs()).at_steps(steps);
        let u_bar = if self.linearized { &self.ones } else { &self.controls_bar[k] };
        let x_bar = through_inputs.then_some(&mut self.inputs_bar[..]);
        policy.backward(columns, &rollout.tape, u_bar, &mut self.tape_bar[k], x_bar);
    }
}

/// Bytes on the heap of nested vectors without spare capacity.
pub(super) fn nested_bytes<T>(rows: &[Vec<T>]) -> usize {
    size_of_val(rows) + rows.iter().map(|row| size_of_val(&row[..])).sum::<usize>()
}
