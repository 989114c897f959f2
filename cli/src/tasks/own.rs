//! [`ProgramTask`]: a task of the user, with its fields as settings.

use crate::operations::trajectory::Trajectory;
use crate::settings::config_error::{ConfigError, allowed};
use crate::tasks::hard::Nothing;
use crate::tasks::own_numbers::Owner;
use crate::tasks::{SceneEffects, Section, Settings, TaskSpec};
use physgrad::{DynSystem, DynTask, System, Task};
use physgrad_plot::{Animation, Channel, channels_over_time};
use toml::Table;

/// A task that the program trains, checks, compares and animates.
///
/// The fields of the task are the settings of the section `system` of a scene. The task derives
/// traits of serde and schemars. `Default` gives the default values of the settings.
/// [`program`](crate::program()) has an example.
///
/// Only [`NAME`](ProgramTask::NAME) is required. Several of the other items extend the program:
///
/// - Names of components label tables, CSV files and pictures.
/// - [`refined`](ProgramTask::refined) admits `integrator.substeps` and the command `accuracy`.
/// - [`animation`](ProgramTask::animation) draws a rollout.
pub trait ProgramTask: Task + Section + Default {
    /// Name of the task in commands and scenes: lower case letters, digits and underscores.
    const NAME: &'static str;
    /// Description in one line.
    const ABOUT: &'static str = "a task of this program";
    /// Default number of epochs.
    const EPOCHS: usize = 300;

    /// Checks the settings. Default: all values are valid.
    ///
    /// Bound fields that determine sizes, such as a number of cells. After this check, other
    /// methods may allocate as many numbers.
    ///
    /// # Errors
    /// The name of a field and its allowed values, for instance `("mass", "a positive number")`.
    fn validate(&self) -> Result<(), (&'static str, &'static str)> {
        Ok(())
    }
    /// Time step in seconds. Default: 1.
    fn dt(&self) -> f64 {
        1.0
    }
    /// The task with a time step that is shorter by the factor `substeps`. Substep i of step t has
    /// the step number `substeps·t + i`. Default: `None`, the time step cannot be changed.
    fn refined(&self, _substeps: usize) -> Option<Self> {
        None
    }
    /// The task with the effects of a scene. `effects.of::<Model>()` lists the effects of a model.
    /// Default: `None`, the task accepts no effects.
    fn with_effects(&self, _effects: &SceneEffects) -> Option<Self> {
        None
    }
    /// Names of the state components. Default: `x_1`, `x_2`, …
    fn state_names(&self) -> Vec<String> {
        numbered("x", self.system().state_dim())
    }
    /// Indices of the state components that are angles in rad. `identify` compares them modulo 2π
    /// if they wrap in the data, and if a step commutes with a full turn. Default: none.
    fn angles(&self) -> Vec<usize> {
        Vec::new()
    }
    /// Names of the control components. Default: `u_1`, `u_2`, …
    fn control_names(&self) -> Vec<String> {
        numbered("u", self.system().control_dim())
    }
    /// Names of the parameters of a rollout that are not drawn or trained numbers, in order. The
    /// program ignores further names. Default: `p_1`, `p_2`, …
    fn param_names(&self) -> Vec<String> {
        numbered("p", self.param_dim())
    }
    /// Animation of one rollout of T steps: T + 1 states, T controls and the parameters, those
    /// of the first step if there is noise. Default:
    /// states and controls over time. If `Animation::time` is positive and `channels` is empty, the
    /// program adds the controls as channels.
    fn animation(&self, states: &[Vec<f64>], controls: &[Vec<f64>], _params: &[f64]) -> Animation {
        let states = Channel::columns(self.state_names(), states, "#0072B2");
        let controls = Channel::columns(self.control_names(), controls, "#D55E00");
        channels_over_time(Self::ABOUT, &[states, controls].concat(), self.dt())
    }
}

fn numbered(letter: &str, count: usize) -> Vec<String> {
    (1..=count).map(|i| format!("{letter}_{i}")).collect()
}

