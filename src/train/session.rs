//! [`Session`]: a training under way, epoch by epoch.

use super::checkpoint;
use super::progress::{Progress, Trained};
use super::{CheckpointError, Record, Report, Skip, TrainError, Training};
use crate::dynamics::task::Task;
use crate::engine::divergence::Divergence;
use crate::engine::schedule::Schedule;
use crate::numbers::scalar::Float;
use crate::policy::{Policy, Weights};
use crate::train::field::{Compose, Field, SignAgreement};

/// A training under way.
#[derive(Debug)]
pub struct Session<T, P, F: Float, C = SignAgreement> {
    task: T,
    policy: P,
    field: Field<C>,
    progress: Progress<F>,
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
    ) -> Result<Self, TrainError> {
        let progress = Progress::new(&task, &policy, field.flows(), training, weights, train, test)?;
        Ok(Self { task, policy, field, progress })
    }

    pub(super) fn into_report(self) -> Report<F> {
        Report { weights: self.progress.weights, records: self.progress.records }
    }

    /// Whether all epochs are done.
    pub fn is_done(&self) -> bool {
        self.progress.records.len() >= self.progress.training.epochs
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
        &self.progress.weights
    }

    /// What is kept of the trajectories of a mini-batch, and what is run again.
    pub fn schedule(&self) -> Schedule {
        self.progress.batch.schedule()
    }

    /// One record per epoch done.
    pub fn records(&self) -> &[Record] {
        &self.progress.records
    }

    /// The test start states, `state_dim` numbers per sample.
    pub fn test_starts(&self) -> &[F] {
        &self.progress.test
    }

    /// The updates skipped in the last epoch.
    pub fn skips(&self) -> &[Skip] {
        &self.progress.skips
    }

    /// Where the evaluation of the training set and of the test set at the end of the last epoch was not finite.
    pub fn diverged(&self) -> [Option<Divergence>; 2] {
        self.progress.diverged
    }

    /// Updates applied so far, without skipped ones.
    pub fn updates(&self) -> u64 {
        self.progress.optimizer.steps()
    }

    /// Runs to the end of the epoch: all updates, then the losses of both data sets.
    ///
    /// # Errors
    /// [`TrainError::Diverged`] after too many skipped updates in a row. The session is then as it was before this
    /// epoch.
    pub fn epoch(&mut self) -> Result<&Record, TrainError> {
        self.advance(&|| false).map(|record| record.expect("without a pause, the epoch ends"))
    }

    /// Runs to the end of the epoch and returns its record, or to the first update after which `pause` returns true, and
    /// returns `None`. The next call goes on from there, and so does a session that takes a checkpoint of the pause.
    /// Pauses do not change the results.
    ///
    /// # Errors
    /// [`TrainError::Diverged`] after too many skipped updates in a row. The session is then as it was before this
    /// epoch.
    pub fn advance(&mut self, pause: &(dyn Fn() -> bool + Sync)) -> Result<Option<&Record>, TrainError> {
        let Self { task, policy, field, progress } = self;
        let ended = progress.advance(Trained { task, policy, field }, pause)?;
        Ok(progress.records.last().filter(|_| ended))
    }

    /// The session as bytes. `label` says which run it is; to take it back, the same label is needed.
    pub fn checkpoint(&self, label: &str) -> Vec<u8> {
        self.progress.checkpoint(label)
    }

    /// Takes a checkpoint of the same run back: the updates that follow are, bit for bit, those of a run that was never
    /// interrupted.
    ///
    /// # Errors
    /// [`CheckpointError`], with the session as it was.
    pub fn restore(&mut self, bytes: &[u8], label: &str) -> Result<(), CheckpointError> {
        self.progress.restore(&self.policy, bytes, label)
    }

    /// Makes the checksum that of whatever the bytes are, so that tests reach what stands behind it.
    #[doc(hidden)]
    pub fn seal(bytes: &mut [u8]) {
        checkpoint::seal(bytes);
    }
}
