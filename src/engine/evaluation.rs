//! [`Evaluation`]: loss of a data set, by forward passes on several workers.
//!
//! Several [`Ranks`] share whole rollouts of 32 samples, so results do not depend on the number of
//! ranks.

use crate::engine::any::AnyTask;
use crate::engine::divergence::Divergence;
use crate::engine::parallel::for_each;
use crate::engine::pass::Closed;
use crate::engine::ranks::{Ranks, gather, gather_f64, samples_of};
use crate::engine::rollout::Rollout;
use crate::numbers::scalar::{Float, LANES, Real as _};
use crate::policy::AnyPolicy;
use crate::policy::Weights;
use std::ops::Range;
use std::sync::Arc;

/// Number of samples in one rollout of an evaluation.
const EVALUATED: usize = 32;

/// Number of steps of an episode at which controls are compared with their bounds.
const COMPARED: usize = 32;

/// Workspace for the loss of a data set.
#[derive(Debug)]
pub struct Evaluation<F: Float> {
    workers: Vec<Evaluator<F>>,
    /// Processes that share the samples.
    ranks: Option<Arc<dyn Ranks>>,
}

#[derive(Debug)]
struct Evaluator<F: Float> {
    rollout: Rollout<F>,
    costs: Vec<f64>,
    /// Steps of the episodes, if they can end.
    lengths: Vec<f64>,
    /// Bounds of the controls. Empty for none.
    bounds: Vec<[f64; 2]>,
    /// Number of controls that were compared with their bounds, and of those at a bound.
    compared: [usize; 2],
    outcome: Result<(), Divergence>,
}

impl<F: Float> Evaluator<F> {
    /// Runs the rollout, and compares controls with their bounds.
    fn run(
        &mut self,
        task: &dyn AnyTask<F>,
        policy: &dyn AnyPolicy<F>,
        weights: &Weights<F>,
    ) -> Result<(), Divergence> {
        if self.bounds.is_empty() {
            return self.rollout.run(task, policy, weights);
        }
        let horizon = task.horizon();
        let parts = COMPARED.min(horizon);
        self.rollout.clear_costs();
        for part in 0..parts {
            let steps = part * horizon / parts..(part + 1) * horizon / parts;
            let last = steps.end - 1;
            self.rollout.advance(Closed { task, policy, weights }, steps)?;
            self.compare(task, last);
        }
        self.rollout.finish(task)
    }

    /// Compares the controls of step `t` with their bounds, in the episodes that go on.
    fn compare(&mut self, task: &dyn AnyTask<F>, t: usize) {
        let (states, controls) = (self.rollout.states_at(t + 1), self.rollout.controls_at(t));
        for sample in 0..self.rollout.samples() {
            let (block, lane) = (sample / LANES, sample % LANES);
            let state = |i: usize| states[block * self.rollout.state_dim + i].lane(lane);
            if task.ended().is_some_and(|ended| state(ended) != F::zero()) {
                continue;
            }
            let controls = &controls[block * self.bounds.len()..][..self.bounds.len()];
            for (u, &[low, high]) in controls.iter().zip(&self.bounds) {
                let u: f64 = u.lane(lane).as_();
                // tanh² of the policy within its range.
                let square = ((2.0 * u - low - high) / (high - low)).powi(2);
                self.compared[0] += 1;
                self.compared[1] += usize::from(1.0 - square < 0.01);
            }
        }
    }
}

impl<F: Float> Evaluation<F> {
    /// Allocates a workspace for data sets of any size, split over `workers` workers (at least
    /// one).
    ///
    /// # Panics
    /// As [`Rollout::new`].
    pub fn new(task: &dyn AnyTask<F>, policy: &dyn AnyPolicy<F>, workers: usize) -> Self {
        let evaluator = || Evaluator {
            rollout: Rollout::for_evaluation(task, policy, EVALUATED),
            costs: Vec::new(),
            lengths: Vec::new(),
            bounds: policy.control_bounds().unwrap_or_default(),
            compared: [0; 2],
            outcome: Ok(()),
        };
        Self { workers: (0..workers.max(1)).map(|_| evaluator()).collect(), ranks: None }
    }

