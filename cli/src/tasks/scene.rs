//! Scenes: validated settings, independent of the task.
//!
//! [`Scene`] holds the settings that all tasks share. [`AnySettings`] is the object-safe interface
//! to the settings of one task.

use crate::operations::checks::{Amplification, Between, Results};
use crate::operations::evaluation::AnyEvaluation;
use crate::operations::gradients::{Derived, GradientMethod};
use crate::operations::policy_file::{self, About, TrainedNumber};
use crate::operations::session::AnyRun;
use crate::operations::simulation::Job;
use crate::operations::trajectory::Trajectory;
use crate::operations::{
    checks, costs, evaluation, gradients, identification, session, simulation,
};
use crate::settings::config_error::ConfigError;
use crate::settings::{FieldName, LogFormat, OPTIONAL, Precision};
use crate::tasks::{AnyTaskSpec, Conserved, Settings, TaskSpec};
use anyhow::{Context, Result};
use physgrad::check::{Jumps, Kink, Plateau};
use physgrad::identify::{Fit, IdentifyError, Options, Segment};
use physgrad::optimize::{self, Initial, OptimizeError, Plan};
use physgrad::policy::AnyPolicy;
use physgrad::{Divergence, DynTask, Field, Number, System, Task, TaskOpCount};
use physgrad_plot::{Animation, Channel};
use std::ops::Deref;
use std::sync::Arc;
use toml::{Table, Value};

/// Setting with the path of the policy file from which the training starts.
pub const INITIAL_POLICY: &str = "initial_policy";

const CRC: crc::Crc<u32> = crc::Crc::<u32>::new(&crc::CRC_32_ISCSI);

/// Validated settings of a run, independent of the type of the task.
#[derive(Clone)]
pub struct Scene {
    /// Specification of the task.
    pub task: &'static dyn AnyTaskSpec,
    /// Vector field that the optimizer follows.
    pub field: FieldName,
    /// Floating-point precision.
    pub precision: Precision,
    /// Seed of initial states and parameters.
    pub seed: u64,
    /// Total number of epochs.
    pub epochs: usize,
    /// Time steps of a rollout.
    pub horizon: usize,
    /// Formats of the metrics besides CSV.
    pub logs: Vec<LogFormat>,
    /// All settings.
    pub table: Table,
    /// Contents of the policy file from which the training starts.
    initial_policy: Option<Arc<[u8]>>,
    settings: Arc<dyn AnySettings>,
}

/// Why a setting has no effect on an estimator that reads losses only.
const LOSSES: &str = "`training.estimator` is zeroth_order, which follows differences of losses";

/// Object-safe policy in both precisions.
pub trait DynPolicy: AnyPolicy<f32> + AnyPolicy<f64> {}
impl<P: AnyPolicy<f32> + AnyPolicy<f64>> DynPolicy for P {}

