//! [`Batch`]: gradients of a mini-batch. [`Evaluation`]: loss of a data set. Both use several
//! workers.
//!
//! Results do not depend on the number of workers. Samples are independent. Gradients are summed
//! over fixed groups of samples, and groups are summed in order.

use crate::engine::adjoint::Flow;
use crate::engine::any::AnyTask;
use crate::engine::checkpointed::Checkpointed;
use crate::engine::divergence::Divergence;
use crate::engine::gradient::Gradient;
use crate::engine::growth::{Growth, GrowthStats};
use crate::engine::parallel::for_each;
use crate::engine::rollout::Rollout;
use crate::engine::schedule::{MemoryError, Schedule};
use crate::numbers::scalar::Float;
use crate::policy::AnyPolicy;
use crate::policy::Weights;
use std::ops::Range;

/// Number of samples in a group. Each group has one gradient sum, for any number of workers.
const GROUP: usize = 4;
/// Number of samples in one rollout of an evaluation.
const EVALUATED: usize = 32;

/// Workspace for the gradients of mini-batches of up to a fixed size.
#[derive(Debug)]
pub struct Batch<F: Float> {
    workers: Vec<Worker<F>>,
    gradients: Vec<Gradient<F>>,
    /// True if runs measure the growth of the adjoints.
    measured: bool,
}

/// Workspace of one worker, for consecutive groups of samples.
#[derive(Debug)]
struct Worker<F: Float> {
    rollout: Checkpointed<F>,
    /// Gradients, `[group][flow][parameter]`.
    groups: Vec<Vec<Gradient<F>>>,
    outcome: Result<(), Divergence>,
    /// True if the last run assigned samples to this worker.
    active: bool,
}

impl<F: Float> Batch<F> {
    /// Allocates a workspace for mini-batches of up to `samples` samples and one or two flows.
    ///
    /// At most `workers` workers share a mini-batch. All steps are stored.
    ///
    /// # Panics
    /// If `samples` or the horizon is 0, `flows` does not have one or two elements, or the shapes
    /// of task and policy differ.
    #[track_caller]
    pub fn new(task: &dyn AnyTask<F>, policy: &dyn AnyPolicy<F>, samples: usize, flows: &[Flow], workers: usize) -> Self {
        Self::scheduled(task, policy, samples, flows, workers, Schedule::store_all(task.horizon()))
    }

    /// Allocates a workspace of at most `budget` bytes, over all workers.
    ///
    /// The schedule recomputes at most 1 % of the horizon more steps than the minimum. Gradients
    /// are bitwise equal to those of [`new`](Batch::new).
    ///
    /// # Errors
    /// [`MemoryError`] if no schedule fits.
    ///
    /// # Panics
    /// As [`new`](Batch::new).
    #[track_caller]
    pub fn within(
        task: &dyn AnyTask<F>,
        policy: &dyn AnyPolicy<F>,
        samples: usize,
        flows: &[Flow],
        workers: usize,
        budget: u64,
    ) -> Result<Self, MemoryError> {
        let bytes = |schedule: &Schedule| Self::bytes_of(task, policy, samples, flows, workers, schedule);
        let schedule = Schedule::within(task.horizon(), budget, bytes)?;
        Ok(Self::scheduled(task, policy, samples, flows, workers, schedule))
    }

    /// Allocates a workspace with a given schedule for each worker.
    ///
    /// # Panics
    /// As [`new`](Batch::new), or if the horizons of schedule and task differ.
    #[track_caller]
    pub fn scheduled(
        task: &dyn AnyTask<F>,
        policy: &dyn AnyPolicy<F>,
        samples: usize,
        flows: &[Flow],
        workers: usize,
        schedule: Schedule,
    ) -> Self {
        assert!(samples > 0, "a mini-batch needs at least one sample");
        let zeros = || flows.iter().map(|_| Gradient::zeros(policy.param_count())).collect::<Vec<_>>();
        let shares = shares(samples, workers);
        // Allocates the exact capacity, which `stored_bytes` assumes.
        let mut all = Vec::with_capacity(shares.len());
        all.extend(shares.map(|share| {
            let groups = share.len().div_ceil(GROUP);
            let rollout = Checkpointed::new(task, policy, share.len(), flows, schedule);
            Worker { rollout, groups: (0..groups).map(|_| zeros()).collect(), outcome: Ok(()), active: false }
        }));
        Self { workers: all, gradients: zeros(), measured: false }
    }

