//! [`ProgramTask`]: a task of the user, with its fields as settings.

use crate::program::operations::Visit;
use crate::program::operations::trajectory::Trajectory;
use crate::program::settings::config_error::{ConfigError, allowed};
use crate::program::tasks::hard::Nothing;
use crate::program::tasks::{MlpSettings, PolicySpec, SceneEffects, Section, Settings, TaskSpec};
use crate::report::{Animation, Channel, channels_over_time};
use crate::rng::Rng;
use crate::{Actuated, AnyActuator, Cotangent, Cotangents, Inputs, Real, Scalar, Start, Substeps, System, Task};
use std::fmt::{self, Debug};
use std::marker::PhantomData;

/// A task that the program trains, checks, compares and animates.
///
/// The fields of the task are the settings of the section `system` of a scene. They need serde and
/// schemars. `Default` gives their default values. [`program`](crate::program()) has an example.
///
/// Only [`NAME`](ProgramTask::NAME) is required. The other items have these effects:
///
/// - Names of components label tables, CSV files and pictures.
/// - [`refined`](ProgramTask::refined) admits `integrator.substeps` and the command `accuracy`.
/// - [`animation`](ProgramTask::animation) draws a rollout.
pub trait ProgramTask: Task<System: Clone> + Section + Default {
    /// Name of the task in commands and scenes: lower case letters, digits and underscores.
    const NAME: &'static str;
    /// Description in one line.
    const ABOUT: &'static str = "a task of this program";
    /// Default number of epochs.
    const EPOCHS: usize = 300;

    /// Checks the settings. Default: all values are valid.
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
    /// the number `substeps·t + i`. Default: `None`, the time step cannot be changed.
    fn refined(&self, _substeps: usize) -> Option<Self> {
        None
    }
    /// The task with the effects of a scene; `effects.of::<Model>()` lists those of a model. Default:
    /// `None`, the task accepts no effects.
    fn with_effects(&self, _effects: &SceneEffects) -> Option<Self> {
        None
    }
    /// Names of the state components. Default: `x_1`, `x_2`, …
    fn state_names(&self) -> Vec<String> {
        numbered("x", self.system().state_dim())
    }
    /// Names of the control components. Default: `u_1`, `u_2`, …
    fn control_names(&self) -> Vec<String> {
        numbered("u", self.system().control_dim())
    }
    /// Names of the parameters of a rollout. Default: `p_1`, `p_2`, …
    fn param_names(&self) -> Vec<String> {
        numbered("p", self.param_dim())
    }
    /// Animation of one rollout: T + 1 states, T controls and the parameters. Default: states and
    /// controls over time.
    fn animation(&self, states: &[Vec<f64>], controls: &[Vec<f64>], _params: &[f64]) -> Animation {
        let channels = |names: Vec<String>, rows: &[Vec<f64>], color: &'static str| -> Vec<Channel> {
            let values = |i: usize| rows.iter().map(|row| row[i]).collect();
            names.into_iter().enumerate().map(|(i, name)| Channel { name, values: values(i), color }).collect()
        };
        let states = channels(self.state_names(), states, "#0072B2");
        let controls = channels(self.control_names(), controls, "#D55E00");
        channels_over_time(Self::ABOUT, &[states, controls].concat(), self.dt())
    }
}

fn numbered(letter: &str, count: usize) -> Vec<String> {
    (1..=count).map(|i| format!("{letter}_{i}")).collect()
}

/// Entry of a [`ProgramTask`] in the list of tasks.
pub struct Own<T>(PhantomData<fn() -> T>);

impl<T> Own<T> {
    pub const NEW: Self = Self(PhantomData);
}

impl<T> Clone for Own<T> {
    fn clone(&self) -> Self {
        Self::NEW
    }
}

impl<T> Debug for Own<T> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(std::any::type_name::<T>())
    }
}

impl<T: ProgramTask> TaskSpec for Own<T> {
    type System = T;
    type Effects = Nothing;
    type Loss = Nothing;
    type PolicySpec = MlpSettings;

    const NAME: &'static str = T::NAME;
    const ABOUT: &'static str = T::ABOUT;
    const EPOCHS: usize = T::EPOCHS;

    fn horizon() -> usize {
        T::default().horizon()
    }

    fn system() -> T {
        T::default()
    }

    fn validate(settings: &Settings<Self>) -> Result<(), ConfigError> {
        let invalid = |(field, allowed)| ConfigError::new(format!("system.{field}"), format!("is not allowed: choose {allowed}"));
        settings.system.validate().map_err(invalid)?;
        let substeps = settings.integrator.count();
        let refined = substeps == 1 || settings.system.refined(substeps).is_some();
        allowed("integrator.substeps", substeps, refined, "1; for others, implement `ProgramTask::refined`")
    }

