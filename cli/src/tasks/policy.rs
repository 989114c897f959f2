//! The `policy` section: the kind of the policy and its settings, bounds of its controls, and a
//! policy to whose controls it adds.
//!
//! A [`PolicyKind`] has the settings of one kind and builds the policy for the sizes of a scene. The
//! kinds are [`built_in`](kinds), or of the user, who implements [`ProgramPolicy`].

mod kinds;
mod own;

pub use kinds::{CONV, MLP};
pub use own::ProgramPolicy;

use crate::settings::config_error::ConfigError;
use crate::settings::reading::{overlay, read};
use crate::tasks::{Section, schema};
use physgrad::Number;
use physgrad::number::Varied;
use physgrad::policy::{Bounded, DynPolicy, Policy as _, Sum, TrainedParam, WithParams};
use physgrad::train::TrainedNumber;
use serde_json::json;
use std::fmt::Debug;
use std::marker::PhantomData;
use toml::{Table, Value};

/// The policy of a scene, with the trained numbers of its system.
pub type ScenePolicy = WithParams<DynPolicy>;

/// What a policy observes and controls.
#[derive(Clone, Debug, PartialEq)]
#[non_exhaustive]
pub struct Controlled {
    /// Names of the components of the observation.
    pub observations: Vec<String>,
    /// Names of the controls.
    pub controls: Vec<String>,
    /// Bounds of each control that the task is meant for. None without bounds.
    pub bounds: Option<Vec<[f64; 2]>>,
    /// Steps of a rollout.
    pub horizon: usize,
    /// Time step, in the unit of time of the task.
    pub dt: f64,
}

/// Settings of one kind of policy. Keys in errors are relative to the section.
pub trait PolicyKind: Section + Default {
    /// Name in `policy.kind`.
    const NAME: &'static str;
    /// Description in one line.
    const ABOUT: &'static str;
    /// Whether the policy computes controls themselves, which bounds then hardly change within their
    /// range. Others begin with controls of about 0, which then mean the middle of the range.
    const SATURATES: bool = false;

    /// Checks the ranges of all settings.
    ///
    /// # Errors
    /// A value is out of range.
    fn validate(&self) -> Result<(), ConfigError> {
        Ok(())
    }
    /// The policy for a scene.
    ///
    /// # Errors
    /// The policy does not suit the scene.
    fn build(&self, of: &Controlled) -> Result<DynPolicy, ConfigError>;
    /// Trained numbers with a meaning of their own, by their keys, in the order of θ.
    fn numbers(&self) -> Vec<(String, TrainedParam)> {
        Vec::new()
    }
    /// What is allowed but hardly meant.
    fn remarks(&self) -> Vec<String> {
        Vec::new()
    }
    /// Keys of names that no expression of the policy uses.
    fn unused(&self) -> Vec<String> {
        Vec::new()
    }
    /// Keys of the expressions that give these controls and the next memory, in this order. None by
    /// default.
    fn expressions(&self, _controls: &[String]) -> Vec<String> {
        Vec::new()
    }
    /// Expressions of the policy: what each gives, and the expression.
    fn equations(&self) -> Vec<(String, String)> {
        Vec::new()
    }
}

/// Object-safe [`PolicyKind`], without a value.
pub trait AnyPolicyKind: Send + Sync {
    fn name(&self) -> &'static str;
    fn about(&self) -> &'static str;
    fn saturates(&self) -> bool;
    fn defaults(&self) -> Table;
    fn schema(&self) -> serde_json::Value;
    /// Reads a section with all its settings.
    fn read(&self, section: Table) -> Result<Box<dyn AnyPolicySettings>, ConfigError>;
}

/// Object-safe [`PolicyKind`].
pub trait AnyPolicySettings: Debug + Send + Sync {
    fn table(&self) -> Table;
    fn validate(&self) -> Result<(), ConfigError>;
    fn build(&self, of: &Controlled) -> Result<DynPolicy, ConfigError>;
    fn numbers(&self) -> Vec<(String, TrainedParam)>;
    fn remarks(&self) -> Vec<String>;
    fn unused(&self) -> Vec<String>;
    fn expressions(&self, controls: &[String]) -> Vec<String>;
    fn equations(&self) -> Vec<(String, String)>;
}

impl<S: PolicyKind> AnyPolicySettings for S {
    fn table(&self) -> Table {
        Table::try_from(self).expect("settings are plain tables")
    }
    fn validate(&self) -> Result<(), ConfigError> {
        PolicyKind::validate(self)
    }
    fn build(&self, of: &Controlled) -> Result<DynPolicy, ConfigError> {
        PolicyKind::build(self, of)
    }
    fn numbers(&self) -> Vec<(String, TrainedParam)> {
        PolicyKind::numbers(self)
    }
    fn remarks(&self) -> Vec<String> {
        PolicyKind::remarks(self)
    }
    fn unused(&self) -> Vec<String> {
        PolicyKind::unused(self)
    }
    fn expressions(&self, controls: &[String]) -> Vec<String> {
        PolicyKind::expressions(self, controls)
    }
    fn equations(&self) -> Vec<(String, String)> {
        PolicyKind::equations(self)
    }
}