/// The task with the effects of the scene, and its physics with the time step of a substep.
fn physics<T: ProgramTask>(settings: &Settings<T>) -> Result<(DynTask, DynSystem), ConfigError> {
    let task = match settings.own_effects.first() {
        None => settings.system.clone(),
        Some(key) => settings.system.with_effects(&settings.own_effects).ok_or_else(|| {
            ConfigError::new(key, "has no effect; implement `ProgramTask::with_effects`")
        })?,
    };
    if let Some(key) = settings.own_effects.unused() {
        return Err(ConfigError::new(
            key,
            "has another model than those that `ProgramTask::with_effects` lists",
        ));
    }
    let substeps = settings.integrator.count();
    let refined = if substeps == 1 { Some(task.clone()) } else { task.refined(substeps) };
    let what = "1; for others, implement `ProgramTask::refined`";
    allowed("integrator.substeps", substeps, refined.is_some(), what)?;
    let (task, refined) = (DynTask::new(task), refined.map(DynTask::new));
    let system = refined.as_ref().unwrap_or(&task).system().clone();
    Ok((task, system))
}
impl<T: ProgramTask> TaskSpec for T {
    type System = T;
    type Effects = Nothing;
    type Loss = Nothing;

    const NAME: &'static str = <T as ProgramTask>::NAME;
    const ABOUT: &'static str = <T as ProgramTask>::ABOUT;
    const EPOCHS: usize = <T as ProgramTask>::EPOCHS;

    fn horizon() -> usize {
        T::default().horizon()
    }

    fn system() -> T {
        T::default()
    }

    fn validate(settings: &Settings<Self>) -> Result<(), ConfigError> {
        let system = Table::try_from(&settings.system).expect("settings are plain tables");
        let invalid = |(field, allowed)| {
            ConfigError::invalid(&format!("system.{field}"), system.get(field), allowed)
        };
        settings.system.validate().map_err(invalid)?;
        let (task, dims) = (&settings.system, settings.system.system());
        for (method, found, expected) in [
            ("state_names", task.state_names().len(), dims.state_dim()),
            ("control_names", task.control_names().len(), dims.control_dim()),
        ] {
            if found != expected {
                let what = format!(
                    "has {found} names in `ProgramTask::{method}` for {expected} components; name each component"
                );
                return Err(ConfigError::new("task", what));
            }
        }
        if let Some(angle) = task.angles().into_iter().find(|&angle| angle >= dims.state_dim()) {
            let what = format!(
                "has the angle {angle} in `ProgramTask::angles`, but the state has {}",
                dims.state_dim()
            );
            return Err(ConfigError::new("task", what + " components; count from 0"));
        }
        let owner = Owner { section: "system", method: "System::numbers" };
        owner.check_numbers(&system, dims.numbers(), &dims.varied(dims.param_dim()))?;
        for (method, names) in
            [("state_names", task.state_names()), ("control_names", task.control_names())]
        {
            if let Some(name) =
                (1..names.len()).find(|&i| names[..i].contains(&names[i])).map(|i| &names[i])
            {
                return Err(ConfigError::new(
                    "task",
                    format!(
                        "has two components `{name}` in `ProgramTask::{method}`; name each once"
                    ),
                ));
            }
        }
        // The default of the setting is the horizon of the default task.
        let (own, default) = (task.horizon(), T::default().horizon());
        if own != default && settings.horizon == default {
            let what = format!(
                "is {}, but the task has {own} steps with these settings; set it to {own}",
                settings.horizon
            );
            return Err(ConfigError::new("horizon", what));
        }
        physics(settings).map(drop)
    }

    fn validate_own_effects(_effects: &SceneEffects) -> Result<(), ConfigError> {
        // `validate` checks the effects, because the check needs the settings.
        Ok(())
    }

    fn task(settings: &Settings<Self>) -> DynTask {
        let (task, system) = physics(settings).expect("validated settings");
        settings.adapted(task, system)
    }

    fn variants() -> Vec<(String, Settings<Self>)> {
        vec![("default settings".into(), Settings::defaults())]
    }

    fn dt(settings: &Settings<Self>) -> f64 {
        settings.system.dt()
    }

    fn state_names(settings: &Settings<Self>) -> Vec<String> {
        settings.system.state_names()
    }

    fn angles(settings: &Settings<Self>) -> Vec<usize> {
        settings.system.angles()
    }

    fn param_names(settings: &Settings<Self>) -> Vec<String> {
        settings.system.param_names()
    }

    fn control_names(settings: &Settings<Self>) -> Vec<String> {
        settings.system.control_names()
    }

    fn animation(
        settings: &Settings<Self>,
        Trajectory { states, controls, params }: &Trajectory,
    ) -> Animation {
        let dim = settings.system.system().state_dim();
        let states: Vec<Vec<f64>> = states.iter().map(|x| x[..dim].to_vec()).collect();
        settings.system.animation(&states, controls, &params[0])
    }
}
