//! Linear-quadratic regulator: settings, limits and animation.

use crate::operations::trajectory::Trajectory;
use crate::settings::config_error::{ConfigError, allowed, positive};
use crate::tasks::hard::{Nothing, in_scene, names};
use crate::tasks::{Settings, TaskSpec};
use physgrad::DynTask;
use physgrad::tasks::{self, CartPoleSystem};
use physgrad_plot::{Animation, Posture, Stage, mechanics};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// Task `lqr`.
#[derive(Clone, Debug)]
pub struct Lqr;

/// The `system` section of the regulator.
#[derive(Clone, Copy, Debug, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct LqrSettings {
    /// Linear plant with its quadratic cost.
    plant: Plant,
    /// Half-width of the interval around 0 for each component of the initial state.
    spread: f64,
}

/// Linear plant with its quadratic cost.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
enum Plant {
    /// Mass on a damped spring: stable.
    Spring,
    /// Cart with an upright pole, linearized: unstable.
    UprightCartPole,
}

impl TaskSpec for Lqr {
    type System = LqrSettings;
    type Effects = Nothing;
    type Loss = Nothing;

    const NAME: &'static str = "lqr";
    const ABOUT: &'static str =
        "regulate a linear plant to rest, with a quadratic cost of known minimum";
    const EPOCHS: usize = 300;
    fn horizon() -> usize {
        100
    }

    fn system() -> LqrSettings {
        LqrSettings { plant: Plant::Spring, spread: 1.0 }
    }

    fn validate(settings: &Settings<Self>) -> Result<(), ConfigError> {
        positive("system.spread", settings.system.spread)?;
        let substeps = settings.integrator.count();
        allowed(
            "integrator.substeps",
            substeps,
            substeps == 1,
            "1, because a linear plant is discrete in time",
        )
    }

    fn task(settings: &Settings<Self>) -> DynTask {
        let LqrSettings { plant, spread } = settings.system;
        let mut lqr = match plant {
            Plant::Spring => tasks::Lqr::spring(),
            Plant::UprightCartPole => tasks::Lqr::upright_cart_pole(),
        };
        (lqr.spread, lqr.horizon) = (spread, settings.horizon);
        in_scene(settings, lqr)
    }

    fn variants() -> Vec<(String, Settings<Self>)> {
        let of = |plant: Plant, name: &str| {
            let mut settings = Settings::<Self>::defaults();
            settings.system.plant = plant;
            (name.to_owned(), settings)
        };
        vec![of(Plant::Spring, "spring"), of(Plant::UprightCartPole, "upright cart-pole")]
    }

    fn dt(settings: &Settings<Self>) -> f64 {
        match settings.system.plant {
            Plant::Spring => 0.1,
            Plant::UprightCartPole => CartPoleSystem::default().dt,
        }
    }

    fn state_names(settings: &Settings<Self>) -> Vec<String> {
        match settings.system.plant {
            Plant::Spring => names(&["x", "x_dot"]),
            Plant::UprightCartPole => names(&["x", "x_dot", "theta_1", "omega_1"]),
        }
    }

    fn control_names(_settings: &Settings<Self>) -> Vec<String> {
        names(&["force"])
    }

    fn animation(settings: &Settings<Self>, Trajectory { states, .. }: &Trajectory) -> Animation {
        let length = 2.0 * CartPoleSystem::default().half_length.nominal();
        let posture = |x: &Vec<f64>| {
            let cart = [x[0], 0.0];
            let chain = match settings.system.plant {
                Plant::Spring => Vec::new(),
                // Draws the tip at the angle of the linear model, which may be arbitrarily large.
                Plant::UprightCartPole => {
                    vec![cart, [x[0] + length * x[2].sin(), length * x[2].cos()]]
                }
            };
            Posture { chain, boxes: vec![cart] }
        };
        let title = match settings.system.plant {
            Plant::Spring => "A mass on a spring",
            Plant::UprightCartPole => "A cart with an upright pole, linearized",
        };
        let stage =
            Stage { title: title.into(), size: 0.2, floor: Some(-0.1), mark: Some([0.0, -0.1]) };
        mechanics(&stage, &states.iter().map(posture).collect::<Vec<_>>(), Self::dt(settings))
    }
}
