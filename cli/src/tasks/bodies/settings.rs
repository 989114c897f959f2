//! [`BodiesSettings`]: the section `system` of articulated bodies.

use crate::platform::terminal::did_you_mean;
use crate::settings::config_error::{ConfigError, finite, not_negative, one_of, positive};
use physgrad::Number;
use physgrad_bodies::files::FileError;
use physgrad_bodies::model::{Integrator, Model};
use physgrad_bodies::{Bodies, BodiesError, BodiesTask, components, files, models};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use std::collections::{BTreeMap, HashSet};
use std::path::Path;
use std::sync::{Arc, Mutex, PoisonError};

/// Settings that determine a model.
type Source = (String, Method, Contacts, Option<f64>);
/// Numbers by the name of a part of the model, and by their own names.
type Parts = BTreeMap<String, BTreeMap<String, Number>>;

/// The `system` section of articulated bodies.
#[derive(Clone, Debug, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct BodiesSettings {
    /// MJCF or URDF file, relative to the scene; or the name of a model of the program. A run keeps
    /// the text of the file here.
    pub model: String,
    /// Steps of the model per control.
    #[serde(default = "one")]
    pub frames: usize,
    /// Method of the steps of the model.
    #[serde(default)]
    pub method: Method,
    /// Contacts of the file, or softer ones for smooth gradients.
    #[serde(default)]
    pub contacts: Contacts,
    /// Depth in m at which smooth contacts have their full stiffness, and their time constant in s.
    /// Other contacts do not read it. Default: 0.05.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    softness: Option<f64>,
    /// Named pose of the file from which rollouts start. Default: the reference pose.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub pose: Option<String>,
    /// Half widths of uniform noise on initial positions and velocities.
    #[serde(default)]
    pub spread: [f64; 2],
    /// Initial values by name: `qpos.NAME` and `qvel.NAME`. Default: the pose with its spread.
    #[serde(default, skip_serializing_if = "BTreeMap::is_empty")]
    pub start: Parts,
    /// Numbers of bodies: `body.NAME.mass` in kg, `centre_x` to `centre_z` in m, `stretch_x` to
    /// `stretch_z`, `shear_xy`, `shear_xz`, `shear_yz`.
    #[serde(default, skip_serializing_if = "BTreeMap::is_empty")]
    body: Parts,
    /// Numbers of joints: `joint.NAME.damping`, `armature`, `stiffness`, `friction_loss`.
    #[serde(default, skip_serializing_if = "BTreeMap::is_empty")]
    joint: Parts,
    /// Numbers of actuators: `motor.NAME.gear`, `kp`, `kv`.
    #[serde(default, skip_serializing_if = "BTreeMap::is_empty")]
    motor: Parts,
    /// Numbers of shapes: `shape.NAME.friction`.
    #[serde(default, skip_serializing_if = "BTreeMap::is_empty")]
    shape: Parts,
    /// What the policy observes. Default: the state without `hidden`.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub observe: Vec<String>,
    /// Components of the state that the policy does not observe.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    hidden: Vec<String>,
    /// Expressions by name, for use in all other expressions.
    #[serde(default, skip_serializing_if = "BTreeMap::is_empty")]
    pub define: BTreeMap<String, String>,
}

fn one() -> usize {
    1
}

/// Method of the steps of the model.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum Method {
    /// That of the file.
    #[default]
    File,
    /// Semi-implicit Euler method with implicit joint damping.
    Euler,
    /// As `euler`, with implicit velocity feedback of actuators.
    ImplicitFast,
    /// Runge-Kutta method of order 4, at the cost of four steps.
    Rk4,
}

/// Contacts of the file, or softer ones.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum Contacts {
    /// Those of the file.
    #[default]
    File,
    /// Softer ones, whose forces begin without a jump; `softness` sets how soft.
    Smooth,
    /// No contacts.
    None,
}

/// Default softness of smooth contacts. Gradients of half_cheetah over 16 steps agree with those of the
/// mean loss to 1 % with it.
const SOFTNESS: f64 = 0.05;

impl Default for BodiesSettings {
    fn default() -> Self {
        Self {
            model: "half_cheetah".into(),
            frames: 1,
            method: Method::File,
            contacts: Contacts::File,
            softness: None,
            pose: None,
            spread: [0.0; 2],
            start: Parts::new(),
            body: Parts::new(),
            joint: Parts::new(),
            motor: Parts::new(),
            shape: Parts::new(),
            observe: Vec::new(),
            hidden: Vec::new(),
            define: BTreeMap::new(),
        }
    }
}