    /// Returns the [`stored_bytes`](Batch::stored_bytes) of a schedule without allocating.
    ///
    /// # Panics
    /// If `samples` is 0.
    #[track_caller]
    pub fn bytes_of(
        task: &dyn AnyTask<F>,
        policy: &dyn AnyPolicy<F>,
        samples: usize,
        flows: &[Flow],
        workers: usize,
        schedule: &Schedule,
    ) -> usize {
        assert!(samples > 0, "a mini-batch needs at least one sample");
        let gradients = flows.len() * (size_of::<Gradient<F>>() + Gradient::<F>::bytes_of(policy.param_count()));
        let worker = |share: Range<usize>| {
            let groups = share.len().div_ceil(GROUP) * (size_of::<Vec<Gradient<F>>>() + gradients);
            size_of::<Worker<F>>() + groups + Checkpointed::<F>::bytes_of(task, policy, share.len(), flows, schedule)
        };
        shares(samples, workers).map(worker).sum::<usize>() + gradients
    }

    /// Bytes on the heap, independent of the number of samples in a run.
    pub fn stored_bytes(&self) -> usize {
        let nested = |rows: &[Gradient<F>]| size_of_val(rows) + rows.iter().map(Gradient::stored_bytes).sum::<usize>();
        let worker = |worker: &Worker<F>| {
            let groups = worker.groups.iter().map(|group| nested(group)).sum::<usize>();
            size_of_val(&worker.groups[..]) + groups + worker.rollout.stored_bytes()
        };
        size_of_val(&self.workers[..]) + self.workers.iter().map(worker).sum::<usize>() + nested(&self.gradients)
    }

    /// Schedule of every worker.
    pub fn schedule(&self) -> Schedule {
        self.workers[0].rollout.schedule()
    }

    /// Runs rollouts from `starts` (see [`initial_states`](crate::initial_states)) and their reverse
    /// passes.
    ///
    /// Computes the gradient of the mean loss for each flow, and returns the mean loss.
    ///
    /// # Errors
    /// The first [`Divergence`] of the batch. The gradients are then invalid.
    ///
    /// # Panics
    /// If `starts` is empty, exceeds the capacity, or is not a whole number of samples.
    #[track_caller]
    pub fn run(
        &mut self,
        task: &dyn AnyTask<F>,
        policy: &dyn AnyPolicy<F>,
        weights: &Weights<F>,
        starts: &[F],
    ) -> Result<f64, Divergence> {
        let n = task.start_dim();
        let samples = starts.len() / n;
        let capacity: usize = self.workers.iter().map(|w| w.rollout.capacity()).sum();
        assert!(
            samples > 0 && samples <= capacity && starts.len().is_multiple_of(n),
            "got {} numbers; expected 1 to {capacity} samples of {n} numbers each",
            starts.len()
        );
        let scale = F::lift(1.0 / samples as f64);
        let per_worker = self.workers[0].rollout.capacity();
        for_each(&mut self.workers, &|index, worker| {
            let own = starts.chunks(per_worker * n).nth(index).unwrap_or(&[]);
            worker.outcome = worker.run(task, policy, weights, own, scale);
        });

        let active = samples.div_ceil(per_worker);
        let diverged = self.workers[..active].iter().enumerate();
        let diverged = diverged.filter_map(|(i, w)| w.outcome.err().map(|d| d.offset(i * per_worker)));
        if let Some(first) = diverged.min_by_key(Divergence::order) {
            return Err(first);
        }
        for (k, gradient) in self.gradients.iter_mut().enumerate() {
            let groups = self.workers[..active].iter().flat_map(|w| w.groups.iter().take(w.rollout.samples().div_ceil(GROUP)));
            for (g, group) in groups.enumerate() {
                if g == 0 {
                    gradient.copy_from(&group[k]);
                } else {
                    gradient.add(&group[k]);
                }
            }
            gradient.normalize();
        }
        let costs = self.workers[..active].iter().flat_map(|w| (0..w.rollout.samples()).map(|s| w.rollout.cost(s).as_()));
        Ok(costs.sum::<f64>() / samples as f64)
    }

