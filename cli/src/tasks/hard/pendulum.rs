//! Pendulum of several arms with friction: settings, limits and animation.

use crate::operations::trajectory::Trajectory;
use crate::settings::config_error::{ConfigError, count, finite, not_negative, positive};
use crate::settings::{Joined, Method};
use crate::tasks::hard::{Nothing, Swing, UprightLoss, in_scene, names, upright, validate_upright};
use crate::tasks::{Conserved, Settings, TaskSpec};
use physgrad::DynTask;
use physgrad::Number;
use physgrad::tasks::{self, MultiPendulum};
use physgrad_plot::{Animation, Posture, Stage, mechanics};

/// Task `pendulum`.
#[derive(Clone, Debug)]
pub struct Pendulum;

impl TaskSpec for Pendulum {
    type System = Joined<MultiPendulum, Swing>;
    type Effects = Nothing;
    type Loss = UprightLoss;

    const NAME: &'static str = "pendulum";
    const ABOUT: &'static str =
        "swing up a pendulum of rigid arms with friction by a torque on its first joint";
    const EPOCHS: usize = 300;
    fn horizon() -> usize {
        100
    }
    const METHODS: &'static [Method] = &Method::ODE;

    fn system() -> Self::System {
        Joined(MultiPendulum::default(), Swing::DEFAULT)
    }

    fn validate(settings: &Settings<Self>) -> Result<(), ConfigError> {
        let Joined(MultiPendulum { arms, gravity }, swing) = &settings.system;
        count("system.arms", arms.len(), 1..=8)?;
        for (i, arm) in arms.iter().enumerate() {
            let tasks::Arm { mass, center, length, inertia, viscous, dry, quadratic } = *arm;
            let key = |name: &str| format!("system.arms[{i}].{name}");
            [("mass", mass), ("center", center)]
                .into_iter()
                .try_for_each(|(name, value)| positive(&key(name), value))?;
            let rest = [
                ("length", length),
                ("inertia", inertia),
                ("viscous", viscous),
                ("dry", dry),
                ("quadratic", quadratic),
            ];
            rest.into_iter().try_for_each(|(name, value)| not_negative(&key(name), value))?;
        }
        finite("system.gravity", *gravity)?;
        positive("system.dt", swing.dt)?;
        validate_upright(settings)
    }

    fn task(settings: &Settings<Self>) -> DynTask {
        let task = upright(settings, settings.system.0.clone(), 0, settings.system.1.start, 1.0);
        in_scene(settings, task)
    }

    fn variants() -> Vec<(String, Settings<Self>)> {
        let mut rubbed = Settings::<Self>::defaults();
        let friction = Number::Uniform { low: 1e-4, high: 2e-4 };
        rubbed
            .system
            .0
            .arms
            .iter_mut()
            .for_each(|arm| (arm.viscous, arm.dry, arm.quadratic) = (friction, friction, friction));
        vec![("two arms".into(), Settings::defaults()), ("drawn friction".into(), rubbed)]
    }

    fn dt(settings: &Settings<Self>) -> f64 {
        settings.system.1.dt
    }

    fn state_names(settings: &Settings<Self>) -> Vec<String> {
        (1..=settings.system.0.arms.len())
            .flat_map(|i| [format!("theta_{i}"), format!("omega_{i}")])
            .collect()
    }

    fn control_names(_settings: &Settings<Self>) -> Vec<String> {
        names(&["torque"])
    }

    fn conserved(settings: &Settings<Self>) -> Option<Conserved> {
        let body = settings.system.0.clone();
        let zero = Number::Fixed(0.0);
        let is_free =
            body.arms.iter().all(|arm| [arm.viscous, arm.dry, arm.quadratic] == [zero; 3]);
        let energy = || Conserved { name: "energy", value: Box::new(move |x| body.energy(x)) };
        (is_free && settings.actuator.is_empty()).then(energy)
    }

    fn animation(settings: &Settings<Self>, Trajectory { states, .. }: &Trajectory) -> Animation {
        let lengths: Vec<f64> = settings
            .system
            .0
            .arms
            .iter()
            .map(|arm| arm.length.nominal().max(arm.center.nominal()))
            .collect();
        let posture = |x: &Vec<f64>| {
            let mut chain = vec![[0.0; 2]];
            for (length, pair) in lengths.iter().zip(x.chunks_exact(2)) {
                let [across, up] = chain[chain.len() - 1];
                chain.push([across + length * pair[0].sin(), up + length * pair[0].cos()]);
            }
            Posture { chain, boxes: Vec::new() }
        };
        let reach: f64 = lengths.iter().sum();
        let stage = Stage {
            title: "Pendulum".into(),
            size: 0.15 * reach,
            floor: None,
            mark: Some([0.0, reach]),
        };
        mechanics(&stage, &states.iter().map(posture).collect::<Vec<_>>(), settings.system.1.dt)
    }
}