    fn validate_own_effects(effects: &SceneEffects) -> Result<(), ConfigError> {
        match effects.first() {
            Some(key) if T::default().with_effects(effects).is_none() => {
                Err(ConfigError::new(key, "has no effect; implement `ProgramTask::with_effects`"))
            }
            _ => Ok(()),
        }
    }

    fn visit<V: Visit>(settings: &Settings<Self>, visitor: V) -> V::Out {
        let task = settings.system.with_effects(&settings.own_effects).unwrap_or_else(|| settings.system.clone());
        let count = settings.integrator.count();
        let refined = if count == 1 { None } else { task.refined(count) };
        let system = Substeps { system: refined.as_ref().unwrap_or(&task).system().clone(), count };
        let states = system.state_dim();
        let system = settings.actuator.wrap(system, task.dt());
        settings.policy.visit(InScene { task, system, states, horizon: settings.horizon }, visitor)
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

    fn param_names(settings: &Settings<Self>) -> Vec<String> {
        settings.system.param_names()
    }

    fn control_names(settings: &Settings<Self>) -> Vec<String> {
        settings.system.control_names()
    }

    fn animation(settings: &Settings<Self>, Trajectory { states, controls, params }: &Trajectory) -> Animation {
        let dim = settings.system.system().state_dim();
        let states: Vec<Vec<f64>> = states.iter().map(|x| x[..dim].to_vec()).collect();
        settings.system.animation(&states, controls, params)
    }
}

/// A task of the user with horizon, substeps and actuators of a scene. The states of actuators
/// follow the `states` components of the task.
#[derive(Clone)]
struct InScene<T: ProgramTask> {
    task: T,
    system: Actuated<Substeps<T::System>, Vec<AnyActuator>>,
    states: usize,
    horizon: usize,
}

impl<T: ProgramTask> InScene<T> {
    /// The inputs of the task.
    #[inline(always)]
    fn inner<'a, R: Scalar>(&self, inputs: Inputs<'a, R>) -> Inputs<'a, R> {
        inputs.with_x(&inputs.x[..self.states])
    }

    /// The cotangents of the inputs of the task.
    #[inline(always)]
    fn inner_cotangents<'a, C>(&self, cotangents: Cotangents<'a, C>) -> Cotangents<'a, C> {
        Cotangents { x: cotangents.x.map(|bar| &mut bar[..self.states]), ..cotangents }
    }
}

impl<T: ProgramTask> Task for InScene<T> {
    type System = Actuated<Substeps<T::System>, Vec<AnyActuator>>;

    fn system(&self) -> &Self::System {
        &self.system
    }

    fn horizon(&self) -> usize {
        self.horizon
    }

    fn param_dim(&self) -> usize {
        self.task.param_dim()
    }

    fn start(&self, rng: &mut Rng, start: Start<'_>) {
        self.task.start(rng, Start { x: &mut start.x[..self.states], p: start.p });
    }

    fn observation_dim(&self) -> Option<usize> {
        self.task.observation_dim()
    }

    #[inline(always)]
    fn observe<R: Scalar>(&self, inputs: Inputs<'_, R>, y: &mut [R]) {
        self.task.observe(self.inner(inputs), y);
    }

    #[inline(always)]
    fn observe_vjp<R: Real, C: Cotangent<R>>(&self, inputs: Inputs<'_, R>, y_bar: &[C], cotangents: Cotangents<'_, C>) {
        self.task.observe_vjp(self.inner(inputs), y_bar, self.inner_cotangents(cotangents));
    }

    #[inline(always)]
    fn running_cost<R: Scalar>(&self, inputs: Inputs<'_, R>, next: &[R]) -> R {
        self.task.running_cost(self.inner(inputs), &next[..self.states])
    }

    #[inline(always)]
    fn running_cost_gradient<R: Real>(
        &self,
        inputs: Inputs<'_, R>,
        next: &[R],
        cotangents: Cotangents<'_, R>,
        next_bar: &mut [R],
    ) {
        let (next, next_bar) = (&next[..self.states], &mut next_bar[..self.states]);
        self.task.running_cost_gradient(self.inner(inputs), next, self.inner_cotangents(cotangents), next_bar);
    }

    #[inline(always)]
    fn terminal_cost<R: Scalar>(&self, x: &[R], p: &[R]) -> R {
        self.task.terminal_cost(&x[..self.states], p)
    }

    #[inline(always)]
    fn terminal_cost_gradient<R: Real>(&self, x: &[R], p: &[R], x_bar: &mut [R], p_bar: Option<&mut [R]>) {
        self.task.terminal_cost_gradient(&x[..self.states], p, &mut x_bar[..self.states], p_bar);
    }
}
