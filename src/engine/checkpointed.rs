//! [`Checkpointed`]: forward and reverse passes of a batch of samples, with checkpoints by a
//! [`Schedule`].

use crate::engine::adjoint::Adjoint;
use crate::engine::any::AnyTask;
use crate::engine::divergence::Divergence;
use crate::engine::flow::Flow;
use crate::engine::gradient::Gradient;
use crate::engine::pass::{Closed, Pass};
use crate::engine::rollout::Rollout;
use crate::engine::schedule::{MemoryError, Schedule, split};
use crate::numbers::scalar::{Float, LANES, Lane, Real, Scalar};
use crate::policy::AnyPolicy;
use crate::policy::Weights;

/// Batch of rollouts with their gradients. Stores the tape of one segment at a time.
///
/// The constructor allocates all buffers. A run allocates only in the cases that [`Adjoint`] lists.
/// Gradients are bitwise equal to those of [`Rollout`] and [`Adjoint`], for every schedule.
/// ```
/// use physgrad::{Flow, Gradient, Weights, initial_states, policy::Mlp, rng, tasks::CartPole, engine::{Checkpointed, Schedule}};
///
/// let (task, policy) = (CartPole { horizon: 1000, ..CartPole::new(1) }, Mlp::new([4, 16, 1]));
/// let weights = Weights::<f64>::init(&policy, &mut rng::stream(0, rng::Purpose::Policy, 0));
/// let starts = initial_states(&task, 0, rng::Purpose::Train, 1);
///
/// let flows = [Flow::REGULAR];
/// let schedule = Checkpointed::<f64>::schedule_within(&task, &policy, 1, &flows, 200_000)?;
/// let mut gradient = [vec![Gradient::zeros(weights.theta().len())]];
/// let mut rollout = Checkpointed::new(&task, &policy, 1, &flows, schedule);
/// rollout.run(&task, &policy, &weights, &starts, 1.0, 1, &mut gradient)?;
/// assert!(rollout.stored_bytes() <= 200_000);
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
#[derive(Debug)]
pub struct Checkpointed<F: Float> {
    schedule: Schedule,
    /// Rollout that stores one segment.
    rollout: Rollout<F>,
    adjoint: Adjoint<F>,
    /// Length of the states and memories of all samples at one step, in lanes.
    state_len: usize,
    /// Checkpoints. Each has states, `[block][component]`, then memories, `[block][component]`.
    states: Vec<Lane<F>>,
    /// Segments that start at a checkpoint, in ascending order.
    kept: Vec<usize>,
    /// Costs of the forward pass, copied because recomputed steps change the costs of `rollout`.
    costs: Vec<Lane<F>>,
}

impl<F: Float> Checkpointed<F> {
    /// Allocates a workspace for `samples` rollouts and the gradients of one or two flows.
    ///
    /// # Panics
    /// As [`Rollout::new`]. Also if the horizons of schedule and task differ, or `flows` does not
    /// have one or two elements.
    #[track_caller]
    pub fn new(
        task: &dyn AnyTask<F>,
        policy: &dyn AnyPolicy<F>,
        samples: usize,
        flows: &[Flow],
        schedule: Schedule,
    ) -> Self {
        let (planned, horizon) = (schedule.horizon(), task.horizon());
        assert_eq!(
            planned, horizon,
            "the schedule has a horizon of {planned} steps, but the task has {horizon}"
        );
        let rollout = Rollout::with_steps(task, policy, samples, schedule.segment());
        let adjoint = Adjoint::of_kept(task, policy, &rollout, flows);
        let blocks = samples.div_ceil(LANES);
        let state_len = blocks * (task.state_dim() + policy.memory_dim());
        Self {
            schedule,
            rollout,
            adjoint,
            state_len,
            states: vec![Lane::zero(); schedule.checkpoints() * state_len],
            kept: Vec::with_capacity(schedule.checkpoints()),
            costs: vec![Lane::zero(); blocks],
        }
    }

    /// Finds a schedule with few recomputed steps within `budget` bytes.
    ///
    /// The number of recomputed steps exceeds the minimum within the budget by at most 1 % of the
    /// horizon.
    ///
    /// # Errors
    /// [`MemoryError`] if no schedule fits.
    pub fn schedule_within(
        task: &dyn AnyTask<F>,
        policy: &dyn AnyPolicy<F>,
        samples: usize,
        flows: &[Flow],
        budget: u64,
    ) -> Result<Schedule, MemoryError> {
        Schedule::within(task.horizon(), budget, |schedule| {
            Self::bytes_of(task, policy, samples, flows, schedule)
        })
    }

