//! Guidance by repulsion in the program.

use super::{MlpSettings, Scene};
use crate::cli::settings::{count, positive};
use anyhow::{Result, bail};
use physgrad::report::{self, Animation};
use physgrad::tasks::{Guidance, GuidanceSystem, LossMode};
use serde::{Deserialize, Serialize};

/// `loss` of guidance.
#[derive(Clone, Copy, Debug, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct GuidanceLoss {
    mode: LossMode,
    regularization: f64,
}

impl Default for GuidanceLoss {
    fn default() -> Self {
        let Guidance { loss, regularization, .. } = Guidance::new(1, 1);
        Self { mode: loss, regularization }
    }
}

impl Scene for Guidance {
    type Setup = GuidanceSystem;
    type Loss = GuidanceLoss;
    type Network = MlpSettings;

    const NAME: &'static str = "guidance";
    const ABOUT: &'static str = "drivers herd evaders, who flee from them, to the origin";
    const EPOCHS: usize = 200;
    const HORIZON: usize = 60;

    fn setup() -> GuidanceSystem {
        GuidanceSystem::default()
    }

    fn validate(system: &GuidanceSystem, loss: &GuidanceLoss) -> Result<()> {
        count("system.drivers", system.drivers, 1..=1000)?;
        count("system.evaders", system.evaders, 1..=1000)?;
        positive("system.softening", system.softening)?;
        positive("system.dt", system.dt)?;
        for (key, value) in [
            ("system.driver_friction", system.driver_friction),
            ("system.evader_friction", system.evader_friction),
            ("system.driver_repulsion", system.driver_repulsion),
            ("system.flight", system.flight),
            ("system.flocking", system.flocking),
            ("system.flocking_distance", system.flocking_distance),
        ] {
            if !value.is_finite() {
                bail!("`{key}` is {value}; allowed: a finite number");
            }
        }
        if !(loss.regularization.is_finite() && loss.regularization >= 0.0) {
            bail!("`loss.regularization` is {}; allowed: 0 or more", loss.regularization);
        }
        Ok(())
    }

    fn build(system: &GuidanceSystem, loss: &GuidanceLoss, horizon: usize) -> Self {
        Self { system: *system, loss: loss.mode, regularization: loss.regularization, horizon }
    }

    fn variants() -> Vec<(String, Self)> {
        let variant = |drivers, evaders, loss| Self { loss, ..Self::new(drivers, evaders) };
        vec![
            ("1 driver, 1 evader, final loss".into(), variant(1, 1, LossMode::Final)),
            ("2 drivers, 4 evaders, continuous loss".into(), variant(2, 4, LossMode::Continuous)),
        ]
    }

    fn dt(&self) -> f64 {
        self.system.dt
    }

    fn state_names(&self) -> Vec<String> {
        let drivers = (1..=self.system.drivers).map(|i| format!("driver_{i}"));
        let evaders = (1..=self.system.evaders).map(|i| format!("evader_{i}"));
        drivers.chain(evaders).flat_map(|agent| ["x", "y", "vx", "vy"].map(|name| format!("{agent}_{name}"))).collect()
    }

    fn control_names(&self) -> Vec<String> {
        (1..=self.system.drivers).flat_map(|i| [format!("radial_{i}"), format!("tangential_{i}")]).collect()
    }

    fn animation(&self, states: &[Vec<f64>], _controls: &[Vec<f64>]) -> Animation {
        report::guidance(states, self.system.drivers, self.system.dt)
    }
}
