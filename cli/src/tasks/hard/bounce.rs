//! Bouncing ball: settings, limits and animation.

use crate::operations::trajectory::Trajectory;
use crate::settings::config_error::{ConfigError, finite, positive};
use crate::tasks::hard::contact::ContactSettings;
use crate::tasks::hard::{Nothing, in_scene, names, small_step};
use crate::tasks::{Settings, TaskSpec};
use physgrad::DynTask;
use physgrad::tasks::{self, BouncingBall};
use physgrad_plot::{Animation, Posture, Stage, mechanics};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// Task `bounce`.
#[derive(Clone, Debug)]
pub struct Bounce;

/// The `system` section of the bouncing ball.
#[derive(Clone, Copy, Debug, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct BounceSettings {
    /// Mass, kg.
    mass: f64,
    /// Gravitational acceleration, m/s².
    gravity: f64,
    /// Time step, s.
    dt: f64,
    /// Contact with the floor; default restitution 0.8.
    contact: ContactSettings,
}

/// The `loss` section of the bouncing ball.
#[derive(Clone, Copy, Debug, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct BounceLoss {
    /// Target height at the end, m.
    target: f64,
}

impl Default for BounceLoss {
    fn default() -> Self {
        Self { target: tasks::Bounce::default().target }
    }
}

impl TaskSpec for Bounce {
    type System = BounceSettings;
    type Effects = Nothing;
    type Loss = BounceLoss;

    const NAME: &'static str = "bounce";
    const ABOUT: &'static str =
        "bring a bouncing ball to a target height at the final time, by thrust";
    const EPOCHS: usize = 300;
    fn horizon() -> usize {
        100
    }

    fn system() -> BounceSettings {
        let BouncingBall { mass, gravity, dt, contact: _ } = BouncingBall::default();
        BounceSettings { mass, gravity, dt, contact: ContactSettings::DEFAULT }
    }

    fn validate(settings: &Settings<Self>) -> Result<(), ConfigError> {
        let BounceSettings { mass, gravity, dt, contact } = settings.system;
        positive("system.mass", mass)?;
        finite("system.gravity", gravity)?;
        positive("system.dt", dt)?;
        finite("loss.target", settings.loss.target)?;
        contact.validate()
    }

    fn task(settings: &Settings<Self>) -> DynTask {
        let BounceSettings { mass, gravity, dt: _, contact } = settings.system;
        let system =
            BouncingBall { mass, gravity, dt: small_step(settings), contact: contact.contact(0.8) };
        let task =
            tasks::Bounce { system, target: settings.loss.target, horizon: settings.horizon };
        in_scene(settings, task)
    }

    fn variants() -> Vec<(String, Settings<Self>)> {
        let mut soft = Settings::<Self>::defaults();
        (soft.system.contact, soft.integrator.substeps) = (ContactSettings::soft(), Some(10));
        vec![("by time of impact".into(), Settings::defaults()), ("by penalty".into(), soft)]
    }

    fn dt(settings: &Settings<Self>) -> f64 {
        settings.system.dt
    }

    fn state_names(_settings: &Settings<Self>) -> Vec<String> {
        names(&["height", "speed"])
    }

    fn control_names(_settings: &Settings<Self>) -> Vec<String> {
        names(&["thrust"])
    }

    fn animation(settings: &Settings<Self>, Trajectory { states, .. }: &Trajectory) -> Animation {
        let target = settings.loss.target;
        let posture = |x: &Vec<f64>| Posture { chain: vec![[0.0, x[0]]], boxes: Vec::new() };
        let stage = Stage {
            title: "Bouncing ball".into(),
            size: 0.3,
            floor: Some(0.0),
            mark: Some([-0.3, target]),
        };
        mechanics(&stage, &states.iter().map(posture).collect::<Vec<_>>(), settings.system.dt)
    }
}
