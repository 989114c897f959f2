//! Object-safe training session, independent of task, policy and precision.

use crate::operations::adjoint_norms::{self, AdjointNorms};
use crate::operations::onnx;
use crate::operations::policy_file::{self, About};
use crate::operations::trajectory::{self, Trajectory};
use crate::settings::Precision;
use anyhow::Result;
use physgrad::engine::Ranks;
use physgrad::engine::any::AnyTask;
use physgrad::episode::Windows;
use physgrad::train::{CheckpointError, Record, Session, TrainedNumber, Warning};
use physgrad::{DynTask, Field, Float, Policy, Task, TrainError, Trainer, Training};
use std::ops::Range;
use std::sync::Arc;

/// Epoch of a run whose parameters are used.
#[derive(Clone, Copy, Debug, PartialEq, Eq, clap::ValueEnum)]
pub enum Epoch {
    /// The last epoch.
    Last,
    /// The epoch with the lowest test loss.
    Best,
}

/// Object-safe part of a [`Session`].
pub trait AnyRun: Send {
    /// Shares the samples among ranks; see [`Session::share`].
    fn share(&mut self, ranks: &Arc<dyn Ranks>) -> Result<(), TrainError>;
    /// Runs to the end of the epoch, or to the first update after which `pause` returns true.
    ///
    /// Returns the record of the epoch, or None if paused.
    fn advance(&mut self, pause: &(dyn Fn() -> bool + Sync))
    -> Result<Option<&Record>, TrainError>;
    /// Loss of the test set with the current parameters, before the first update. NaN if a rollout
    /// diverges, and without parameters: such a policy is never untrained.
    fn untrained_loss(&mut self) -> f64;
    /// Lowest recorded test loss and the loss of its parameters now, if they differ; see
    /// [`Session::changed_test_loss`].
    fn changed_test_loss(&mut self) -> Option<[f64; 2]>;
    /// Number of updates applied so far.
    fn updates(&self) -> u64;
    /// True after the last epoch.
    fn is_done(&self) -> bool;
    /// Records of the completed epochs.
    fn records(&self) -> &[Record];
    /// Warnings about the last epoch and these trained numbers. Empty within an epoch.
    fn warnings(&self, numbers: &[TrainedNumber]) -> Vec<Warning>;
    /// Serializes the run. [`restore`](Self::restore) requires an equal label.
    fn checkpoint(&self, label: &str) -> Vec<u8>;
    /// Restores a checkpoint with an equal label. On an error, the session is unchanged.
    fn restore(&mut self, bytes: &[u8], label: &str) -> Result<(), CheckpointError>;
    /// Parameters after the epoch as named tensors in the safetensors format.
    fn safetensors(&self, epoch: Epoch, about: &About) -> Result<Vec<u8>>;
    /// The policy after the epoch as an ONNX model.
    fn onnx(&self, epoch: Epoch, about: &About) -> Result<Vec<u8>>;
    /// Values of the trained numbers after the epoch, with their indices in the parameters of a
    /// rollout.
    fn trained(&self, epoch: Epoch) -> Vec<(usize, f64)>;
    /// Parameters of the policy after the epoch, without the trained numbers.
    fn theta(&self, epoch: Epoch) -> Vec<f64>;
    /// Number of initial states in the test set.
    fn test_samples(&self) -> usize;
    /// Rollouts with the current parameters, from a range of test initial states. Truncates the end
    /// of the range to the test set.
    fn rollouts(&self, chosen: Range<usize>) -> Vec<Trajectory>;
    /// [`rollouts`](AnyRun::rollouts) in double precision, from the rounded parameters and states, with
    /// noise at its mean.
    fn mean_rollouts(&self, chosen: Range<usize>) -> Vec<Trajectory>;
    /// Initial states and parameters of a range of the test set, as rollouts without steps.
    fn starts(&self, chosen: Range<usize>) -> Vec<Trajectory>;
    /// Norms of the adjoints of R and M along rollouts with the current parameters. Uses at most
    /// [`adjoint_norms::SAMPLES`] test initial states.
    fn adjoint_norms(&self) -> [AdjointNorms; 2];
}

impl<T: Task, P: Policy, F: Float> AnyRun for Session<T, P, F> {
    fn share(&mut self, ranks: &Arc<dyn Ranks>) -> Result<(), TrainError> {
        Session::share(self, ranks)
    }

    fn advance(
        &mut self,
        pause: &(dyn Fn() -> bool + Sync),
    ) -> Result<Option<&Record>, TrainError> {
        Session::advance(self, pause)
    }

