//! Cart-pole in the program.

use super::{MlpSettings, Scene};
use crate::cli::settings::{count, positive};
use anyhow::{Result, bail};
use physgrad::report::{self, Animation};
use physgrad::tasks::{CartPole, CartPoleSystem, LossMode};
use serde::{Deserialize, Serialize};

/// `loss` of cart-pole.
#[derive(Clone, Copy, Debug, Default, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct CartPoleLoss {
    mode: LossMode,
}

impl Scene for CartPole {
    type Setup = CartPoleSystem;
    type Loss = CartPoleLoss;
    type Network = MlpSettings;

    const NAME: &'static str = "cart_pole";
    const ABOUT: &'static str = "swing up any number of poles on one cart";
    const EPOCHS: usize = 1000;
    const HORIZON: usize = 100;

    fn setup() -> CartPoleSystem {
        CartPoleSystem { poles: 2, ..CartPoleSystem::default() }
    }

    fn validate(system: &CartPoleSystem, _loss: &CartPoleLoss) -> Result<()> {
        count("system.poles", system.poles, 1..=1000)?;
        positive("system.cart_mass", system.cart_mass)?;
        positive("system.pole_mass", system.pole_mass)?;
        positive("system.half_length", system.half_length)?;
        positive("system.dt", system.dt)?;
        if !system.gravity.is_finite() {
            bail!("`system.gravity` is {}; allowed: a finite number", system.gravity);
        }
        Ok(())
    }

    fn build(system: &CartPoleSystem, loss: &CartPoleLoss, horizon: usize) -> Self {
        Self { system: *system, loss: loss.mode, horizon }
    }

    fn variants() -> Vec<(String, Self)> {
        let modes = [(LossMode::Final, "final"), (LossMode::Continuous, "continuous")];
        let variant = |poles: usize, (loss, name): (LossMode, &str)| {
            (format!("{poles} pole{}, {name} loss", if poles == 1 { "" } else { "s" }), Self { loss, ..Self::new(poles) })
        };
        [1, 2, 4].into_iter().flat_map(|poles| modes.map(|mode| variant(poles, mode))).collect()
    }

    fn dt(&self) -> f64 {
        self.system.dt
    }

    fn state_names(&self) -> Vec<String> {
        let poles = (1..=self.system.poles).flat_map(|i| [format!("theta_{i}"), format!("omega_{i}")]);
        ["x".into(), "x_dot".into()].into_iter().chain(poles).collect()
    }

    fn control_names(&self) -> Vec<String> {
        vec!["force".into()]
    }

    fn animation(&self, states: &[Vec<f64>], controls: &[Vec<f64>]) -> Animation {
        let forces: Vec<f64> = controls.iter().map(|u| u[0]).collect();
        report::cart_pole(states, &forces, self.system.half_length, self.system.dt)
    }
}