    /// Shares the samples of each data set among ranks. Every rank calls [`run`](Evaluation::run)
    /// with all samples. Results are bitwise those of a single process.
    #[must_use]
    pub fn shared(self, ranks: Arc<dyn Ranks>) -> Self {
        Self { ranks: Some(ranks), ..self }
    }

    /// Returns the mean loss of rollouts from `starts`; see
    /// [`initial_states`](crate::initial_states).
    ///
    /// # Errors
    /// [`Divergence`] if a control, memory, state or cost is non-finite.
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
        let n = self.workers[0].rollout.start_dim();
        let samples = starts.len() / n;
        assert!(
            samples > 0 && starts.len().is_multiple_of(n),
            "`starts` has {} numbers; expected one or more samples of {n} numbers each",
            starts.len()
        );
        let Some(ranks) = self.ranks.clone() else {
            self.run_samples(task, policy, weights, starts)?;
            return Ok(self.costs().sum::<f64>() / samples as f64);
        };
        // A rank runs whole rollouts, so they diverge as in a single process.
        let own = |rank: usize| samples_of(samples, EVALUATED, rank, ranks.count());
        let Range { start, end } = own(ranks.rank());
        let outcome = self.run_samples(task, policy, weights, &starts[start * n..end * n]);
        let costs: Vec<f64> = self.costs().collect();
        // The first rank with a divergence has the first diverged samples.
        let failed = gather(&*ranks, &[u8::from(outcome.is_err())]);
        if let Some(rank) = failed.iter().position(|failed| failed == &[1]) {
            let Range { start, end } = own(rank);
            self.run_samples(task, policy, weights, &starts[start * n..end * n])
                .map_err(|d| d.offset(start))?;
        }
        Ok(gather_f64(&*ranks, &costs).iter().sum::<f64>() / samples as f64)
    }

    /// Mean number of steps of the episodes of the last run, of this rank. None if they cannot end.
    pub(crate) fn mean_length(&self) -> Option<f64> {
        let lengths = || self.workers.iter().flat_map(|worker| &worker.lengths);
        let count = lengths().count();
        (count > 0).then(|| lengths().sum::<f64>() / count as f64)
    }

    /// Share of the controls of the last run, of this rank, that are at a bound: so near that the policy
    /// changes them by less than a hundredth of what it would in the middle. It is measured at
    /// [`COMPARED`] steps of the episodes. None without bounds.
    pub(crate) fn saturated(&self) -> Option<f64> {
        let sum = |i: usize| self.workers.iter().map(|worker| worker.compared[i]).sum::<usize>();
        (sum(0) > 0).then(|| sum(1) as f64 / sum(0) as f64)
    }

    /// Costs of the samples of the last run.
    fn costs(&self) -> impl Iterator<Item = f64> {
        self.workers.iter().flat_map(|worker| worker.costs.iter().copied())
    }

    /// Runs the samples in `starts`. A worker stops after its first rollout that diverges. Returns
    /// the divergence of the first such worker.
    fn run_samples(
        &mut self,
        task: &dyn AnyTask<F>,
        policy: &dyn AnyPolicy<F>,
        weights: &Weights<F>,
        starts: &[F],
    ) -> Result<(), Divergence> {
        let n = self.workers[0].rollout.start_dim();
        let samples = starts.len() / n;
        let per_worker =
            samples.div_ceil(EVALUATED).div_ceil(self.workers.len()).max(1) * EVALUATED;
        for_each(&mut self.workers, &|index, worker| {
            worker.costs.clear();
            worker.lengths.clear();
            worker.compared = [0; 2];
            let own = starts.chunks(per_worker * n).nth(index).unwrap_or(&[]);
            worker.outcome = own.chunks(EVALUATED * n).enumerate().try_for_each(|(i, starts)| {
                worker.rollout.start(starts);
                let outcome = worker.run(task, policy, weights);
                worker
                    .costs
                    .extend((0..worker.rollout.samples()).map(|s| worker.rollout.cost(s).as_()));
                let Evaluator { rollout, lengths, .. } = &mut *worker;
                let length = |sample| rollout.length(task, sample).map(|steps| steps as f64);
                lengths.extend((0..rollout.samples()).filter_map(length));
                outcome.map_err(|d| d.offset(index * per_worker + i * EVALUATED))
            });
        });
        self.workers.iter().find_map(|w| w.outcome.err()).map_or(Ok(()), Err)
    }
}
