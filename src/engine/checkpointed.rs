//! [`Checkpointed`]: forward and reverse pass of a batch of samples, in the memory that a [`Schedule`] takes.

use crate::engine::adjoint::{Adjoint, Flow, Pass};
use crate::engine::any::AnyTask;
use crate::engine::divergence::Divergence;
use crate::engine::gradient::Gradient;
use crate::engine::growth::Together;
use crate::engine::rollout::{Lane, Rollout, WIDTH};
use crate::engine::schedule::{MemoryError, Schedule, split};
use crate::numbers::scalar::{Float, Real, Scalar};
use crate::policy::AnyPolicy;
use crate::policy::Weights;

/// A batch of rollouts and their gradients, with a tape of one segment at a time: sized once, then run as often as one
/// likes without allocating.
///
/// The gradients are bit for bit those of [`Rollout`] and [`Adjoint`], whatever the schedule.
/// ```
/// use physgrad::{Checkpointed, Flow, Gradient, Schedule, Task, Weights, policy::Mlp, rng, tasks::CartPole};
///
/// let (task, policy) = (CartPole { horizon: 1000, ..CartPole::new(1) }, Mlp::new([4, 16, 1]));
/// let weights = Weights::<f64>::init(&policy, &mut rng::stream(0, rng::Purpose::Policy, 0));
/// let mut start = [0.0; 4];
/// task.start(&mut rng::stream(0, rng::Purpose::Train, 0), &mut start);
///
/// let flows = [Flow::REGULAR];
/// let schedule = Checkpointed::<f64>::schedule_within(&task, &policy, 1, &flows, 200_000)?;
/// let mut gradient = [vec![Gradient::zeros(weights.theta().len())]];
/// let mut rollout = Checkpointed::new(&task, &policy, 1, &flows, schedule);
/// rollout.run(&task, &policy, &weights, &start, 1.0, 1, &mut gradient)?;
/// assert!(rollout.stored_bytes() <= 200_000);
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
#[derive(Debug)]
pub struct Checkpointed<F: Float> {
    schedule: Schedule,
    /// Keeps one segment.
    rollout: Rollout<F>,
    adjoint: Adjoint<F>,
    /// Lanes of one state of all samples there is room for.
    state_len: usize,
    /// `[checkpoint][block][component]`.
    states: Vec<Lane<F>>,
    /// The segments at whose start the checkpoints are, in ascending order.
    kept: Vec<usize>,
    /// Of the forward pass: what is run again adds to those of the rollout.
    costs: Vec<Lane<F>>,
}

impl<F: Float> Checkpointed<F> {
    /// Room for `samples` rollouts and the gradients of one or two flows.
    ///
    /// # Panics
    /// If the schedule is for another horizon, without samples, with no flow or more than two, or if the shapes of task
    /// and policy differ.
    #[track_caller]
    pub fn new(task: &dyn AnyTask<F>, policy: &dyn AnyPolicy<F>, samples: usize, flows: &[Flow], schedule: Schedule) -> Self {
        let (planned, horizon) = (schedule.horizon(), task.horizon());
        assert_eq!(planned, horizon, "the schedule is for a horizon of {planned} steps, the task has {horizon}");
        let rollout = Rollout::with_steps(task, policy, samples, schedule.segment());
        let adjoint = Adjoint::of_kept(policy, &rollout, flows);
        let blocks = samples.div_ceil(WIDTH);
        let state_len = blocks * policy.state_dim();
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

    /// The schedule that runs the fewest steps again among those that take at most `budget` bytes.
    ///
    /// # Errors
    /// [`MemoryError`] says how many bytes would do.
    pub fn schedule_within(
        task: &dyn AnyTask<F>,
        policy: &dyn AnyPolicy<F>,
        samples: usize,
        flows: &[Flow],
        budget: u64,
    ) -> Result<Schedule, MemoryError> {
        Schedule::within(task.horizon(), budget, |schedule| Self::bytes_of(policy, samples, flows, schedule))
    }

    /// The [`stored_bytes`](Checkpointed::stored_bytes) of a schedule, without taking them.
    pub fn bytes_of(policy: &dyn AnyPolicy<F>, samples: usize, flows: &[Flow], schedule: &Schedule) -> usize {
        let (segment, blocks) = (schedule.segment(), samples.div_ceil(WIDTH));
        let checkpoint = blocks * policy.state_dim() * size_of::<Lane<F>>() + size_of::<usize>();
        Rollout::<F>::bytes_of(policy, samples, segment)
            + Adjoint::<F>::bytes_of(policy, samples, segment, flows)
            + schedule.checkpoints() * checkpoint
            + blocks * size_of::<Lane<F>>()
    }

    /// Bytes on the heap. They do not depend on how many samples are started.
    pub fn stored_bytes(&self) -> usize {
        let own = size_of_val(&self.states[..]) + self.kept.capacity() * size_of::<usize>() + size_of_val(&self.costs[..]);
        self.rollout.stored_bytes() + self.adjoint.stored_bytes() + own
    }

    /// What it keeps, and what it runs again.
    pub fn schedule(&self) -> Schedule {
        self.schedule
    }

    /// Number of samples of the last run.
    pub fn samples(&self) -> usize {
        self.rollout.samples()
    }

    /// Number of samples there is room for.
    pub fn capacity(&self) -> usize {
        self.rollout.capacity()
    }

    /// Cost of one sample of the last run.
    pub fn cost(&self, sample: usize) -> F {
        self.costs[sample / WIDTH].lane(sample % WIDTH)
    }

    /// Rollouts from `starts` (`state_dim` numbers per sample) and their gradients, `[group][flow][parameter]`, each the
    /// sum over `group` successive samples. Those of groups without samples are left as they are. Cotangents are scaled by
    /// `scale`: 1 / batch for a batch mean.
    ///
    /// # Errors
    /// [`Divergence`] says where a number was not finite. The gradients are then not to be used.
    ///
    /// # Panics
    /// If `starts` is empty, no whole number of samples or too long, or if there are too few groups.
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
        self.run_unsettled(task, policy, weights, starts, scale, group, gradients)?;
        gradients.iter_mut().flatten().for_each(Gradient::settle);
        Ok(())
    }

