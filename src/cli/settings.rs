//! What a run is: one TOML document, from a task's defaults, changed key by key.

use super::scene::{Network, Scene};
use anyhow::{Context, Result, anyhow, bail};
use physgrad::{Clip, Field, Float, Policy, Rule, System, Training};
use serde::{Deserialize, Serialize};
use std::ops::RangeInclusive;
use toml::{Table, Value};

/// Gigabytes that the workspaces of a run may take.
const MEMORY: f64 = 32.0;

/// Everything needed to repeat a run; `run.toml` is this.
#[derive(Clone, Debug, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Settings<S: Scene> {
    /// Version of the program.
    pub physgrad: String,
    pub task: String,
    pub field: FieldName,
    pub precision: Precision,
    pub seed: u64,
    pub epochs: usize,
    /// Steps of one rollout.
    pub horizon: usize,
    #[serde(bound = "")]
    pub system: S::Setup,
    #[serde(bound = "")]
    pub loss: S::Loss,
    #[serde(bound = "")]
    pub policy: S::Network,
    pub training: TrainingSettings,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, clap::ValueEnum)]
#[serde(rename_all = "snake_case")]
pub enum Precision {
    F32,
    F64,
}

impl Precision {
    pub fn name(self) -> &'static str {
        match self {
            Self::F32 => "f32",
            Self::F64 => "f64",
        }
    }
}

/// A [`Field`] by name or letter; written by name.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(try_from = "String", into = "String")]
pub struct FieldName(pub Field);

impl TryFrom<String> for FieldName {
    type Error = physgrad::UnknownField;
    fn try_from(name: String) -> Result<Self, Self::Error> {
        name.parse().map(Self)
    }
}

impl From<FieldName> for String {
    fn from(field: FieldName) -> String {
        field.0.name().into()
    }
}

#[derive(Clone, Debug, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct TrainingSettings {
    pub batch: usize,
    pub train_samples: usize,
    pub test_samples: usize,
    pub shuffle: bool,
    pub optimizer: OptimizerName,
    pub learning_rate: f64,
    pub clip: ClipName,
    /// Limit of `clip`.
    pub clip_limit: f64,
    /// Updates in a row that may be skipped because a number was not finite.
    pub max_skipped: usize,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, clap::ValueEnum)]
#[serde(rename_all = "snake_case")]
pub enum ClipName {
    None,
    Value,
    Norm,
}

impl ClipName {
    pub fn name(self) -> &'static str {
        match self {
            Self::None => "none",
            Self::Value => "value",
            Self::Norm => "norm",
        }
    }
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum OptimizerName {
    Adam,
    Sgd,
    Momentum,
    RmsProp,
    Adagrad,
    Adadelta,
}

impl<S: Scene> Settings<S> {
    /// The task's defaults.
    pub fn defaults() -> Self {
        let Training { batch, train_samples, test_samples, seed, shuffle, learning_rate, max_skipped, .. } = Training::default();
        Self {
            physgrad: env!("CARGO_PKG_VERSION").into(),
            task: S::NAME.into(),
            field: FieldName(Field::combined()),
            precision: Precision::F32,
            seed,
            epochs: S::EPOCHS,
            horizon: S::HORIZON,
            system: S::setup(),
            loss: S::Loss::default(),
            policy: S::Network::default(),
            training: TrainingSettings {
                batch,
                train_samples,
                test_samples,
                shuffle,
                optimizer: OptimizerName::Adam,
                learning_rate,
                clip: ClipName::None,
                clip_limit: 1.0,
                max_skipped,
            },
        }
    }

    /// As a table whose keys are all there are.
    pub fn to_table(&self) -> Table {
        Table::try_from(self).expect("settings are plain tables")
    }

    /// From a table: shapes and names by serde, ranges by [`Scene`] and here.
    pub fn from_table(table: Table) -> Result<Self> {
        let settings: Self = serde_path_to_error::deserialize(Value::Table(table))
            .map_err(|error| anyhow!("`{}`: {}", error.path(), error.inner().message()))?;
        if settings.task != S::NAME {
            bail!("these settings are of the task `{}`, not `{}`", settings.task, S::NAME);
        }
        settings.validate()?;
        Ok(settings)
    }

    fn validate(&self) -> Result<()> {
        let t = &self.training;
        for (key, value, limit) in [
            ("horizon", self.horizon, 100_000_000),
            ("training.batch", t.batch, 1_000_000),
            ("training.train_samples", t.train_samples, 1_000_000),
            ("training.test_samples", t.test_samples, 1_000_000),
        ] {
            count(key, value, 1..=limit)?;
        }
        positive("training.learning_rate", t.learning_rate)?;
        if t.learning_rate > 1e6 {
            bail!("`training.learning_rate` is {}; allowed: a positive number up to 1e6", t.learning_rate);
        }
        positive("training.clip_limit", t.clip_limit)?;
        self.policy.validate()?;
        S::validate(&self.system, &self.loss)?;
        match self.precision {
            Precision::F32 => self.check_memory::<f32>(),
            Precision::F64 => self.check_memory::<f64>(),
        }
    }