    /// Returns the [`stored_bytes`](Checkpointed::stored_bytes) of a workspace with this schedule,
    /// without allocating it.
    pub fn bytes_of(
        task: &dyn AnyTask<F>,
        policy: &dyn AnyPolicy<F>,
        samples: usize,
        flows: &[Flow],
        schedule: &Schedule,
    ) -> usize {
        let (segment, blocks) = (schedule.segment(), samples.div_ceil(LANES));
        let checkpoint = blocks * (task.state_dim() + policy.memory_dim()) * size_of::<Lane<F>>()
            + size_of::<usize>();
        Rollout::<F>::bytes_of(task, policy, samples, segment)
            + Adjoint::<F>::bytes_of(task, policy, samples, segment, flows)
            + schedule.checkpoints() * checkpoint
            + blocks * size_of::<Lane<F>>()
    }

    /// Bytes on the heap, independent of the number of samples in a run.
    pub fn stored_bytes(&self) -> usize {
        let own = size_of_val(&self.states[..])
            + self.kept.capacity() * size_of::<usize>()
            + size_of_val(&self.costs[..]);
        self.rollout.stored_bytes() + self.adjoint.stored_bytes() + own
    }

    /// Schedule of stored and recomputed steps.
    pub fn schedule(&self) -> Schedule {
        self.schedule
    }

    /// Number of samples of the last run.
    pub fn samples(&self) -> usize {
        self.rollout.samples()
    }

    /// Largest number of samples.
    pub fn capacity(&self) -> usize {
        self.rollout.capacity()
    }

    /// The rollout, which stores the last segment.
    pub(crate) fn rollout(&self) -> &Rollout<F> {
        &self.rollout
    }

    /// Numbers per sample in a list of initial states.
    pub(crate) fn start_dim(&self) -> usize {
        self.rollout.start_dim()
    }

    /// Cost of one sample of the last run.
    ///
    /// # Panics
    /// If there is no such sample.
    #[track_caller]
    pub fn cost(&self, sample: usize) -> F {
        assert!(
            sample < self.samples(),
            "there is no sample {sample}: the run has {}",
            self.samples()
        );
        self.costs[sample / LANES].lane(sample % LANES)
    }

    /// Runs rollouts from `starts` (see [`initial_states`](crate::initial_states)) and their
    /// reverse passes.
    ///
    /// Writes `gradients`, `[group][flow][parameter]`, each the sum over up to `group` successive
    /// samples. Groups without samples are unchanged. All cotangents are multiplied by `scale`. Use
    /// 1 / batch size for the gradient of a batch mean.
    ///
    /// # Errors
    /// [`Divergence`] if a state, control, memory or cost, or a cotangent of a state, control or
    /// memory, is non-finite. The gradients are then invalid.
    ///
    /// # Panics
    /// If `starts` is empty, exceeds the capacity, or is not a whole number of samples. If `group`
    /// is 0, `gradients` has too few groups, or a group does not have one gradient per flow.
    #[track_caller]
    #[allow(clippy::too_many_arguments)]
    pub fn run(
        &mut self,
        task: &dyn AnyTask<F>,
        policy: &dyn AnyPolicy<F>,
        weights: &Weights<F>,
        starts: &[F],
        scale: F,
        group: usize,
        gradients: &mut [Vec<Gradient<F>>],
    ) -> Result<(), Divergence> {
        let closed = Closed { task, policy, weights };
        self.run_unnormalized(closed, starts, scale, group, gradients)?;
        gradients.iter_mut().flatten().for_each(Gradient::normalize);
        Ok(())
    }

