//! [`State`]: one training epoch, independent of the types of task, policy and field.
//!
//! [`State::advance`] runs an epoch: an update per mini-batch, then the losses of both data sets.

use super::average::average_direction;
use super::episodes::{Episodes, EpisodesState, Windows};
use super::record::{Means, Record, Skip, UpdateStep};
use super::smoothing::Estimates;
use super::{Begin, TrainError, Training};
use crate::dynamics::number::key_of_epoch;
use crate::engine::any::AnyTask;
use crate::engine::batch::Batch;
use crate::engine::divergence::Divergence;
use crate::engine::evaluation::Evaluation;
use crate::engine::flow::Flow;
use crate::engine::gradient::Gradient;
use crate::engine::growth::Growth;
use crate::engine::initial_states::append_start;
#[cfg(feature = "parallel")]
use crate::engine::parallel::among_workers;
use crate::engine::ranks::Ranks;
use crate::engine::rollout::Rollout;
use crate::numbers::extended::ExtendedF64;
use crate::numbers::kernels::{SimdLevel, elementwise};
use crate::numbers::rng::{Purpose, stream};
use crate::numbers::scalar::{Float, LANES};
use crate::policy::AnyPolicy;
use crate::policy::Weights;
use crate::train::field::AnyField;
use crate::train::optim::Optimizer;
use rand::seq::SliceRandom;
use serde::{Deserialize, Serialize};
use std::ops::Range;
use std::sync::Arc;
use std::time::Instant;

/// Task, policy and field of a training, as trait objects.
#[derive(Clone, Copy)]
pub(super) struct Problem<'a, F: Float> {
    pub(super) task: &'a dyn AnyTask<F>,
    pub(super) policy: &'a dyn AnyPolicy<F>,
    pub(super) field: &'a dyn AnyField<F>,
}

/// State that a failed epoch restores.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub(super) struct Snapshot<F> {
    pub(super) theta: Vec<F>,
    pub(super) optimizer: Optimizer<F>,
    pub(super) direction: Vec<F>,
    pub(super) skipped_in_a_row: usize,
    /// Episodes and value function of a training by windows.
    pub(super) episodes: Option<EpisodesState<F>>,
}

/// Parameters after the epoch with the lowest test loss.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub(super) struct Best<F> {
    pub(super) theta: Vec<F>,
    /// Test loss of these parameters. NaN before the first epoch whose test loss is a number.
    pub(super) loss: f64,
}

impl<F: Float> Best<F> {
    /// Stores `theta` if its test loss is lower than the stored loss, or the first that is not NaN.
    /// Keeps the first of equal losses.
    fn update(&mut self, theta: &[F], loss: f64) {
        if loss < self.loss || (self.loss.is_nan() && !loss.is_nan()) {
            self.theta.copy_from_slice(theta);
            self.loss = loss;
        }
    }
}

/// Unfinished epoch.
#[derive(Clone, Debug, Default, Serialize, Deserialize)]
pub(super) struct Epoch {
    /// Updates done, skipped ones included.
    pub(super) updates: usize,
    /// Updates skipped.
    pub(super) skipped: usize,
    pub(super) means: Means,
    /// Wall time so far, s.
    pub(super) seconds: f64,
}