    /// An error if the workspaces would not fit into the memory of any ordinary machine, before any of it is asked for.
    fn check_memory<F: Float>(&self) -> Result<()> {
        let task = S::build(&self.system, &self.loss, self.horizon);
        let (n, m) = (task.system().state_dim(), task.system().control_dim());
        let samples = self.training.batch.min(self.training.train_samples);
        let columns = samples as f64 * self.horizon as f64;
        // The policy's needs grow with the columns; a few are enough to see how.
        let policy = self.policy.build(n, m);
        let few = policy.sizes::<F>(64);
        let per_column = (few.tape + 2 * few.tape_bar) as f64 / 64.0 + 4.0 * (n + m) as f64;
        // θ and its packed form, the optimizer and its copy, gradients of two flows.
        let parameters = policy.param_count() as f64 * 16.0;
        let sets = (self.training.train_samples + self.training.test_samples) as f64 * n as f64;
        let gigabytes = (columns * per_column + parameters + sets) * size_of::<F>() as f64 * 1e-9;
        if gigabytes > MEMORY {
            bail!(
                "a mini-batch of {samples} samples over {} steps would need about {gigabytes:.0} GB, and at most {MEMORY} GB are \
                 used; choose a smaller `training.batch`, `horizon` or policy",
                self.horizon
            );
        }
        Ok(())
    }

    /// The training they describe, on so many workers.
    pub fn training(&self, workers: usize) -> Training {
        let t = &self.training;
        let rule = match t.optimizer {
            OptimizerName::Adam => "adam",
            OptimizerName::Sgd => "sgd",
            OptimizerName::Momentum => "momentum",
            OptimizerName::RmsProp => "rmsprop",
            OptimizerName::Adagrad => "adagrad",
            OptimizerName::Adadelta => "adadelta",
        };
        Training {
            epochs: self.epochs,
            batch: t.batch,
            train_samples: t.train_samples,
            test_samples: t.test_samples,
            seed: self.seed,
            shuffle: t.shuffle,
            rule: Rule::named(rule).expect("every name is a rule"),
            learning_rate: t.learning_rate,
            clip: match t.clip {
                ClipName::None => Clip::None,
                ClipName::Value => Clip::Value(t.clip_limit),
                ClipName::Norm => Clip::Norm(t.clip_limit),
            },
            max_skipped: t.max_skipped,
            workers,
        }
    }

    /// The settings that a resumed run must share: all but the number of epochs.
    pub fn identity(&self) -> String {
        self.without(&["epochs"])
    }

    /// The settings that the runs of a comparison share: all but field, seed and the number of epochs.
    pub fn comparable(&self) -> String {
        self.without(&["epochs", "field", "seed"])
    }

    fn without(&self, keys: &[&str]) -> String {
        let mut table = self.to_table();
        for &key in keys {
            table.remove(key);
        }
        table.to_string()
    }
}

/// An error that names the key unless the value is a positive number.
pub fn positive(key: &str, value: f64) -> Result<()> {
    if value.is_finite() && value > 0.0 { Ok(()) } else { bail!("`{key}` is {value}; allowed: a positive number") }
}

/// An error that names the key unless the value is within the range.
pub fn count(key: &str, value: usize, range: RangeInclusive<usize>) -> Result<()> {
    if range.contains(&value) { Ok(()) } else { bail!("`{key}` is {value}; allowed: {} to {}", range.start(), range.end()) }
}

/// Changes one key of a table of settings: `training.learning_rate=3e-4`.
pub fn set(table: &mut Table, assignment: &str) -> Result<()> {
    let (key, text) = assignment
        .split_once('=')
        .with_context(|| format!("`--set {assignment}`: write KEY=VALUE, for example system.poles=4"))?;
    let (key, text) = (key.trim(), text.trim());
    if ["physgrad", "task"].contains(&key) {
        bail!("`{key}` says what made a run, and cannot be set (to {text})");
    }
    // A word that is no TOML value is a string: shells take the quotes away.
    let value = format!("value = {text}").parse::<Table>().map_or_else(|_| Value::String(text.into()), |mut t| t["value"].take());
    put(table, key, value)
}

/// Puts a value in place of the one that `key` (dotted) names; there must be one.
pub fn put(table: &mut Table, key: &str, value: Value) -> Result<()> {
    let mut inner = table;
    let mut path = String::new();
    let mut parts = key.split('.').peekable();
    while let Some(part) = parts.next() {
        let Some(found) = inner.get(part) else {
            let place = if path.is_empty() { "a run".into() } else { format!("`{path}`") };
            bail!("unknown key `{key}`; allowed in {place}: {}", inner.keys().cloned().collect::<Vec<_>>().join(", "));
        };
        path = if path.is_empty() { part.into() } else { format!("{path}.{part}") };
        if parts.peek().is_none() {
            if let Value::Table(section) = found {
                bail!("`{path}` is a section; set one of its keys: {}", keys(section, &path));
            }
            inner.insert(part.into(), value);
            return Ok(());
        }
        inner = match inner.get_mut(part) {
            Some(Value::Table(section)) => section,
            _ => bail!("unknown key `{key}`; `{path}` has no parts"),
        };
    }
    bail!("an empty key cannot be set")
}

fn keys(section: &Table, path: &str) -> String {
    section.keys().map(|key| format!("{path}.{key}")).collect::<Vec<_>>().join(", ")
}

trait Take {
    fn take(&mut self) -> Value;
}

impl Take for Value {
    fn take(&mut self) -> Value {
        std::mem::replace(self, Value::Boolean(false))
    }
}
