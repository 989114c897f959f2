//! Everything there is to set of a run, by name and type.

use crate::program::operations::Visit;
use crate::program::operations::memory::{self, Memory, Needs};
use crate::program::settings::config_error::{ConfigError, count};
use crate::program::settings::{
    ActuatorSettings, FieldName, IntegratorSettings, OPTIONAL, Precision, TrainingSettings, VERSION, reading,
};
use crate::program::tasks::{PolicySpec, TaskSpec};
use physgrad::Field;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use toml::{Table, Value};

/// Everything needed to repeat a run of a task.
#[derive(Clone, Debug, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, bound = "")]
#[schemars(bound = "", rename = "Scene")]
pub struct Settings<K: TaskSpec> {
    /// Version of the format.
    pub scene: i64,
    /// Version of physgrad that a run was made with. Scenes need none.
    pub physgrad: String,
    /// What is trained for.
    pub task: String,
    /// The vector field that the optimizer follows.
    pub field: FieldName,
    /// The precision of all numbers.
    pub precision: Precision,
    /// Decides start states and initial parameters.
    pub seed: u64,
    /// Passes over the training set, in all.
    pub epochs: usize,
    /// Steps of one rollout.
    pub horizon: usize,
    /// The physics.
    pub system: K::System,
    /// Optional physics: what is not here is absent.
    #[serde(default)]
    pub effects: K::Effects,
    /// What stands between the policy and the physics: what is not here is absent.
    #[serde(default)]
    pub actuator: ActuatorSettings,
    /// How the steps of the physics are taken.
    #[serde(default)]
    pub integrator: IntegratorSettings,
    /// What is paid for.
    pub loss: K::Loss,
    /// The network that is trained.
    pub policy: K::PolicySpec,
    /// How it is trained.
    pub training: TrainingSettings,
}

impl<K: TaskSpec> Settings<K> {
    /// The task's defaults.
    pub fn defaults() -> Self {
        Self {
            scene: VERSION,
            physgrad: env!("CARGO_PKG_VERSION").into(),
            task: K::NAME.into(),
            field: FieldName(Field::combined()),
            precision: Precision::F32,
            seed: 0,
            epochs: K::EPOCHS,
            horizon: K::HORIZON,
            system: K::system(),
            effects: K::Effects::default(),
            actuator: ActuatorSettings::default(),
            integrator: IntegratorSettings::default(),
            loss: K::Loss::default(),
            policy: K::PolicySpec::default(),
            training: TrainingSettings::default(),
        }
    }

    /// As a table, without the sections of what is absent.
    pub fn table(&self) -> Table {
        let mut table = Table::try_from(self).expect("settings are plain tables");
        for section in OPTIONAL.into_iter().chain(["integrator"]) {
            if table.get(section).and_then(Value::as_table).is_some_and(Table::is_empty) {
                table.remove(section);
            }
        }
        table
    }

    /// From a table in which nothing is missing but effects, and what has a default of its own: shapes and names by
    /// serde.
    pub fn fill(table: Table) -> Result<Self, ConfigError> {
        let mut settings: Self = reading::read(table).map_err(|error| ConfigError::unreadable(&error))?;
        settings.training.complete();
        Ok(settings)
    }

    /// What is out of range, here or by [`TaskSpec`], and what nothing reads.
    pub fn validate(&self) -> Result<(), ConfigError> {
        count("horizon", self.horizon, 1..=100_000_000)?;
        self.training.validate()?;
        self.policy.validate()?;
        self.actuator.validate()?;
        self.integrator.validate(self.precision, K::METHODS)?;
        K::validate(self)?;
        let TrainingSettings { batch, train_samples, test_samples, .. } = self.training;
        let samples = batch.min(train_samples);
        let Needs { batch: whole, rest } =
            self.visit(Memory { precision: self.precision, samples, start_states: train_samples + test_samples });
        // With a budget, what does not fit is computed again.
        let batch = self.training.budget().map_or(whole, |budget| whole.min(budget as f64));
        let (needed, most) = (batch + rest, memory::of_this_machine());
        if needed > most {
            let what = format!(
                "is {}: a run with mini-batches of {samples} samples would need about {:.1} GB, {:.1} GB of them for a mini-batch, and \
                 this machine has {:.1} GB; choose a smaller `training.batch`, `horizon` or policy, or a budget for the mini-batch, \
                 as in `training.memory = \"1GB\"`",
                self.horizon,
                needed * 1e-9,
                batch * 1e-9,
                most * 1e-9
            );
            return Err(ConfigError::new("horizon", what));
        }
        Ok(())
    }

    /// Hands task and policy to the visitor.
    pub fn visit<V: Visit>(&self, visitor: V) -> V::Out {
        K::visit(self, visitor)
    }
}
