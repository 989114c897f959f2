//! What is to be run, whatever the task: settings that have been read and can be used.

use super::any_run::{AnyRun, Open};
use super::check::{Checking, Results};
use super::kind::{AnyKind, Kind};
use super::problem::Problem;
use super::settings::{FieldName, Precision, Settings};
use anyhow::Result;
use physgrad::report::Animation;
use std::ops::Deref;
use std::sync::Arc;
use toml::{Table, Value};

/// Settings that have been read and can be used.
#[derive(Clone)]
pub struct Scene {
    pub kind: &'static dyn AnyKind,
    pub field: FieldName,
    pub precision: Precision,
    pub seed: u64,
    pub epochs: usize,
    /// All settings.
    pub table: Table,
    settings: Arc<dyn AnySettings>,
}

/// What can be made of a task's settings.
pub trait AnySettings: Send + Sync {
    /// A run of them, before its first epoch.
    fn open(&self, workers: usize) -> Result<Box<dyn AnyRun>>;
    /// Checks the gradients of what they describe, called `variant` in the results.
    fn check(&self, variant: &str, results: &mut Results);
    /// Seconds per step.
    fn dt(&self) -> f64;
    fn state_names(&self) -> Vec<String>;
    fn control_names(&self) -> Vec<String>;
    /// A rollout that moves: states and controls step by step.
    fn animation(&self, states: &[Vec<f64>], controls: &[Vec<f64>]) -> Animation;
}

impl<K: Kind> AnySettings for Settings<K> {
    fn open(&self, workers: usize) -> Result<Box<dyn AnyRun>> {
        let training = self.training.training(self.epochs, self.seed, workers);
        Ok(self.visit(Open { precision: self.precision, field: self.field.0, training })?)
    }

    fn check(&self, variant: &str, results: &mut Results) {
        self.visit(Checking { variant, results });
    }

    fn dt(&self) -> f64 {
        K::dt(self)
    }

    fn state_names(&self) -> Vec<String> {
        K::state_names(self)
    }

    fn control_names(&self) -> Vec<String> {
        K::control_names(self)
    }

    fn animation(&self, states: &[Vec<f64>], controls: &[Vec<f64>]) -> Animation {
        K::animation(self, states, controls)
    }
}

impl Deref for Scene {
    type Target = dyn AnySettings;

    fn deref(&self) -> &Self::Target {
        &*self.settings
    }
}

impl Scene {
    pub fn new<K: Kind>(kind: &'static dyn AnyKind, settings: Settings<K>) -> Self {
        let Settings { field, precision, seed, epochs, .. } = settings;
        Self { kind, field, precision, seed, epochs, table: settings.table(), settings: Arc::new(settings) }
    }

    /// The same with another field and seed.
    pub fn with(&self, field: FieldName, seed: u64) -> Result<Self, Problem> {
        let mut table = self.table.clone();
        table.insert("field".into(), Value::String(field.into()));
        table.insert("seed".into(), Value::Integer(seed as i64));
        self.kind.scene(table)
    }

    /// The settings that a resumed run must share: what differs from the task's defaults, but for the number of epochs.
    /// So a setting that later versions add, with a default that changes nothing, leaves the identity of a run as it is.
    pub fn identity(&self) -> String {
        self.unusual(&["epochs"])
    }

    /// The settings that the runs of a comparison share: as [`identity`](Self::identity), but for field and seed.
    pub fn comparable(&self) -> String {
        self.unusual(&["epochs", "field", "seed"])
    }

    /// A line for every setting that is not the task's default, and none of these.
    fn unusual(&self, but: &[&str]) -> String {
        let defaults = flat(&self.kind.defaults());
        let unusual = flat(&self.table).into_iter().filter(|setting| !defaults.contains(setting) && !but.contains(&&*setting.0));
        let lines = unusual.map(|(key, value)| format!("\n{key} = {value}"));
        format!("task = {:?}{}", self.kind.name(), lines.collect::<String>())
    }
}

/// All settings by their dotted keys. A section that holds nothing is a setting too: an effect without parameters.
pub fn flat(table: &Table) -> Vec<(String, Value)> {
    let inner = |(key, value): (&String, &Value)| match value {
        Value::Table(section) if !section.is_empty() => {
            flat(section).into_iter().map(|(rest, value)| (format!("{key}.{rest}"), value)).collect()
        }
        value => vec![(key.clone(), value.clone())],
    };
    table.iter().flat_map(inner).collect()
}