    /// As [`run`](Checkpointed::run), with gradients that are still to be added up.
    #[track_caller]
    #[allow(clippy::too_many_arguments)]
    pub(crate) fn run_unsettled(
        &mut self,
        task: &dyn AnyTask<F>,
        policy: &dyn AnyPolicy<F>,
        weights: &Weights<F>,
        starts: &[F],
        scale: F,
        group: usize,
        gradients: &mut [Vec<Gradient<F>>],
    ) -> Result<(), Divergence> {
        let samples = starts.len() / task.state_dim();
        let groups = samples.div_ceil(group);
        assert!(groups <= gradients.len(), "{samples} samples are {groups} groups of {group}, not {}", gradients.len());
        let gradients = &mut gradients[..groups];
        gradients.iter_mut().flatten().for_each(Gradient::clear);

        let segments = self.schedule.segments();
        self.forward(task, policy, weights, starts)?;
        let measured = self.adjoint.measures();
        self.adjoint.begin(&Pass { task, policy, weights, rollout: &self.rollout, scale, measured });
        for index in (0..segments).rev() {
            if index + 1 < segments {
                self.tape_again(task, policy, weights, index)?;
            }
            // The parameter gradient of a unit while its cotangents are in the cache.
            for unit in Rollout::<F>::units(self.schedule.steps(index)) {
                self.adjoint.back(&Pass { task, policy, weights, rollout: &self.rollout, scale, measured }, unit.clone())?;
                for (g, gradient) in gradients.iter_mut().enumerate() {
                    let own = g * group..samples.min((g + 1) * group);
                    for (k, sum) in gradient.iter_mut().enumerate() {
                        self.adjoint.add_param_gradient(k, policy, weights, &self.rollout, &unit, own.clone(), sum);
                    }
                }
            }
        }
        Ok(())
    }

    /// Whether the next runs measure how the adjoints grow, which takes a little time.
    pub(crate) fn measure(&mut self, measured: bool) {
        self.adjoint.measure(measured);
    }

    /// Adds the growth of flow number `k` in the last run, of every sample, if that was measured.
    pub(crate) fn add_growth(&self, k: usize, together: &mut Together) {
        self.adjoint.add_growth(k, self.rollout.samples(), together);
    }

    /// The forward pass, which leaves checkpoints and the tape of the last segment.
    fn forward(
        &mut self,
        task: &dyn AnyTask<F>,
        policy: &dyn AnyPolicy<F>,
        weights: &Weights<F>,
        starts: &[F],
    ) -> Result<(), Divergence> {
        self.kept.clear();
        self.rollout.start(starts);
        self.rollout.costs.fill(Lane::zero());
        let last = self.schedule.segments() - 1;
        if last > 0 {
            self.keep(0);
        }
        self.advance(task, policy, weights, 0, last)?;
        let finished = self.rollout.finish(task);
        self.costs.copy_from_slice(&self.rollout.costs);
        finished
    }

    /// Runs from the last checkpoint to the end of a segment, whose tape is then there.
    fn tape_again(
        &mut self,
        task: &dyn AnyTask<F>,
        policy: &dyn AnyPolicy<F>,
        weights: &Weights<F>,
        index: usize,
    ) -> Result<(), Divergence> {
        // Those after this segment have served.
        self.kept.truncate(self.kept.partition_point(|&kept| kept <= index));
        let slot = self.kept.len() - 1;
        let from = self.kept[slot];
        let state = self.rollout.states_at_mut(self.schedule.steps(from).start);
        let len = state.len();
        state.copy_from_slice(&self.states[slot * self.state_len..][..len]);
        self.advance(task, policy, weights, from, index)
    }

    /// Runs from the start of segment `from` to the end of segment `to`, and keeps states on the way.
    fn advance(
        &mut self,
        task: &dyn AnyTask<F>,
        policy: &dyn AnyPolicy<F>,
        weights: &Weights<F>,
        from: usize,
        to: usize,
    ) -> Result<(), Divergence> {
        let mut at = from;
        while at < to {
            let free = self.schedule.checkpoints() - self.kept.len();
            let next = at + split(to + 1 - at, free + 1);
            let steps = self.schedule.steps(at).start..self.schedule.steps(next).start;
            self.rollout.pass_over(task, policy, weights, steps)?;
            at = next;
            // The last one's tape is about to be there.
            if at < to {
                self.keep(at);
            }
        }
        self.rollout.advance(task, policy, weights, self.schedule.steps(to))
    }

    /// Keeps the state at the start of a segment.
    fn keep(&mut self, index: usize) {
        let state = self.rollout.states_at(self.schedule.steps(index).start);
        self.states[self.kept.len() * self.state_len..][..state.len()].copy_from_slice(state);
        self.kept.push(index);
    }
}