/// Object-safe operations on the settings of a task.
pub trait AnySettings: Send + Sync {
    /// The task.
    fn task(&self) -> DynTask;
    /// The policy, with the trained numbers of the system.
    fn policy(&self) -> Arc<dyn DynPolicy>;
    /// Opens a run before its first epoch, with these parameters.
    fn open_from(&self, theta: Vec<f64>, workers: usize) -> Result<Box<dyn AnyRun>>;
    /// Checks the gradients of system, policy and rollout. In rollouts, the policy has the
    /// parameters `theta`, or random ones. Results carry the name `variant`.
    fn check(&self, variant: &str, theta: Option<&[f64]>, results: &mut Results);
    /// Stability of the steps of test rollouts, and at a state between two that alternate with
    /// longer steps.
    ///
    /// # Errors
    /// A rollout diverges in the first step.
    fn amplification(
        &self,
        theta: &[f64],
        known: Option<&Between>,
    ) -> Result<Amplification, Divergence>;
    /// Kinks and jumps of the step, the observation and the costs along test rollouts.
    fn kinks(&self, theta: &[f64]) -> Vec<Kink>;
    /// Loss and gradient at the parameters `theta` and at parameters nearby.
    fn plateau(&self, theta: &[f64]) -> Result<Plateau, Divergence>;
    /// Compares R with differences of the mean loss over finite distances. None for horizons above
    /// 10,000 steps.
    fn jumps(&self, theta: &[f64]) -> Option<Result<Jumps, Divergence>>;
    /// Runs a rollout and its adjoints, and prepares them for timing.
    fn prepare(&self, theta: &[f64]) -> Job;
    /// Gradient and its costs, by the given method in the given precision.
    fn derive(&self, theta: &[f64], precision: Precision, method: GradientMethod) -> Derived;
    /// Components of the gradients of R, M and S, in double-double arithmetic. The indices of their
    /// parameters are evenly spaced. Calls `done` after each component.
    fn refer(&self, theta: &[f64], done: &(dyn Fn() + Sync)) -> [Vec<f64>; 3];
    /// Operation counts of a physics step and of its VJPs, and of the costs and the observation.
    fn cost(&self) -> TaskOpCount;
    /// Bytes of a rollout of 8 samples, for evaluation or with the adjoint of a
    /// field.
    fn stored(&self, field: Option<Field>) -> usize;
    /// Prepares the policy with these parameters for rollouts from new initial states. Numbers that
    /// the scene trains have their initial values.
    fn evaluation(&self, theta: &[f64], seed: u64) -> Result<Box<dyn AnyEvaluation>>;
    /// Time step, in the unit of time of the task: s, except for `quantum`.
    fn dt(&self) -> f64;
    /// Names of the state components.
    fn state_names(&self) -> Vec<String>;
    /// Names of the components that the policy observes: those of the state, or y_1, y_2, … if the
    /// task has an observation of its own.
    fn observation_names(&self) -> Vec<String>;
    /// Names of the parameters of a rollout.
    fn param_names(&self) -> Vec<String>;
    /// Keys and values of the numbers that are not fixed.
    fn varied(&self) -> Vec<(String, Number)>;
    /// Indices of the state components that are angles in rad.
    fn angles(&self) -> Vec<usize>;
    /// Fits the trained numbers to measured segments.
    fn identify(&self, segments: &[Segment], options: &Options) -> Result<Fit, IdentifyError>;
    /// Returns whether the physics depends on the time of the segment, at its measured states.
    fn depends_on_time(&self, segment: &Segment) -> bool;
    /// Optimizes the controls from the initial state `x0` with the parameters `p`.
    fn optimize(
        &self,
        x0: &[f64],
        p: &[f64],
        initial: Initial,
        options: &optimize::Options,
    ) -> Result<Plan, OptimizeError>;
    /// Names of the control components.
    fn control_names(&self) -> Vec<String>;
    /// Names of the applied controls. Empty without an actuator.
    fn applied_names(&self) -> Vec<String>;
    /// Controls that the actuator applies, for these states and controls of the policy.
    fn applied(&self, states: &[Vec<f64>], controls: &[Vec<f64>]) -> Vec<Vec<f64>>;
    /// A quantity that is conserved while the control is zero. None also if numbers are drawn or
    /// trained.
    fn conserved(&self) -> Option<Conserved>;
    /// Animation of one rollout, from its states, controls and parameters.
    fn animation(&self, rollout: &Trajectory) -> Animation;
}

impl<K: TaskSpec> AnySettings for Settings<K> {
    fn task(&self) -> DynTask {
        Settings::task(self)
    }

    fn policy(&self) -> Arc<dyn DynPolicy> {
        Arc::new(self.task_and_policy().1)
    }

    fn open_from(&self, theta: Vec<f64>, workers: usize) -> Result<Box<dyn AnyRun>> {
        let training = self.training.training(self.epochs, self.seed, workers);
        let (task, policy) = self.task_and_policy();
        session::open(
            task,
            policy,
            self.precision,
            self.training.weighted(self.field.0),
            training,
            theta,
        )
    }

