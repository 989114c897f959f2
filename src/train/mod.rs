//! Training: data sets, mini-batches, vector fields, optimizers, sessions and checkpoints.
//!
//! - [`Trainer`]: builder of a training.
//! - [`Session`]: a training in progress, one epoch at a time, with checkpoints.
//! - [`Training`]: settings. [`Decay`]: learning rates. [`Record`]: results of one epoch.
//! - [`Field`] and [`GradientCombiner`]: the vector field that the optimizer follows.
//! - [`Combination`]: rules that combine M and R.
//! - [`Smoothing`]: estimates from perturbed parameters.
//! - [`Windows`]: episodes that updates see a window at a time, with a value function of its end.
//! - [`OptimizerKind`] and [`Clip`]: update rules, and clipping of the field.
//! - [`vector_field`]: the two-parameter examples of the paper.
//!
//! Imports `numbers`, `dynamics`, `policy` and `engine`. Read this file first, then `epoch.rs`,
//! which contains the update. Mini-batches, fields, clipping and optimizers are public, so that
//! users can write their own updates.

mod average;
pub mod calls;
mod checkpoint;
pub(crate) mod combination;
pub(crate) mod critic;
mod decay;
pub(crate) mod episodes;
mod epoch;
pub(crate) mod field;
pub(crate) mod optim;
mod record;
mod session;
mod smoothing;
mod units;
pub mod vector_field;
mod warnings;
mod window;

pub use calls::Trajectories;
pub use checkpoint::{CheckpointError, differences};
pub use combination::Combination;
pub use decay::Decay;
pub use field::{GradientCombiner, UnknownField};
pub use optim::OptimizerKind;
pub use record::{Record, Skip};
pub use session::Session;
pub use smoothing::{Estimator, Smoothing};
pub use warnings::{TrainedNumber, Warning};

use crate::dynamics::task::Task;
use crate::engine::divergence::{Divergence, InTraining};
use crate::engine::initial_states::initial_states;
use crate::engine::schedule::MemoryError;
use crate::numbers::rng::{Purpose, stream};
use crate::numbers::scalar::Float;
use crate::policy::{Policy, Weights};
use crate::train::episodes::Windows;
use crate::train::field::Field;
use crate::train::optim::Clip;
use std::io::Write as _;
use std::marker::PhantomData;

/// Settings of a training. The defaults are those of the paper.
#[derive(Clone, Debug, PartialEq)]
pub struct Training {
    /// Number of passes over the training set.
    pub epochs: usize,
    /// Samples per update.
    pub batch: usize,
    /// Number of initial states in the training set.
    pub train_samples: usize,
    /// Number of initial states in the test set.
    pub test_samples: usize,
    /// Seed of the initial states and of the initial parameters of the policy. Also the seed of the
    /// sample order with `shuffle`, and of the perturbations with `smoothing`.
    pub seed: u64,
    /// Shuffles the training set before every epoch. The paper uses one fixed order.
    pub shuffle: bool,
    /// Draws new initial states and parameters of the task for the updates of every epoch. Sample i
    /// of epoch e has the random stream of training sample e N + i. N is the number of training
    /// samples, and i and e start at 0. The data sets on which losses are evaluated do not change.
    pub resample: bool,
    /// Update rule of the optimizer.
    pub rule: OptimizerKind,
    /// Learning rate of the optimizer, positive and at most 1e6.
    pub learning_rate: f64,
    /// Decay of the learning rate over all epochs. A checkpoint restored with another number of
    /// epochs continues with the decay for that number.
    pub decay: Decay,
    /// Number of updates at the start in which the learning rate rises linearly to its full value.
    pub warm_up: usize,
    /// Weight of the past, from 0 to below 1, in a moving average of the direction of R. In fields
    /// of two flows, the average times the norm of R replaces R. With 0, fields use the current R.
    /// In custom fields, R stands for the second gradient. With `smoothing`, every evaluation of
    /// the field at perturbed parameters updates the average.
    pub average: f64,
    /// Noise in the parameters, and the estimator that uses it. With `None`, updates follow the
    /// field at the unperturbed parameters.
    pub smoothing: Option<Smoothing>,
    /// Clipping of the field, before the optimizer. `docs/results.md` compares the variants.
    pub clip: Clip,
    /// Largest number of consecutive updates skipped because of a
    /// [`Divergence`]. One more stops the training.
    pub max_skipped: usize,
    /// Number of threads that share a mini-batch. Results do not depend on it.
    pub workers: usize,
    /// Upper bound in bytes on the workspace of a mini-batch, over all workers. Steps whose tape
    /// does not fit are recomputed, see [`Schedule`](crate::engine::Schedule). `None` stores
    /// everything. Results do not depend on the bound.
    pub memory: Option<u64>,
}