/// Mutable state of a training, and its workspaces.
#[derive(Debug)]
pub(super) struct State<F: Float> {
    pub(super) training: Training,
    pub(super) weights: Weights<F>,
    pub(super) optimizer: Optimizer<F>,
    /// Moving average of the direction of the second gradient. Empty without an average.
    pub(super) direction: Vec<F>,
    /// Moving average before the current update. A skipped update restores it.
    previous_direction: Vec<F>,
    pub(super) train: Vec<F>,
    pub(super) test: Vec<F>,
    order: Vec<usize>,
    pub(super) records: Vec<Record>,
    pub(super) skips: Vec<Skip>,
    /// Number of consecutive skipped updates.
    pub(super) skipped_in_a_row: usize,
    /// State at the start of the epoch.
    pub(super) before: Snapshot<F>,
    pub(super) best: Best<F>,
    /// Unfinished epoch, if the training is paused within one.
    pub(super) epoch: Option<Epoch>,
    /// Non-finite numbers in the losses of the training set and of the test set after the last
    /// epoch.
    pub(super) diverged: [Option<Divergence>; 2],
    /// For each number that is trained with the policy, true if it had a slope of 0 in all updates of
    /// the epoch.
    flat: Vec<bool>,
    /// Numbers with a slope of 0 in all updates of the last epoch, each with whether a change of the
    /// number changes the loss.
    pub(super) without_slope: Vec<(usize, bool)>,
    /// Kinds of warnings that were returned.
    pub(super) warned: Vec<&'static str>,
    flows: Vec<Flow>,
    pub(super) batch: Batch<F>,
    evaluation: Evaluation<F>,
    /// Episodes of a training by windows.
    pub(super) episodes: Option<Episodes<F>>,
    /// Mean length of the test episodes before the first update, if they can end and if this process
    /// began the training.
    pub(super) untrained_length: Option<f64>,
    /// Share of the controls of the test set that are at a bound, if the policy has bounds.
    pub(super) saturated: Option<f64>,
    /// Initial states of the mini-batch.
    starts: Vec<F>,
    /// True if initial states end with a key of noise, which differs between epochs.
    is_noisy: bool,
    /// Buffer for one drawn sample.
    drawn: Vec<f64>,
    pub(super) combined: Gradient<F>,
    /// Workspace of the estimates of [`Smoothing`](super::Smoothing).
    pub(super) estimates: Option<Estimates<F>>,
}

impl<F: Float> State<F> {
    #[inline(never)]
    pub(super) fn new(
        task: &dyn AnyTask<F>,
        policy: &dyn AnyPolicy<F>,
        flows: Vec<Flow>,
        training: Training,
        windows: Option<Windows>,
        Begin { mut weights, is_drawn }: Begin<F>,
        [train, test]: [Vec<F>; 2],
    ) -> Result<Self, TrainError> {
        let params = policy.param_count();
        let n = task.start_dim();
        training.validate()?;
        check_starts("train_samples", &train, n)?;
        check_starts("test_samples", &test, n)?;
        let samples = training.batch.min(train.len() / n);
        let derived = training.derived(samples);
        let episodes = match windows {
            None => None,
            Some(windows) => {
                let dims = [task.state_dim(), task.param_dim(), task.horizon()];
                windows.validate(&training, policy, dims)?;
                Some(Episodes::new(windows, &training, policy, is_drawn, &train))
            }
        };
        if let Some(episodes) = &episodes {
            weights.update(policy, |theta| episodes.begin_drawn(theta));
        }
        let stepped: &dyn AnyTask<F> = episodes.as_ref().map_or(task, |episodes| &episodes.window);
        let mut batch = match training.memory {
            None => Batch::new(stepped, policy, derived, &flows, training.workers),
            Some(budget) => {
                Batch::within(stepped, policy, derived, &flows, training.workers, budget)?
            }
        };
        if episodes.is_some() {
            if batch.schedule().segments() > 1 {
                let problem =
                    "is too small for the steps of a window; allow more, or shorten the window";
                return Err(TrainError::Setting { setting: "memory", problem: problem.into() });
            }
            batch.keep_visited();
        }
        check_written(task, policy, &weights, &train)?;
        let optimizer = Optimizer::new(training.rule, training.learning_rate, params);
        let averaged = training.average > 0.0 && flows.len() > 1;
        let direction = vec![F::zero(); if averaged { params } else { 0 }];
        Ok(Self {
            batch,
            flows,
            evaluation: Evaluation::new(task, policy, training.workers),
            best: Best { theta: weights.theta().to_vec(), loss: f64::NAN },
            before: Snapshot {
                theta: weights.theta().to_vec(),
                optimizer: optimizer.clone(),
                direction: direction.clone(),
                skipped_in_a_row: 0,
                episodes: episodes.as_ref().map(Episodes::state),
            },
            episodes,
            previous_direction: direction.clone(),
            direction,
            epoch: None,
            diverged: [None; 2],
            // False until an epoch begins: a restored session does not know the earlier updates.
            flat: vec![false; policy.trained_params().len()],
            without_slope: Vec::new(),
            warned: Vec::new(),
            optimizer,
            untrained_length: None,
            saturated: None,
            order: (0..train.len() / n).collect(),
            starts: Vec::with_capacity(samples * n),
            is_noisy: !task.noise().is_empty(),
            drawn: vec![0.0; n],
            combined: Gradient::zeros(params),
            estimates: training.smoothing.map(|_| Estimates::new(params)),
            // The bound limits the allocation, because `epochs` may be huge.
            records: Vec::with_capacity(training.epochs.min(100_000)),
            skips: Vec::new(),
            skipped_in_a_row: 0,
            training,
            weights,
            train,
            test,
        })
    }

