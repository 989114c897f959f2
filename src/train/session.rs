//! [`Session`]: a training in progress, one epoch at a time.

use super::checkpoint;
use super::episodes::Windows;
use super::epoch::{Problem, State};
use super::warnings::{TrainedNumber, Warning};
use super::{Begin, CheckpointError, Record, Report, Skip, TrainError, Training};
use crate::dynamics::system::System;
use crate::dynamics::task::Task;
use crate::engine::divergence::Divergence;
use crate::engine::ranks::Ranks;
use crate::engine::schedule::Schedule;
use crate::numbers::scalar::Float;
use crate::policy::{Policy, TrainedParam, Weights};
use crate::train::combination::Combination;
use crate::train::field::{Field, GradientCombiner};
use std::sync::Arc;

/// A training in progress. [`Trainer::session`](crate::Trainer::session) and
/// [`Trainer::session_from`](crate::Trainer::session_from) create it.
#[derive(Debug)]
pub struct Session<T, P, F: Float, C = Combination> {
    task: T,
    policy: P,
    field: Field<C>,
    state: State<F>,
}

impl<T: Task, P: Policy, F: Float, C: GradientCombiner> Session<T, P, F, C> {
    pub(super) fn new(
        task: T,
        policy: P,
        field: Field<C>,
        training: Training,
        windows: Option<Windows>,
        begin: Begin<F>,
        sets: [Vec<F>; 2],
    ) -> Result<Self, TrainError> {
        let state = State::new(&task, &policy, field.flows(), training, windows, begin, sets)?;
        Ok(Self { task, policy, field, state })
    }

    pub(super) fn into_report(self) -> Report<F> {
        let State { weights, best, records, .. } = self.state;
        Report { weights, best: Weights::new(&self.policy, best.theta), records }
    }

    /// Shares the samples of mini-batches and data sets among ranks, each with a session of its
    /// own.
    ///
    /// All sessions need equal settings and states. Every rank then calls the same methods in the
    /// same order, with an equal `pause` in [`advance`](Self::advance). Results are bitwise those
    /// of a single process.
    ///
    /// # Errors
    /// [`TrainError::Memory`] if no schedule fits the memory limit.
    pub fn share(&mut self, ranks: &Arc<dyn Ranks>) -> Result<(), TrainError> {
        self.state.share(&self.task, &self.policy, ranks)
    }

    /// Returns true after the last epoch.
    pub fn is_done(&self) -> bool {
        self.state.records.len() >= self.state.training.epochs
    }

    /// The task.
    pub fn task(&self) -> &T {
        &self.task
    }

    /// The policy.
    pub fn policy(&self) -> &P {
        &self.policy
    }

    /// Current parameters.
    pub fn weights(&self) -> &Weights<F> {
        &self.state.weights
    }

    /// Parameters after the epoch with the lowest test loss, the first of equal ones. Before the
    /// first epoch whose test loss is a number, these are the initial parameters.
    ///
    /// The test set selects these parameters, so their loss on it is optimistic. Evaluate them on
    /// other initial states.
    pub fn best_theta(&self) -> &[F] {
        &self.state.best.theta
    }

    /// Schedule of stored and recomputed steps of a mini-batch.
    pub fn schedule(&self) -> Schedule {
        self.state.batch.schedule()
    }

    /// One record per completed epoch.
    pub fn records(&self) -> &[Record] {
        &self.state.records
    }

    /// Initial states of the test set; see [`initial_states`](crate::initial_states).
    pub fn test_starts(&self) -> &[F] {
        &self.state.test
    }

    /// Updates skipped in the current or last epoch. [`restore`](Session::restore) clears them.
    pub fn skips(&self) -> &[Skip] {
        &self.state.skips
    }

    /// Non-finite numbers in the losses of the training set and of the test set after the last
    /// epoch. [`restore`](Session::restore) clears them.
    pub fn diverged(&self) -> [Option<Divergence>; 2] {
        self.state.diverged
    }

    /// Warnings about the last epoch: skipped updates, non-finite losses, unreliable gradients, and
    /// trained numbers that run away, are at a bound or have no slope.
    /// Each states the epoch. Each states a remedy, unless the causes of skips are unknown after
    /// [`restore`](Session::restore). A session returns each kind of warning once.
    ///
    /// Empty within an epoch. [`Trainer::run`](crate::Trainer::run) prints them.
    pub fn warnings(&mut self) -> Vec<String> {
        self.state
            .new_warnings(self.steps(), &self.numbers())
            .iter()
            .map(Warning::to_string)
            .collect()
    }

