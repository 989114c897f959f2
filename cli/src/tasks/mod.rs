//! Tasks of the program: built-in tasks, and tasks of the user.
//!
//! A [`TaskSpec`] adds settings, defaults, limits, column names and an animation to the physics of
//! a task. [`Settings`] are the sections of one task; [`Scene`] hides the type of the task. [`all`]
//! lists the built-in tasks and the tasks of the user, which implement [`ProgramTask`].
//!
//! Imports `settings` and `operations`. Start with `cart_pole`.

mod bodies;
mod cart_pole;
mod effects;
mod equations;
mod guidance;
mod hard;
mod own;
mod own_effect;
mod own_numbers;
pub mod policy;
mod quantum;
pub mod scene;
mod schema;
pub mod settings;

pub use own::ProgramTask;
pub use own_effect::{AnyEffectSpec, OwnEffect, ProgramEffect, SceneEffects};
pub use policy::{Controlled, ProgramPolicy, ScenePolicy};
pub use scene::Scene;
pub use schema::schema;
pub use settings::Settings;

use crate::operations::trajectory::Trajectory;
use crate::settings::config_error::ConfigError;
use crate::settings::{Info, Method};
use anyhow::{Result, anyhow, bail};
use effects::EffectsSection;
use physgrad::DynTask;
use physgrad::engine::Cause;
use physgrad::graph::Operations;
use physgrad_plot::Animation;
use policy::AnyPolicyKind;
use schemars::JsonSchema;
use serde::{Serialize, de::DeserializeOwned};
use std::fmt::Debug;
use std::marker::PhantomData;
use std::path::Path;
use std::sync::OnceLock;
use toml::{Table, Value};

/// A section of a scene's settings.
pub trait Section:
    Clone + Debug + Serialize + DeserializeOwned + JsonSchema + Send + Sync + 'static
{
}
impl<T: Clone + Debug + Serialize + DeserializeOwned + JsonSchema + Send + Sync + 'static> Section
    for T
{
}