    /// Shares the samples of mini-batches and data sets among ranks.
    #[inline(never)]
    pub(super) fn share(
        &mut self,
        task: &dyn AnyTask<F>,
        policy: &dyn AnyPolicy<F>,
        ranks: &Arc<dyn Ranks>,
    ) -> Result<(), TrainError> {
        if self.episodes.is_some() {
            let problem = "are not shared among ranks; use threads, or run without windows".into();
            return Err(TrainError::Setting { setting: "windows", problem });
        }
        let Training { batch, workers, memory, .. } = self.training;
        let samples = self.training.derived(batch.min(self.order.len()));
        // Frees the workspace of a single process before the allocation of the shared one.
        self.batch = Batch::new(task, policy, 1, &self.flows, 1);
        self.batch =
            Batch::shared(ranks.clone(), task, policy, samples, &self.flows, workers, memory)?;
        self.evaluation = Evaluation::new(task, policy, workers).shared(ranks.clone());
        Ok(())
    }

    /// Runs to the end of the epoch, or until `pause` returns true after an update. Returns whether
    /// the epoch ended. With several workers and the feature `parallel`, the epoch runs on a worker
    /// thread.
    #[inline(never)]
    pub(super) fn advance(
        &mut self,
        problem: Problem<'_, F>,
        pause: &(dyn Fn() -> bool + Sync),
    ) -> Result<bool, TrainError> {
        #[cfg(feature = "parallel")]
        if self.training.workers > 1 {
            let mut outcome = Ok(true);
            among_workers(&mut || outcome = self.run_epoch(problem, pause));
            return outcome;
        }
        self.run_epoch(problem, pause)
    }

    /// Runs a new epoch, or continues an unfinished one: an update per mini-batch, then the losses
    /// of both data sets.
    fn run_epoch(
        &mut self,
        problem: Problem<'_, F>,
        pause: &dyn Fn() -> bool,
    ) -> Result<bool, TrainError> {
        let begin = Instant::now();
        if self.records.is_empty() && self.epoch.is_none() && problem.task.ended().is_some() {
            self.test_loss(problem.task, problem.policy);
            self.untrained_length = self.evaluation.mean_length();
        }
        let mut epoch = self.epoch.take().unwrap_or_else(|| self.begin_epoch());
        while epoch.updates < self.updates_per_epoch() {
            // Measures growth up to the first applied update.
            self.batch.measure(epoch.means.is_empty());
            match self.update(problem, epoch.updates) {
                Ok(step) => self.count(&mut epoch, &step),
                Err(divergence) => self.skip(&mut epoch, divergence, problem.policy)?,
            }
            epoch.updates += 1;
            if epoch.updates < self.updates_per_epoch() && pause() {
                epoch.seconds += begin.elapsed().as_secs_f64();
                self.epoch = Some(epoch);
                return Ok(false);
            }
        }
        let [train_loss, test_loss] = self.evaluate(problem);
        let length = self.evaluation.mean_length();
        self.saturated = self.evaluation.saturated();
        self.without_slope.clear();
        if !epoch.means.is_empty() {
            self.test_numbers_without_slope(problem);
        }
        self.best.update(self.weights.theta(), test_loss);
        let seconds = epoch.seconds + begin.elapsed().as_secs_f64();
        let number = self.records.len() + 1;
        let record = epoch.means.record(number, train_loss, test_loss, epoch.skipped, seconds);
        let [value_error, explained] = self.episodes.as_ref().map_or([None; 2], Episodes::fit);
        self.records.push(Record { length, value_error, explained, ..record });
        Ok(true)
    }