    fn check(&self, variant: &str, theta: Option<&[f64]>, results: &mut Results) {
        let (task, policy) = self.task_and_policy();
        checks::check(&task, &policy, theta, variant, results);
    }

    fn amplification(
        &self,
        theta: &[f64],
        known: Option<&Between>,
    ) -> Result<Amplification, Divergence> {
        let (task, policy) = self.task_and_policy();
        checks::amplification(&task, &policy, theta, self.seed, known)
    }

    fn kinks(&self, theta: &[f64]) -> Vec<Kink> {
        let (task, policy) = self.task_and_policy();
        checks::kinks(&task, &policy, theta, self.seed)
    }

    fn plateau(&self, theta: &[f64]) -> Result<Plateau, Divergence> {
        let (task, policy) = self.task_and_policy();
        checks::plateau(&task, &policy, theta, self.seed)
    }

    fn jumps(&self, theta: &[f64]) -> Option<Result<Jumps, Divergence>> {
        let (task, policy) = self.task_and_policy();
        checks::jumps(&task, &policy, theta, self.seed)
    }

    fn prepare(&self, theta: &[f64]) -> Job {
        let (task, policy) = self.task_and_policy();
        simulation::job(task, policy, theta, self.precision, self.seed)
    }

    fn derive(&self, theta: &[f64], precision: Precision, method: GradientMethod) -> Derived {
        let (task, policy) = self.task_and_policy();
        gradients::derived(task, policy, theta, precision, self.seed, method)
    }

    fn refer(&self, theta: &[f64], done: &(dyn Fn() + Sync)) -> [Vec<f64>; 3] {
        let (task, policy) = self.task_and_policy();
        gradients::reference(&task, &policy, theta, self.seed, done)
    }

    fn cost(&self) -> TaskOpCount {
        TaskOpCount::of(&self.task())
    }

    fn stored(&self, field: Option<Field>) -> usize {
        let (task, policy) = self.task_and_policy();
        costs::stored(&task, &policy, self.precision, field)
    }

    fn evaluation(&self, theta: &[f64], seed: u64) -> Result<Box<dyn AnyEvaluation>> {
        let (task, policy) = self.task_and_policy();
        evaluation::new(task, policy, self.precision, theta, seed)
    }

    fn dt(&self) -> f64 {
        K::dt(self)
    }

    fn param_names(&self) -> Vec<String> {
        let task = self.task();
        let (params, varied) = (task.param_dim(), task.system().varied(task.param_dim()));
        let mut own = K::param_names(self).into_iter();
        let name = |i: usize| match varied.iter().find(|varied| varied.index == i) {
            // Names of numbers of effects start with the key of the effect's section.
            Some(varied) if varied.name.starts_with("effects.") => varied.name.clone(),
            Some(varied) => format!("system.{}", varied.name),
            None => own.next().unwrap_or_else(|| format!("p_{}", i + 1)),
        };
        (0..params).map(name).collect()
    }

    fn varied(&self) -> Vec<(String, Number)> {
        let names = AnySettings::param_names(self);
        let task = self.task();
        let varied = task.system().varied(task.param_dim());
        varied.into_iter().map(|varied| (names[varied.index].clone(), varied.number)).collect()
    }

    fn identify(&self, segments: &[Segment], options: &Options) -> Result<Fit, IdentifyError> {
        let names = AnySettings::param_names(self);
        identification::identified(
            &self.task(),
            &names,
            &AnySettings::angles(self),
            segments,
            options,
        )
    }

    fn depends_on_time(&self, segment: &Segment) -> bool {
        identification::depends_on_time(&self.task(), &AnySettings::param_names(self), segment)
    }

    fn angles(&self) -> Vec<usize> {
        K::angles(self)
    }

    fn state_names(&self) -> Vec<String> {
        let mut names = K::state_names(self);
        names.extend(self.actuator.state_names(&K::control_names(self)));
        names
    }