/// Specification of a task: name, settings, defaults and limits. [`task`](TaskSpec::task) creates
/// the [`Task`](physgrad::Task) of given settings.
pub trait TaskSpec: Clone + Debug + Send + Sync + 'static {
    /// The `system` section: settings of the physics.
    type System: Section;
    /// The `effects` section: one subsection per effect that is present.
    type Effects: Section + Default + EffectsSection;
    /// The `loss` section: settings of the cost function.
    type Loss: Section + Default;

    /// The task's name.
    const NAME: &'static str;
    /// One-line description.
    const ABOUT: &'static str;
    /// Default number of epochs.
    const EPOCHS: usize;
    /// Default number of time steps.
    fn horizon() -> usize;
    /// Default kind of the policy.
    const POLICY: &'static str = policy::MLP;
    /// Integrators that can replace the task's native scheme.
    const METHODS: &'static [Method] = &[];

    /// A setting that names a file, whose contents the scene keeps. None by default.
    const FILE: Option<FileSetting> = None;

    /// Sentences that define the symbols in the equations of the effects, and state the size of the
    /// system whose operations the documentation counts.
    const SYMBOLS: &'static str = "";

    /// The default physics.
    fn system() -> Self::System;
    /// Checks the sections `system`, `effects` and `loss`, and refuses settings of other sections
    /// that the task does not support.
    ///
    /// # Errors
    /// A value is out of range, or a setting has no effect in this task.
    fn validate(settings: &Settings<Self>) -> Result<(), ConfigError>;
    /// Checks that the task accepts the effects of the user.
    ///
    /// # Errors
    /// An effect has another model than the task. The default refuses any effect.
    fn validate_own_effects(effects: &SceneEffects) -> Result<(), ConfigError> {
        effects.first().map_or(Ok(()), |key| {
            Err(ConfigError::new(key, "is an effect of the user, which this task does not accept; remove it from the scene"))
        })
    }
    /// Task of these settings.
    fn task(settings: &Settings<Self>) -> DynTask;
    /// Named settings for gradient checks.
    fn variants() -> Vec<(String, Settings<Self>)>;

    /// Time step, in the unit of time of the task: s, except for `quantum`.
    fn dt(settings: &Settings<Self>) -> f64;
    /// Names of the state components, without those that actuators add.
    fn state_names(settings: &Settings<Self>) -> Vec<String>;
    /// Indices of the state components that are angles in rad, in increasing order. By default,
    /// those with names that begin with `theta_`.
    fn angles(settings: &Settings<Self>) -> Vec<usize> {
        let names = Self::state_names(settings).into_iter().enumerate();
        names.filter(|(_, name)| name.starts_with("theta_")).map(|(i, _)| i).collect()
    }
    /// Names of the parameters of a rollout that are not drawn or trained numbers, in order. Empty
    /// by default.
    fn param_names(_settings: &Settings<Self>) -> Vec<String> {
        Vec::new()
    }
    /// Names of the control components.
    fn control_names(settings: &Settings<Self>) -> Vec<String>;
    /// Equations that the settings contain: what each gives, and its expression. None by default.
    fn equations(_settings: &Settings<Self>) -> Vec<(String, String)> {
        Vec::new()
    }
    /// Number of operations of these equations. None by default.
    fn operations(_settings: &Settings<Self>) -> Option<Operations> {
        None
    }
    /// Expressions that the settings of the system observe. None by default.
    fn observe(_settings: &Settings<Self>) -> Vec<String> {
        Vec::new()
    }
    /// Keys and values of physical numbers that a scene may set, and that have a value without it:
    /// those of a model in a file. None by default.
    fn model_numbers(_settings: &Settings<Self>) -> Vec<(String, f64)> {
        Vec::new()
    }
    /// Names of the parts of a model in a file. None by default.
    fn model(_settings: &Settings<Self>) -> Option<ModelParts> {
        None
    }
    /// Settings whose trained numbers have these typical values, by key, if the physics depends on
    /// typical values besides the parameters of a sample. None by default.
    fn with_typical(
        _settings: &Settings<Self>,
        _values: &[(String, f64)],
    ) -> Option<Settings<Self>> {
        None
    }
    /// What is allowed in these settings but hardly meant. Nothing by default.
    fn remarks(_settings: &Settings<Self>) -> Vec<String> {
        Vec::new()
    }
    /// Key and value of a setting of the system with which forces at contact begin without a jump, if
    /// the settings have another value. None by default.
    fn smoother(_settings: &Settings<Self>) -> Option<(&'static str, &'static str)> {
        None
    }
    /// Keys of the section `system` with names that no expression uses. None by default.
    fn unused(_settings: &Settings<Self>) -> Vec<String> {
        Vec::new()
    }
    /// Key of the expression that gives a state component that is not finite after a step, if it is
    /// known. None by default.
    fn expression_of(
        _settings: &Settings<Self>,
        _component: usize,
        _cause: Option<Cause>,
    ) -> Option<String> {
        None
    }
    /// A quantity that is conserved while the control is zero, or None.
    fn conserved(_settings: &Settings<Self>) -> Option<Conserved> {
        None
    }
    /// Animation of one rollout, from its states, controls and parameters.
    fn animation(settings: &Settings<Self>, rollout: &Trajectory) -> Animation;
    /// Animation of the states so far of an unfinished rollout, whose last frame must not move by
    /// later states. `bounds` has the range of each control, if any.
    fn unfinished(
        settings: &Settings<Self>,
        rollout: &Trajectory,
        _bounds: Option<&[[f64; 2]]>,
    ) -> Animation {
        Self::animation(settings, rollout)
    }
}

/// Names of the parts of a model in a file, as settings and expressions have them.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct ModelParts {
    /// Name of the model.
    pub name: String,
    /// Kinds of parts, in the plural, with the names of all parts.
    pub parts: Vec<(&'static str, Vec<String>)>,
    /// What the file has and what does not act, one sentence each.
    pub remarks: Vec<String>,
}

/// A setting whose value may be the path of a file.
#[derive(Clone, Copy, Debug)]
pub struct FileSetting {
    /// Dotted key of the setting.
    pub key: &'static str,
    /// Returns what the scene keeps for a value, from a file in a folder: the contents, or the value
    /// itself if it is no path.
    pub read: fn(&str, &Path) -> Result<String, String>,
}

/// A function of the state that is conserved in continuous time.
pub struct Conserved {
    /// Name of the quantity.
    pub name: &'static str,
    /// Evaluates the quantity at a state.
    pub value: StateFunction,
}

type StateFunction = Box<dyn Fn(&[f64]) -> f64>;

impl Conserved {
    /// Largest deviation from the initial value over all samples, relative to the largest absolute
    /// value.
    pub fn drift(&self, samples: &[Vec<Vec<f64>>]) -> f64 {
        let (mut drift, mut size) = (0.0_f64, 0.0_f64);
        for states in samples {
            let start = (self.value)(&states[0]);
            for value in states.iter().map(|x| (self.value)(x)) {
                (drift, size) = (drift.max((value - start).abs()), size.max(value.abs()));
            }
        }
        // 0/0 is NaN: without samples, or if the quantity is 0 in all states.
        drift / size
    }
}

