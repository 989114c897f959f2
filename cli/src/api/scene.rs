//! [`Scene`]: task, physics, loss, policy and training.

use super::{Policy, TooLarge, fits};
use crate::commands::accuracy::{Measured, Setting, Study};
use crate::commands::check::about;
use crate::commands::identify::remarks::{CALL, Remarks, remarks};
use crate::operations::checks::Results;
use crate::operations::identification::{MOST_BYTES, bytes_per_fitted_step, bytes_per_step};
use crate::operations::trajectory::Trajectory;
use crate::scenes::presets;
use crate::scenes::source::{SceneSource, find};
use crate::settings::reading::is_drawn;
use crate::settings::{OPTIONAL, Precision, VERSION};
use crate::tasks::{self, ModelParts, scene::INITIAL_POLICY};
use anyhow::{Context, Result, bail};
use physgrad::engine::append_starts;
use physgrad::identify::{Fit, IdentifyError, Options, Segment};
use physgrad::rng::Purpose;
use physgrad::{DynTask, Float, Number, System, Task};
use physgrad_plot::Picture;
use std::ops::Range;
use std::sync::atomic::{AtomicBool, Ordering};
use toml::{Table, Value};

/// Source of settings in messages.
const OPTION: &str = "settings";

/// The dotted key of a setting, for example `system.poles`, and its value. A table changes only its
/// keys. An empty table adds an effect with its default parameters, and is refused for a whole
/// section. None removes an effect or a part of the actuator, as in `effects.bumpers`.
pub type Change = (String, Option<Value>);

/// Results of [`Scene::check`].
pub struct Checked {
    /// All checks.
    pub table: String,
    /// Properties of the scene and its test rollouts, as `physgrad check` prints them.
    pub notes: Vec<String>,
    /// A message per failure.
    pub failures: Vec<String>,
}

/// A validated scene: task, physics, loss, policy and training.
#[derive(Clone)]
pub struct Scene {
    pub(super) source: SceneSource,
    pub(super) scene: tasks::Scene,
}

impl Scene {
    /// Opens the preset or the scene file with this name, with other values of some settings.
    /// Removes effects and parts of the actuator first.
    ///
    /// # Errors
    /// There is no such preset or file. A setting is unknown or out of range. A section is an empty
    /// table. An effect to remove is not present. A run does not fit in the memory of this machine.
    pub fn open(name: &str, changes: impl IntoIterator<Item = Change>) -> Result<Self> {
        Self::changed(presets::source(name)?, changes.into_iter().collect(), None)
    }

    /// A scene of the task with this name, with these settings and the defaults of the task.
    ///
    /// # Errors
    /// Those of [`open`](Self::open).
    pub fn of_task(task: &str, settings: impl IntoIterator<Item = Change>) -> Result<Self> {
        let source = SceneSource::parse(task, &format!("scene = {VERSION}\ntask = {task:?}\n"))?;
        Self::changed(source, settings.into_iter().collect(), None)
    }

    /// The scene of a [`text`](Self::text), with the contents of its initial policy.
    ///
    /// # Errors
    /// Those of [`open`](Self::open).
    pub fn of_text(text: &str, initial_policy: Option<&[u8]>) -> Result<Self> {
        Self::of(SceneSource::parse("the scene", text)?, initial_policy)
    }

    /// All settings as TOML. Equal scenes have equal texts and initial policies.
    pub fn text(&self) -> String {
        self.scene.table().to_string()
    }

    /// Contents of the policy file from which a training starts.
    pub fn initial_policy(&self) -> Option<&[u8]> {
        self.scene.initial_policy()
    }

    /// Copy with other values of some settings, as in [`open`](Self::open).
    ///
    /// # Errors
    /// Those of [`open`](Self::open).
    pub fn with(&self, changes: impl IntoIterator<Item = Change>) -> Result<Self> {
        let settings: Vec<Change> = changes.into_iter().collect();
        // Keeps the contents of the initial policy: its file may have changed or moved.
        let replaced = settings.iter().any(|(key, _)| key == INITIAL_POLICY);
        let policy = self.scene.initial_policy().filter(|_| !replaced);
        Self::changed(self.source.clone(), settings, policy)
    }

