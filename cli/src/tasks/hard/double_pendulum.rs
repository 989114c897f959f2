//! Double pendulum: settings, limits and animation.

use crate::operations::trajectory::Trajectory;
use crate::settings::Method;
use crate::settings::config_error::{ConfigError, finite, positive};
use crate::tasks::hard::{Nothing, Start, UprightLoss, in_scene, names, upright, validate_upright};
use crate::tasks::{Conserved, MlpSettings, Settings, TaskSpec};
use physgrad::DynTask;
use physgrad::tasks;
use physgrad_plot::{Animation, Posture, Stage, mechanics};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// Task `double_pendulum`.
#[derive(Clone, Debug)]
pub struct DoublePendulum;

/// The `system` section of the double pendulum.
#[derive(Clone, Copy, Debug, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct DoublePendulumSettings {
    /// Masses at the ends of the two rods, kg.
    masses: [f64; 2],
    /// Lengths of the two rods, m.
    lengths: [f64; 2],
    /// Gravitational acceleration, m/s².
    gravity: f64,
    /// Time step, s.
    dt: f64,
    /// Distribution of initial states.
    start: Start,
}

fn body(settings: &Settings<DoublePendulum>) -> tasks::DoublePendulum {
    let DoublePendulumSettings { masses, lengths, gravity, .. } = settings.system;
    tasks::DoublePendulum { masses, lengths, gravity }
}

impl TaskSpec for DoublePendulum {
    type System = DoublePendulumSettings;
    type Effects = Nothing;
    type Loss = UprightLoss;
    type PolicySpec = MlpSettings;

    const NAME: &'static str = "double_pendulum";
    const ABOUT: &'static str =
        "swing up a double pendulum, which is chaotic, by a torque on its first joint";
    const EPOCHS: usize = 300;
    fn horizon() -> usize {
        100
    }
    const METHODS: &'static [Method] = &Method::ODE;

    fn system() -> DoublePendulumSettings {
        let tasks::DoublePendulum { masses, lengths, gravity } = tasks::DoublePendulum::default();
        DoublePendulumSettings { masses, lengths, gravity, dt: 0.01, start: Start::Hanging }
    }

    fn validate(settings: &Settings<Self>) -> Result<(), ConfigError> {
        let DoublePendulumSettings { masses, lengths, gravity, dt, start: _ } = settings.system;
        masses.into_iter().try_for_each(|mass| positive("system.masses", mass))?;
        lengths.into_iter().try_for_each(|length| positive("system.lengths", length))?;
        finite("system.gravity", gravity)?;
        positive("system.dt", dt)?;
        validate_upright(settings)
    }

    fn task(settings: &Settings<Self>) -> DynTask {
        let task = upright(settings, body(settings), 0, settings.system.start, 30.0);
        in_scene(settings, task)
    }

    fn variants() -> Vec<(String, Settings<Self>)> {
        let mut held = Settings::<Self>::defaults();
        (held.system.start, held.loss.control_weight) = (Start::Upright, 1e-3);
        vec![("swung up".into(), Settings::defaults()), ("held".into(), held)]
    }

    fn dt(settings: &Settings<Self>) -> f64 {
        settings.system.dt
    }

    fn state_names(_settings: &Settings<Self>) -> Vec<String> {
        names(&["theta_1", "omega_1", "theta_2", "omega_2"])
    }

    fn control_names(_settings: &Settings<Self>) -> Vec<String> {
        names(&["torque"])
    }

    fn conserved(settings: &Settings<Self>) -> Option<Conserved> {
        let body = body(settings);
        settings
            .actuator
            .is_empty()
            .then(|| Conserved { name: "energy", value: Box::new(move |x| body.energy(x)) })
    }

    fn animation(settings: &Settings<Self>, Trajectory { states, .. }: &Trajectory) -> Animation {
        let [first, second] = settings.system.lengths;
        let posture = |x: &Vec<f64>| {
            let elbow = [first * x[0].sin(), first * x[0].cos()];
            let tip = [elbow[0] + second * x[2].sin(), elbow[1] + second * x[2].cos()];
            Posture { chain: vec![[0.0; 2], elbow, tip], boxes: Vec::new() }
        };
        let stage = Stage {
            title: "Double pendulum".into(),
            size: 0.15 * (first + second),
            floor: None,
            mark: Some([0.0, first + second]),
        };
        mechanics(&stage, &states.iter().map(posture).collect::<Vec<_>>(), settings.system.dt)
    }
}