    /// Starts a new epoch and records the state that a failure restores.
    fn begin_epoch(&mut self) -> Epoch {
        self.skips.clear();
        self.flat.fill(true);
        self.before.theta.copy_from_slice(self.weights.theta());
        self.before.optimizer.copy_from(&self.optimizer);
        self.before.direction.copy_from_slice(&self.direction);
        self.before.skipped_in_a_row = self.skipped_in_a_row;
        if let Some(episodes) = &mut self.episodes {
            episodes.begin(self.records.len());
            self.before.episodes = Some(episodes.state());
        }
        self.order_samples();
        Epoch::default()
    }

    /// Adds an applied update to the statistics of the epoch.
    fn count(&mut self, epoch: &mut Epoch, step: &UpdateStep) {
        if epoch.means.is_empty() {
            epoch.means.growths = [Flow::REGULAR, Flow::MODIFIED].map(|flow| self.growth(flow));
        }
        epoch.means.add(step);
        self.skipped_in_a_row = 0;
    }

    /// Skips a diverged update.
    ///
    /// # Errors
    /// [`TrainError::Diverged`] after too many consecutive skipped updates. Parameters, optimizer,
    /// moving average and the number of consecutive skips then return to their state at the start
    /// of the epoch.
    fn skip(
        &mut self,
        epoch: &mut Epoch,
        divergence: Divergence,
        policy: &dyn AnyPolicy<F>,
    ) -> Result<(), TrainError> {
        let skip = Skip { epoch: self.records.len() + 1, update: epoch.updates, divergence };
        self.skips.push(skip);
        epoch.skipped += 1;
        self.skipped_in_a_row += 1;
        if self.skipped_in_a_row <= self.training.max_skipped {
            return Ok(());
        }
        let count = self.skipped_in_a_row;
        self.restore_start_of_epoch(policy);
        Err(TrainError::Diverged { count, last: Box::new(skip) })
    }

    /// Restores parameters, optimizer, moving average and the number of consecutive skips to their
    /// state at the start of the epoch.
    pub(super) fn restore_start_of_epoch(&mut self, policy: &dyn AnyPolicy<F>) {
        self.weights.update(policy, |theta| theta.copy_from_slice(&self.before.theta));
        self.optimizer.copy_from(&self.before.optimizer);
        self.direction.copy_from_slice(&self.before.direction);
        self.skipped_in_a_row = self.before.skipped_in_a_row;
        if let (Some(episodes), Some(state)) = (&mut self.episodes, &self.before.episodes) {
            episodes.set_state(state);
        }
    }

    /// Loss of the test set. A diverged loss is NaN.
    #[inline(never)]
    pub(super) fn test_loss(&mut self, task: &dyn AnyTask<F>, policy: &dyn AnyPolicy<F>) -> f64 {
        self.evaluation.run(task, policy, &self.weights, &self.test).unwrap_or(f64::NAN)
    }

    /// Test loss of the best parameters, as recorded and as computed now. None if both are equal up
    /// to rounding, or if no loss is recorded.
    #[inline(never)]
    pub(super) fn changed_test_loss(
        &mut self,
        task: &dyn AnyTask<F>,
        policy: &dyn AnyPolicy<F>,
    ) -> Option<[f64; 2]> {
        let recorded = self.best.loss;
        if recorded.is_nan() {
            return None;
        }
        let best = Weights::new(policy, self.best.theta.clone());
        let computed = self.evaluation.run(task, policy, &best, &self.test).unwrap_or(f64::NAN);
        let is_equal = (computed - recorded).abs() <= F::EPSILON.sqrt() * recorded.abs();
        (!is_equal).then_some([recorded, computed])
    }