    /// Copy with the section `policy` of the scene of this policy.
    ///
    /// # Errors
    /// The section does not suit the task.
    pub fn with_policy(&self, policy: &Policy) -> Result<Self> {
        let section = policy.scene().settings().remove("policy");
        let section = section.context("the scene has no section `policy`")?;
        let mut source = self.source.clone();
        // Another kind of policy has other settings.
        source.without_section("policy");
        let settings = [("policy".to_owned(), Some(section))].into();
        Self::changed(source, settings, self.scene.initial_policy())
    }

    /// Copy without its sensor and the end of its episodes, whose states no measurement contains.
    ///
    /// # Errors
    /// An expression of the scene needs the sensor.
    pub fn without_sensor(&self) -> Result<Self> {
        let mut source = self.source.clone();
        source.make_bare();
        Self::of(source, self.scene.initial_policy())
    }

    /// Copy with another integrator, number of substeps and precision.
    ///
    /// # Errors
    /// The task does not support them.
    pub fn with_setting(&self, setting: &Setting) -> Result<Self> {
        Self::of(setting.source(&self.source)?, self.scene.initial_policy())
    }

    /// Scene of the source with these changes. `policy` is as in [`SceneSource::starting_from`].
    fn changed(
        mut source: SceneSource,
        changes: Vec<Change>,
        policy: Option<&[u8]>,
    ) -> Result<Self> {
        source.begin_changes();
        for (key, _) in changes.iter().filter(|(_, value)| value.is_none()) {
            let option = format!("{OPTION}: `{key}` is None");
            let is_part = |section: &&str| {
                let name = key.strip_prefix(*section).and_then(|rest| rest.strip_prefix('.'));
                name.is_some_and(|name| !name.contains('.'))
            };
            if !OPTIONAL.iter().any(is_part) {
                bail!(
                    "{option}, which removes single effects and parts of the actuator only; give a value"
                );
            }
            let is_inside = |other: &str| {
                other.strip_prefix(key.as_str()).is_some_and(|rest| rest.starts_with('.'))
            };
            if let Some((other, _)) = changes.iter().find(|(other, _)| is_inside(other)) {
                bail!("{option}, but `{other}` has a value; give one of them");
            }
            source.remove(key, &option)?;
        }
        let mut empty = Vec::new();
        for (key, value) in changes {
            let Some(value) = value else { continue };
            if !key.contains('.') && value.as_table().is_some_and(Table::is_empty) {
                empty.push(key.clone());
            }
            source.replace(&key, value, OPTION)?;
        }
        let scene = Self::of(source, policy)?;
        empty.iter().try_for_each(|section| scene.refuse_empty(section))?;
        Ok(scene)
    }

    /// Refuses an empty table for a section that is not empty, which it would leave unchanged.
    fn refuse_empty(&self, section: &str) -> Result<()> {
        let settings = self.settings();
        let keys: Vec<&str> = match settings.get(section).and_then(Value::as_table) {
            Some(table) if table.is_empty() => return Ok(()),
            Some(table) => table.keys().map(String::as_str).collect(),
            None => Vec::new(),
        };
        let rule = match OPTIONAL.contains(&section) {
            _ if keys.is_empty() => "omit it".to_owned(),
            true => format!(
                "a table changes only its keys, and None removes one of {}, as in {{\"{}\": None}}",
                keys.join(", "),
                keys[0]
            ),
            false => format!("a table changes only its keys: {}", keys.join(", ")),
        };
        bail!("{OPTION}: `{section}` is an empty table, which changes nothing; {rule}")
    }

    fn of(source: SceneSource, policy: Option<&[u8]>) -> Result<Self> {
        let scene = source.starting_from(policy)?;
        scene.check_memory()?;
        Ok(Self { source, scene })
    }