    fn observation_names(&self) -> Vec<String> {
        match self.task().observation_dim() {
            None => AnySettings::state_names(self),
            Some(observations) => (1..=observations).map(|i| format!("y_{i}")).collect(),
        }
    }

    fn optimize(
        &self,
        x0: &[f64],
        p: &[f64],
        initial: Initial,
        options: &optimize::Options,
    ) -> Result<Plan, OptimizeError> {
        optimize::optimize(&self.task(), x0, p, initial, options)
    }

    fn control_names(&self) -> Vec<String> {
        K::control_names(self)
    }

    fn applied_names(&self) -> Vec<String> {
        self.actuator.applied_names(&K::control_names(self))
    }

    fn applied(&self, states: &[Vec<f64>], controls: &[Vec<f64>]) -> Vec<Vec<f64>> {
        self.actuator.applied(K::dt(self), states, controls)
    }

    fn conserved(&self) -> Option<Conserved> {
        // The quantity has fixed numbers, but the drawn or trained numbers of a sample may differ.
        K::conserved(self).filter(|_| self.varied().is_empty())
    }

    fn animation(&self, rollout: &Trajectory) -> Animation {
        let mut animation = K::animation(self, rollout);
        if animation.time > 0.0 && animation.channels.is_empty() {
            let names = K::control_names(self);
            animation.channels = Channel::columns(
                names,
                &held(&rollout.controls, animation.time / K::dt(self)),
                CONTROL,
            );
            for channel in &mut animation.channels {
                let [low, high] = channel.range();
                channel.range = Some([low.min(0.0), high.max(0.0)]);
            }
        }
        animation
    }
}

/// Colour of controls in animations.
const CONTROL: &str = "#D55E00";

/// Controls up to this number of steps. The last control holds until the final time.
fn held(controls: &[Vec<f64>], steps: f64) -> Vec<Vec<f64>> {
    let shown = &controls[..controls.len().min(steps.round() as usize)];
    [shown, shown.last().map_or(&[], std::slice::from_ref)].concat()
}

impl Deref for Scene {
    type Target = dyn AnySettings;

    fn deref(&self) -> &Self::Target {
        &*self.settings
    }
}

impl Scene {
    /// Creates a scene from validated settings.
    pub fn new<K: TaskSpec>(task: &'static dyn AnyTaskSpec, settings: Settings<K>) -> Self {
        let Settings { field, precision, seed, epochs, horizon, .. } = settings;
        let (table, logs) = (settings.table(), settings.log.clone());
        Self {
            task,
            field,
            precision,
            seed,
            epochs,
            horizon,
            logs,
            table,
            initial_policy: None,
            settings: Arc::new(settings),
        }
    }

    /// Starts the training from the policy file with these contents.
    pub fn starting_from(self, policy: Vec<u8>) -> Self {
        Self { initial_policy: Some(policy.into()), ..self }
    }

    /// CRC-32C of the policy file from which the training starts.
    pub fn initial_policy_checksum(&self) -> Option<u32> {
        self.initial_policy.as_deref().map(|bytes| CRC.checksum(bytes))
    }

    /// Contents of the policy file from which the training starts.
    pub fn initial_policy(&self) -> Option<&[u8]> {
        self.initial_policy.as_deref()
    }

    /// Description of the policy, for other programs.
    pub fn about(&self) -> About {
        let finite = |bound: f64| Some(bound).filter(|bound| bound.is_finite());
        let trained = |(name, number)| match number {
            Number::Trained { min, max, .. } => {
                Some(TrainedNumber { name, min: finite(min), max: finite(max) })
            }
            _ => None,
        };
        About {
            physgrad: env!("CARGO_PKG_VERSION"),
            task: self.task.name().into(),
            observations: self.observation_names(),
            controls: self.control_names(),
            trained: self.varied().into_iter().filter_map(trained).collect(),
        }
    }