/// The text that a scene keeps for its setting `model`. A name of a model of the program, and text,
/// stay as they are.
pub fn read_text(model: &str, folder: &Path) -> Result<String, String> {
    if model.trim_start().starts_with('<') || models::text(model).is_some() {
        return Ok(model.to_owned());
    }
    let path = folder.join(model);
    if !path.exists() {
        let names: Vec<&str> = models::names().collect();
        let hint = did_you_mean(model, names.iter().copied());
        return Err(format!(
            "is `{model}`, which is no file in the folder of the scene; models of the program: {}{hint}",
            one_of(&names)
        ));
    }
    let text = files::read(&path).and_then(|_| files::expand(&path));
    text.map_err(|error: FileError| format!("cannot be read: {error}"))
}

impl BodiesSettings {
    /// The model of the text, with the method and the contacts of these settings.
    fn model(&self) -> Result<Model, ConfigError> {
        let known = models::text(&self.model);
        let text = known.unwrap_or(&self.model);
        let name = if known.is_some() { &self.model } else { "the model" };
        let model = files::parse(text, name);
        let mut model = model.map_err(|error| {
            ConfigError::new("system.model", format!("cannot be read: {error}"))
        })?;
        match self.method {
            Method::File => {}
            Method::Euler => model.options.integrator = Integrator::Euler,
            Method::ImplicitFast => model.options.integrator = Integrator::ImplicitFast,
            Method::Rk4 => model.options.integrator = Integrator::Rk4,
        }
        match self.contacts {
            Contacts::File => {}
            Contacts::Smooth => {
                let softness = self.softness.unwrap_or(SOFTNESS);
                model.soften_contacts(softness, softness);
            }
            Contacts::None => model.options.contacts = false,
        }
        Ok(model)
    }

    /// The model of validated settings. The last one is kept.
    pub fn known(&self) -> Arc<Model> {
        static LAST: Mutex<Option<(Source, Arc<Model>)>> = Mutex::new(None);
        let mut last = LAST.lock().unwrap_or_else(PoisonError::into_inner);
        let source = (self.model.clone(), self.method, self.contacts, self.softness);
        if let Some((_, model)) = last.as_ref().filter(|(last, _)| *last == source) {
            return model.clone();
        }
        let model = Arc::new(self.model().expect("validated settings"));
        *last = Some((source, model.clone()));
        model
    }

    /// The task with a step of the model divided into `substeps`.
    pub fn task(&self, substeps: usize, horizon: usize) -> Result<BodiesTask, ConfigError> {
        if let Some(softness) = self.softness {
            positive("system.softness", softness)?;
        }
        let mut model = self.model()?;
        model.options.dt /= substeps as f64;
        check_model(&model)?;
        self.check_numbers()?;
        let bodies = Bodies::with_numbers(model, self.numbers());
        let bodies = bodies.map_err(|error| match error {
            BodiesError::UnknownNumber { name, known } => {
                let hint = did_you_mean(&name, known.iter().map(String::as_str));
                let (part, _) = name.rsplit_once('.').unwrap_or(("", &name));
                let of_part: Vec<&str> = known
                    .iter()
                    .map(String::as_str)
                    .filter(|known| known.starts_with(part))
                    .collect();
                let kind = part.split('.').next().unwrap_or_default();
                let of_kind = || {
                    known
                        .iter()
                        .map(String::as_str)
                        .filter(|known| known.starts_with(kind))
                        .collect()
                };
                let shown = if of_part.is_empty() { of_kind() } else { of_part };
                let what =
                    format!("is not a number of the model; allowed: {}{hint}", one_of(&shown));
                ConfigError::new(format!("system.{name}"), what)
            }
            error => ConfigError::new("system.model", format!("cannot be simulated: {error}")),
        })?;
        let start = self.starts(&bodies)?;
        Ok(BodiesTask::new(bodies, self.frames, start, horizon))
    }

    /// Expressions that the policy observes. Empty: the state.
    pub fn observed(&self, model: &Model) -> Result<Vec<String>, ConfigError> {
        if self.hidden.is_empty() {
            return Ok(self.observe.clone());
        }
        if !self.observe.is_empty() {
            let what = "has no effect: `system.observe` lists what the policy observes";
            return Err(ConfigError::new("system.hidden", what));
        }
        let states = components::states(model);
        if let Some(name) = self.hidden.iter().find(|name| !states.contains(name)) {
            let hint = did_you_mean(name, states.iter().map(String::as_str));
            let states: Vec<&str> = states.iter().map(String::as_str).collect();
            let what =
                format!("has `{name}`, which is no state; states: {}{hint}", one_of(&states));
            return Err(ConfigError::new("system.hidden", what));
        }
        Ok(states.into_iter().filter(|name| !self.hidden.contains(name)).collect())
    }