    /// Name of the task.
    pub fn name(&self) -> &'static str {
        self.scene.task.name()
    }

    /// All settings, including defaults.
    pub fn settings(&self) -> Table {
        self.scene.table()
    }

    /// Value of the setting with this dotted key, as in `system.arms[0].mass`.
    pub fn setting(&self, key: &str) -> Option<Value> {
        find(&self.scene.table(), key).cloned()
    }

    /// Value of the number with this dotted key: its setting, or that of the model in a file.
    pub fn number(&self, key: &str) -> Option<Value> {
        let of_model = || self.scene.model_numbers().into_iter().find(|(name, _)| name == key);
        self.setting(key).or_else(|| of_model().map(|(_, value)| Value::Float(value)))
    }

    /// The model in a file: names of its parts, and its numbers with their keys and settings.
    pub fn model(&self) -> Option<(ModelParts, Table)> {
        let parts = self.scene.model()?;
        let table = self.scene.table();
        let of_scene = |(key, value): (String, f64)| {
            let value = find(&table, &key).cloned().unwrap_or(Value::Float(value));
            (key, value)
        };
        Some((parts, self.scene.model_numbers().into_iter().map(of_scene).collect()))
    }

    /// Whether the task has a model in a file, whose numbers may be set.
    pub fn has_model_numbers(&self) -> bool {
        !self.scene.model_numbers().is_empty()
    }

    /// The key of a setting, or of a parameter of the equations of a scene: `mu` is short for
    /// `system.parameters.mu`, as is `system.mu`, unless there is such a setting.
    pub fn key(&self, name: String) -> String {
        let short = name.strip_prefix("system.").unwrap_or(&name);
        let long = format!("system.parameters.{short}");
        let is_short = self.setting(&name).is_none() && self.setting(&long).is_some();
        if is_short { long } else { name }
    }

    /// Returns true if the scene computes in f64, and false for f32.
    pub fn is_f64(&self) -> bool {
        self.scene.precision == Precision::F64
    }

    /// The task.
    pub fn task(&self) -> DynTask {
        self.scene.task().clone()
    }

    /// Number of time steps of a rollout.
    pub fn horizon(&self) -> usize {
        self.scene.horizon
    }

    /// Range of each control, None without bounds. A limit replaces the bounds of the task.
    pub fn control_bounds(&self) -> Option<Vec<[f64; 2]>> {
        self.scene.control_bounds()
    }

    /// Time step, in the unit of time of the task: s, except for `quantum`.
    pub fn dt(&self) -> f64 {
        self.scene.dt()
    }

    /// Names of the components of the state.
    pub fn state_names(&self) -> Vec<String> {
        self.scene.state_names()
    }

    /// Names of the components of the control.
    pub fn control_names(&self) -> Vec<String> {
        self.scene.control_names()
    }

    /// Names of the parameters of a rollout.
    pub fn param_names(&self) -> Vec<String> {
        self.scene.param_names()
    }

    /// Names of the components that the policy observes.
    pub fn observation_names(&self) -> Vec<String> {
        self.scene.observation_names()
    }

    /// Appends the initial states of these samples, `[sample][component]`: the state, then the
    /// parameters of the sample. See [`initial_states`](physgrad::initial_states).
    pub fn append_starts<F: Float>(
        &self,
        seed: u64,
        purpose: Purpose,
        samples: Range<usize>,
        starts: &mut Vec<F>,
    ) {
        append_starts(&self.task(), seed, purpose, samples, starts);
    }

    /// Draws the last of these states of an unfinished rollout. `states` and `params` have a row per
    /// state, and `controls` one less; `params` has the noise of each step.
    pub fn picture(
        &self,
        states: Vec<Vec<f64>>,
        controls: Vec<Vec<f64>>,
        params: Vec<Vec<f64>>,
    ) -> Picture {
        let time = controls.len() as f64 * self.dt();
        let mut animation = self.scene.unfinished(&Trajectory { states, controls, params });
        animation.view = animation.reach.unwrap_or(animation.view);
        animation.picture(animation.frames.last().map_or(&[], Vec::as_slice), time)
    }

    /// Fits the trained numbers of the scene to measured segments, as `physgrad identify` does.
    ///
    /// # Errors
    /// [`IdentifyError`], for example if the scene trains no number, the segments do not fit the
    /// system, or a simulation diverges.
    pub fn identify(&self, segments: &[Segment], options: &Options) -> Result<Fit, IdentifyError> {
        if !self.scene.varied().iter().any(|(_, number)| matches!(number, Number::Trained { .. })) {
            return Err(IdentifyError::NothingUnknown);
        }
        self.scene.identify(segments, options)
    }

    /// Fits only the initial states of measured segments, as the validation of `physgrad identify`
    /// does.
    ///
    /// # Errors
    /// Those of [`identify`](Self::identify), without that of a scene that trains no number.
    pub fn fit_starts(
        &self,
        segments: &[Segment],
        options: &Options,
    ) -> Result<Fit, IdentifyError> {
        self.scene.identify(segments, &Options { free_starts: true, ..options.clone() })
    }

    /// Largest number of rows of all segments of [`identify`](Self::identify), which then take 1 GB.
    pub fn most_rows(&self) -> usize {
        let [states, controls, _] = self.dims();
        (MOST_BYTES / bytes_per_step(states, controls)) as usize
    }

    /// Checks that a fit to segments with this number of rows in total fits into memory.
    ///
    /// # Errors
    /// [`TooLarge`].
    pub fn fits_rows(&self, rows: usize) -> Result<(), TooLarge> {
        let [states, controls, _] = self.dims();
        let varied = self.scene.varied();
        let unknowns = varied.iter().filter(|(_, number)| matches!(number, Number::Trained { .. }));
        let bytes = bytes_per_fitted_step(states, controls, unknowns.count());
        fits("the fit", &[rows], bytes as usize)
    }

    /// Sentences about a fit of [`identify`](Self::identify), as `physgrad identify` prints them.
    pub fn remarks(&self, fit: &Fit, segments: &[Segment], noise_is_known: bool) -> Remarks {
        let mut remarks = remarks(fit, &self.scene, segments, segments, noise_is_known, &CALL);
        let fitted = fit.names.iter().map(String::as_str).zip(fit.values.iter().copied());
        // Values of a fit that has not converged have warnings of their own.
        if let (true, Ok(Some(error))) = (fit.converged, self.source.refusal_with(fitted)) {
            remarks.warnings.push(format!(
                "a fitted value is outside of the range of its setting: {error}; give it bounds"
            ));
        }
        remarks
    }

    /// Checks values of the parameters of a rollout, against the ranges of their settings. NaN is a
    /// missing value.
    ///
    /// # Errors
    /// A value is out of range.
    pub fn check_params(&self, p: &[f64]) -> Result<()> {
        let (names, varied) = (self.param_names(), self.scene.varied());
        let is_drawn = |name: &String| {
            let is_this = |(known, number): &&(String, Number)| {
                known == name && !matches!(number, Number::Trained { .. })
            };
            varied.iter().find(is_this).is_some()
        };
        let given = names.iter().zip(p).filter(|(name, value)| !value.is_nan() && is_drawn(name));
        match self.source.refusal_with(given.map(|(name, value)| (&**name, *value)))? {
            Some(error) => bail!("{error}"),
            None => Ok(()),
        }
    }

    /// Drawn parameters of a rollout that the ranges of their settings keep from being negative:
    /// their indices, and whether each may be 0.
    pub fn signed_params(&self) -> Vec<(usize, bool)> {
        let count = self.param_names().len();
        let refuses = |i: usize, value: f64| {
            let mut p = vec![f64::NAN; count];
            p[i] = value;
            self.check_params(&p).is_err()
        };
        let negative = (0..count).filter(|&i| refuses(i, -1.0) && !refuses(i, 1.0));
        negative.map(|i| (i, !refuses(i, 0.0))).collect()
    }

    /// Returns whether the physics depends on the time of a segment. A recording that begins between
    /// two steps, or before the time 0, then has no exact [`Segment::first_step`].
    pub fn depends_on_time(&self, segment: &Segment) -> bool {
        self.scene.depends_on_time(segment)
    }

    /// Errors and costs of all integrators, numbers of substeps and precisions, as `physgrad
    /// accuracy` measures them, in `rounds` rounds of timing. Calls `begin` with a description before
    /// each simulation and timing.
    ///
    /// # Errors
    /// The task does not support other time steps, the reference diverges, or `begin` returns an
    /// error.
    pub fn accuracy(
        &self,
        rounds: usize,
        begin: &mut dyn FnMut(String) -> Result<()>,
    ) -> Result<Measured> {
        let study = Study::new(self.source.clone())?;
        study.measure(study.settings()?, rounds, begin)
    }

    /// Checks the derivatives of system, policy and rollout against dual numbers, as `physgrad
    /// check` does. With a policy, rollouts have its parameters; otherwise random ones, and those of
    /// the notes the initial parameters.
    ///
    /// # Errors
    /// The policy does not fit the scene. `stop` becomes true, which is read before each note.
    pub fn check(&self, policy: Option<&Policy>, stop: &AtomicBool) -> Result<Checked> {
        let mut results = Results::new(false);
        results.begin(self.name());
        let mut notes = Vec::new();
        let mut note = |note: String| {
            if stop.load(Ordering::Relaxed) {
                bail!("the checks were stopped");
            }
            notes.push(note);
            Ok(())
        };
        match policy {
            Some(policy) => {
                policy.check(self)?;
                let scene = self.with_policy(policy)?;
                let (found, expected) =
                    (policy.theta().len(), Policy::new(&scene, 0).theta().len());
                if found != expected {
                    bail!(
                        "the policy has {found} parameters, but {} trains {expected}; create a policy for this task",
                        self.name()
                    );
                }
                scene.scene.check("scene", Some(policy.theta()), &mut results);
                about(&scene.scene, scene.source, policy.theta(), &mut note)?;
            }
            None => {
                self.scene.check("scene", None, &mut results);
                let theta = self.scene.checked_theta()?;
                about(&self.scene, self.source.clone(), &theta, &mut note)?;
            }
        }
        let (table, failures) = results.finish();
        Ok(Checked { table: table.to_string(), notes, failures })
    }

    /// Names of the single numbers of the section `system` and of its model, which a fit may find.
    /// Parameters of equations have their short names.
    pub fn number_names(&self) -> Vec<String> {
        let mut names =
            self.settings().get("system").map_or_else(Vec::new, |system| numbers("system", system));
        for (name, _) in self.scene.model_numbers() {
            if !names.contains(&name) {
                names.push(name);
            }
        }
        let own: Vec<String> = names
            .iter()
            .filter_map(|key| key.strip_prefix("system.parameters.").map(str::to_owned))
            .collect();
        if own.is_empty() { names } else { own }
    }

    /// Numbers of state components, control components and parameters of a sample.
    pub fn dims(&self) -> [usize; 3] {
        let task = self.task();
        [task.system().state_dim(), task.system().control_dim(), task.param_dim()]
    }
}

/// Keys of the single numbers in a value with this key.
fn numbers(key: &str, value: &Value) -> Vec<String> {
    match value {
        Value::Integer(_) | Value::Float(_) => vec![key.to_owned()],
        Value::Table(table) if table.contains_key("start") => vec![key.to_owned()],
        Value::Table(table) if is_drawn(table) => Vec::new(),
        Value::Table(table) => table
            .iter()
            .flat_map(|(name, value)| numbers(&format!("{key}.{name}"), value))
            .collect(),
        Value::Array(list) => {
            let tables = list.iter().enumerate().filter(|(_, value)| value.is_table());
            tables.flat_map(|(i, value)| numbers(&format!("{key}[{i}]"), value)).collect()
        }
        _ => Vec::new(),
    }
}
