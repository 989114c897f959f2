//! [`Settings`]: settings of a run, generic over the task.

use crate::settings::config_error::{ConfigError, count};
use crate::settings::{
    ActuatorSettings, FieldName, IntegratorSettings, LogFormat, OPTIONAL, Precision,
    SensorSettings, TrainingSettings, VERSION, WindowSettings, reading,
};
use crate::tasks::effects::Present;
use crate::tasks::equations::located;
use crate::tasks::policy::{self, Built, PolicySettings};
use crate::tasks::{self, Controlled, SceneEffects, TaskSpec};
use physgrad::actuator::Actuator as _;
use physgrad::effect::{DynEffect, Named};
use physgrad::episode::Ending;
use physgrad::graph::{Names, Replaced, Replacement, is_name};
use physgrad::sensor::Sensed;
use physgrad::{DynSystem, DynTask, Field, System as _, Task as _};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use std::collections::HashSet;
use toml::{Table, Value};

/// All settings of a run.
#[derive(Clone, Debug, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, bound = "")]
#[schemars(bound = "", rename = "Scene")]
pub struct Settings<K: TaskSpec> {
    /// Version of the scene format.
    pub scene: i64,
    /// Version of physgrad that created the run; optional in scenes.
    pub physgrad: String,
    /// Name of the task.
    pub task: String,
    /// Vector field that the optimizer follows.
    pub field: FieldName,
    /// Floating-point precision.
    pub precision: Precision,
    /// Seed of initial states and initial parameters.
    pub seed: u64,
    /// Total number of epochs: passes over the training set.
    pub epochs: usize,
    /// Tags of the run, for searches. Results do not depend on them.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub tags: Vec<String>,
    /// Files with the metrics of every epoch, besides `metrics.csv`. Results do not depend on them.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub log: Vec<LogFormat>,
    /// Policy file whose parameters start the training, relative to the folder of the scene.
    /// Random parameters if absent.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub initial_policy: Option<String>,
    /// Time steps of a rollout.
    pub horizon: usize,
    /// Settings of the physics.
    pub system: K::System,
    /// Optional physics; effects that are not listed are absent.
    #[serde(default)]
    pub effects: K::Effects,
    /// Effects of the user that the scene lists.
    #[serde(skip)]
    pub own_effects: SceneEffects,
    /// Actuators between policy and physics; actuators that are not listed are absent.
    #[serde(default)]
    pub actuator: ActuatorSettings,
    /// Sensors between observation and policy; sensors that are not listed are absent.
    #[serde(default)]
    pub sensor: SensorSettings,
    /// Integrator of the physics.
    #[serde(default)]
    pub integrator: IntegratorSettings,
    /// Settings of the cost function.
    pub loss: K::Loss,
    /// Expressions in place of the observation and the costs of the task.
    #[serde(default, skip_serializing_if = "is_absent")]
    pub equations: Replacement,
    /// Settings of the policy, by its kind.
    #[schemars(with = "std::collections::BTreeMap<String, String>")]
    pub policy: Table,
    /// Optimizer, data sets and memory.
    pub training: TrainingSettings,
    /// Training by windows of an episode. By default, updates see whole rollouts.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub window: Option<WindowSettings>,
}

fn is_absent(equations: &Replacement) -> bool {
    *equations == Replacement::default()
}

/// The first columns of a trajectory, before those of the state.
pub const COLUMNS: [&str; 3] = ["sample", "step", "time"];

/// A task as the policy sees it.
#[derive(Clone)]
pub struct Physics {
    pub task: DynTask,
    /// Names of the state components.
    pub states: Vec<String>,
    /// Names of the observed components.
    pub observed: Vec<String>,
    /// Number of state components that the end of episodes and the sensor add, after all others.
    pub added: usize,
}

/// What valid settings describe.
pub struct Parts {
    pub physics: Physics,
    /// Settings of the policy.
    pub settings: PolicySettings,
    /// The policy.
    pub built: Built,
}

impl<K: TaskSpec> Settings<K> {
    /// Default settings of the task.
    pub fn defaults() -> Self {
        Self {
            scene: VERSION,
            physgrad: env!("CARGO_PKG_VERSION").into(),
            task: K::NAME.into(),
            field: FieldName(Field::combined()),
            precision: Precision::F32,
            seed: 0,
            epochs: K::EPOCHS,
            tags: Vec::new(),
            log: Vec::new(),
            initial_policy: None,
            horizon: K::horizon(),
            system: K::system(),
            effects: K::Effects::default(),
            own_effects: SceneEffects::default(),
            actuator: ActuatorSettings::default(),
            sensor: SensorSettings::default(),
            integrator: IntegratorSettings::default(),
            loss: K::Loss::default(),
            equations: Replacement::default(),
            policy: policy::defaults(None, K::POLICY),
            training: TrainingSettings::default(),
            window: None,
        }
    }

