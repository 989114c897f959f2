//! Hard contacts in the program: a ball on a floor, a pusher and a box.

use super::{Nothing, names, small_step, visit};
use crate::cli::kind::{Info, Kind, MlpSettings, Visit};
use crate::cli::problem::{Problem, allowed, finite, not_negative, positive};
use crate::cli::settings::{Method, Settings};
use physgrad::report::{Animation, Posture, Stage, mechanics};
use physgrad::tasks::{self, AnyHard, BouncingBall, Contact, TwoBodies};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// `bounce`.
#[derive(Clone, Debug)]
pub struct Bounce;

/// `push`.
#[derive(Clone, Debug)]
pub struct Push;

/// What happens where two bodies touch.
#[derive(Clone, Copy, Debug, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
struct ContactSettings {
    /// By the instant of the impact, or by a spring.
    model: Model,
    /// Of `time_of_impact`: the share of the speed that is left, 0 to 1.
    #[serde(skip_serializing_if = "Option::is_none")]
    restitution: Option<f64>,
    /// Of `penalty`: N/m.
    #[serde(skip_serializing_if = "Option::is_none")]
    stiffness: Option<f64>,
    /// Of `penalty`: s/m.
    #[serde(skip_serializing_if = "Option::is_none")]
    damping: Option<f64>,
}

/// A model of contacts.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
enum Model {
    /// The instant is found within the step: exact, derivatives included.
    TimeOfImpact,
    /// A spring and a damper: derivatives are not those of an impact.
    Penalty,
}

impl ContactSettings {
    const USUAL: Self = Self { model: Model::TimeOfImpact, restitution: None, stiffness: None, damping: None };

    fn validate(&self) -> Result<(), Problem> {
        let Self { model, restitution, stiffness, damping } = *self;
        let unread = |key: &str, value: Option<f64>, of: Model| match value {
            Some(value) if model != of => {
                let name = if of == Model::Penalty { "penalty" } else { "time_of_impact" };
                Err(Problem::unread(&format!("system.contact.{key}"), value, &format!("`system.contact.model` is not {name}")))
            }
            _ => Ok(()),
        };
        unread("restitution", restitution, Model::TimeOfImpact)?;
        unread("stiffness", stiffness, Model::Penalty)?;
        unread("damping", damping, Model::Penalty)?;
        let share = restitution.unwrap_or(0.0);
        allowed("system.contact.restitution", share, (0.0..=1.0).contains(&share), "0 to 1")?;
        positive("system.contact.stiffness", stiffness.unwrap_or(1.0))?;
        not_negative("system.contact.damping", damping.unwrap_or(0.0))
    }

    /// With this restitution, if none is given.
    fn contact(&self, restitution: f64) -> Contact {
        match self.model {
            Model::TimeOfImpact => Contact::TimeOfImpact { restitution: self.restitution.unwrap_or(restitution) },
            Model::Penalty => Contact::Penalty { stiffness: self.stiffness.unwrap_or(1e4), damping: self.damping.unwrap_or(0.0) },
        }
    }

    /// By a spring that substeps of 1 ms resolve.
    fn soft() -> Self {
        Self { model: Model::Penalty, stiffness: Some(1e4), ..Self::USUAL }
    }
}

/// `system` of the ball.
#[derive(Clone, Copy, Debug, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct BounceSettings {
    /// Mass, kg.
    mass: f64,
    /// Gravity, m/s².
    gravity: f64,
    /// Time step, s.
    dt: f64,
    /// What the floor does; a restitution of 0.8 without it.
    contact: ContactSettings,
}

/// `loss` of the ball.
#[derive(Clone, Copy, Debug, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct BounceLoss {
    /// The height to be at, at the end, m.
    target: f64,
}

impl Default for BounceLoss {
    fn default() -> Self {
        Self { target: tasks::Bounce::default().target }
    }
}

impl Kind for Bounce {
    type System = BounceSettings;
    type Effects = Nothing;
    type Loss = BounceLoss;
    type Network = MlpSettings;

    const NAME: &'static str = "bounce";
    const ABOUT: &'static str = "have a bouncing ball at a height at the end, by thrust";
    const EPOCHS: usize = 300;
    const HORIZON: usize = 100;
    const METHODS: &'static [Method] = &[];
    const EFFECTS: &'static [Info] = &[];

