//! [`Batch`]: gradients of a mini-batch. Workers share the samples.
//!
//! Results do not depend on the number of workers. Samples are independent. Gradients are summed
//! over fixed groups of samples, then over fixed blocks of groups, then over all blocks in order.
//! If several [`Ranks`] share the blocks, the sums do not change.

use crate::engine::any::AnyTask;
use crate::engine::checkpointed::Checkpointed;
use crate::engine::divergence::Divergence;
use crate::engine::flow::Flow;
use crate::engine::gradient::Gradient;
use crate::engine::growth::{Growth, GrowthStats};
use crate::engine::parallel::for_each;
use crate::engine::pass::Closed;
use crate::engine::ranks::{Ranks, add_blocks, gather, gather_f64, samples_of};
use crate::engine::schedule::{MemoryError, Schedule};
use crate::engine::visited::Visited;
use crate::numbers::scalar::Float;
use crate::policy::AnyPolicy;
use crate::policy::Weights;
use std::ops::Range;
use std::sync::Arc;

/// Number of samples in a group. Each group has one gradient sum, for any number of workers.
pub(crate) const GROUP: usize = 4;
/// Largest number of blocks of groups. Each block has one sum over its groups. The limit bounds the
/// number of sums that ranks exchange, and the number of ranks that share a mini-batch. Up to 128
/// samples, a block is a group.
const BLOCKS: usize = 32;
/// Largest number of groups in one chunk: more samples would not fit into the cache.
const CHUNK: usize = 8;

/// Workspace for the gradients of mini-batches of up to a fixed size.
///
/// In each round, every worker runs the forward and reverse pass of one chunk of samples. A chunk
/// stays in the cache. Mini-batches larger than one round need no more memory.
#[derive(Debug)]
pub struct Batch<F: Float> {
    /// Largest number of samples.
    capacity: usize,
    workers: Vec<Worker<F>>,
    gradients: Vec<Gradient<F>>,
    /// Sum of the current block for each flow. Empty if every block is a group.
    block: Vec<Gradient<F>>,
    /// Growth of the adjoint of each flow in the last run, if measured.
    growth: Vec<GrowthStats>,
    /// True if runs measure the growth of the adjoints.
    measured: bool,
    /// What the samples of the last run visited, if kept.
    visited: Option<Visited<F>>,
    /// Processes that share the samples, and the results of this process.
    shared: Option<Box<Shared<F>>>,
}

/// Closed loop and sizes of one mini-batch.
#[derive(Clone, Copy)]
struct MiniBatch<'a, F: Float> {
    closed: Closed<'a, F>,
    /// Weight of a sample in the mean loss.
    scale: F,
    /// Number of groups in a block.
    block: usize,
}

/// Results of the samples of one rank, before the exchange.
#[derive(Debug)]
struct Shared<F: Float> {
    ranks: Arc<dyn Ranks>,
    /// Sums of the blocks, `[block][flow]`.
    blocks: Vec<Vec<Gradient<F>>>,
    /// Number of groups in these blocks.
    groups: usize,
    /// Costs of the samples.
    costs: Vec<f64>,
    /// Growth of the samples, `[flow]`, if measured. Each sample has two numbers, those of
    /// [`Growth`].
    growths: Vec<Vec<f64>>,
}

/// Workspace of one worker, for one chunk of consecutive groups of samples.
#[derive(Debug)]
struct Worker<F: Float> {
    rollout: Checkpointed<F>,
    /// Gradients, `[group][flow][parameter]`.
    groups: Vec<Vec<Gradient<F>>>,
    /// What the samples of the last run visited, if kept.
    visited: Option<Visited<F>>,
    outcome: Result<(), Divergence>,
}

impl<F: Float> Batch<F> {
    /// Allocates a workspace for mini-batches of up to `samples` samples and one or two flows.
    ///
    /// At most `workers` workers, and at least one, share a mini-batch. All steps are stored.
    ///
    /// # Panics
    /// As [`Rollout::new`](crate::Rollout::new), or if `flows` does not have one or two elements.
    #[track_caller]
    pub fn new(
        task: &dyn AnyTask<F>,
        policy: &dyn AnyPolicy<F>,
        samples: usize,
        flows: &[Flow],
        workers: usize,
    ) -> Self {
        Self::scheduled(task, policy, samples, flows, workers, Schedule::store_all(task.horizon()))
    }