    /// All warnings about the last epoch, including kinds that [`warnings`](Self::warnings) has
    /// already returned.
    pub fn epoch_warnings(&self) -> Vec<Warning> {
        self.epoch_warnings_about(&self.numbers())
    }

    /// [`epoch_warnings`](Self::epoch_warnings) about these trained numbers, of the policy too,
    /// instead of those of the system.
    pub fn epoch_warnings_about(&self, numbers: &[TrainedNumber]) -> Vec<Warning> {
        self.state.warnings(self.steps(), numbers)
    }

    /// Steps that an update sees.
    fn steps(&self) -> usize {
        let windows = self.state.episodes.as_ref();
        windows.map_or(self.task.horizon(), |episodes| Task::horizon(&episodes.window))
    }

    /// The numbers of the system that are trained with the policy.
    fn numbers(&self) -> Vec<TrainedNumber> {
        let varied = self.task.system().varied(self.task.param_dim());
        let name = |index: usize| {
            varied.iter().find(|varied| varied.index == index).map(|varied| varied.name.clone())
        };
        let params = self.policy.trained_params();
        let first = self.state.weights.theta().len() - params.len();
        let number = |(i, &map): (usize, &TrainedParam)| {
            let name = name(map.index()).unwrap_or_else(|| format!("p[{}]", map.index()));
            TrainedNumber { name, index: first + i, map }
        };
        params.iter().enumerate().map(number).collect()
    }

    /// Values of these observations by the value function of a training by windows. `None` without.
    ///
    /// # Panics
    /// If the length is not a multiple of the number of observed components.
    pub fn values(&self, observations: &[F]) -> Option<Vec<f64>> {
        self.state.episodes.as_ref()?.values(observations)
    }

    /// Loss of the whole test set with the current parameters; NaN if it diverges.
    pub fn test_loss(&mut self) -> f64 {
        self.state.test_loss(&self.task, &self.policy)
    }

    /// Compares the lowest recorded test loss with the loss that its parameters have now. Returns
    /// both if they differ by more than rounding, for example because the equations of the task
    /// have changed since the training.
    ///
    /// The limit is a relative difference of the square root of the machine epsilon. Chaotic tasks
    /// may exceed it on a processor that rounds differently. A diverged loss is NaN.
    pub fn changed_test_loss(&mut self) -> Option<[f64; 2]> {
        self.state.changed_test_loss(&self.task, &self.policy)
    }

    /// Number of updates applied, without skipped ones.
    pub fn updates(&self) -> u64 {
        self.state.optimizer.steps()
    }

    /// Runs to the end of the epoch: all updates, then the losses of both data sets.
    ///
    /// # Errors
    /// [`TrainError::Diverged`] after too many consecutive skipped updates. Parameters, optimizer
    /// and moving average then return to their state before this epoch.
    pub fn epoch(&mut self) -> Result<&Record, TrainError> {
        self.advance(&|| false).map(|record| record.expect("an epoch without a pause completes"))
    }

    /// Runs until the end of the epoch, or until `pause` returns true after an update.
    ///
    /// Returns the record of the epoch, or `None` after a pause. The next call continues the epoch.
    /// A session restored from a checkpoint of the pause continues the epoch too. Pauses do not
    /// change the results.
    ///
    /// # Errors
    /// [`TrainError::Diverged`] after too many consecutive skipped updates. Parameters, optimizer
    /// and moving average then return to their state before this epoch.
    pub fn advance(
        &mut self,
        pause: &(dyn Fn() -> bool + Sync),
    ) -> Result<Option<&Record>, TrainError> {
        let Self { task, policy, field, state } = self;
        let ended = state.advance(Problem { task, policy, field }, pause)?;
        Ok(state.records.last().filter(|_| ended))
    }

    /// Serializes the session. `label` identifies the run; [`restore`](Session::restore) requires
    /// the same label.
    pub fn checkpoint(&self, label: &str) -> Vec<u8> {
        self.state.checkpoint(label)
    }

    /// Restores a checkpoint of the same run. The updates that follow are bit for bit those of an
    /// uninterrupted run. If no epoch remains, returns to the end of the last complete one.
    ///
    /// # Errors
    /// [`CheckpointError`]. The session is then unchanged.
    pub fn restore(&mut self, bytes: &[u8], label: &str) -> Result<(), CheckpointError> {
        self.state.restore(&self.policy, bytes, label)
    }

    /// Rewrites magic number, format and checksum in `bytes` to match the contents. Used by tests
    /// that corrupt the body.
    #[doc(hidden)]
    pub fn seal(bytes: &mut [u8]) {
        checkpoint::seal(bytes);
    }
}
