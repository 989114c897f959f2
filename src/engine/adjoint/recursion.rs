//! Adjoint recursion, for one flow or two flows side by side.

use super::exponents::{Exponents, Size};
use super::step::{CostsOf, StepBack};
use super::{Flow, Pass, PolicyAdjoint};
use crate::engine::any::AnyTask;
use crate::engine::divergence::{Divergence, Variable};
use crate::engine::growth::Meter;
use crate::engine::rollout::{Lane, Rollout, WIDTH, find_non_finite, gather};
use crate::numbers::extended::times_power_of_two;
use crate::numbers::scalar::{CotangentPack, Float, Real, Scalar};
use crate::numbers::zip::zip;
use crate::policy::PolicyColumns;
use std::ops::Range;

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
    /// Exponents, per block.
    pub(super) exponents: Vec<Exponents<F, K>>,
    /// `scaled`: an exponent is not 0. `low`: an exponent is so low that cost gradients may
    /// overflow.
    pub(super) scaled: bool,
    low: bool,
    /// Growth, `[sample][flow]`, with ‖λ‖² and its exponent before the current step.
    meters: Vec<[(Meter, f64, i32); K]>,
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
            exponents: vec![Exponents::new(); blocks],
            scaled: false,
            low: false,
            meters: vec![[(Meter::default(), 0.0, 0); K]; rollout.capacity()],
        }
    }

    /// Returns the [`stored_bytes`](Self::stored_bytes) for `n` state and `m` control components.
    pub(super) fn bytes_of(n: usize, m: usize, samples: usize) -> usize {
        let blocks = samples.div_ceil(WIDTH);
        blocks * (2 * n + m) * size_of::<CotangentPack<Lane<F>, K>>()
            + (n + m) * size_of::<Lane<F>>()
            + blocks * size_of::<Exponents<F, K>>()
            + samples * size_of::<[(Meter, f64, i32); K]>()
    }

    pub(super) fn stored_bytes(&self) -> usize {
        let columns = [&self.lambda, &self.x_bar, &self.u_bar].map(|columns| size_of_val(&columns[..]));
        let costs = [&self.cost_x, &self.cost_u].map(|costs| size_of_val(&costs[..]));
        let others = [size_of_val(&self.exponents[..]), size_of_val(&self.meters[..])];
        columns.into_iter().chain(costs).chain(others).sum()
    }

    /// Initializes λ with the gradient of the terminal cost. `norms` has one row per flow, or none.
    pub(super) fn begin(&mut self, pass: &Pass<'_, F>, norms: &mut [Vec<f64>]) {
        let Pass { task, rollout, scale, .. } = *pass;
        let n = rollout.state_dim;
        let last = rollout.states_at(rollout.horizon);
        self.exponents.iter_mut().for_each(|exponents| exponents.reset(scale));
        (self.scaled, self.low) = (false, false);
        self.meters.fill([(Meter::default(), 0.0, 0); K]);
        for (lambda, x) in zip(self.lambda.chunks_exact_mut(n), last.chunks_exact(n)) {
            task.terminal_cost_gradient(x, &mut self.cost_x);
            for (lambda, &x_bar) in zip(lambda.iter_mut(), &self.cost_x) {
                *lambda = CotangentPack([x_bar * Lane::splat(scale); K]);
            }
        }
        self.note_norms(rollout, rollout.horizon, scale, norms);
    }

    /// Runs the recursion (see [`adjoint`](super)) backwards through `steps`, for all flows at
    /// once.
    pub(super) fn back(
        &mut self,
        pass: &Pass<'_, F>,
        task: &dyn StepBack<F, K>,
        flows: [Flow; K],
        steps: Range<usize>,
        policy: &mut PolicyAdjoint<F>,
        norms: &mut [Vec<f64>],
    ) -> Result<(), Divergence> {
        let Pass { rollout, scale, measured, .. } = *pass;
        let (n, m) = (rollout.state_dim, rollout.control_dim);
        for t in steps.rev() {
            let at = rollout.columns(t);
            if self.low || measured {
                let mut costs = |block: usize, of_state: &mut [Lane<F>], of_control: &mut [Lane<F>]| {
                    let (next, u) = (&rollout.states_at(t + 1)[block * n..][..n], &rollout.controls_at(t)[block * m..][..m]);
                    pass.task.stage_cost_gradient(next, u, of_state, of_control);
                };
                if self.low {
                    self.lift(rollout, scale, &mut costs);
                }
                if measured {
                    self.measure_before(rollout, &mut costs);
                }
            }
            let in_range = task.step_back(flows, rollout, t, self);
            if !in_range && self.rescale(flows, rollout, scale) == Size::NotFinite {
                return Err(self.divergence(pass.task, flows, rollout, t));
            }
            for (k, flow) in flows.into_iter().enumerate() {
                gather(&self.u_bar, |h, lane| h.0[k].lane(lane), m, at, &mut policy.controls_bar[k]);
                if self.scaled {
                    let of = |sample: usize| self.exponents[sample / WIDTH].of[k][sample % WIDTH];
                    policy.note_exponents(k, at, of);
                }
                if flow.control {
                    if !policy.unit {
                        policy.backward(pass, k, at, true);
                    }
                    self.add_inputs(k, at, n, policy);
                }
            }
            if measured {
                self.measure_after(rollout);
            }
            self.note_norms(rollout, t, scale, norms);
        }
        Ok(())
    }

    /// Rescales cotangents outside the range of [`Limits`](super::exponents::Limits).
    #[cold]
    fn rescale(&mut self, flows: [Flow; K], rollout: &Rollout<F>, scale: F) -> Size {
        let (n, m) = (rollout.state_dim, rollout.control_dim);
        let blocks = zip(zip(self.lambda.chunks_exact_mut(n), self.u_bar.chunks_exact_mut(m)), &mut self.exponents);
        for ((lambda, u_bar), exponents) in blocks.take(rollout.samples.div_ceil(WIDTH)) {
            for (k, flow) in flows.into_iter().enumerate() {
                for lane in 0..WIDTH {
                    if exponents.rescale(flow, (k, lane), scale, lambda, u_bar) == Size::NotFinite {
                        return Size::NotFinite;
                    }
                }
            }
        }
        self.scaled = self.exponents.iter().any(Exponents::any);
        self.low = self.exponents.iter().any(Exponents::any_low);
        Size::Carried
    }

    /// Resets exponents that are too low for the cost gradients of the next step.
    ///
    /// Samples without a cost gradient at this step keep their exponent.
    #[cold]
    fn lift(&mut self, rollout: &Rollout<F>, scale: F, costs: CostsOf<'_, F>) {
        let n = rollout.state_dim;
        for block in 0..rollout.samples.div_ceil(WIDTH) {
            costs(block, &mut self.cost_x, &mut self.cost_u);
            for lane in 0..WIDTH {
                if self.cost_x.iter().chain(&self.cost_u).any(|cost| cost.lane(lane) != F::zero()) {
                    let lambda = &mut self.lambda[block * n..][..n];
                    (0..K).for_each(|k| self.exponents[block].lift((k, lane), scale, lambda));
                }
            }
        }
        self.low = self.exponents.iter().any(Exponents::any_low);
    }

    /// Records ‖λ + ∂l/∂x‖² before the step.
    fn measure_before(&mut self, rollout: &Rollout<F>, costs: CostsOf<'_, F>) {
        let n = rollout.state_dim;
        for (sample, meters) in self.meters[..rollout.samples].iter_mut().enumerate() {
            let (block, lane) = (sample / WIDTH, sample % WIDTH);
            if lane == 0 {
                costs(block, &mut self.cost_x, &mut self.cost_u);
            }
            let exponents = &self.exponents[block];
            for (k, (_, before, exponent)) in meters.iter_mut().enumerate() {
                let sum = |(lambda, cost): (&CotangentPack<Lane<F>, K>, &Lane<F>)| -> f64 {
                    (lambda.0[k].lane(lane) + cost.lane(lane) * exponents.inject.0[k].lane(lane)).as_()
                };
                let terms = zip(self.lambda[block * n..][..n].iter(), &self.cost_x).map(sum);
                (*before, *exponent) = (terms.map(|x| x * x).sum(), exponents.of[k][lane]);
            }
        }
    }

    /// Adds the growth over the step to the meters.
    fn measure_after(&mut self, rollout: &Rollout<F>) {
        let n = rollout.state_dim;
        for (sample, meters) in self.meters[..rollout.samples].iter_mut().enumerate() {
            let (block, lane) = (sample / WIDTH, sample % WIDTH);
            for (k, (meter, before, exponent)) in meters.iter_mut().enumerate() {
                let of_lane = |lambda: &CotangentPack<Lane<F>, K>| -> f64 { lambda.0[k].lane(lane).as_() };
                let after = self.lambda[block * n..][..n].iter().map(of_lane).map(|x| x * x).sum();
                meter.step(*before, after, self.exponents[block].of[k][lane] - *exponent);
            }
        }
    }

    /// Growth of flow `k` for each sample of the last measured run.
    pub(super) fn meters(&self, k: usize, samples: usize) -> impl Iterator<Item = &Meter> {
        self.meters[..samples].iter().map(move |meters| &meters[k].0)
    }

    /// Records the norm of λ at step `t`, in f64: squares of f32 overflow early.
    fn note_norms(&self, rollout: &Rollout<F>, t: usize, scale: F, norms: &mut [Vec<f64>]) {
        let lambda = |k: usize, sample: usize| {
            let block = &self.lambda[sample / WIDTH * rollout.state_dim..][..rollout.state_dim];
            let exponent = self.exponents[sample / WIDTH].of[k][sample % WIDTH];
            block.iter().map(move |c| times_power_of_two(c.0[k].lane(sample % WIDTH).as_(), exponent))
        };
        for (k, norms) in norms.iter_mut().enumerate() {
            let squares: f64 = (0..rollout.samples).flat_map(|sample| lambda(k, sample)).map(|x: f64| x * x).sum();
            norms[t] = (squares / rollout.samples as f64).sqrt() / scale.as_();
        }
    }

    /// Adds `(∂N/∂x)ᵀ h` to λ of flow `k`.
    fn add_inputs(&mut self, k: usize, at: PolicyColumns, n: usize, policy: &PolicyAdjoint<F>) {
        for (block, lambda) in self.lambda.chunks_exact_mut(n).take(at.count.div_ceil(WIDTH)).enumerate() {
            for lane in 0..WIDTH {
                let sample = (block * WIDTH + lane).min(at.count - 1);
                let c = at.first + sample * at.step;
                // Results for a unit cotangent still lack the factor h.
                let factor = if policy.unit { policy.controls_bar[k][c] } else { F::one() };
                for (lambda, &x_bar) in zip(lambda.iter_mut(), &policy.inputs_bar[c * n..][..n]) {
                    lambda.0[k].0[lane] += x_bar * factor;
                }
            }
        }
    }

    /// Finds the first flow, and its first sample, with a non-finite state or control cotangent.
    #[cold]
    fn divergence(&self, task: &dyn AnyTask<F>, flows: [Flow; K], rollout: &Rollout<F>, step: usize) -> Divergence {
        let find = |columns: &[CotangentPack<Lane<F>, K>], n: usize, k: usize| {
            find_non_finite(columns, n, rollout.samples, |c, lane| c.0[k].lane(lane))
        };
        let state = |k: usize| find(&self.lambda, rollout.state_dim, k).map(|place| (k, Variable::State, place));
        let control = |k: usize| find(&self.u_bar, rollout.control_dim, k).map(|place| (k, Variable::Control, place));
        let first = (0..K).find_map(|k| state(k).or_else(|| control(k)));
        let (k, variable, (sample, component)) = first.expect("the probe saw one of them");
        let of = |lanes: &[Lane<F>], n: usize| -> Vec<F> {
            lanes[sample / WIDTH * n..][..n].iter().map(|number| number.lane(sample % WIDTH)).collect()
        };
        let (x, u) = (of(rollout.states_at(step), rollout.state_dim), of(rollout.controls_at(step), rollout.control_dim));
        Divergence::Cotangent { flow: flows[k], variable, step, sample, component, cause: task.diagnose(&x, &u) }
    }
}