    /// Refuses settings of the training that its field does not read.
    ///
    /// # Errors
    /// As [`check_fields`](Self::check_fields). Also if `training.truncation` exceeds the horizon, or
    /// if an estimator that reads losses only has a field other than C, the default, and R.
    pub fn check_field(&self) -> Result<(), ConfigError> {
        let field = self.field.0.name();
        if self.reads_losses_only() && !["combined", "regular"].contains(&field) {
            return Err(ConfigError::unread("field", field, LOSSES));
        }
        let training = self.table.get("training");
        let truncation = training.and_then(|training| training.get("truncation")?.as_integer());
        if let Some(steps) = truncation.filter(|&steps| steps > self.horizon as i64) {
            let because = format!("`horizon` is {}", self.horizon);
            return Err(ConfigError::unread("training.truncation", steps, &because));
        }
        self.check_fields(&[self.field.0])
    }

    /// Whether the estimator of the training reads losses only, without derivatives.
    pub fn reads_losses_only(&self) -> bool {
        let estimator = self.table.get("training").and_then(|training| training.get("estimator"));
        estimator.and_then(Value::as_str) == Some("zeroth_order")
    }

    /// Refuses settings of the training that none of the fields reads.
    ///
    /// # Errors
    /// The scene has such a setting.
    pub fn check_fields(&self, fields: &[Field]) -> Result<(), ConfigError> {
        let number = |key: &str| {
            let value = self.table.get("training")?.get(key)?;
            value.as_float().or_else(|| value.as_integer().map(|value| value as f64))
        };
        let names: Vec<&str> = fields.iter().map(Field::name).collect();
        let [verb, have, omit] =
            if fields.len() == 1 { ["field", "has", "omits"] } else { ["fields", "have", "omit"] };
        let named = format!("{verb} {}", names.join(", "));
        let flows = || fields.iter().flat_map(Field::flows);
        let losses = self.reads_losses_only();
        let has_second = fields.iter().any(|field| field.flows().len() > 1);
        let sees = flows().any(|flow| flow.control != 0.0);
        let has_path = flows().any(|flow| [flow.physics, flow.control, flow.memory] != [0.0; 3]);
        let second = format!("{named} {have} no second gradient");
        let observation = format!("{named} {omit} the path through the observation");
        let paths = format!("{named} {omit} all paths between steps");
        // Value without effect, and what reads the setting.
        let settings = [
            ("average", 0.0, has_second, &*second),
            ("control", 1.0, sees, &*observation),
            ("discount", 1.0, has_path, &*paths),
            ("truncation", f64::NAN, has_path, &*paths),
            ("cut", f64::NAN, has_path, &*paths),
        ];
        for (key, neutral, is_read, because) in settings {
            if let Some(value) = number(key).filter(|value| *value != neutral)
                && (losses || !is_read)
            {
                let because = if losses { LOSSES } else { because };
                return Err(ConfigError::unread(&format!("training.{key}"), value, because));
            }
        }
        Ok(())
    }

    /// Opens a run before its first epoch.
    pub fn open(&self, workers: usize) -> Result<Box<dyn AnyRun>> {
        self.settings.open_from(self.initial_theta()?, workers)
    }

    /// Parameters before the first epoch: those of the initial policy, or random ones.
    ///
    /// # Errors
    /// The initial policy does not fit the scene.
    pub fn initial_theta(&self) -> Result<Vec<f64>> {
        let policy = self.policy();
        let Some(bytes) = self.initial_policy() else {
            return Ok(policy_file::random(&*policy, self.seed));
        };
        policy_file::read(bytes, &self.about(), &*policy, self.seed).with_context(|| {
            let file = self.table.get(INITIAL_POLICY).map_or_else(String::new, Value::to_string);
            format!("`{INITIAL_POLICY}` {file}")
        })
    }

    /// Note about the mini-batch if it is larger than the training set. None otherwise.
    pub fn large_batch(&self) -> Option<String> {
        let count = |key: &str| self.table.get("training")?.get(key)?.as_integer();
        let (batch, samples) = (count("batch")?, count("train_samples")?);
        (batch > samples).then(|| {
            format!(
                "note: `training.batch` is {batch}, but `training.train_samples` is {samples}: each epoch has one update, with \
                 all samples"
            )
        })
    }

