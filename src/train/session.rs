//! [`Session`]: a training under way, epoch by epoch.

use super::record::{Means, Record, Skip, Step};
use super::{Report, TrainError, Training};
use crate::backward::Flow;
use crate::batch::{Batch, Evaluation};
use crate::divergence::Divergence;
use crate::field::{Compose, Field, SignAgreement};
use crate::kernels::{Level, elementwise};
use crate::optim::Optimizer;
use crate::policy::{Policy, Weights};
use crate::rng::{Purpose, stream};
use crate::scalar::Float;
use crate::system::System;
use crate::task::Task;
use rand::seq::SliceRandom;
use std::time::Instant;

/// A training under way.
#[derive(Debug)]
pub struct Session<T, P, F: Float, C = SignAgreement> {
    task: T,
    pub(super) policy: P,
    field: Field<C>,
    training: Training,
    pub(super) weights: Weights<F>,
    pub(super) optimizer: Optimizer<F>,
    train: Vec<F>,
    test: Vec<F>,
    order: Vec<usize>,
    pub(super) records: Vec<Record>,
    skips: Vec<Skip>,
    /// Skipped updates up to now, in a row.
    pub(super) skipped_in_a_row: usize,
    flows: Vec<Flow>,
    batch: Batch<F>,
    evaluation: Evaluation<F>,
    starts: Vec<F>,
    composed: Vec<F>,
}

impl<T: Task, P: Policy, F: Float, C: Compose> Session<T, P, F, C> {
    pub(super) fn new(
        task: T,
        policy: P,
        field: Field<C>,
        training: Training,
        weights: Weights<F>,
        train: Vec<F>,
        test: Vec<F>,
    ) -> Self {
        let params = policy.param_count();
        let n = task.system().state_dim();
        let flows = field.flows();
        Self {
            batch: Batch::new(&task, &policy, training.batch.min(train.len() / n), &flows, training.workers),
            flows,
            evaluation: Evaluation::new(&task, &policy, training.workers),
            optimizer: Optimizer::new(training.rule, training.learning_rate, params),
            order: (0..train.len() / n).collect(),
            starts: Vec::with_capacity(training.batch * n),
            composed: vec![F::zero(); params],
            // Room for all of them, unless "for ever" was meant.
            records: Vec::with_capacity(training.epochs.min(100_000)),
            skips: Vec::new(),
            skipped_in_a_row: 0,
            task,
            policy,
            field,
            training,
            weights,
            train,
            test,
        }
    }

    pub(super) fn into_report(self) -> Report<F> {
        Report { weights: self.weights, records: self.records }
    }

    /// Whether all epochs are done.
    pub fn is_done(&self) -> bool {
        self.records.len() >= self.training.epochs
    }

    /// The task.
    pub fn task(&self) -> &T {
        &self.task
    }

    /// The policy.
    pub fn policy(&self) -> &P {
        &self.policy
    }

    /// The parameters as they are now.
    pub fn weights(&self) -> &Weights<F> {
        &self.weights
    }

    /// One record per epoch done.
    pub fn records(&self) -> &[Record] {
        &self.records
    }

    /// The test start states, `state_dim` numbers per sample.
    pub fn test_starts(&self) -> &[F] {
        &self.test
    }

    /// The updates skipped in the last epoch.
    pub fn skips(&self) -> &[Skip] {
        &self.skips
    }

    /// Runs one epoch: all updates, then the losses of both data sets.
    ///
    /// # Errors
    /// [`TrainError::Diverged`] after too many skipped updates in a row. The parameters are those before them.
    pub fn epoch(&mut self) -> Result<&Record, TrainError> {
        // Among the workers rather than waiting for them: half the work starts without waking anybody.
        #[cfg(feature = "parallel")]
        if self.training.workers > 1 {
            rayon::scope(|_| self.epoch_here())?;
            return Ok(&self.records[self.records.len() - 1]);
        }
        self.epoch_here()?;
        Ok(&self.records[self.records.len() - 1])
    }

    fn epoch_here(&mut self) -> Result<(), TrainError> {
        let begin = Instant::now();
        let epoch = self.records.len() + 1;
        self.skips.clear();
        if self.training.shuffle {
            // From the same start in every epoch, so that a resumed run has the same order.
            self.order.sort_unstable();
            self.order.shuffle(&mut stream(self.training.seed, Purpose::Shuffle, epoch as u64));
        }
        let mut means = Means::default();
        for update in 0..self.order.len().div_ceil(self.training.batch) {
            match self.update(update) {
                Ok(step) => {
                    means.add(&step);
                    self.skipped_in_a_row = 0;
                }
                Err(divergence) => {
                    let skip = Skip { epoch, update, divergence };
                    self.skips.push(skip);
                    self.skipped_in_a_row += 1;
                    if self.skipped_in_a_row > self.training.max_skipped {
                        return Err(TrainError::Diverged { count: self.skipped_in_a_row, last: skip });
                    }
                }
            }
        }
        let mut loss = |starts: &[F]| self.evaluation.run(&self.task, &self.policy, &self.weights, starts).unwrap_or(f64::NAN);
        let (train_loss, test_loss) = (loss(&self.train), loss(&self.test));
        let seconds = begin.elapsed().as_secs_f64();
        self.records.push(means.record(epoch, train_loss, test_loss, self.skips.len(), seconds));
        Ok(())
    }

    /// One update, on mini-batch number `index` of the epoch.
    fn update(&mut self, index: usize) -> Result<Step, Divergence> {
        let n = self.task.system().state_dim();
        let batch = self.training.batch;
        self.starts.clear();
        for &sample in self.order.chunks(batch).nth(index).unwrap_or(&[]) {
            self.starts.extend_from_slice(&self.train[sample * n..][..n]);
        }
        let loss = self.batch.run(&self.task, &self.policy, &self.weights, &self.starts)?;
        let gradients = self.batch.gradients();
        let level = Level::best();
        let (first, second) = (&gradients[0], &gradients[gradients.len() - 1]);
        let (dot, first_square, second_square) = elementwise::moments(level, first, second);
        for (&flow, (gradient, square)) in self.flows.iter().zip([(first, first_square), (second, second_square)]) {
            if !square.is_finite() {
                let parameter = gradient.iter().position(|g| !g.as_().is_finite()).unwrap_or(0);
                return Err(Divergence::Gradient { flow, parameter });
            }
        }
        self.field.compose(gradients, &mut self.composed);
        let composed = gradients.len() > 1;
        let norm =
            if composed { elementwise::moments(level, &self.composed, &self.composed).0.sqrt() } else { first_square.sqrt() };
        let zero = F::zero();
        let step = Step {
            loss,
            norm,
            cosine: composed.then(|| if dot == 0.0 { 0.0 } else { dot / (first_square.sqrt() * second_square.sqrt()) }),
            kept: composed.then(|| self.composed.iter().filter(|&&g| g != zero).count() as f64 / self.composed.len() as f64),
        };
        self.training.clip.apply(&mut self.composed, norm);
        self.weights.update(&self.policy, |theta| self.optimizer.step(theta, &self.composed));
        Ok(step)
    }
}