    /// Table of all settings, without empty optional sections.
    pub fn table(&self) -> Table {
        let mut table = Table::try_from(self).expect("settings are plain tables");
        self.own_effects.put(&mut table);
        for section in OPTIONAL.into_iter().chain(["integrator"]) {
            if table.get(section).and_then(Value::as_table).is_some_and(Table::is_empty) {
                table.remove(section);
            }
        }
        table
    }

    /// Reads a table. Missing effects are absent; other missing settings must have a default.
    ///
    /// # Errors
    /// Reports unknown keys, missing keys and values of the wrong type.
    pub fn fill(mut table: Table) -> Result<Self, ConfigError> {
        let registered = tasks::own_effects(K::NAME);
        let own_effects = SceneEffects::take(&registered, &mut table)?;
        let names = registered.iter().map(|(_, effect)| effect.info().name);
        let settings: Self =
            reading::read(table).map_err(|error| error.also_allowed("effects", names))?;
        let policy = policy::completed(settings.policy, K::POLICY);
        let mut settings = Self { own_effects, policy, ..settings };
        settings.training.complete();
        Ok(settings)
    }

    /// Checks all ranges, refuses unused settings, and builds task and policy.
    pub fn parts(&self) -> Result<Parts, ConfigError> {
        count("horizon", self.horizon, 1..=100_000_000)?;
        count("epochs", self.epochs, 0..=1_000_000_000)?;
        self.training.validate()?;
        if let Some(window) = &self.window {
            window.validate(self.horizon, self.training.discount)?;
        }
        let settings = PolicySettings::read(self.policy.clone(), Some(K::POLICY));
        let settings = settings.map_err(|error| error.within("policy"))?;
        self.actuator.validate()?;
        self.sensor.validate()?;
        self.integrator.validate(self.precision, K::METHODS)?;
        K::validate(self)?;
        K::validate_own_effects(&self.own_effects)?;
        let physics = self.physics()?;
        let built = settings.build(&self.controlled(&physics));
        let built = built.map_err(|error| error.within("policy"))?.within("policy.", 0);
        if let Some(window) = &self.window {
            let restarts = window.restarts() || physics.task.ended().is_some();
            if let Some(part) = self.sensor.remembers().filter(|_| restarts) {
                let what = "is not supported with a value function or the end of episodes: the sensor begins \
                            at step 0, but these episodes begin at other steps of the epoch. Remove it, or \
                            train on whole rollouts";
                return Err(ConfigError::new(format!("sensor.{part}"), what));
            }
            window.check_policy(&built.policy)?;
        }
        self.check_names(&physics.states)?;
        Ok(Parts { physics, settings, built })
    }

    /// Refuses a name that two columns of a trajectory would have.
    fn check_names(&self, states: &[String]) -> Result<(), ConfigError> {
        let controls = K::control_names(self);
        let others = COLUMNS.map(str::to_owned).into_iter();
        let mut seen: HashSet<_> = others.chain(self.actuator.applied_names(&controls)).collect();
        match states.iter().chain(&controls).find(|name| !seen.insert((*name).clone())) {
            Some(name) => {
                let what = "is also the name of another column of trajectories: of their number, step or time, or of a \
                            component that the actuator or the sensor adds; choose another name";
                Err(ConfigError::new(name.clone(), what))
            }
            None => Ok(()),
        }
    }

    /// What a policy observes and controls in this task.
    pub fn controlled(&self, Physics { task, observed, .. }: &Physics) -> Controlled {
        let limited = || {
            let range = self.actuator.chain(K::dt(self)).range()?;
            Some(vec![range; task.system().control_dim()])
        };
        Controlled {
            observations: observed.clone(),
            controls: K::control_names(self),
            bounds: task.control_bounds().or_else(limited),
            horizon: self.horizon,
            dt: K::dt(self),
        }
    }