impl Default for Training {
    fn default() -> Self {
        Self {
            epochs: 1000,
            batch: 8,
            train_samples: 256,
            test_samples: 256,
            seed: 0,
            shuffle: false,
            resample: false,
            rule: OptimizerKind::Adam { beta1: 0.9, beta2: 0.999, epsilon: 1e-7 },
            learning_rate: 1e-3,
            decay: Decay::Constant,
            warm_up: 0,
            average: 0.0,
            smoothing: None,
            clip: Clip::None,
            max_skipped: 10,
            workers: 1,
            memory: None,
        }
    }
}

impl Training {
    /// Number of samples for which a mini-batch of `samples` samples needs memory for gradients.
    /// One for zeroth-order estimates, which use losses only.
    pub fn derived(&self, samples: usize) -> usize {
        let is_zeroth =
            self.smoothing.is_some_and(|smoothing| smoothing.estimator == Estimator::ZerothOrder);
        if is_zeroth { 1 } else { samples }
    }

    /// Checks counts, learning rate, rule, decay, average, smoothing and clipping.
    ///
    /// # Errors
    /// [`TrainError::Setting`] for the first invalid setting.
    fn validate(&self) -> Result<(), TrainError> {
        let counts = [
            ("batch", self.batch),
            ("train_samples", self.train_samples),
            ("test_samples", self.test_samples),
            ("workers", self.workers),
        ];
        if let Some((setting, _)) = counts.into_iter().find(|&(_, count)| count == 0) {
            return Err(TrainError::Setting {
                setting,
                problem: "is 0; allowed: 1 or more".into(),
            });
        }
        // Larger rates can overflow θ in one step.
        if !(self.learning_rate > 0.0 && self.learning_rate <= 1e6) {
            let problem =
                format!("is {}; allowed: a positive number up to 1e6", self.learning_rate);
            return Err(TrainError::Setting { setting: "learning_rate", problem });
        }
        if let Some(problem) = self.rule.problem() {
            return Err(TrainError::Setting { setting: "rule", problem });
        }
        if let Some(problem) = self.decay.problem() {
            return Err(TrainError::Setting { setting: "decay", problem });
        }
        if !(0.0..1.0).contains(&self.average) {
            let problem = format!("is {}; allowed: 0 to below 1", self.average);
            return Err(TrainError::Setting { setting: "average", problem });
        }
        if let Some((setting, problem)) = self.smoothing.and_then(|smoothing| smoothing.problem()) {
            return Err(TrainError::Setting { setting, problem });
        }
        if let Some(problem) = self.clip.problem() {
            return Err(TrainError::Setting { setting: "clip", problem });
        }
        Ok(())
    }
}

/// Error of a training.
#[derive(Debug, thiserror::Error)]
pub enum TrainError {
    /// Invalid setting.
    #[error("training.{setting}: {problem}")]
    Setting {
        /// Name of the setting.
        setting: &'static str,
        /// Problem and allowed values.
        problem: String,
    },
    /// No schedule fits the memory limit of a mini-batch.
    #[error("training.memory: {0}")]
    Memory(MemoryError),
    /// More than [`Training::max_skipped`] consecutive updates were skipped.
    #[error(
        "training stopped: {count} updates in a row were skipped, the last in epoch {}, update {} ({}). \
         The parameters are those before this epoch{}",
        last.epoch, last.update, InTraining(&last.divergence), advice(&last.divergence)
    )]
    Diverged {
        /// Number of consecutive skipped updates.
        count: usize,
        /// Last skipped update.
        last: Box<Skip>,
    },
    /// A method of the task or policy leaves a component of its output unwritten. Its value would
    /// be that of an earlier step or sample.
    #[error(
        "`{method}` leaves component {component} of its output unwritten. Write every component in every call"
    )]
    Unwritten {
        /// `observe`, `act` of the policy or `step`.
        method: &'static str,
        /// Index of the component. Memory follows the controls.
        component: usize,
    },
}

/// Advice after consecutive skips, unless the task alone caused them.
fn advice(divergence: &Divergence) -> &'static str {
    if divergence.is_of_task() {
        "."
    } else {
        ". Try a smaller learning rate, clipping by norm, a shorter horizon, or field C or M"
    }
}

