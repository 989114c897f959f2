//! [`Trainer`]: what is trained, and how. Thin: every step of it is a call that a user can make alone.

mod checkpoint;
pub(crate) mod field;
pub(crate) mod optim;
mod progress;
mod record;
mod session;
pub mod toy;

pub use checkpoint::{CheckpointError, differences};
pub use record::{Record, Skip};
pub use session::Session;

use crate::dynamics::task::Task;
use crate::engine::any::AnyTask;
use crate::engine::schedule::MemoryError;
use crate::numbers::rng::{Purpose, stream};
use crate::numbers::scalar::Float;
use crate::policy::{Policy, Weights};
use crate::train::field::{Compose, Field, SignAgreement};
use crate::train::optim::{Clip, Rule};
use std::marker::PhantomData;

/// How to train. The defaults are the paper's.
#[derive(Clone, Debug, PartialEq)]
pub struct Training {
    /// Passes over the training set, in all.
    pub epochs: usize,
    /// Samples per update.
    pub batch: usize,
    /// Start states to train on.
    pub train_samples: usize,
    /// Start states to test on.
    pub test_samples: usize,
    /// Decides start states, initial parameters and, if shuffled, the order.
    pub seed: u64,
    /// A new order of the training set in every epoch. The paper keeps one order.
    pub shuffle: bool,
    /// The optimizer.
    pub rule: Rule,
    /// Its learning rate.
    pub learning_rate: f64,
    /// Limits the field before the optimizer.
    pub clip: Clip,
    /// Updates in a row that may be skipped because a number was not finite; one more stops the training.
    pub max_skipped: usize,
    /// Threads a mini-batch is split over. Results do not depend on it.
    pub workers: usize,
    /// Bytes that the rollouts and gradients of a mini-batch may take, over all workers: steps are run again for what
    /// there is no room for, see [`Schedule`](crate::Schedule). Without it everything is stored. Results do not depend on
    /// it.
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
            rule: Rule::Adam { beta1: 0.9, beta2: 0.999, epsilon: 1e-7 },
            learning_rate: 1e-3,
            clip: Clip::None,
            max_skipped: 10,
            workers: 1,
            memory: None,
        }
    }
}

impl Training {
    /// # Errors
    /// The first setting that cannot work.
    fn validate(&self) -> Result<(), TrainError> {
        let counts = [
            ("batch", self.batch),
            ("train_samples", self.train_samples),
            ("test_samples", self.test_samples),
            ("workers", self.workers),
        ];
        if let Some((setting, _)) = counts.into_iter().find(|&(_, count)| count == 0) {
            return Err(TrainError::Setting { setting, problem: "is 0; at least 1 is needed".into() });
        }
        // Larger rates could overflow θ in one step.
        if !(self.learning_rate > 0.0 && self.learning_rate <= 1e6) {
            let problem = format!("is {}; a positive number up to 1e6 is needed", self.learning_rate);
            return Err(TrainError::Setting { setting: "learning_rate", problem });
        }
        Ok(())
    }
}

/// Why a training stopped.
#[derive(Debug, thiserror::Error)]
pub enum TrainError {
    /// A setting that cannot work.
    #[error("training.{setting}: {problem}")]
    Setting {
        /// Its name.
        setting: &'static str,
        /// What is wrong, and what is allowed.
        problem: String,
    },
    /// The memory that a mini-batch may take is too little.
    #[error("training.memory: {0}")]
    Memory(MemoryError),
    /// Too many updates in a row were skipped.
    #[error(
        "training stopped: {count} updates in a row were skipped, the last in epoch {}, update {} ({}). \
         The parameters are those before this epoch. Try a smaller learning rate, clipping by norm, a shorter horizon, or field C or M",
        last.epoch, last.update, last.divergence
    )]
    Diverged {
        /// How many.
        count: usize,
        /// The last of them.
        last: Skip,
    },
}

/// A training to be run: what, with which policy, following which field.
///
/// ```
/// use physgrad::{Field, Trainer, policy::Mlp, tasks::CartPole};
///
/// let report = Trainer::new(CartPole::new(1), Mlp::new([4, 16, 1])).field(Field::combined()).epochs(2).run()?;
/// assert_eq!(report.records.len(), 2);
/// # Ok::<(), physgrad::TrainError>(())
/// ```
#[derive(Clone, Debug)]
pub struct Trainer<T, P, F = f32, C = SignAgreement> {
    task: T,
    policy: P,
    field: Field<C>,
    training: Training,
    precision: PhantomData<F>,
}