    /// Names of the components that a policy observes of a task without the sensor: those of the
    /// state. A component of another observation has the name that its expression consists of, or
    /// else y_1, y_2, …
    ///
    /// # Errors
    /// A component without a name has that of a state or of another component.
    fn observation_names(&self, unsensed: &DynTask) -> Result<Vec<String>, ConfigError> {
        let states = self.unsensed_states();
        let Some(count) = unsensed.observation_dim() else { return Ok(states) };
        let replaced = &self.equations.observe;
        let texts = if replaced.is_empty() { K::observe(self) } else { replaced.clone() };
        let own = |i: usize| {
            let own = texts.get(i).map(|text| text.trim());
            own.filter(|text| text.split('.').all(is_name))
                .filter(|own| !texts[..i].iter().any(|text| text.trim() == *own))
        };
        let name = |i: usize| match own(i) {
            Some(own) => Ok(own.to_owned()),
            None => {
                let name = format!("y_{}", i + 1);
                let is_other = states.contains(&name) || (0..count).any(|k| own(k) == Some(&name));
                if !is_other {
                    return Ok(name);
                }
                let section = if replaced.is_empty() { "system" } else { "equations" };
                let what = format!(
                    "component {} has no name of its own, so its name is `{name}`, which another number has; rename \
                     that number, or define the component in `define` and write its name",
                    i + 1
                );
                Err(ConfigError::new(format!("{section}.observe"), what))
            }
        };
        (0..count).map(name).collect()
    }

    /// The task as the policy sees it: with the observation and the costs of the section `equations`,
    /// with the end of episodes, and with the sensor.
    pub fn physics(&self) -> Result<Physics, ConfigError> {
        let task = self.unsensed()?;
        let observed = self.observation_names(&task)?;
        let mut states = self.unsensed_states();
        let own = states.len();
        let task = if task.can_end() {
            states.push("ended".into());
            DynTask::new(Ending::new(task))
        } else {
            task
        };
        states.extend(self.sensor.state_names(&observed));
        let added = states.len() - own;
        if self.sensor.is_empty() {
            return Ok(Physics { task, states, observed, added });
        }
        let sensed = Sensed::new(task, self.sensor.sensor(observed.len(), K::dt(self)));
        let sensed = sensed.map_err(|error| {
            let list = if error.list == "bias" { "bias.value" } else { "noise.deviation" };
            ConfigError::new(format!("sensor.{list}"), format!("{error}: {}", observed.join(", ")))
        })?;
        Ok(Physics { task: DynTask::new(sensed), states, observed, added })
    }

    /// Names of the state components of the task and its actuators.
    fn unsensed_states(&self) -> Vec<String> {
        [K::state_names(self), self.actuator.state_names(&K::control_names(self))].concat()
    }

    /// The task, with the observation and the costs of the section `equations`.
    fn unsensed(&self) -> Result<DynTask, ConfigError> {
        let task = K::task(self);
        if is_absent(&self.equations) {
            return Ok(task);
        }
        let names = Names {
            states: self.unsensed_states(),
            params: self.param_names(&task),
            controls: K::control_names(self),
            dt: K::dt(self),
        };
        let replaced = Replaced::new(task, names, &self.equations);
        replaced.map(DynTask::new).map_err(|error| located("equations.", error))
    }

    /// Names of the parameters of a rollout.
    pub fn param_names(&self, task: &DynTask) -> Vec<String> {
        let params = task.param_dim();
        let varied = task.system().varied(params);
        let mut own = K::param_names(self).into_iter();
        let name = |i: usize| match varied.iter().find(|varied| varied.index == i) {
            // Names of numbers of effects and sensors start with their section.
            Some(varied)
                if ["effects.", "sensor."].iter().any(|own| varied.name.starts_with(own)) =>
            {
                varied.name.clone()
            }
            Some(varied) => format!("system.{}", varied.name),
            None => own.next().unwrap_or_else(|| format!("p_{}", i + 1)),
        };
        (0..params).map(name).collect()
    }

    /// Effects that are present, in order of evaluation: first built-in effects, then effects of
    /// the user.
    pub fn all_effects<M: 'static, E: From<DynEffect<M>>>(&self) -> Vec<Named<E>>
    where
        K::Effects: Present<E>,
    {
        let mut effects = self.effects.present();
        effects.extend(self.own_effects.listed());
        effects
    }

    /// Adds horizon, substeps and actuators of the scene to a task. `system` is the physics of the
    /// task, with the time step of a substep.
    pub fn adapted(&self, task: DynTask, system: DynSystem) -> DynTask {
        let actuator = self.actuator.chain(K::dt(self));
        task.adapted(system, self.integrator.count(), actuator, self.horizon)
    }
}
