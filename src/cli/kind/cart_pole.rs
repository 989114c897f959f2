//! Cart-pole in the program.

use super::{Kind, MlpSettings, Network, Visit};
use crate::cli::problem::{Problem, count, finite, positive};
use crate::cli::settings::Settings;
use physgrad::report::{self, Animation};
use physgrad::tasks::{self, CartPoleSystem, LossMode};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// `cart_pole`.
#[derive(Clone, Debug)]
pub struct CartPole;

/// `effects` of cart-pole.
#[derive(Clone, Debug, Default, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct CartPoleEffects {}

/// `loss` of cart-pole.
#[derive(Clone, Copy, Debug, Default, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct CartPoleLoss {
    /// Which states are paid for.
    mode: LossMode,
}

impl Kind for CartPole {
    type System = CartPoleSystem;
    type Effects = CartPoleEffects;
    type Loss = CartPoleLoss;
    type Network = MlpSettings;

    const NAME: &'static str = "cart_pole";
    const ABOUT: &'static str = "swing up any number of poles on one cart";
    const EPOCHS: usize = 1000;
    const HORIZON: usize = 100;

    fn system() -> CartPoleSystem {
        CartPoleSystem { poles: 2, ..CartPoleSystem::default() }
    }

    fn validate(settings: &Settings<Self>) -> Result<(), Problem> {
        let system = &settings.system;
        count("system.poles", system.poles, 1..=1000)?;
        positive("system.cart_mass", system.cart_mass)?;
        positive("system.pole_mass", system.pole_mass)?;
        positive("system.half_length", system.half_length)?;
        positive("system.dt", system.dt)?;
        finite("system.gravity", system.gravity)
    }

    fn visit<V: Visit>(settings: &Settings<Self>, visitor: V) -> V::Out {
        let task = tasks::CartPole { system: settings.system, loss: settings.loss.mode, horizon: settings.horizon };
        settings.policy.visit(task, visitor)
    }

    fn variants() -> Vec<(String, Settings<Self>)> {
        let modes = [(LossMode::Final, "final"), (LossMode::Continuous, "continuous")];
        let variant = |poles: usize, (mode, name): (LossMode, &str)| {
            let mut settings = Settings::<Self>::defaults();
            settings.system.poles = poles;
            settings.loss.mode = mode;
            (format!("{poles} pole{}, {name} loss", if poles == 1 { "" } else { "s" }), settings)
        };
        [1, 2, 4].into_iter().flat_map(|poles| modes.map(|mode| variant(poles, mode))).collect()
    }

    fn dt(settings: &Settings<Self>) -> f64 {
        settings.system.dt
    }

    fn state_names(settings: &Settings<Self>) -> Vec<String> {
        let poles = (1..=settings.system.poles).flat_map(|i| [format!("theta_{i}"), format!("omega_{i}")]);
        ["x".into(), "x_dot".into()].into_iter().chain(poles).collect()
    }

    fn control_names(_settings: &Settings<Self>) -> Vec<String> {
        vec!["force".into()]
    }

    fn animation(settings: &Settings<Self>, states: &[Vec<f64>], controls: &[Vec<f64>]) -> Animation {
        let forces: Vec<f64> = controls.iter().map(|u| u[0]).collect();
        report::cart_pole(states, &forces, settings.system.half_length, settings.system.dt)
    }
}