/// Built-in tasks. Each has a [`TaskSpec`], an entry here, and a preset in `scenes/presets`.
const BUILT_IN: [&dyn AnyTaskSpec; 12] = [
    entry::<cart_pole::CartPole>(),
    entry::<guidance::Guidance>(),
    entry::<quantum::Quantum>(),
    entry::<hard::Lqr>(),
    entry::<hard::DoublePendulum>(),
    entry::<hard::Pendulum>(),
    entry::<hard::PoleChain>(),
    entry::<hard::Slider>(),
    entry::<hard::Bounce>(),
    entry::<hard::Push>(),
    entry::<equations::Equations>(),
    entry::<bodies::Bodies>(),
];

/// Tasks and effects of this process, set once by [`register`].
static REGISTERED: OnceLock<Registered> = OnceLock::new();

struct Registered {
    tasks: Vec<&'static dyn AnyTaskSpec>,
    /// Effects of the user with their keys in scenes.
    effects: Vec<(&'static str, &'static dyn AnyEffectSpec)>,
    policies: Vec<&'static dyn AnyPolicyKind>,
}

/// All tasks: first the built-in tasks, then the tasks of the user.
pub fn all() -> &'static [&'static dyn AnyTaskSpec] {
    REGISTERED.get().map_or(&BUILT_IN, |registered| &registered.tasks)
}

/// Tasks of the user.
pub fn own() -> &'static [&'static dyn AnyTaskSpec] {
    &all()[BUILT_IN.len()..]
}

/// Returns whether code of the user reads this setting of a task. The setting then belongs to the
/// system of a task of the user, or to an effect of the user.
pub fn is_read_by_user(task: &str, key: &str) -> bool {
    let is_own_task = own().iter().any(|own| own.name() == task);
    let is_of_own_effect = own_effects(task).iter().any(|(effect, _)| key.starts_with(effect));
    is_own_task && key.starts_with("system.") || is_of_own_effect
}

/// Effects of the user for this task, with their keys in scenes.
fn own_effects(task: &str) -> Vec<(&'static str, &'static dyn AnyEffectSpec)> {
    let effects = REGISTERED.get().map_or(&[][..], |registered| &registered.effects);
    effects.iter().copied().filter(|(_, effect)| effect.task() == task).collect()
}

/// Kinds of policies of the user.
fn own_policies() -> &'static [&'static dyn AnyPolicyKind] {
    REGISTERED.get().map_or(&[], |registered| &registered.policies)
}

/// Adds tasks, effects and policies of the user to the built-in ones.
///
/// # Errors
/// A name is empty, or has characters other than lower case letters, digits and underscores. Two
/// tasks, two policies, or two effects of a task, have the same name. An effect names an unknown
/// task. The process has called this function before.
pub fn register(
    own: Vec<&'static dyn AnyTaskSpec>,
    own_effects: Vec<&'static dyn AnyEffectSpec>,
    policies: Vec<&'static dyn AnyPolicyKind>,
) -> Result<()> {
    let is_name = |name: &str| {
        !name.is_empty()
            && name
                .bytes()
                .all(|byte| byte == b'_' || byte.is_ascii_lowercase() || byte.is_ascii_digit())
    };
    let names = own
        .iter()
        .map(|task| task.name())
        .chain(own_effects.iter().map(|effect| effect.info().name))
        .chain(policies.iter().map(|policy| policy.name()));
    if let Some(name) = names.into_iter().find(|name| !is_name(name)) {
        bail!("`NAME` is {name:?}; allowed: lower case letters, digits and underscores");
    }
    let tasks: Vec<_> = BUILT_IN.into_iter().chain(own).collect();
    for (i, task) in tasks.iter().enumerate() {
        if tasks[..i].iter().any(|other| other.name() == task.name()) {
            bail!("two tasks have the name `{}`; choose another `NAME`", task.name());
        }
    }
    for (i, effect) in own_effects.iter().enumerate() {
        let (name, of) = (effect.info().name, effect.task());
        let Some(task) = tasks.iter().find(|task| task.name() == of) else {
            bail!(
                "the effect `{name}` is of the task `{of}`, which is unknown; choose another `TASK`"
            );
        };
        let is_same = |other: &&dyn AnyEffectSpec| other.task() == of && other.info().name == name;
        if task.effects().iter().any(|info| info.name == name)
            || own_effects[..i].iter().any(is_same)
        {
            bail!("two effects of {of} have the name `{name}`; choose another `NAME`");
        }
    }
    let kinds: Vec<_> = policy::all().into_iter().chain(policies.iter().copied()).collect();
    for (i, kind) in kinds.iter().enumerate() {
        if kinds[..i].iter().any(|other| other.name() == kind.name()) {
            bail!("two policies have the name `{}`; choose another `NAME`", kind.name());
        }
    }
    // Leaks the keys, because names of effects are static. A process registers once.
    let key =
        |name: &str| -> &'static str { Box::leak(format!("effects.{name}").into_boxed_str()) };
    let effects = own_effects.into_iter().map(|effect| (key(effect.info().name), effect)).collect();
    REGISTERED.set(Registered { tasks, effects, policies }).map_err(|_| {
        anyhow!("this process has already registered tasks, effects and policies; call `main` once")
    })
}