    /// Evaluates the losses of the training and the test set. A diverged loss is NaN.
    fn evaluate(&mut self, Problem { task, policy, .. }: Problem<'_, F>) -> [f64; 2] {
        let mut loss_of = |starts| self.evaluation.run(task, policy, &self.weights, starts);
        // The test set comes last, for the lengths of its episodes.
        let losses = match &self.episodes {
            None => [loss_of(&self.train), loss_of(&self.test)],
            Some(episodes) => [Ok(episodes.loss()), loss_of(&self.test)],
        };
        self.diverged = losses.map(Result::err);
        losses.map(|loss| loss.unwrap_or(f64::NAN))
    }

    /// Orders the training samples for the current epoch.
    pub(super) fn order_samples(&mut self) {
        if self.training.shuffle {
            // Each epoch shuffles the sorted order, so a resumed run has the same order.
            self.order.sort_unstable();
            let epoch = self.records.len() as u64 + 1;
            self.order.shuffle(&mut stream(self.training.seed, Purpose::Shuffle, epoch));
        }
    }

    pub(super) fn updates_per_epoch(&self) -> usize {
        self.batches() * self.episodes.as_ref().map_or(1, |episodes| episodes.windows)
    }

    /// Number of mini-batches that together have all samples.
    fn batches(&self) -> usize {
        self.order.len().div_ceil(self.training.batch)
    }

    /// Samples of mini-batch `index` of the epoch.
    fn chosen(&self, index: usize) -> Range<usize> {
        let first = index % self.batches() * self.training.batch;
        first..self.order.len().min(first + self.training.batch)
    }

    /// Performs one update with mini-batch `index` of the epoch.
    fn update(&mut self, problem: Problem<'_, F>, index: usize) -> Result<UpdateStep, Divergence> {
        self.select_batch(problem.task, index);
        let update = self.records.len() * self.updates_per_epoch() + index;
        self.previous_direction.copy_from_slice(&self.direction);
        let step = self.vector(problem, update);
        let step = step.and_then(|step| self.continue_episodes(index).map(|()| step));
        if step.is_err() {
            self.direction.copy_from_slice(&self.previous_direction);
            let (chosen, window) = (self.chosen(index), index / self.batches());
            if let Some(episodes) = &mut self.episodes {
                episodes.abandon(&self.order[chosen], self.records.len(), window);
            }
        }
        let applied = step?;
        self.note_slopes();
        self.training.clip.apply_knowing(&mut self.combined, applied.norm);
        let rate = self.learning_rate(update);
        let (optimizer, combined) = (&mut self.optimizer, &self.combined);
        let mut step = |theta: &mut [F]| optimizer.step_at(rate, theta, combined);
        self.weights.update(problem.policy, |theta| match &mut self.episodes {
            Some(episodes) => episodes.step(theta, step),
            None => step(theta),
        });
        Ok(applied)
    }

    /// In a training by windows, continues the episodes of a mini-batch where its windows ended, and
    /// trains the value function.
    fn continue_episodes(&mut self, index: usize) -> Result<(), Divergence> {
        let (chosen, window) = (self.chosen(index), index / self.batches());
        match (&mut self.episodes, self.batch.visited()) {
            (Some(episodes), Some(visited)) => {
                episodes.finish(&self.order[chosen], self.records.len(), window, visited)
            }
            _ => Ok(()),
        }
    }

    /// Notes which trained numbers have a slope other than 0 in this update.
    fn note_slopes(&mut self) {
        let first = self.combined.values().len() - self.flat.len();
        for gradient in self.batch.gradients().iter().chain([&self.combined]) {
            for (flat, &slope) in self.flat.iter_mut().zip(&gradient.values()[first..]) {
                *flat &= slope == F::zero();
            }
        }
    }