    /// Allocates a workspace of at most `budget` bytes, over all workers.
    ///
    /// The number of recomputed steps exceeds the minimum within the budget by at most 1 % of the
    /// horizon. Gradients are bitwise equal to those of [`new`](Batch::new).
    ///
    /// # Errors
    /// [`MemoryError`] if no schedule fits.
    ///
    /// # Panics
    /// As [`new`](Batch::new).
    #[track_caller]
    #[inline(never)]
    pub fn within(
        task: &dyn AnyTask<F>,
        policy: &dyn AnyPolicy<F>,
        samples: usize,
        flows: &[Flow],
        workers: usize,
        budget: u64,
    ) -> Result<Self, MemoryError> {
        let bytes =
            |schedule: &Schedule| Self::bytes_of(task, policy, samples, flows, workers, schedule);
        let schedule = Schedule::within(task.horizon(), budget, bytes)?;
        Ok(Self::scheduled(task, policy, samples, flows, workers, schedule))
    }

    /// Allocates a workspace with a given schedule for each worker.
    ///
    /// # Panics
    /// As [`new`](Batch::new), or if the horizons of schedule and task differ.
    #[track_caller]
    #[inline(never)]
    pub fn scheduled(
        task: &dyn AnyTask<F>,
        policy: &dyn AnyPolicy<F>,
        samples: usize,
        flows: &[Flow],
        workers: usize,
        schedule: Schedule,
    ) -> Self {
        assert!(samples > 0, "a mini-batch needs at least one sample");
        let zeros =
            || flows.iter().map(|_| Gradient::zeros(policy.param_count())).collect::<Vec<_>>();
        let (workers, chunk) = chunks(samples, workers);
        // Allocates the exact capacity, which `stored_bytes` assumes.
        let mut all = Vec::with_capacity(workers);
        all.extend((0..workers).map(|_| {
            let groups = chunk.div_ceil(GROUP);
            let rollout = Checkpointed::new(task, policy, chunk, flows, schedule);
            Worker {
                rollout,
                groups: (0..groups).map(|_| zeros()).collect(),
                visited: None,
                outcome: Ok(()),
            }
        }));
        let growth = vec![GrowthStats::default(); flows.len()];
        let block = if block_of(samples) > 1 { zeros() } else { Vec::new() };
        Self {
            capacity: samples,
            workers: all,
            gradients: zeros(),
            block,
            growth,
            measured: false,
            visited: None,
            shared: None,
        }
    }

    /// Returns the [`stored_bytes`](Batch::stored_bytes) of a workspace with this schedule, without
    /// allocating it.
    ///
    /// # Panics
    /// If `samples` is 0.
    #[track_caller]
    #[inline(never)]
    pub fn bytes_of(
        task: &dyn AnyTask<F>,
        policy: &dyn AnyPolicy<F>,
        samples: usize,
        flows: &[Flow],
        workers: usize,
        schedule: &Schedule,
    ) -> usize {
        assert!(samples > 0, "a mini-batch needs at least one sample");
        let gradients = flows.len()
            * (size_of::<Gradient<F>>() + Gradient::<F>::bytes_of(policy.param_count()));
        let (workers, chunk) = chunks(samples, workers);
        let groups = chunk.div_ceil(GROUP) * (size_of::<Vec<Gradient<F>>>() + gradients);
        let worker = size_of::<Worker<F>>()
            + groups
            + Checkpointed::<F>::bytes_of(task, policy, chunk, flows, schedule);
        let sums = if block_of(samples) > 1 { 2 * gradients } else { gradients };
        workers * worker + sums + flows.len() * size_of::<GrowthStats>()
    }

    /// Bytes on the heap, independent of the number of samples in a run. Excludes the results that
    /// ranks exchange.
    pub fn stored_bytes(&self) -> usize {
        let nested = |rows: &[Gradient<F>]| {
            size_of_val(rows) + rows.iter().map(Gradient::stored_bytes).sum::<usize>()
        };
        let worker = |worker: &Worker<F>| {
            let groups = worker.groups.iter().map(|group| nested(group)).sum::<usize>();
            size_of_val(&worker.groups[..]) + groups + worker.rollout.stored_bytes()
        };
        let own = size_of_val(&self.workers[..]) + size_of_val(&self.growth[..]);
        own + self.workers.iter().map(worker).sum::<usize>()
            + nested(&self.gradients)
            + nested(&self.block)
    }