/// Entry of a kind in the list of kinds.
pub const fn kind<S: PolicyKind>() -> &'static dyn AnyPolicyKind {
    &const { Entry::<S>(PhantomData) }
}

struct Entry<S>(PhantomData<fn() -> S>);

impl<S: PolicyKind> AnyPolicyKind for Entry<S> {
    fn name(&self) -> &'static str {
        S::NAME
    }
    fn about(&self) -> &'static str {
        S::ABOUT
    }
    fn saturates(&self) -> bool {
        S::SATURATES
    }
    fn defaults(&self) -> Table {
        S::default().table()
    }
    fn schema(&self) -> serde_json::Value {
        schema::of_section::<S>(&self.defaults())
    }
    fn read(&self, section: Table) -> Result<Box<dyn AnyPolicySettings>, ConfigError> {
        let names = COMMON.into_iter();
        let settings: S = read(section).map_err(|error| error.also_allowed("", names))?;
        Ok(Box::new(settings))
    }
}

/// Keys that every kind has.
pub const COMMON: [&str; 3] = ["kind", "bounds", "base"];

/// All kinds: the built-in ones, then those of the user.
pub fn all() -> Vec<&'static dyn AnyPolicyKind> {
    kinds::BUILT_IN.into_iter().chain(super::own_policies().iter().copied()).collect()
}

/// Whether a key of a scene is that of a kind of policy.
pub fn is_kind(key: &str) -> bool {
    let inner = key.strip_prefix("policy.").and_then(|key| key.strip_suffix("kind"));
    inner.is_some_and(|bases| bases.split_inclusive('.').all(|part| part == "base."))
}

/// The kind that a section names, or the default. None if there is no such kind.
fn named(section: &Table, default: Option<&str>) -> Option<&'static dyn AnyPolicyKind> {
    let name = section.get("kind").map_or(default, Value::as_str);
    all().into_iter().find(|kind| Some(kind.name()) == name)
}

/// Default settings of the kind that a `policy` section names, and of its base. Those of `default`
/// without a kind.
pub fn defaults(section: Option<&Table>, default: &str) -> Table {
    let empty = Table::new();
    let section = section.unwrap_or(&empty);
    let mut settings =
        named(section, Some(default)).map_or_else(Table::new, |kind| kind.defaults());
    if let Some(kind) = section.get("kind") {
        settings.insert("kind".into(), kind.clone());
    }
    if let Some(Value::Table(base)) = section.get("base") {
        settings.insert("base".into(), defaults(Some(base), "").into());
    }
    settings
}

/// Whether a policy can keep a control between these bounds, also in f32.
fn is_range([low, high]: &[f64; 2]) -> bool {
    low.abs().max(high.abs()) <= 1e30 && high - low >= 1e-30
}

/// Bounds of the controls of a policy.
#[derive(Clone, Debug)]
enum Bounds {
    /// Those of the task.
    OfTask,
    Given(Vec<[f64; 2]>),
}

impl Bounds {
    /// None if the controls have no bounds.
    fn read(value: &Value) -> Result<Option<Self>, ConfigError> {
        let range = |value: &Value| {
            let number = |value: &Value| value.as_float().or(value.as_integer().map(|x| x as f64));
            let [low, high] = value.as_array()?.as_slice() else { return None };
            Some([number(low)?, number(high)?]).filter(is_range)
        };
        let given = |list: &Vec<Value>| list.iter().map(range).collect::<Option<Vec<_>>>();
        match value {
            Value::Boolean(bounded) => Ok(bounded.then_some(Self::OfTask)),
            Value::Array(list) if given(list).is_some() => Ok(given(list).map(Self::Given)),
            other => Err(ConfigError::invalid(
                "bounds",
                Some(other),
                "true, for the bounds of the task, false, or a list with [low, high] for each control",
            )),
        }
    }