    /// Copy with another field and seed.
    pub fn with(&self, field: FieldName, seed: u64) -> Result<Self, ConfigError> {
        let mut table = self.table.clone();
        table.insert("field".into(), Value::String(field.into()));
        table.insert("seed".into(), Value::Integer(seed as i64));
        Ok(Self { initial_policy: self.initial_policy.clone(), ..self.task.scene(table)? })
    }

    /// Identity of a run: the settings that a resumed run must share, one per line.
    ///
    /// Lists the differences from the task's defaults. Excludes settings that do not change
    /// results, and the number of epochs unless the learning rate decays over them. A setting added
    /// by a later version, with a default that preserves the behaviour, does not change the
    /// identity.
    pub fn identity(&self) -> String {
        let decay = self
            .table
            .get("training")
            .and_then(|training| training.get("decay"))
            .and_then(Value::as_str);
        let is_constant = decay.is_none_or(|decay| decay == "constant");
        self.differences(if is_constant {
            &["epochs", "training.memory"]
        } else {
            &["training.memory"]
        })
    }

    /// Settings shared by the runs of a comparison: [`identity`](Self::identity) without field,
    /// seed and epochs.
    pub fn comparable(&self) -> String {
        self.differences(&["epochs", "training.memory", "field", "seed"])
    }

    /// One line for the task, one per effect or part of the actuator, and one per setting that
    /// differs from its default. The last line identifies the initial policy, if any. Skips the
    /// keys in `but`, and the keys `tags` and `log`.
    fn differences(&self, but: &[&str]) -> String {
        let mut lines = vec![format!("task = {:?}", self.task.name())];
        // Default settings with the same effects and parts of the actuator, each with its default
        // parameters.
        let mut defaults = self.task.defaults();
        for section in OPTIONAL {
            let parts: Vec<&String> = self
                .table
                .get(section)
                .and_then(Value::as_table)
                .into_iter()
                .flat_map(Table::keys)
                .collect();
            lines.extend(parts.iter().map(|part| format!("{section}.{part}")));
            let bare: Table =
                parts.into_iter().map(|part| (part.clone(), Value::Table(Table::new()))).collect();
            defaults.insert(section.into(), Value::Table(bare));
        }
        let defaults = flat(&self.task.fill(defaults.clone()).unwrap_or(defaults));
        let differences = flat(&self.table)
            .into_iter()
            .filter(|setting| !defaults.contains(setting) && !but.contains(&&*setting.0));
        let differences =
            differences.filter(|(key, _)| ![INITIAL_POLICY, "tags", "log"].contains(&&**key));
        lines.extend(differences.map(|(key, value)| format!("{key} = {value}")));
        // Identifies the policy file by its contents, not by its path.
        lines.extend(
            self.initial_policy_checksum()
                .map(|checksum| format!("{INITIAL_POLICY} = CRC-32C {checksum:08x}")),
        );
        lines.join("\n")
    }
}