    /// Schedule of every worker.
    pub fn schedule(&self) -> Schedule {
        self.workers[0].rollout.schedule()
    }

    /// Allocates a workspace for the samples of one rank in mini-batches of up to `samples`
    /// samples. A budget limits the workspace as in [`within`](Batch::within).
    ///
    /// Every rank calls [`run`](Batch::run) with all samples. Results are bitwise those of a single
    /// process. The budget excludes the results that ranks exchange. These are mainly the sums of
    /// blocks: `param_count` numbers for each flow and each of up to 32 blocks of samples.
    ///
    /// # Errors
    /// As [`within`](Batch::within).
    ///
    /// # Panics
    /// As [`new`](Batch::new).
    #[track_caller]
    pub fn shared(
        ranks: Arc<dyn Ranks>,
        task: &dyn AnyTask<F>,
        policy: &dyn AnyPolicy<F>,
        samples: usize,
        flows: &[Flow],
        workers: usize,
        budget: Option<u64>,
    ) -> Result<Self, MemoryError> {
        assert!(samples > 0, "a mini-batch needs at least one sample");
        let own = samples
            .div_ceil(ranks.count())
            .next_multiple_of(GROUP * block_of(samples))
            .min(samples);
        let batch = match budget {
            None => Self::new(task, policy, own, flows, workers),
            Some(budget) => Self::within(task, policy, own, flows, workers, budget)?,
        };
        let shared = Shared {
            ranks,
            blocks: Vec::new(),
            groups: 0,
            costs: Vec::new(),
            growths: vec![Vec::new(); flows.len()],
        };
        Ok(Self { capacity: samples, shared: Some(Box::new(shared)), ..batch })
    }

    /// Numbers per sample in a list of initial states.
    fn start_dim(&self) -> usize {
        self.workers[0].rollout.start_dim()
    }

    /// Runs rollouts from `starts` (see [`initial_states`](crate::initial_states)) and their
    /// reverse passes.
    ///
    /// Computes the gradient of the mean loss for each flow, and returns the mean loss.
    ///
    /// # Errors
    /// The first [`Divergence`] of the batch. The gradients are then invalid.
    ///
    /// # Panics
    /// If `starts` is empty, exceeds the capacity, or is not a whole number of samples.
    #[track_caller]
    #[inline(never)]
    pub fn run(
        &mut self,
        task: &dyn AnyTask<F>,
        policy: &dyn AnyPolicy<F>,
        weights: &Weights<F>,
        starts: &[F],
    ) -> Result<f64, Divergence> {
        let n = self.start_dim();
        let samples = starts.len() / n;
        let capacity = self.capacity;
        assert!(
            samples > 0 && samples <= capacity && starts.len().is_multiple_of(n),
            "`starts` has {} numbers; expected 1 to {capacity} samples of {n} numbers each",
            starts.len()
        );
        let mini_batch = MiniBatch {
            closed: Closed { task, policy, weights },
            scale: F::from_f64(1.0 / samples as f64),
            block: block_of(samples),
        };
        self.growth.fill(GrowthStats::default());
        self.visited.iter_mut().for_each(Visited::clear);
        let loss = match self.shared.take() {
            None => self.run_samples(mini_batch, starts, None)?,
            Some(mut shared) => {
                let loss = self.run_shared(mini_batch, starts, &mut shared);
                self.shared = Some(shared);
                loss?
            }
        };
        self.gradients.iter_mut().for_each(Gradient::normalize);
        Ok(loss / samples as f64)
    }

    /// Runs the samples of this rank, and exchanges the results. Returns the sum of all costs.
    fn run_shared(
        &mut self,
        mini_batch: MiniBatch<'_, F>,
        starts: &[F],
        shared: &mut Shared<F>,
    ) -> Result<f64, Divergence> {
        let ranks = shared.ranks.clone();
        let n = self.start_dim();
        let samples = starts.len() / n;
        let own = |rank: usize| samples_of(samples, GROUP * mini_batch.block, rank, ranks.count());
        let Range { start, end } = own(ranks.rank());
        shared.clear();
        let outcome = self.run_samples(mini_batch, &starts[start * n..end * n], Some(shared));
        let diverged = first_diverged(&*ranks, outcome.err().map(|d| d.offset(start)));
        if let Some(rank) = diverged {
            // Repeats the samples of that rank, which gives every rank the same error.
            let Range { start, end } = own(rank);
            shared.clear();
            self.run_samples(mini_batch, &starts[start * n..end * n], Some(shared))
                .map_err(|divergence| divergence.offset(start))?;
        }
        add_blocks(&*ranks, &shared.blocks, &mut self.gradients);
        if self.measured {
            for (stats, growths) in self.growth.iter_mut().zip(&shared.growths) {
                gather_f64(&*ranks, growths)
                    .as_chunks()
                    .0
                    .iter()
                    .for_each(|&growth| stats.add(growth));
            }
        }
        Ok(gather_f64(&*ranks, &shared.costs).into_iter().fold(0.0, |loss, cost| loss + cost))
    }

