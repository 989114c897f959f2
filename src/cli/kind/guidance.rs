//! Guidance by repulsion in the program.

use super::{Info, Kind, MlpSettings, Network, Visit};
use crate::cli::problem::{Problem, allowed, count, finite, positive};
use crate::cli::settings::Settings;
use physgrad::report::{self, Animation};
use physgrad::tasks::{self, GuidanceSystem, LossMode};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// `guidance`.
#[derive(Clone, Debug)]
pub struct Guidance;

/// `effects` of guidance.
#[derive(Clone, Debug, Default, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct GuidanceEffects {}

/// `loss` of guidance.
#[derive(Clone, Copy, Debug, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct GuidanceLoss {
    /// Which states are paid for.
    mode: LossMode,
    /// Price of the mean of squared controls, m² s⁴.
    regularization: f64,
}

impl Default for GuidanceLoss {
    fn default() -> Self {
        let tasks::Guidance { loss, regularization, .. } = tasks::Guidance::new(1, 1);
        Self { mode: loss, regularization }
    }
}

impl Kind for Guidance {
    type System = GuidanceSystem;
    type Effects = GuidanceEffects;
    type Loss = GuidanceLoss;
    type Network = MlpSettings;

    const NAME: &'static str = "guidance";
    const ABOUT: &'static str = "drivers herd evaders, who flee from them, to the origin";
    const EPOCHS: usize = 200;
    const HORIZON: usize = 60;

    const EFFECTS: &'static [Info] = &[];

    fn system() -> GuidanceSystem {
        GuidanceSystem::default()
    }

    fn validate(settings: &Settings<Self>) -> Result<(), Problem> {
        let (system, price) = (&settings.system, settings.loss.regularization);
        count("system.drivers", system.drivers, 1..=1000)?;
        count("system.evaders", system.evaders, 1..=1000)?;
        positive("system.softening", system.softening)?;
        positive("system.dt", system.dt)?;
        finite("system.driver_friction", system.driver_friction)?;
        finite("system.evader_friction", system.evader_friction)?;
        finite("system.driver_repulsion", system.driver_repulsion)?;
        finite("system.flight", system.flight)?;
        finite("system.flocking", system.flocking)?;
        finite("system.flocking_distance", system.flocking_distance)?;
        allowed("loss.regularization", price, price.is_finite() && price >= 0.0, "0 or more")
    }

    fn visit<V: Visit>(settings: &Settings<Self>, visitor: V) -> V::Out {
        let GuidanceLoss { mode: loss, regularization } = settings.loss;
        let task = tasks::Guidance { system: settings.system, loss, regularization, horizon: settings.horizon };
        settings.policy.visit(task, visitor)
    }

    fn variants() -> Vec<(String, Settings<Self>)> {
        let variant = |drivers, evaders, mode| {
            let mut settings = Settings::<Self>::defaults();
            (settings.system.drivers, settings.system.evaders) = (drivers, evaders);
            settings.loss.mode = mode;
            settings
        };
        vec![
            ("1 driver, 1 evader, final loss".into(), variant(1, 1, LossMode::Final)),
            ("2 drivers, 4 evaders, continuous loss".into(), variant(2, 4, LossMode::Continuous)),
        ]
    }

    fn dt(settings: &Settings<Self>) -> f64 {
        settings.system.dt
    }

    fn state_names(settings: &Settings<Self>) -> Vec<String> {
        let drivers = (1..=settings.system.drivers).map(|i| format!("driver_{i}"));
        let evaders = (1..=settings.system.evaders).map(|i| format!("evader_{i}"));
        drivers.chain(evaders).flat_map(|agent| ["x", "y", "vx", "vy"].map(|name| format!("{agent}_{name}"))).collect()
    }

    fn control_names(settings: &Settings<Self>) -> Vec<String> {
        (1..=settings.system.drivers).flat_map(|i| [format!("radial_{i}"), format!("tangential_{i}")]).collect()
    }

    fn animation(settings: &Settings<Self>, states: &[Vec<f64>], _controls: &[Vec<f64>]) -> Animation {
        report::guidance(states, settings.system.drivers, settings.system.dt)
    }
}