    fn untrained_loss(&mut self) -> f64 {
        if self.policy().param_count() == 0 { f64::NAN } else { Session::test_loss(self) }
    }

    fn changed_test_loss(&mut self) -> Option<[f64; 2]> {
        Session::changed_test_loss(self)
    }

    fn updates(&self) -> u64 {
        Session::updates(self)
    }

    fn is_done(&self) -> bool {
        Session::is_done(self)
    }

    fn records(&self) -> &[Record] {
        Session::records(self)
    }

    fn warnings(&self, numbers: &[TrainedNumber]) -> Vec<Warning> {
        Session::epoch_warnings_about(self, numbers)
    }

    fn checkpoint(&self, label: &str) -> Vec<u8> {
        Session::checkpoint(self, label)
    }

    fn restore(&mut self, bytes: &[u8], label: &str) -> Result<(), CheckpointError> {
        Session::restore(self, bytes, label)
    }

    fn safetensors(&self, epoch: Epoch, about: &About) -> Result<Vec<u8>> {
        policy_file::write(about, self.policy(), theta(self, epoch))
    }

    fn onnx(&self, epoch: Epoch, about: &About) -> Result<Vec<u8>> {
        onnx::write(about, self.policy(), theta(self, epoch))
    }

    fn trained(&self, epoch: Epoch) -> Vec<(usize, f64)> {
        let (trained, theta) = (self.policy().trained_params(), theta(self, epoch));
        let values = &theta[theta.len() - trained.len()..];
        trained.iter().zip(values).map(|(param, r)| (param.index(), param.value(r.as_()))).collect()
    }

    fn theta(&self, epoch: Epoch) -> Vec<f64> {
        let theta = theta(self, epoch);
        theta[..theta.len() - self.policy().trained_params().len()]
            .iter()
            .map(|theta| theta.as_())
            .collect()
    }

    fn test_samples(&self) -> usize {
        self.test_starts().len() / AnyTask::<F>::start_dim(self.task())
    }

    fn rollouts(&self, chosen: Range<usize>) -> Vec<Trajectory> {
        trajectory::rollouts(self.task(), self.policy(), self.weights(), self.test_starts(), chosen)
    }

    fn mean_rollouts(&self, chosen: Range<usize>) -> Vec<Trajectory> {
        let theta: Vec<f64> = self.weights().theta().iter().map(|theta| theta.as_()).collect();
        let starts = self.starts(chosen).into_iter();
        starts.map(|start| trajectory::follow(self.task(), self.policy(), &theta, start)).collect()
    }

    fn starts(&self, chosen: Range<usize>) -> Vec<Trajectory> {
        let task: &dyn AnyTask<F> = self.task();
        let (n, params, len) = (task.state_dim(), task.param_dim(), task.start_dim());
        let start = |start: &[F]| {
            let numbers: Vec<f64> = start.iter().map(|number| number.as_()).collect();
            let (x, rest) = numbers.split_at(n);
            let params = vec![rest[..params].to_vec()];
            Trajectory { states: vec![x.to_vec()], controls: Vec::new(), params }
        };
        let all = self.test_starts().chunks_exact(len);
        all.skip(chosen.start).take(chosen.len()).map(start).collect()
    }

    fn adjoint_norms(&self) -> [AdjointNorms; 2] {
        adjoint_norms::norms(self.task(), self.policy(), self.weights(), self.test_starts())
    }
}

/// Current parameters for [`Epoch::Last`], also within an epoch. For [`Epoch::Best`], see
/// [`Session::best_theta`].
fn theta<T: Task, P: Policy, F: Float>(session: &Session<T, P, F>, epoch: Epoch) -> &[F] {
    match epoch {
        Epoch::Last => session.weights().theta(),
        Epoch::Best => session.best_theta(),
    }
}

/// Opens a session before its first epoch, with the parameters `theta`. Without, they are drawn.
pub fn open<P: Policy + 'static>(
    task: DynTask,
    policy: P,
    precision: Precision,
    field: Field,
    training: Training,
    windows: Option<Windows>,
    theta: Option<Vec<f64>>,
) -> Result<Box<dyn AnyRun>> {
    let mut trainer = Trainer::new(task, policy).field(field).training(training);
    if let Some(theta) = theta {
        trainer = trainer.start_from(theta);
    }
    if let Some(windows) = windows {
        trainer = trainer.windows(windows);
    }
    Ok(match precision {
        Precision::F32 => Box::new(trainer.precision::<f32>().session()?),
        Precision::F64 => Box::new(trainer.precision::<f64>().session()?),
    })
}