/// Object-safe [`TaskSpec`].
pub trait AnyTaskSpec: Send + Sync {
    /// The task's name.
    fn name(&self) -> &'static str;
    /// One-line description.
    fn about(&self) -> &'static str;
    /// Documentation of every effect.
    fn effects(&self) -> Vec<Info>;
    /// Sentences about the symbols in the equations of the effects. Empty without built-in effects.
    fn symbols(&self) -> &'static str;
    /// Integrators that can replace the task's native scheme.
    fn methods(&self) -> &'static [Method];
    /// Integrator of the reference solution, and its number of substeps per control step. The
    /// native scheme if the task has no integrator of high order.
    fn reference(&self) -> (&'static str, usize);
    /// A setting that names a file.
    fn file(&self) -> Option<FileSetting>;
    /// Default kind of the policy.
    fn policy(&self) -> &'static str;
    /// The default settings, with those of the kind of policy that a scene names.
    fn defaults(&self, scene: &Table) -> Table;
    /// Fills in missing settings that have a default.
    fn fill(&self, settings: Table) -> Result<Table, ConfigError>;
    /// Creates a scene. Missing settings that have a default get it.
    fn scene(&'static self, settings: Table) -> Result<Scene, ConfigError>;
    /// JSON schema of scenes of this task.
    fn schema(&self) -> serde_json::Value;
    /// Named scenes for gradient checks.
    fn variants(&'static self) -> Vec<(String, Scene)>;
}

/// Entry of a task in the list of tasks, built-in or of the user.
pub const fn entry<K: TaskSpec>() -> &'static dyn AnyTaskSpec {
    &const { Entry::<K>(PhantomData) }
}

struct Entry<K>(PhantomData<fn() -> K>);

impl<K: TaskSpec> AnyTaskSpec for Entry<K> {
    fn name(&self) -> &'static str {
        K::NAME
    }

    fn about(&self) -> &'static str {
        K::ABOUT
    }

    fn effects(&self) -> Vec<Info> {
        let own = own_effects(K::NAME).into_iter().map(|(_, effect)| effect.info());
        K::Effects::INFO.iter().copied().chain(own).collect()
    }

    fn symbols(&self) -> &'static str {
        K::SYMBOLS
    }

    fn methods(&self) -> &'static [Method] {
        K::METHODS
    }

    fn reference(&self) -> (&'static str, usize) {
        let best =
            [Method::Tsit5, Method::Pade].into_iter().find(|method| K::METHODS.contains(method));
        (best.map_or("native", Method::name), 128)
    }

    fn file(&self) -> Option<FileSetting> {
        K::FILE
    }

    fn policy(&self) -> &'static str {
        K::POLICY
    }

    fn defaults(&self, scene: &Table) -> Table {
        let mut defaults = Settings::<K>::defaults().table();
        let section = scene.get("policy").and_then(Value::as_table);
        defaults.insert("policy".into(), policy::defaults(section, K::POLICY).into());
        defaults
    }

    fn fill(&self, settings: Table) -> Result<Table, ConfigError> {
        Ok(Settings::<K>::fill(settings)?.table())
    }

    fn scene(&'static self, settings: Table) -> Result<Scene, ConfigError> {
        let settings = Settings::<K>::fill(settings)?;
        let parts = settings.parts()?;
        Ok(Scene::new(self, settings, parts))
    }

    fn schema(&self) -> serde_json::Value {
        schema::of::<Settings<K>>(self, &own_effects(K::NAME))
    }

    fn variants(&'static self) -> Vec<(String, Scene)> {
        K::variants()
            .into_iter()
            .map(|(name, settings)| {
                let parts = settings.parts().expect("variants are valid");
                (name, Scene::new(self, settings, parts))
            })
            .collect()
    }
}
