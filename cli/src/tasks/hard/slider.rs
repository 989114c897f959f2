//! Block with dry friction: settings, limits and animation.

use crate::operations::trajectory::Trajectory;
use crate::settings::config_error::{ConfigError, not_negative, positive};
use crate::tasks::hard::{Nothing, in_scene, names, small_step};
use crate::tasks::{Settings, TaskSpec};
use physgrad::DynTask;
use physgrad::tasks::{self, FrictionScheme, SliderSystem};
use physgrad_plot::{Animation, Posture, Stage, mechanics};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// Task `slider`.
#[derive(Clone, Debug)]
pub struct Slider;

/// The `loss` section of the block.
#[derive(Clone, Copy, Debug, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct SliderLoss {
    /// Weight of the squared final speed, s².
    speed_weight: f64,
}

impl Default for SliderLoss {
    fn default() -> Self {
        Self { speed_weight: tasks::Slider::default().speed_weight }
    }
}

impl TaskSpec for Slider {
    type System = SliderSystem;
    type Effects = Nothing;
    type Loss = SliderLoss;

    const NAME: &'static str = "slider";
    const ABOUT: &'static str = "stop a block with stiff dry friction at a target position";
    const EPOCHS: usize = 300;
    fn horizon() -> usize {
        100
    }

    fn system() -> SliderSystem {
        SliderSystem::default()
    }

    fn validate(settings: &Settings<Self>) -> Result<(), ConfigError> {
        let SliderSystem { mass, coefficient, smoothing, dt, scheme: _ } = settings.system;
        positive("system.mass", mass)?;
        not_negative("system.coefficient", coefficient)?;
        positive("system.smoothing", smoothing)?;
        positive("system.dt", dt)?;
        not_negative("loss.speed_weight", settings.loss.speed_weight)
    }

    fn task(settings: &Settings<Self>) -> DynTask {
        let task = tasks::Slider {
            system: SliderSystem { dt: small_step(settings), ..settings.system },
            speed_weight: settings.loss.speed_weight,
            horizon: settings.horizon,
        };
        in_scene(settings, task)
    }

    fn variants() -> Vec<(String, Settings<Self>)> {
        let mut explicit = Settings::<Self>::defaults();
        (explicit.system.scheme, explicit.system.smoothing) = (FrictionScheme::Explicit, 0.1);
        vec![("implicit".into(), Settings::defaults()), ("explicit".into(), explicit)]
    }

    fn dt(settings: &Settings<Self>) -> f64 {
        settings.system.dt
    }

    fn state_names(_settings: &Settings<Self>) -> Vec<String> {
        names(&["x", "x_dot"])
    }

    fn control_names(_settings: &Settings<Self>) -> Vec<String> {
        names(&["push"])
    }

    fn animation(settings: &Settings<Self>, Trajectory { states, .. }: &Trajectory) -> Animation {
        let posture = |x: &Vec<f64>| Posture { boxes: vec![[x[0], 0.1]], chain: Vec::new() };
        let stage = Stage {
            title: "A block with dry friction".into(),
            size: 0.2,
            floor: Some(0.0),
            mark: Some([0.0, -0.05]),
        };
        mechanics(&stage, &states.iter().map(posture).collect::<Vec<_>>(), settings.system.dt)
    }
}