    /// Runs all samples in `starts` and adds their gradients, or keeps the sums of their blocks of
    /// groups in `shared`. Returns the sum of the costs, 0 with `shared`.
    fn run_samples(
        &mut self,
        mini_batch: MiniBatch<'_, F>,
        starts: &[F],
        mut shared: Option<&mut Shared<F>>,
    ) -> Result<f64, Divergence> {
        let (n, block) = (self.start_dim(), mini_batch.block);
        let chunk = self.workers[0].rollout.capacity();
        let groups = (starts.len() / n).div_ceil(GROUP);
        let (mut loss, mut diverged) = (0.0, None);
        for (round, starts) in starts.chunks(self.workers.len() * chunk * n).enumerate() {
            for_each(&mut self.workers, &|index, worker| {
                let own = starts.chunks(chunk * n).nth(index).unwrap_or(&[]);
                worker.outcome = worker.run(mini_batch, own);
            });
            let active = starts.len().div_ceil(chunk * n);
            // All rounds run, because a later round may diverge at an earlier step.
            let first = round * self.workers.len() * chunk;
            let errors = self.workers[..active].iter().enumerate();
            let errors = errors.filter_map(|(i, worker)| {
                worker.outcome.err().map(|d| d.offset(first + i * chunk))
            });
            diverged = diverged.into_iter().chain(errors).min_by_key(Divergence::order);
            if diverged.is_none() {
                match &mut shared {
                    None => {
                        loss = self.add_round(active, first.div_ceil(GROUP), groups, block, loss)
                    }
                    Some(shared) => shared.keep(&self.workers[..active], block, self.measured),
                }
            }
        }
        diverged.map_or(Ok(loss), Err)
    }

    /// Adds the gradients and growths of the first `active` workers, in the order of the samples.
    /// Their first group has the index `first` among all `groups` groups. Returns `loss` plus the
    /// costs of these samples.
    fn add_round(
        &mut self,
        active: usize,
        first: usize,
        groups: usize,
        block: usize,
        loss: f64,
    ) -> f64 {
        if let Some(visited) = &mut self.visited {
            let of_workers = self.workers[..active].iter_mut();
            of_workers.filter_map(|w| w.visited.as_mut()).for_each(|own| visited.take(own));
        }
        let workers = &self.workers[..active];
        for (k, total) in self.gradients.iter_mut().enumerate() {
            for (g, group) in (first..).zip(workers.iter().flat_map(Worker::sums)) {
                if block == 1 {
                    total.set_or_add(&group[k], g == 0);
                    continue;
                }
                let sum = &mut self.block[k];
                sum.set_or_add(&group[k], g % block == 0);
                if g % block == block - 1 || g == groups - 1 {
                    total.set_or_add(sum, g < block);
                }
            }
        }
        if self.measured {
            for (k, stats) in self.growth.iter_mut().enumerate() {
                workers
                    .iter()
                    .for_each(|worker| worker.rollout.growth(k, &mut |growth| stats.add(growth)));
            }
        }
        let costs =
            workers.iter().flat_map(|w| (0..w.rollout.samples()).map(|s| w.rollout.cost(s).as_()));
        costs.fold(loss, |loss, cost: f64| loss + cost)
    }

    /// Gradients of the last [`run`](Batch::run), one per flow.
    pub fn gradients(&self) -> &[Gradient<F>] {
        &self.gradients
    }

    /// Gradients of the last run, for changes before their combination.
    pub(crate) fn gradients_mut(&mut self) -> &mut [Gradient<F>] {
        &mut self.gradients
    }

    /// Enables or disables the measurement of growth, which evaluates the cost gradients of each
    /// step a second time.
    pub fn measure(&mut self, measured: bool) {
        self.measured = measured;
        self.workers.iter_mut().for_each(|worker| worker.rollout.measure(measured));
    }