impl<T: Task, P: Policy> Trainer<T, P> {
    /// The paper's settings: the combined field, Adam, 1000 epochs, single precision.
    pub fn new(task: T, policy: P) -> Self {
        Self { task, policy, field: Field::combined(), training: Training::default(), precision: PhantomData }
    }
}

impl<T: Task, P: Policy, F: Float, C: Compose> Trainer<T, P, F, C> {
    /// Follows this field.
    pub fn field<D: Compose>(self, field: Field<D>) -> Trainer<T, P, F, D> {
        let Self { task, policy, training, precision, .. } = self;
        Trainer { task, policy, field, training, precision }
    }

    /// Computes in this precision, `f32` or `f64`.
    pub fn precision<G: Float>(self) -> Trainer<T, P, G, C> {
        let Self { task, policy, field, training, .. } = self;
        Trainer { task, policy, field, training, precision: PhantomData }
    }

    /// Trains for so many epochs in all.
    pub fn epochs(mut self, epochs: usize) -> Self {
        self.training.epochs = epochs;
        self
    }

    /// Draws start states and initial parameters from this seed.
    pub fn seed(mut self, seed: u64) -> Self {
        self.training.seed = seed;
        self
    }

    /// Replaces all settings.
    pub fn training(mut self, training: Training) -> Self {
        self.training = training;
        self
    }

    /// Trains to the end.
    ///
    /// # Errors
    /// A setting that cannot work, or too many non-finite updates in a row.
    pub fn run(self) -> Result<Report<F>, TrainError> {
        let mut session = self.session()?;
        while !session.is_done() {
            session.epoch()?;
        }
        Ok(session.into_report())
    }

    /// Draws data and parameters and sizes every workspace; epochs are then run one by one.
    ///
    /// # Errors
    /// A setting that cannot work.
    ///
    /// # Panics
    /// If task and policy have different dimensions.
    pub fn session(self) -> Result<Session<T, P, F, C>, TrainError> {
        let Self { task, policy, field, training, .. } = self;
        training.validate()?;
        let starts = |purpose, samples| starts(&task, training.seed, purpose, samples);
        let (train, test) = (starts(Purpose::Train, training.train_samples), starts(Purpose::Test, training.test_samples));
        let weights = Weights::init(&policy, &mut stream(training.seed, Purpose::Policy, 0));
        Session::new(task, policy, field, training, weights, train, test)
    }

    /// As [`session`](Trainer::session), with given parameters and start states (`state_dim` numbers per sample)
    /// instead of drawn ones.
    ///
    /// # Errors
    /// A setting that cannot work, or an empty set.
    ///
    /// # Panics
    /// If `theta` is not the policy's, or task and policy have different dimensions.
    pub fn session_from(self, theta: Vec<F>, train: Vec<F>, test: Vec<F>) -> Result<Session<T, P, F, C>, TrainError> {
        let Self { task, policy, field, training, .. } = self;
        let weights = Weights::new(&policy, theta);
        Session::new(task, policy, field, training, weights, train, test)
    }
}

/// Start states, each of its own stream.
fn starts<F: Float>(task: &dyn AnyTask<F>, seed: u64, purpose: Purpose, samples: usize) -> Vec<F> {
    let mut x = vec![0.0; task.state_dim()];
    let mut all = Vec::with_capacity(samples * x.len());
    for sample in 0..samples {
        x.fill(0.0);
        task.start(&mut stream(seed, purpose, sample as u64), &mut x);
        all.extend(x.iter().map(|&x| F::lift(x)));
    }
    all
}

/// What a training leaves.
#[derive(Clone, Debug)]
pub struct Report<F> {
    /// The trained parameters.
    pub weights: Weights<F>,
    /// One record an epoch.
    pub records: Vec<Record>,
}

impl From<MemoryError> for TrainError {
    fn from(error: MemoryError) -> Self {
        Self::Memory(error)
    }
}