    fn system() -> BounceSettings {
        let BouncingBall { mass, gravity, dt, contact: _ } = BouncingBall::default();
        BounceSettings { mass, gravity, dt, contact: ContactSettings::USUAL }
    }

    fn validate(settings: &Settings<Self>) -> Result<(), Problem> {
        let BounceSettings { mass, gravity, dt, contact } = settings.system;
        positive("system.mass", mass)?;
        finite("system.gravity", gravity)?;
        positive("system.dt", dt)?;
        finite("loss.target", settings.loss.target)?;
        contact.validate()
    }

    fn visit<V: Visit>(settings: &Settings<Self>, visitor: V) -> V::Out {
        let BounceSettings { mass, gravity, dt: _, contact } = settings.system;
        let system = BouncingBall { mass, gravity, dt: small_step(settings), contact: contact.contact(0.8) };
        let task = tasks::Bounce { system, target: settings.loss.target, horizon: settings.horizon };
        visit(settings, AnyHard::Bounce(task), visitor)
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

    fn animation(settings: &Settings<Self>, states: &[Vec<f64>], _controls: &[Vec<f64>]) -> Animation {
        let target = settings.loss.target;
        let posture = |x: &Vec<f64>| Posture { chain: vec![[0.0, x[0]]], boxes: Vec::new() };
        let stage = Stage { title: "Bouncing ball".into(), size: 0.3, floor: Some(0.0), mark: Some([-0.3, target]) };
        mechanics(&stage, &states.iter().map(posture).collect::<Vec<_>>(), settings.system.dt)
    }
}

/// `system` of pusher and box.
#[derive(Clone, Copy, Debug, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct PushSettings {
    /// Masses of pusher and box, kg.
    masses: [f64; 2],
    /// The distance of their middles when they touch, m.
    reach: f64,
    /// Time step, s.
    dt: f64,
    /// What they do then; without it, they stay together.
    contact: ContactSettings,
}

impl Kind for Push {
    type System = PushSettings;
    type Effects = Nothing;
    type Loss = Nothing;
    type Network = MlpSettings;

    const NAME: &'static str = "push";
    const ABOUT: &'static str = "push a box to a place that only contact can bring it to";
    const EPOCHS: usize = 300;
    const HORIZON: usize = 100;
    const METHODS: &'static [Method] = &[];
    const EFFECTS: &'static [Info] = &[];

    fn system() -> PushSettings {
        let TwoBodies { masses, reach, dt, contact: _ } = TwoBodies::pusher();
        PushSettings { masses, reach, dt, contact: ContactSettings::USUAL }
    }

    fn validate(settings: &Settings<Self>) -> Result<(), Problem> {
        let PushSettings { masses, reach, dt, contact } = settings.system;
        masses.into_iter().try_for_each(|mass| positive("system.masses", mass))?;
        positive("system.reach", reach)?;
        positive("system.dt", dt)?;
        contact.validate()
    }

    fn visit<V: Visit>(settings: &Settings<Self>, visitor: V) -> V::Out {
        let PushSettings { masses, reach, dt: _, contact } = settings.system;
        let system = TwoBodies { masses, reach, dt: small_step(settings), contact: contact.contact(0.0) };
        visit(settings, AnyHard::Push(tasks::Push { system, horizon: settings.horizon }), visitor)
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
        names(&["pusher", "box", "pusher_dot", "box_dot"])
    }

    fn control_names(_settings: &Settings<Self>) -> Vec<String> {
        names(&["push"])
    }

    fn animation(settings: &Settings<Self>, states: &[Vec<f64>], _controls: &[Vec<f64>]) -> Animation {
        let PushSettings { reach, dt, .. } = settings.system;
        let height = 0.5 * reach;
        let posture = |x: &Vec<f64>| Posture { boxes: vec![[x[0], height], [x[1], height]], chain: Vec::new() };
        let stage = Stage { title: "A pusher and a box".into(), size: reach, floor: Some(0.0), mark: Some([0.0, -0.2 * reach]) };
        mechanics(&stage, &states.iter().map(posture).collect::<Vec<_>>(), dt)
    }
}