    /// Determines, for each number without a slope in all updates of the epoch, whether the loss of
    /// the training set depends on it nevertheless: changes it by about a tenth in both directions.
    fn test_numbers_without_slope(&mut self, Problem { task, policy, .. }: Problem<'_, F>) {
        let first = self.weights.theta().len() - self.flat.len();
        if !self.flat.contains(&true) {
            return;
        }
        let mut loss_of = |weights: &Weights<F>| {
            self.evaluation.run(task, policy, weights, &self.train).unwrap_or(f64::NAN)
        };
        let loss = loss_of(&self.weights);
        for number in 0..self.flat.len() {
            if !self.flat[number] {
                continue;
            }
            let changes = [-0.1, 0.1].into_iter().any(|by| {
                let mut theta = self.weights.theta().to_vec();
                let r: f64 = theta[first + number].as_();
                theta[first + number] = F::from_f64(r + by * r.abs().max(1.0));
                let moved = Weights::new(policy, theta);
                // A loss that diverges differs from any other.
                let moved = loss_of(&moved);
                moved != loss && !(moved.is_nan() && loss.is_nan())
            });
            self.without_slope.push((first + number, changes));
        }
    }

    /// Computes the combined vector of update number `update`: the field, or an estimate with
    /// smoothing.
    ///
    /// # Errors
    /// [`Divergence`] if a number is non-finite, or the vector is too large for the optimizer.
    fn vector(&mut self, problem: Problem<'_, F>, update: usize) -> Result<UpdateStep, Divergence> {
        let step = match self.training.smoothing {
            None => self.field(problem)?,
            Some(smoothing) => self.estimate(problem, smoothing, update)?,
        };
        self.check_range(step.norm)?;
        Ok(step)
    }

    /// Evaluates the loss and the field of the mini-batch at the current parameters.
    pub(super) fn field(
        &mut self,
        Problem { task, policy, field }: Problem<'_, F>,
    ) -> Result<UpdateStep, Divergence> {
        let task = self.episodes.as_ref().map_or(task, |episodes| &episodes.window);
        let loss = self.batch.run(task, policy, &self.weights, &self.starts)?;
        if let Some(episodes) = &self.episodes {
            for gradient in self.batch.gradients_mut() {
                episodes.enter_gradient(gradient);
            }
        }
        self.combine(field, loss)
    }

    /// Evaluates the loss of the mini-batch at the current parameters.
    pub(super) fn loss(
        &mut self,
        Problem { task, policy, .. }: Problem<'_, F>,
    ) -> Result<UpdateStep, Divergence> {
        let loss = self.evaluation.run(task, policy, &self.weights, &self.starts)?;
        Ok(UpdateStep { loss, ..UpdateStep::default() })
    }

    /// Learning rate of update number `update`, counted from 0 over the whole training.
    ///
    /// Checkpoints do not store this rate, which depends only on settings and the update number.
    fn learning_rate(&self, update: usize) -> f64 {
        let Training { epochs, learning_rate, decay, warm_up, .. } = self.training;
        learning_rate
            * decay.factor(warm_up, update, epochs.saturating_mul(self.updates_per_epoch()))
    }

    /// Copies the initial states of mini-batch `index`, or draws them if the training resamples.
    fn select_batch(&mut self, task: &dyn AnyTask<F>, index: usize) {
        let n = self.drawn.len();
        self.starts.clear();
        let (chosen, batches) = (self.chosen(index), self.batches());
        if let Some(episodes) = &mut self.episodes {
            episodes.select(&self.order[chosen], index / batches, &mut self.starts);
            return;
        }
        for &sample in &self.order[chosen] {
            if self.training.resample {
                // One stream per epoch and sample, so a resumed run draws the same numbers.
                let drawn = self.records.len() as u64 * self.order.len() as u64 + sample as u64;
                let rng = &mut stream(self.training.seed, Purpose::Train, drawn);
                append_start(task, rng, &mut self.drawn, &mut self.starts);
            } else {
                self.starts.extend_from_slice(&self.train[sample * n..][..n]);
                if self.is_noisy
                    && let Some(key) = self.starts.last_mut()
                {
                    *key = F::from_f64(key_of_epoch(key.as_(), self.records.len() as u64));
                }
            }
        }
    }

