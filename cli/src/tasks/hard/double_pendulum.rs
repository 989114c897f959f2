//! Double pendulum: settings, limits and animation.

use crate::operations::trajectory::Trajectory;
use crate::settings::config_error::{ConfigError, finite, positive};
use crate::settings::{Joined, Method};
use crate::tasks::hard::{
    Nothing, Start, Swing, UprightLoss, in_scene, names, upright, validate_upright,
};
use crate::tasks::{Conserved, Settings, TaskSpec};
use physgrad::DynTask;
use physgrad::tasks;
use physgrad_plot::{Animation, Posture, Stage, mechanics};

/// Task `double_pendulum`.
#[derive(Clone, Debug)]
pub struct DoublePendulum;

impl TaskSpec for DoublePendulum {
    type System = Joined<tasks::DoublePendulum, Swing>;
    type Effects = Nothing;
    type Loss = UprightLoss;

    const NAME: &'static str = "double_pendulum";
    const ABOUT: &'static str =
        "swing up a double pendulum, which is chaotic, by a torque on its first joint";
    const EPOCHS: usize = 300;
    fn horizon() -> usize {
        100
    }
    const METHODS: &'static [Method] = &Method::ODE;

    fn system() -> Self::System {
        Joined(tasks::DoublePendulum::default(), Swing::DEFAULT)
    }

    fn validate(settings: &Settings<Self>) -> Result<(), ConfigError> {
        let Joined(tasks::DoublePendulum { masses, lengths, gravity }, swing) = settings.system;
        masses.into_iter().try_for_each(|mass| positive("system.masses", mass))?;
        lengths.into_iter().try_for_each(|length| positive("system.lengths", length))?;
        finite("system.gravity", gravity)?;
        positive("system.dt", swing.dt)?;
        validate_upright(settings)
    }

    fn task(settings: &Settings<Self>) -> DynTask {
        let task = upright(settings, settings.system.0, 0, settings.system.1.start, 30.0);
        in_scene(settings, task)
    }

    fn variants() -> Vec<(String, Settings<Self>)> {
        let mut held = Settings::<Self>::defaults();
        (held.system.1.start, held.loss.control_weight) = (Start::Upright, 1e-3);
        vec![("swung up".into(), Settings::defaults()), ("held".into(), held)]
    }

    fn dt(settings: &Settings<Self>) -> f64 {
        settings.system.1.dt
    }

    fn state_names(_settings: &Settings<Self>) -> Vec<String> {
        names(&["theta_1", "omega_1", "theta_2", "omega_2"])
    }

    fn control_names(_settings: &Settings<Self>) -> Vec<String> {
        names(&["torque"])
    }

    fn conserved(settings: &Settings<Self>) -> Option<Conserved> {
        let body = settings.system.0;
        settings
            .actuator
            .is_empty()
            .then(|| Conserved { name: "energy", value: Box::new(move |x| body.energy(x)) })
    }

    fn animation(settings: &Settings<Self>, Trajectory { states, .. }: &Trajectory) -> Animation {
        let [first, second] = settings.system.0.lengths;
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
        mechanics(&stage, &states.iter().map(posture).collect::<Vec<_>>(), settings.system.1.dt)
    }
}