    fn ranges(&self, of: &Controlled) -> Result<Vec<[f64; 2]>, ConfigError> {
        let (found, controls) = match self {
            Self::OfTask => (of.bounds.clone(), of.controls.len()),
            Self::Given(ranges) => (Some(ranges.clone()), of.controls.len()),
        };
        let example = "as in [[-1.0, 1.0]]";
        let Some(ranges) = found else {
            let what = format!(
                "is true, but the task has no bounds of its controls; list them, {example}"
            );
            return Err(ConfigError::new("bounds", what));
        };
        if ranges.len() != controls {
            let what = format!("has {} pairs, but there are {controls} controls", ranges.len());
            return Err(ConfigError::new("bounds", what));
        }
        let unbounded = ranges.iter().position(|range| range.iter().any(|x| !x.is_finite()));
        if let Some(i) = unbounded {
            let what = format!(
                "is true, but the task has no bounds of `{}`; list all bounds, {example}",
                of.controls[i]
            );
            return Err(ConfigError::new("bounds", what));
        }
        if let Some(i) = ranges.iter().position(|range| !is_range(range)) {
            let ([low, high], name) = (ranges[i], &of.controls[i]);
            let what = format!(
                "has [{low:e}, {high:e}] for `{name}`; allowed: bounds within ±1e30, the smaller first and 1e-30 apart"
            );
            return Err(ConfigError::new("bounds", what));
        }
        Ok(ranges)
    }
}

/// The settings of a `policy` section.
#[derive(Debug)]
pub struct PolicySettings {
    name: &'static str,
    saturates: bool,
    own: Box<dyn AnyPolicySettings>,
    bounds: Option<Bounds>,
    base: Option<Box<PolicySettings>>,
}

/// A policy, and its trained numbers with a meaning of their own, by their keys.
pub struct Built {
    pub policy: DynPolicy,
    pub numbers: Vec<TrainedNumber>,
}

impl Built {
    /// The policy with its numbers as those of a section, after a number of other parameters.
    pub fn within(mut self, section: &str, shift: usize) -> Self {
        for TrainedNumber { name, index, .. } in &mut self.numbers {
            *name = format!("{section}{name}");
            *index += shift;
        }
        self
    }
}

impl PolicySettings {
    /// Reads a `policy` section with all settings. Keys in errors are relative to the section.
    ///
    /// # Errors
    /// The kind or a key is unknown, or a value is out of range.
    pub fn read(mut section: Table, default: Option<&str>) -> Result<Self, ConfigError> {
        let Some(kind) = named(&section, default) else {
            let names: Vec<&str> = all().iter().map(|kind| kind.name()).collect();
            let found = section.get("kind").map_or("missing".into(), Value::to_string);
            let allowed = format!("`{}`", names.join("`, `"));
            return Err(ConfigError::new("kind", format!("is {found}; allowed: {allowed}")));
        };
        let [_, bounds, base] = COMMON.map(|key| section.remove(key));
        let base = match base {
            None => None,
            Some(Value::Table(base)) => {
                let base = Self::read(base, None).map_err(|error| error.within("base"))?;
                Some(Box::new(base))
            }
            Some(other) => {
                let allowed = "a section with the `kind` of a policy";
                return Err(ConfigError::invalid("base", Some(&other), allowed));
            }
        };
        let bounds = bounds.as_ref().map(Bounds::read).transpose()?.flatten();
        let saturates = kind.saturates() || base.as_ref().is_some_and(|base| base.saturates);
        let own = kind.read(section)?;
        own.validate()?;
        Ok(Self { name: kind.name(), saturates, own, bounds, base })
    }

    /// The section with all settings, in one order. Omits a kind that is the `default`.
    fn table(&self, default: Option<&str>) -> Table {
        let mut table = Table::new();
        if default != Some(self.name) {
            table.insert("kind".into(), self.name.into());
        }
        table.extend(self.own.table());
        match &self.bounds {
            None => {}
            Some(Bounds::OfTask) => drop(table.insert("bounds".into(), true.into())),
            Some(Bounds::Given(ranges)) => {
                let ranges = ranges.iter().map(|range| Value::from(range.to_vec()));
                table.insert("bounds".into(), Value::Array(ranges.collect()));
            }
        }
        if let Some(base) = &self.base {
            table.insert("base".into(), base.table(None).into());
        }
        table
    }

    /// What the parameters of the policy mean in a scene: its settings with bounds as numbers, without
    /// those of initial parameters and fixed numbers.
    pub fn meaning(&self, of: &Controlled) -> Table {
        let mut table = self.table(None);
        table.remove("zero_init_output");
        if let Some(Value::Table(numbers)) = table.get_mut("parameters") {
            numbers.retain(|_, number| number.get("start").is_some());
            for number in numbers.iter_mut().filter_map(|(_, number)| number.as_table_mut()) {
                number.remove("start");
            }
        }
        if let Some(Ok(ranges)) = self.bounds.as_ref().map(|bounds| bounds.ranges(of)) {
            let ranges = ranges.iter().map(|range| Value::from(range.to_vec()));
            table.insert("bounds".into(), Value::Array(ranges.collect()));
        }
        if let Some(base) = &self.base {
            table.insert("base".into(), base.meaning(of).into());
        }
        table
    }