    /// Combines the gradients of the mini-batch into the vector of the field.
    fn combine(&mut self, field: &dyn AnyField<F>, loss: f64) -> Result<UpdateStep, Divergence> {
        let gradients = self.batch.gradients();
        let level = SimdLevel::best();
        let (first, second) = (gradients[0].values(), gradients[gradients.len() - 1].values());
        let (dot, first_square, second_square) = elementwise::moments(level, first, second);
        for (&flow, (gradient, square)) in
            self.flows.iter().zip([(first, first_square), (second, second_square)])
        {
            if !square.is_finite() {
                return Err(Divergence::Gradient { flow, parameter: worst(gradient) });
            }
        }
        if !self.direction.is_empty() {
            let second = &mut self.batch.gradients_mut()[1];
            average_direction(
                &mut self.direction,
                self.training.average,
                second,
                second_square.sqrt(),
            );
        }
        field.combine(self.batch.gradients(), &mut self.combined);
        self.combined.drop_signs();
        let two = self.flows.len() > 1;
        let values = self.combined.values();
        let size = if two {
            elementwise::moments(level, values, values).0.sqrt()
        } else {
            first_square.sqrt()
        };
        let zero = F::zero();
        Ok(UpdateStep {
            loss,
            norm: ExtendedF64::new(size, self.combined.exponent()),
            cosine: two.then(|| {
                if dot == 0.0 { 0.0 } else { dot / (first_square.sqrt() * second_square.sqrt()) }
            }),
            kept: two.then(|| {
                values.iter().filter(|&&g| g != zero).count() as f64 / values.len() as f64
            }),
            first_order: None,
        })
    }

    /// Checks that the combined vector, after clipping, is within the range of the optimizer.
    /// `norm` is the norm of the vector before clipping.
    fn check_range(&self, norm: ExtendedF64) -> Result<(), Divergence> {
        // Optimizers sum the squares of many updates. The factor 1e-3 allows 1e6 summands.
        if norm.is_finite() && self.training.clip.bound(norm.get()) <= F::MAX.sqrt() * 1e-3 {
            return Ok(());
        }
        Err(Divergence::Field { parameter: worst(self.combined.values()), norm })
    }

    /// Growth of the adjoint of `flow` in the last update, if the field contains it.
    fn growth(&self, flow: Flow) -> Option<Growth> {
        self.flows
            .iter()
            .position(|own| own.letter() == flow.letter())
            .and_then(|k| self.batch.growth(k))
    }
}

/// Refuses `starts` that are not one or more initial states of `n` numbers each. `setting` names
/// them.
fn check_starts<F>(setting: &'static str, starts: &[F], n: usize) -> Result<(), TrainError> {
    if starts.is_empty() || !starts.len().is_multiple_of(n) {
        let problem = format!(
            "has {} numbers; allowed: one or more initial states of {n} numbers each",
            starts.len()
        );
        return Err(TrainError::Setting { setting, problem });
    }
    Ok(())
}

/// Refuses a task or policy that leaves a component unwritten in rollouts from the first samples of
/// `starts`.
fn check_written<F: Float>(
    task: &dyn AnyTask<F>,
    policy: &dyn AnyPolicy<F>,
    weights: &Weights<F>,
    starts: &[F],
) -> Result<(), TrainError> {
    let first = &starts[..starts.len().min(LANES * task.start_dim())];
    match Rollout::first_unwritten(task, policy, weights, first) {
        Some((method, component)) => Err(TrainError::Unwritten { method, component }),
        None => Ok(()),
    }
}

/// Returns the index of the first non-finite component, or else of the largest absolute value.
#[cold]
fn worst<F: Float>(gradient: &[F]) -> usize {
    let size = |i: &usize| gradient[*i].as_().abs();
    let all = 0..gradient.len();
    all.clone()
        .find(|i| !size(i).is_finite())
        .or_else(|| all.max_by(|i, j| size(i).total_cmp(&size(j))))
        .unwrap_or(0)
}