    /// Keeps what the samples visit in later runs. Requires a schedule that stores all steps.
    pub(crate) fn keep_visited(&mut self) {
        self.visited = Some(Visited::default());
        self.workers.iter_mut().for_each(|worker| worker.visited = Some(Visited::default()));
    }

    /// What the samples of the last run visited, in their order.
    pub(crate) fn visited(&self) -> Option<&Visited<F>> {
        self.visited.as_ref()
    }

    /// Growth of the adjoint of flow `k` in the last run, if measured.
    pub fn growth(&self, k: usize) -> Option<Growth> {
        self.growth[k].growth()
    }
}

impl<F: Float> Shared<F> {
    fn clear(&mut self) {
        self.blocks.clear();
        self.groups = 0;
        self.costs.clear();
        self.growths.iter_mut().for_each(Vec::clear);
    }

    /// Appends the results of these workers. Adds their groups to the current block, up to `block`
    /// groups.
    fn keep(&mut self, workers: &[Worker<F>], block: usize, measured: bool) {
        for worker in workers {
            let samples = worker.rollout.samples();
            for group in worker.sums() {
                match self.blocks.last_mut().filter(|_| !self.groups.is_multiple_of(block)) {
                    Some(sums) => {
                        sums.iter_mut().zip(group).for_each(|(sum, group)| sum.add(group))
                    }
                    None => self.blocks.push(group.clone()),
                }
                self.groups += 1;
            }
            self.costs.extend((0..samples).map(|s| -> f64 { worker.rollout.cost(s).as_() }));
            if measured {
                for (k, growths) in self.growths.iter_mut().enumerate() {
                    worker.rollout.growth(k, &mut |growth| growths.extend(growth));
                }
            }
        }
    }
}

/// Rank with the first divergence of all ranks, if any.
fn first_diverged(ranks: &dyn Ranks, own: Option<Divergence>) -> Option<usize> {
    let order = own.map(|divergence| divergence.order());
    let message: Vec<u8> = order
        .into_iter()
        .flat_map(|(pass, time, sample)| order_bytes(pass, time, sample))
        .collect();
    let messages = gather(ranks, &message).into_iter().enumerate();
    messages
        .filter(|(_, message)| !message.is_empty())
        .min_by(|(_, a), (_, b)| a.cmp(b))
        .map(|(rank, _)| rank)
}

/// Sort key of a divergence as bytes with the same order.
fn order_bytes(pass: u8, time: usize, sample: usize) -> impl Iterator<Item = u8> {
    [pass].into_iter().chain((time as u64).to_be_bytes()).chain((sample as u64).to_be_bytes())
}

impl<F: Float> Worker<F> {
    /// Sums of the groups of the last run, `[group][flow]`.
    fn sums(&self) -> &[Vec<Gradient<F>>] {
        &self.groups[..self.rollout.samples().div_ceil(GROUP)]
    }

    fn run(&mut self, mini_batch: MiniBatch<'_, F>, starts: &[F]) -> Result<(), Divergence> {
        let MiniBatch { closed, scale, .. } = mini_batch;
        if starts.is_empty() {
            return Ok(());
        }
        self.rollout.run_unnormalized(closed, starts, scale, GROUP, &mut self.groups)?;
        if let Some(visited) = &mut self.visited {
            visited.clear();
            visited.append(closed.task, self.rollout.rollout());
        }
        Ok(())
    }
}

/// Number of groups in a block of a mini-batch.
fn block_of(samples: usize) -> usize {
    samples.div_ceil(GROUP).div_ceil(BLOCKS)
}

/// Returns the number of workers and the number of samples in a chunk.
///
/// A chunk consists of whole groups, or of all samples. All rounds have about equal work.
fn chunks(samples: usize, workers: usize) -> (usize, usize) {
    let groups = samples.div_ceil(GROUP);
    let workers = workers.clamp(1, groups);
    let rounds = groups.div_ceil(workers * CHUNK);
    let chunk = groups.div_ceil(workers * rounds) * GROUP;
    (samples.div_ceil(chunk).min(workers), chunk.min(samples))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_batch_has_at_most_32_blocks() {
        for (samples, block) in [(1, 1), (128, 1), (129, 2), (256, 2), (257, 3), (8192, 64)] {
            assert_eq!(block_of(samples), block, "{samples} samples");
        }
    }
}