    /// Like [`run`](Checkpointed::run), but without a common exponent: callers sum and normalize
    /// the gradients.
    #[track_caller]
    pub(crate) fn run_unnormalized(
        &mut self,
        closed: Closed<'_, F>,
        starts: &[F],
        scale: F,
        group: usize,
        gradients: &mut [Vec<Gradient<F>>],
    ) -> Result<(), Divergence> {
        let samples = starts.len() / self.start_dim();
        let groups = samples.div_ceil(group);
        assert!(
            groups <= gradients.len(),
            "{samples} samples form {groups} groups of {group}, but `gradients` has {} groups",
            gradients.len()
        );
        let gradients = &mut gradients[..groups];
        let flows = self.adjoint.flows().len();
        if let Some(group) = gradients.iter().find(|group| group.len() != flows) {
            panic!("a group has {} gradients for {flows} flows; pass one per flow", group.len());
        }
        gradients.iter_mut().flatten().for_each(Gradient::clear);

        let segments = self.schedule.segments();
        self.forward(closed, starts)?;
        let measured = self.adjoint.measures();
        self.adjoint.begin(&Pass { closed, rollout: &self.rollout, scale, measured });
        let samples_of = |g: usize| g * group..samples.min((g + 1) * group);
        for index in (0..segments).rev() {
            if index + 1 < segments {
                self.tape_again(closed, index)?;
            }
            // Adds the parameter gradient of a unit while its cotangents are in the cache.
            for unit in Rollout::<F>::units(self.schedule.steps(index)) {
                let pass = Pass { closed, rollout: &self.rollout, scale, measured };
                self.adjoint.back(&pass, unit.clone())?;
                for (g, gradient) in gradients.iter_mut().enumerate() {
                    for (k, sum) in gradient.iter_mut().enumerate() {
                        self.adjoint.add_param_gradient(k, &pass, &unit, samples_of(g), sum);
                    }
                }
            }
        }
        let Closed { policy, weights, .. } = closed;
        for (g, gradient) in gradients.iter_mut().enumerate() {
            for (k, sum) in gradient.iter_mut().enumerate() {
                self.adjoint.add_trained_gradient(k, policy, weights, samples_of(g), sum);
            }
        }
        Ok(())
    }

    /// Enables or disables the measurement of growth.
    pub(crate) fn measure(&mut self, measured: bool) {
        self.adjoint.measure(measured);
    }

    /// Calls `add` with the two numbers of [`Growth`](crate::engine::Growth) of flow `k`, for each
    /// sample of the last run. Both are 0 if not measured.
    pub(crate) fn growth(&self, k: usize, add: &mut dyn FnMut([f64; 2])) {
        self.adjoint.growth(k, self.rollout.samples(), add);
    }

    /// Runs the forward pass. Stores checkpoints and the tape of the last segment.
    fn forward(&mut self, closed: Closed<'_, F>, starts: &[F]) -> Result<(), Divergence> {
        self.kept.clear();
        self.rollout.start(starts);
        self.rollout.clear_costs();
        let last = self.schedule.segments() - 1;
        if last > 0 {
            self.keep(0);
        }
        self.advance(closed, 0, last)?;
        let finished = self.rollout.finish(closed.task);
        self.costs.copy_from_slice(&self.rollout.costs);
        finished
    }

    /// Recomputes the tape of segment `index` from the last checkpoint at or before its start.
    fn tape_again(&mut self, closed: Closed<'_, F>, index: usize) -> Result<(), Divergence> {
        // Discards checkpoints after this segment.
        self.kept.truncate(self.kept.partition_point(|&kept| kept <= index));
        let slot = self.kept.len() - 1;
        let from = self.kept[slot];
        let state = self.rollout.carried_at_mut(self.schedule.steps(from).start);
        let len = state.len();
        state.copy_from_slice(&self.states[slot * self.state_len..][..len]);
        self.advance(closed, from, index)
    }

    /// Runs from the start of segment `from` to the end of segment `to`, and stores checkpoints in
    /// between.
    ///
    /// Afterwards, `rollout` contains the tape of segment `to`.
    fn advance(&mut self, closed: Closed<'_, F>, from: usize, to: usize) -> Result<(), Divergence> {
        let mut at = from;
        while at < to {
            let free = self.schedule.checkpoints() - self.kept.len();
            let next = at + split(to + 1 - at, free + 1);
            let steps = self.schedule.steps(at).start..self.schedule.steps(next).start;
            self.rollout.pass_over(closed, steps)?;
            at = next;
            // Segment `to` needs no checkpoint: its tape is stored next.
            if at < to {
                self.keep(at);
            }
        }
        self.rollout.advance(closed, self.schedule.steps(to))
    }

    /// Stores the states and memories at the start of segment `index`.
    fn keep(&mut self, index: usize) {
        let state = self.rollout.carried_at(self.schedule.steps(index).start);
        self.states[self.kept.len() * self.state_len..][..state.len()].copy_from_slice(state);
        self.kept.push(index);
    }
}