/// Builder of a training: a task, a policy, a vector field and settings.
///
/// ```
/// use physgrad::{Field, Trainer, policy::Mlp, tasks::CartPole};
///
/// let report = Trainer::new(CartPole::new(1), Mlp::new([4, 16, 1])).field(Field::combined()).epochs(2).run()?;
/// assert_eq!(report.records.len(), 2);
/// # Ok::<(), physgrad::TrainError>(())
/// ```
#[derive(Clone, Debug)]
pub struct Trainer<T, P, F = f32, C = Combination> {
    task: T,
    policy: P,
    field: Field<C>,
    training: Training,
    /// Number of epochs in place of that of `training`.
    epochs: Option<usize>,
    /// Seed in place of that of `training`.
    seed: Option<u64>,
    /// Parameters at the start of the training. None for those of [`Policy::init`].
    theta: Option<Vec<f64>>,
    windows: Option<Windows>,
    precision: PhantomData<F>,
}

impl<T: Task, P: Policy> Trainer<T, P> {
    /// Creates a trainer with the settings of the paper: combined field, Adam, 1000 epochs, `f32`.
    pub fn new(task: T, policy: P) -> Self {
        Self {
            task,
            policy,
            field: Field::combined(),
            training: Training::default(),
            epochs: None,
            seed: None,
            theta: None,
            windows: None,
            precision: PhantomData,
        }
    }
}

impl<T: Task, P: Policy, F: Float, C: GradientCombiner> Trainer<T, P, F, C> {
    /// Sets the vector field.
    pub fn field<D: GradientCombiner>(self, field: Field<D>) -> Trainer<T, P, F, D> {
        let Self { task, policy, training, epochs, seed, theta, windows, precision, .. } = self;
        Trainer { task, policy, field, training, epochs, seed, theta, windows, precision }
    }

    /// Sets the precision, `f32` or `f64`.
    pub fn precision<G: Float>(self) -> Trainer<T, P, G, C> {
        let Self { task, policy, field, training, epochs, seed, theta, windows, .. } = self;
        Trainer {
            task,
            policy,
            field,
            training,
            epochs,
            seed,
            theta,
            windows,
            precision: PhantomData,
        }
    }

    /// Sets the number of epochs. It replaces [`Training::epochs`], also if
    /// [`training`](Self::training) follows.
    pub fn epochs(mut self, epochs: usize) -> Self {
        self.epochs = Some(epochs);
        self
    }

    /// Sets the seed of all random numbers; see [`Training::seed`]. It replaces the seed of
    /// [`training`](Self::training), also if this follows.
    pub fn seed(mut self, seed: u64) -> Self {
        self.seed = Some(seed);
        self
    }

    /// Starts from these parameters of the policy, rather than from those of [`Policy::init`].
    pub fn start_from(mut self, theta: Vec<f64>) -> Self {
        self.theta = Some(theta);
        self
    }

    /// Trains by windows of an episode rather than by whole rollouts.
    pub fn windows(mut self, windows: Windows) -> Self {
        self.windows = Some(windows);
        self
    }

    /// Replaces all settings, except those of [`epochs`](Self::epochs) and [`seed`](Self::seed).
    pub fn training(mut self, training: Training) -> Self {
        self.training = training;
        self
    }

    /// Runs all epochs. Prints [`Session::warnings`] to standard error.
    ///
    /// # Errors
    /// [`TrainError`] if a setting is invalid, the memory limit is too small, or too many
    /// consecutive updates are skipped.
    ///
    /// # Panics
    /// As [`session`](Self::session).
    pub fn run(self) -> Result<Report<F>, TrainError> {
        // Ignores errors: standard error may be closed.
        self.run_with_warnings(|warning| _ = writeln!(std::io::stderr(), "warning: {warning}"))
    }

    /// Runs all epochs. Calls `warn` with each of [`Session::warnings`] after each epoch.
    ///
    /// ```
    /// use physgrad::{Trainer, policy::Mlp, tasks::CartPole};
    ///
    /// let mut warnings = Vec::new();
    /// let trainer = Trainer::new(CartPole::new(1), Mlp::new([4, 16, 1])).epochs(2);
    /// trainer.run_with_warnings(|warning| warnings.push(warning.to_owned()))?;
    /// # Ok::<(), physgrad::TrainError>(())
    /// ```
    ///
    /// # Errors
    /// As [`run`](Self::run).
    ///
    /// # Panics
    /// As [`session`](Self::session).
    pub fn run_with_warnings(self, mut warn: impl FnMut(&str)) -> Result<Report<F>, TrainError> {
        let mut session = self.session()?;
        while !session.is_done() {
            session.epoch()?;
            session.warnings().iter().for_each(|warning| warn(warning));
        }
        Ok(session.into_report())
    }