    /// The policy for a scene. Keys in errors are relative to the section.
    ///
    /// # Errors
    /// The policy does not suit the scene.
    pub fn build(&self, of: &Controlled) -> Result<Built, ConfigError> {
        let own = self.own.build(of)?;
        for (what, found, expected) in [
            ("observations", own.observation_dim(), of.observations.len()),
            ("controls", own.control_dim(), of.controls.len()),
        ] {
            if found != expected {
                let what = format!(
                    "is {}, which has {found} {what}, but the scene has {expected}",
                    self.name
                );
                return Err(ConfigError::new("kind", what));
            }
        }
        let numbers = self.own.numbers().into_iter().enumerate();
        let number = |(index, (name, map))| TrainedNumber { name, index, map };
        let mut built = Built { policy: own, numbers: numbers.map(number).collect() };
        if let Some(base) = &self.base {
            let base = base.build(of).map_err(|error| error.within("base"))?.within("base.", 0);
            let own = built.within("", base.policy.param_count());
            built = Built {
                policy: DynPolicy::new(Sum::new(base.policy, own.policy)),
                numbers: [base.numbers, own.numbers].concat(),
            };
        }
        if let Some(bounds) = &self.bounds {
            let ranges = bounds.ranges(of)?;
            built.policy = DynPolicy::new(if self.saturates {
                Bounded::saturating(built.policy, ranges)
            } else {
                Bounded::between(built.policy, ranges)
            });
        }
        Ok(built)
    }

    /// The kind, with the parts that it has.
    pub fn description(&self) -> String {
        let bounds = if self.bounds.is_some() { " with bounds" } else { "" };
        let base = self.base.as_ref().map(|base| format!(" added to {}", base.description()));
        format!("{}{bounds}{}", self.name, base.unwrap_or_default())
    }

    /// What is allowed but hardly meant.
    pub fn remarks(&self) -> Vec<String> {
        let base = self.base.iter().flat_map(|base| base.remarks());
        self.own.remarks().into_iter().chain(base).collect()
    }

    /// Keys of names that no expression of the policy or its base uses.
    pub fn unused(&self) -> Vec<String> {
        let base = self.base.iter().flat_map(|base| base.unused());
        let base = base.map(|key| format!("base.{key}"));
        self.own.unused().into_iter().chain(base).collect()
    }

    /// Keys of the expressions that give these controls and the next memory, in this order. None if a
    /// base adds to them.
    pub fn expressions(&self, controls: &[String]) -> Vec<String> {
        if self.base.is_some() { Vec::new() } else { self.own.expressions(controls) }
    }

    /// Expressions of the policy and its base.
    pub fn equations(&self) -> Vec<(String, String)> {
        let base = self.base.iter().flat_map(|base| base.equations());
        let base = base.map(|(name, text)| (format!("base: {name}"), text));
        self.own.equations().into_iter().chain(base).collect()
    }
}

/// The `policy` section of a scene with all settings. Omits a kind that is the `default`. Leaves
/// invalid settings as they are.
pub fn completed(section: Table, default: &str) -> Table {
    let mut settings = defaults(Some(&section), default);
    overlay(&mut settings, &section);
    let read = PolicySettings::read(settings.clone(), Some(default));
    read.map_or(settings, |read| read.table(Some(default)))
}

/// JSON schema of the `policy` section of a task with this default kind.
pub fn section_schema(default: &str) -> serde_json::Value {
    let mut kinds = all();
    kinds.sort_by_key(|kind| kind.name() != default);
    let names: Vec<&str> = kinds.iter().map(|kind| kind.name()).collect();
    let branch = |kind: &&'static dyn AnyPolicyKind| {
        let mut schema = kind.schema();
        let own = schema["properties"].as_object().cloned().unwrap_or_default();
        let mut properties = serde_json::Map::new();
        properties
            .insert("kind".into(), json!({ "const": kind.name(), "description": kind.about() }));
        properties.extend(own);
        properties.insert("bounds".into(), json!({
            "description": "Bounds of the controls, by a tanh: true for those of the task, or [low, high] for each control.",
            "type": ["boolean", "array"],
        }));
        properties.insert("base".into(), json!({
            "description": "Policy to whose controls this one adds: a section with a `kind` and its settings.",
            "type": "object",
            "required": ["kind"],
        }));
        schema["properties"] = properties.into();
        schema["title"] = kind.name().into();
        schema["description"] = kind.about().into();
        if kind.name() != default {
            schema["required"] = json!(["kind"]);
        }
        schema
    };
    json!({
        "description": format!("Policy, of one of the kinds {}.", names.join(", ")),
        "type": "object",
        "oneOf": kinds.iter().map(branch).collect::<Vec<_>>(),
    })
}

/// Converts a trained number to an entry of `θ`. None for other numbers.
pub fn trained(varied: &Varied) -> Option<TrainedParam> {
    let Number::Trained { start, min, max } = varied.number else { return None };
    Some(TrainedParam::within(varied.index, start, [min, max]))
}
