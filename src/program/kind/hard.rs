//! Tasks that are hard on purpose, in the program. All of them are one type, so they are compiled once.

mod bounce;
mod contact;
mod double_pendulum;
mod lqr;
mod pole_chain;
mod push;
mod slider;

pub use bounce::Bounce;
pub use double_pendulum::DoublePendulum;
pub use lqr::Lqr;
pub use pole_chain::PoleChain;
pub use push::Push;
pub use slider::Slider;

use super::{Kind, MlpSettings, Network, Visit};
use crate::program::problem::{Problem, not_negative};
use crate::program::settings::Settings;
use physgrad::tasks::{AnyHard, Hard, LossMode, Upright};
use physgrad::{AnyIntegrator, Integrated, Ode, RungeKutta, Substeps};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use std::f64::consts::PI;

/// `effects` of a task that has none, and `loss` of one whose costs are fixed.
#[derive(Clone, Copy, Debug, Default, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Nothing {}

/// Hands over the task behind its actuator.
fn visit<K: Kind<Network = MlpSettings>, V: Visit>(settings: &Settings<K>, task: AnyHard, visitor: V) -> V::Out {
    let system = Substeps { system: task, count: settings.integrator.count() };
    let system = settings.actuator.around(system, K::dt(settings));
    settings.policy.visit(Hard { system }, visitor)
}

/// The time step of the physics, of which there are several in one of the policy.
fn small_step<K: Kind>(settings: &Settings<K>) -> f64 {
    K::dt(settings) / settings.integrator.count() as f64
}

/// Names of state components.
fn names(names: &[&str]) -> Vec<String> {
    names.iter().map(|&name| name.to_owned()).collect()
}

/// `loss` of what is to be upright.
#[derive(Clone, Copy, Debug, Default, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct UprightLoss {
    /// Which states are paid for.
    mode: LossMode,
    /// What control costs: the mean over time of `effort |u|²/2` is added. 0 without it.
    #[serde(default)]
    effort: f64,
}

/// Where what is to be upright starts.
#[derive(Clone, Copy, Debug, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
enum Start {
    /// Within ±π/6 of hanging, at up to as many rad/s and m/s.
    Hanging,
    /// Within ±0.05 of upright.
    Upright,
}

/// The task of swinging it up or holding it, in steps of the method asked for or the classical one of Runge and Kutta.
fn upright<K: Kind<Loss = UprightLoss>, O: Ode>(
    settings: &Settings<K>,
    ode: O,
    first_angle: usize,
    start: Start,
) -> Upright<Integrated<O, AnyIntegrator>> {
    let UprightLoss { mode: loss, effort } = settings.loss;
    let usual = AnyIntegrator::RungeKutta(RungeKutta::RK4);
    let integrator = settings.integrator.integrator(settings.precision).unwrap_or(usual);
    let system = Integrated { ode, integrator, dt: small_step(settings) };
    let (from, spread) = match start {
        Start::Hanging => (PI, PI / 6.0),
        Start::Upright => (0.0, 0.05),
    };
    Upright { system, first_angle, from, spread, loss, effort, horizon: settings.horizon }
}

fn validate_upright<K: Kind<Loss = UprightLoss>>(settings: &Settings<K>) -> Result<(), Problem> {
    not_negative("loss.effort", settings.loss.effort)
}