    /// Creates a session. The caller runs its epochs one at a time.
    ///
    /// Draws the data sets and, without [`start_from`](Self::start_from), the initial parameters.
    /// Allocates all workspaces.
    ///
    /// # Errors
    /// [`TrainError`] if a setting is invalid, the memory limit is too small, or a parameter of
    /// [`start_from`](Self::start_from) is non-finite.
    /// Also if task or policy leave a component of their outputs unwritten in the first step.
    ///
    /// # Panics
    /// If the dimensions of task and policy differ. If the policy trains a parameter that the task
    /// lacks. If the horizon is 0. If the number of parameters of [`start_from`](Self::start_from)
    /// differs from the policy's `param_count`.
    pub fn session(self) -> Result<Session<T, P, F, C>, TrainError> {
        let training = self.settings();
        let Self { task, policy, field, theta, windows, .. } = self;
        training.validate()?;
        let starts = |purpose, samples| initial_states(&task, training.seed, purpose, samples);
        let (train, test) = (
            starts(Purpose::Train, training.train_samples),
            starts(Purpose::Test, training.test_samples),
        );
        let begin = match theta {
            Some(theta) => {
                let theta = finite(theta.into_iter().map(F::from_f64).collect())?;
                Begin { weights: Weights::new(&policy, theta), is_drawn: false }
            }
            None => {
                let rng = &mut stream(training.seed, Purpose::Policy, 0);
                Begin { weights: Weights::init(&policy, rng), is_drawn: true }
            }
        };
        Session::new(task, policy, field, training, windows, begin, [train, test])
    }

    /// Creates a session from given parameters and initial states; see
    /// [`initial_states`]. Ignores [`start_from`](Self::start_from).
    ///
    /// With [`Training::resample`], updates draw their initial states from the task. `train` then
    /// serves for losses only, and its length sets the number of samples of an epoch.
    ///
    /// # Errors
    /// [`TrainError`] if a setting is invalid, the memory limit is too small, or a parameter is
    /// non-finite. Also if a set is empty or not a whole number of samples.
    /// Also if task or policy leave a component of their outputs unwritten in the first step.
    ///
    /// # Panics
    /// If the length of `theta` differs from the policy's `param_count`. If the dimensions of task
    /// and policy differ. If the policy trains a parameter that the task lacks. If the horizon is
    /// 0.
    pub fn session_from(
        self,
        theta: Vec<F>,
        train: Vec<F>,
        test: Vec<F>,
    ) -> Result<Session<T, P, F, C>, TrainError> {
        let training = self.settings();
        let Self { task, policy, field, windows, .. } = self;
        let begin = Begin { weights: Weights::new(&policy, finite(theta)?), is_drawn: false };
        Session::new(task, policy, field, training, windows, begin, [train, test])
    }

    /// All settings, with the number of epochs and the seed of the builder.
    fn settings(&self) -> Training {
        let Training { epochs, seed, .. } = self.training;
        Training {
            epochs: self.epochs.unwrap_or(epochs),
            seed: self.seed.unwrap_or(seed),
            ..self.training.clone()
        }
    }
}

/// Parameters at the start of a training.
struct Begin<F> {
    weights: Weights<F>,
    /// Whether they are those of [`Policy::init`].
    is_drawn: bool,
}

/// Returns the parameters, or an error if one is non-finite.
fn finite<F: Float>(theta: Vec<F>) -> Result<Vec<F>, TrainError> {
    match theta.iter().position(|value| !value.to_f64().is_finite()) {
        None => Ok(theta),
        Some(i) => {
            let problem = format!(
                "contains {} at index {i}; allowed: finite numbers in {}",
                theta[i],
                F::NAME
            );
            Err(TrainError::Setting { setting: "theta", problem })
        }
    }
}

/// Result of a training.
#[derive(Clone, Debug)]
pub struct Report<F> {
    /// Trained parameters, after the last epoch.
    pub weights: Weights<F>,
    /// Parameters after the epoch with the lowest test loss; see [`Session::best_theta`].
    pub best: Weights<F>,
    /// One record per epoch.
    pub records: Vec<Record>,
}

impl From<MemoryError> for TrainError {
    fn from(error: MemoryError) -> Self {
        Self::Memory(error)
    }
}
