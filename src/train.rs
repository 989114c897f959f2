//! [`Trainer`]: epochs, mini-batches, records. Thin: every step is a call that a user can make alone.

mod checkpoint;

pub use checkpoint::CheckpointError;

use crate::backward::Flow;
use crate::batch::{Batch, Evaluation};
use crate::field::{Compose, Field, SignAgreement};
use crate::kernels::{Level, elementwise};
use crate::optim::{Clip, Optimizer, Rule};
use crate::policy::{Policy, Weights};
use crate::rng::{Purpose, stream};
use crate::rollout::Divergence;
use crate::scalar::Float;
use crate::system::System;
use crate::task::Task;
use rand::seq::SliceRandom;
use serde::{Deserialize, Serialize};
use std::marker::PhantomData;
use std::time::Instant;

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
    /// Updates in a row that may be skipped because a number was not finite.
    pub max_skipped: usize,
    /// Threads a mini-batch is split over. Results do not depend on it.
    pub workers: usize,
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
        }
    }
}

/// What happened in one epoch.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Record {
    /// Number of the epoch, from 1.
    pub epoch: usize,
    /// Mean over the updates of the batch loss before each update.
    pub loss: f64,
    /// Loss of the whole training set after the epoch; NaN if it diverged.
    pub train_loss: f64,
    /// Loss of the whole test set after the epoch; NaN if it diverged.
    pub test_loss: f64,
    /// Mean over the updates of the length of the field, before clipping.
    pub grad_norm: f64,
    /// Mean over the updates of the cosine between the two gradients of a composed field.
    pub cosine: Option<f64>,
    /// Mean over the updates of the share of components that a composition leaves non-zero.
    pub kept: Option<f64>,
    /// Updates that were not taken because a number was not finite.
    pub skipped: usize,
    /// Wall time of the epoch, updates and evaluation, in seconds.
    pub seconds: f64,
}

/// An update that was not taken.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Skip {
    /// Number of the epoch, from 1.
    pub epoch: usize,
    /// Number of the update in its epoch, from 0.
    pub update: usize,
    /// Where a number was not finite; samples are counted in the mini-batch.
    pub divergence: Divergence,
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
    /// Too many updates in a row were skipped.
    #[error(
        "training stopped: {count} updates in a row were skipped, the last in epoch {}, update {} ({}). \
         Nothing was changed by them. Try a smaller learning rate, clipping by norm, a shorter horizon, or field C or M",
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
        Ok(Report { weights: session.weights, records: session.records })
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
        for (setting, value) in [
            ("batch", training.batch),
            ("train_samples", training.train_samples),
            ("test_samples", training.test_samples),
            ("workers", training.workers),
            ("max_skipped", training.max_skipped),
        ] {
            if value == 0 {
                return Err(TrainError::Setting { setting, problem: "is 0; at least 1 is needed".into() });
            }
        }
        if !(training.learning_rate.is_finite() && training.learning_rate > 0.0) {
            let problem = format!("is {}; a positive number is needed", training.learning_rate);
            return Err(TrainError::Setting { setting: "learning_rate", problem });
        }
        let seed = training.seed;
        let starts = |purpose, samples| -> Vec<F> {
            let mut x = vec![0.0; task.system().state_dim()];
            let draw = |index| {
                task.start(&mut stream(seed, purpose, index as u64), &mut x);
                x.iter().map(|&x| F::lift(x)).collect::<Vec<F>>()
            };
            (0..samples).flat_map(draw).collect()
        };
        let (train, test) = (starts(Purpose::Train, training.train_samples), starts(Purpose::Test, training.test_samples));
        let weights = Weights::init(&policy, &mut stream(seed, Purpose::Policy, 0));
        Ok(Session::new(task, policy, field, training, weights, train, test))
    }

    /// As [`session`](Trainer::session), with given parameters and start states (`state_dim` numbers per sample)
    /// instead of drawn ones.
    pub fn session_from(self, theta: Vec<F>, train: Vec<F>, test: Vec<F>) -> Session<T, P, F, C> {
        let Self { task, policy, field, training, .. } = self;
        let weights = Weights::new(&policy, theta);
        Session::new(task, policy, field, training, weights, train, test)
    }
}

/// What a training leaves.
#[derive(Clone, Debug)]
pub struct Report<F> {
    /// The trained parameters.
    pub weights: Weights<F>,
    /// One record an epoch.
    pub records: Vec<Record>,
}

/// A training under way.
#[derive(Debug)]
pub struct Session<T, P, F: Float, C = SignAgreement> {
    task: T,
    policy: P,
    field: Field<C>,
    training: Training,
    weights: Weights<F>,
    optimizer: Optimizer<F>,
    train: Vec<F>,
    test: Vec<F>,
    order: Vec<usize>,
    records: Vec<Record>,
    skips: Vec<Skip>,
    /// Skipped updates up to now, in a row.
    skipped_in_a_row: usize,
    flows: Vec<Flow>,
    batch: Batch<F>,
    evaluation: Evaluation<F>,
    starts: Vec<F>,
    composed: Vec<F>,
}

impl<T: Task, P: Policy, F: Float, C: Compose> Session<T, P, F, C> {
    fn new(task: T, policy: P, field: Field<C>, training: Training, weights: Weights<F>, train: Vec<F>, test: Vec<F>) -> Self {
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
        Ok(&self.records[self.records.len() - 1])
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

/// What one update tells.
struct Step {
    loss: f64,
    norm: f64,
    cosine: Option<f64>,
    kept: Option<f64>,
}

/// Sums over the updates of an epoch.
#[derive(Default)]
struct Means {
    updates: usize,
    loss: f64,
    norm: f64,
    cosine: Option<f64>,
    kept: Option<f64>,
}

impl Means {
    fn add(&mut self, step: &Step) {
        self.updates += 1;
        self.loss += step.loss;
        self.norm += step.norm;
        self.cosine = step.cosine.map(|c| c + self.cosine.unwrap_or(0.0));
        self.kept = step.kept.map(|k| k + self.kept.unwrap_or(0.0));
    }

    fn record(&self, epoch: usize, train_loss: f64, test_loss: f64, skipped: usize, seconds: f64) -> Record {
        // NaN if there was no update at all.
        let mean = |sum: f64| sum / self.updates as f64;
        Record {
            epoch,
            loss: mean(self.loss),
            train_loss,
            test_loss,
            grad_norm: mean(self.norm),
            cosine: self.cosine.map(mean),
            kept: self.kept.map(mean),
            skipped,
            seconds,
        }
    }
}