    /// Gradients of the last [`run`](Batch::run), one per flow.
    pub fn gradients(&self) -> &[Gradient<F>] {
        &self.gradients
    }

    /// Enables or disables the measurement of growth, which evaluates the cost gradients of each
    /// step a second time.
    pub fn measure(&mut self, measured: bool) {
        self.measured = measured;
        self.workers.iter_mut().for_each(|worker| worker.rollout.measure(measured));
    }

    /// Growth of the adjoint of flow `k` in the last run, if measured.
    pub fn growth(&self, k: usize) -> Option<Growth> {
        let mut stats = GrowthStats::default();
        let active = self.workers.iter().filter(|worker| self.measured && worker.active);
        active.for_each(|worker| worker.rollout.add_growth(k, &mut stats));
        stats.growth()
    }
}

impl<F: Float> Worker<F> {
    fn run(
        &mut self,
        task: &dyn AnyTask<F>,
        policy: &dyn AnyPolicy<F>,
        weights: &Weights<F>,
        starts: &[F],
        scale: F,
    ) -> Result<(), Divergence> {
        self.active = !starts.is_empty();
        if starts.is_empty() {
            return Ok(());
        }
        self.rollout.run_unnormalized(task, policy, weights, starts, scale, GROUP, &mut self.groups)
    }
}

/// Returns one range of samples per worker. Each range consists of whole groups, except the last.
fn shares(samples: usize, workers: usize) -> impl ExactSizeIterator<Item = Range<usize>> {
    let groups = samples.div_ceil(GROUP);
    let each = groups.div_ceil(workers.clamp(1, groups)) * GROUP;
    (0..samples).step_by(each).map(move |first| first..samples.min(first + each))
}

/// Workspace for the loss of a data set.
#[derive(Debug)]
pub struct Evaluation<F: Float> {
    workers: Vec<Evaluator<F>>,
}

#[derive(Debug)]
struct Evaluator<F: Float> {
    rollout: Rollout<F>,
    costs: Vec<f64>,
    outcome: Result<(), Divergence>,
}

impl<F: Float> Evaluation<F> {
    /// Allocates a workspace for data sets of any size, split over `workers` workers (at least
    /// one).
    pub fn new(task: &dyn AnyTask<F>, policy: &dyn AnyPolicy<F>, workers: usize) -> Self {
        let evaluator =
            || Evaluator { rollout: Rollout::for_evaluation(task, policy, EVALUATED), costs: Vec::new(), outcome: Ok(()) };
        Self { workers: (0..workers.max(1)).map(|_| evaluator()).collect() }
    }

    /// Returns the mean loss of rollouts from `starts`; see
    /// [`initial_states`](crate::initial_states).
    ///
    /// # Errors
    /// [`Divergence`] if a control, state or cost is not finite.
    ///
    /// # Panics
    /// If `starts` is empty or not a whole number of samples.
    #[track_caller]
    pub fn run(
        &mut self,
        task: &dyn AnyTask<F>,
        policy: &dyn AnyPolicy<F>,
        weights: &Weights<F>,
        starts: &[F],
    ) -> Result<f64, Divergence> {
        let n = task.start_dim();
        let samples = starts.len() / n;
        assert!(
            samples > 0 && starts.len().is_multiple_of(n),
            "got {} numbers; expected one or more samples of {n} numbers each",
            starts.len()
        );
        let per_worker = samples.div_ceil(EVALUATED).div_ceil(self.workers.len()) * EVALUATED;
        for_each(&mut self.workers, &|index, worker| {
            worker.costs.clear();
            let own = starts.chunks(per_worker * n).nth(index).unwrap_or(&[]);
            worker.outcome = own.chunks(EVALUATED * n).enumerate().try_for_each(|(i, starts)| {
                worker.rollout.start(starts);
                let outcome = worker.rollout.run(task, policy, weights);
                worker.costs.extend((0..worker.rollout.samples()).map(|s| worker.rollout.cost(s).as_()));
                outcome.map_err(|d| d.offset(index * per_worker + i * EVALUATED))
            });
        });
        match self.workers.iter().find_map(|w| w.outcome.err()) {
            Some(divergence) => Err(divergence),
            None => Ok(self.workers.iter().flat_map(|w| &w.costs).sum::<f64>() / samples as f64),
        }
    }
}