/// All settings by dotted key. An empty section counts as a setting: it is an effect without
/// parameters.
pub fn flat(table: &Table) -> Vec<(String, Value)> {
    let inner = |(key, value): (&String, &Value)| match value {
        Value::Table(section) if !section.is_empty() => flat(section)
            .into_iter()
            .map(|(rest, value)| (format!("{key}.{rest}"), value))
            .collect(),
        value => vec![(key.clone(), value.clone())],
    };
    table.iter().flat_map(inner).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::settings::{Info, Method};
    use crate::tasks::MlpSettings;
    use crate::tasks::effects::EffectsSection;
    use physgrad::DynTask;
    use physgrad::tasks::CartPoleSystem;
    use physgrad_plot as report;
    use schemars::JsonSchema;
    use serde::{Deserialize, Serialize};

    /// Task with one effect.
    #[derive(Clone, Debug)]
    struct Windy;

    #[derive(Clone, Debug, Default, Serialize, Deserialize, JsonSchema)]
    #[serde(deny_unknown_fields)]
    struct Effects {
        /// Steady wind.
        #[serde(skip_serializing_if = "Option::is_none")]
        wind: Option<Wind>,
    }

    #[derive(Clone, Debug, Serialize, Deserialize, JsonSchema)]
    #[serde(deny_unknown_fields, default)]
    struct Wind {
        /// Wind speed, m/s.
        speed: f64,
    }

    impl Default for Wind {
        fn default() -> Self {
            Self { speed: 3.0 }
        }
    }

    impl EffectsSection for Effects {
        const INFO: &'static [Info] = &[];

        fn validate_values(&self) -> Result<(), ConfigError> {
            Ok(())
        }
    }

    impl TaskSpec for Windy {
        type System = CartPoleSystem;
        type Effects = Effects;
        type Loss = Effects;
        type PolicySpec = MlpSettings;

        const NAME: &'static str = "windy";
        const ABOUT: &'static str = "a test";
        const EPOCHS: usize = 1;
        fn horizon() -> usize {
            2
        }
        const METHODS: &'static [Method] = &[];

        fn system() -> CartPoleSystem {
            CartPoleSystem::default()
        }

        fn validate(_settings: &Settings<Self>) -> Result<(), ConfigError> {
            Ok(())
        }

        fn task(_settings: &Settings<Self>) -> DynTask {
            unreachable!("these tests need settings only")
        }

        fn variants() -> Vec<(String, Settings<Self>)> {
            Vec::new()
        }

        fn dt(_settings: &Settings<Self>) -> f64 {
            1.0
        }

        fn state_names(_settings: &Settings<Self>) -> Vec<String> {
            Vec::new()
        }

        fn control_names(_settings: &Settings<Self>) -> Vec<String> {
            Vec::new()
        }

        fn animation(
            _settings: &Settings<Self>,
            Trajectory { states, .. }: &Trajectory,
        ) -> Animation {
            report::cart_pole(states, &[], 1.0, 1.0)
        }
    }

    fn scene(effects: &str, epochs: i64) -> Scene {
        let mut table = Windy.defaults();
        table.insert("epochs".into(), Value::Integer(epochs));
        table.extend(effects.parse::<Table>().expect("TOML"));
        Scene::new(&Windy, Settings::<Windy>::fill(table).expect("settings"))
    }

    #[test]
    fn an_identity_lists_the_differences_from_the_defaults() {
        assert_eq!(scene("", 7).identity(), "task = \"windy\"");
        assert_eq!(scene("seed = 4", 1).identity(), "task = \"windy\"\nseed = 4");
        assert_eq!(scene("seed = 4", 1).comparable(), "task = \"windy\"");
        // Lists an effect even if all its parameters have their defaults.
        assert_eq!(scene("effects.wind = {}", 1).identity(), "task = \"windy\"\neffects.wind");
        let fast = scene("effects.wind.speed = 5", 1);
        assert_eq!(fast.identity(), "task = \"windy\"\neffects.wind\neffects.wind.speed = 5.0");
        assert_eq!(scene("seed = 4\neffects.wind.speed = 5", 1).comparable(), fast.identity());
    }

    #[test]
    fn absent_sections_are_omitted_and_a_schema_has_no_null() {
        assert!(!scene("", 1).table.contains_key("effects"));
        assert_eq!(
            scene("effects.wind = {}", 1).table["effects"]["wind"]["speed"].as_float(),
            Some(3.0)
        );
        let schema = Windy.schema();
        let wind = &schema["properties"]["effects"]["properties"]["wind"];
        assert_eq!(
            (&wind["type"], &wind["description"]),
            (&"object".into(), &"Steady wind.".into())
        );
        assert_eq!(wind["properties"]["speed"]["default"], 3.0);
        assert!(!schema.to_string().contains("null"), "{schema}");
    }
}