    /// Refuses numbers that no body has.
    fn check_numbers(&self) -> Result<(), ConfigError> {
        for (name, number) in self.numbers() {
            let key = format!("system.{name}");
            match name.rsplit('.').next() {
                Some("mass" | "stretch_x" | "stretch_y" | "stretch_z") => positive(&key, number)?,
                Some("gear" | "centre_x" | "centre_y" | "centre_z") => finite(&key, number)?,
                Some("shear_xy" | "shear_xz" | "shear_yz") => finite(&key, number)?,
                _ => not_negative(&key, number)?,
            }
        }
        Ok(())
    }

    /// Numbers that the scene sets, with their names in the model.
    fn numbers(&self) -> Vec<(String, Number)> {
        let kinds = [
            ("body", &self.body),
            ("joint", &self.joint),
            ("motor", &self.motor),
            ("shape", &self.shape),
        ];
        let mut all = Vec::new();
        for (kind, parts) in kinds {
            for (part, numbers) in parts {
                all.extend(
                    numbers.iter().map(|(name, &number)| (format!("{kind}.{part}.{name}"), number)),
                );
            }
        }
        all
    }

    /// Copy whose trained numbers begin at these values, by key.
    pub fn with_typical(&self, values: &[(String, f64)]) -> Self {
        let mut copy = self.clone();
        let kinds = [
            ("body", &mut copy.body),
            ("joint", &mut copy.joint),
            ("motor", &mut copy.motor),
            ("shape", &mut copy.shape),
        ];
        for (kind, parts) in kinds {
            for (part, numbers) in parts {
                for (name, number) in numbers {
                    let key = format!("system.{kind}.{part}.{name}");
                    let value = values.iter().find(|(known, _)| *known == key);
                    if let (Number::Trained { start, .. }, Some((_, value))) = (number, value) {
                        *start = *value;
                    }
                }
            }
        }
        copy
    }

    /// Initial numbers of the state components.
    fn starts(&self, bodies: &Bodies) -> Result<Vec<Number>, ConfigError> {
        let model = bodies.model();
        let pose = match &self.pose {
            None => bodies.reference().to_vec(),
            Some(name) => {
                let found = model.poses.iter().find(|(pose, _)| pose == name);
                let names: Vec<&str> = model.poses.iter().map(|(name, _)| name.as_str()).collect();
                let what = || format!("is `{name}`; poses of the model: {}", one_of(&names));
                found.ok_or_else(|| ConfigError::new("system.pose", what()))?.1.clone()
            }
        };
        let around = |middle: f64, half: f64| match half {
            0.0 => Number::Fixed(middle),
            half => Number::Uniform { low: middle - half, high: middle + half },
        };
        let [of_positions, of_velocities] = self.spread;
        let mut all: Vec<Number> = pose.iter().map(|&q| around(q, of_positions)).collect();
        all.resize(pose.len() + bodies.velocities(), around(0.0, of_velocities));
        let names = components::states(model);
        for (list, numbers) in &self.start {
            for (name, &number) in numbers {
                let key = format!("{list}.{name}");
                let Some(index) = names.iter().position(|known| *known == key) else {
                    let hint = did_you_mean(&key, names.iter().map(String::as_str));
                    let names: Vec<&str> = names.iter().map(String::as_str).collect();
                    let what = format!("is no state; states: {}{hint}", one_of(&names));
                    return Err(ConfigError::new(format!("system.start.{key}"), what));
                };
                if matches!(number, Number::Trained { .. } | Number::Noise(_)) {
                    let what = "is trained or noise; allowed: a number or a distribution";
                    return Err(ConfigError::new(format!("system.start.{key}"), what));
                }
                all[index] = number;
            }
        }
        Ok(all)
    }
}

/// Refuses models without controls, and names that expressions cannot tell apart.
fn check_model(model: &Model) -> Result<(), ConfigError> {
    let controls = components::controls(model);
    if controls.is_empty() {
        let what =
            "has no actuator, but a policy needs one; add a motor, which may have the gear 0";
        return Err(ConfigError::new("system.model", what));
    }
    let mut seen = HashSet::new();
    let names = components::states(model).into_iter().chain(controls);
    if let Some(name) = names.into_iter().find(|name| !seen.insert(name.clone())) {
        let what = format!(
            "has two parts with the name `{name}` in expressions, where other characters than letters, digits \
             and `_` become `_`; rename one"
        );
        return Err(ConfigError::new("system.model", what));
    }
    Ok(())
}
