//! Tasks that are numerically hard by design. The function `in_scene` adds substeps and actuators
//! of a scene to each task.

mod bounce;
mod contact;
mod double_pendulum;
mod lqr;
mod pendulum;
mod pole_chain;
mod push;
mod slider;

pub use bounce::Bounce;
pub use double_pendulum::DoublePendulum;
pub use lqr::Lqr;
pub use pendulum::Pendulum;
pub use pole_chain::PoleChain;
pub use push::Push;
pub use slider::Slider;

use crate::settings::Info;
use crate::settings::config_error::{ConfigError, not_negative};
use crate::tasks::effects::EffectsSection;
use crate::tasks::{Settings, TaskSpec};
use physgrad::integrator::{AnyIntegrator, RungeKutta};
use physgrad::tasks::{LossMode, Upright};
use physgrad::{DynTask, Integrated, Ode, Task};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use std::f64::consts::PI;

/// Empty section: `effects` of tasks without built-in effects, and `loss` of tasks with a fixed
/// cost.
#[derive(Clone, Copy, Debug, Default, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Nothing {}

impl EffectsSection for Nothing {
    const INFO: &'static [Info] = &[];

    fn validate_values(&self) -> Result<(), ConfigError> {
        Ok(())
    }
}

/// Adds substeps and actuators of a scene to a task whose time step is [`small_step`].
pub(in crate::tasks) fn in_scene<K: TaskSpec>(
    settings: &Settings<K>,
    task: impl Task + 'static,
) -> DynTask {
    let task = DynTask::new(task);
    let system = task.system().clone();
    settings.adapted(task, system)
}

/// Time step of the physics: the control step divided by the number of substeps.
fn small_step<K: TaskSpec>(settings: &Settings<K>) -> f64 {
    K::dt(settings) / settings.integrator.count() as f64
}

/// Owned names of state or control components.
fn names(names: &[&str]) -> Vec<String> {
    names.iter().map(|&name| name.to_owned()).collect()
}

/// The `loss` section of swing-up and balancing tasks.
#[derive(Clone, Copy, Debug, Default, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct UprightLoss {
    /// States that enter the loss.
    mode: LossMode,
    /// Weight of the control cost: adds the mean over time of `control_weight |u|²/2`; default 0.
    #[serde(default)]
    control_weight: f64,
}

/// Settings that swing-up and balancing tasks add to the section `system`.
#[derive(Clone, Copy, Debug, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Swing {
    /// Time step, s.
    dt: f64,
    /// Distribution of initial states.
    start: Start,
}

impl Swing {
    const DEFAULT: Self = Self { dt: 0.01, start: Start::Hanging };
}

/// Distribution of initial states of swing-up and balancing tasks.
#[derive(Clone, Copy, Debug, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
enum Start {
    /// Angles within ±π/6 of hanging; other components within ±π/6 rad/s, m and m/s.
    Hanging,
    /// Angles within ±0.05 rad of upright; other components within ±0.05 rad/s, m and m/s.
    Upright,
}

/// Swing-up or balancing task with the chosen integrator, by default the classical Runge-Kutta
/// method (RK4).
fn upright<K: TaskSpec<Loss = UprightLoss>, O: Ode>(
    settings: &Settings<K>,
    ode: O,
    first_angle: usize,
    start: Start,
    control_bound: f64,
) -> Upright<Integrated<O, AnyIntegrator>> {
    let UprightLoss { mode: loss, control_weight } = settings.loss;
    let default = AnyIntegrator::RungeKutta(RungeKutta::RK4);
    let integrator = settings.integrator.integrator(settings.precision).unwrap_or(default);
    let system = Integrated { ode, integrator, dt: small_step(settings) };
    let (from, spread) = match start {
        Start::Hanging => (PI, PI / 6.0),
        Start::Upright => (0.0, 0.05),
    };
    let horizon = settings.horizon;
    Upright { system, first_angle, from, spread, loss, control_weight, control_bound, horizon }
}

fn validate_upright<K: TaskSpec<Loss = UprightLoss>>(
    settings: &Settings<K>,
) -> Result<(), ConfigError> {
    not_negative("loss.control_weight", settings.loss.control_weight)
}
