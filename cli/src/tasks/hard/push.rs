//! Pusher and box: settings, limits and animation.

use crate::operations::trajectory::Trajectory;
use crate::settings::config_error::{ConfigError, positive};
use crate::tasks::hard::contact::ContactSettings;
use crate::tasks::hard::{Nothing, in_scene, names, small_step};
use crate::tasks::{Settings, TaskSpec};
use physgrad::DynTask;
use physgrad::tasks::{self, TwoBodies};
use physgrad_plot::{Animation, Posture, Stage, mechanics};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// Task `push`.
#[derive(Clone, Debug)]
pub struct Push;

/// The `system` section of pusher and box.
#[derive(Clone, Copy, Debug, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct PushSettings {
    /// Masses of pusher and box, kg.
    masses: [f64; 2],
    /// Distance between the centers in contact, m.
    contact_distance: f64,
    /// Time step, s.
    dt: f64,
    /// Contact between pusher and box; default restitution 0.
    contact: ContactSettings,
}

impl TaskSpec for Push {
    type System = PushSettings;
    type Effects = Nothing;
    type Loss = Nothing;

    const NAME: &'static str = "push";
    const ABOUT: &'static str = "push a box to a target position, by contact only";
    const EPOCHS: usize = 300;
    fn horizon() -> usize {
        100
    }

    fn system() -> PushSettings {
        let TwoBodies { masses, contact_distance, dt, contact: _ } = TwoBodies::pusher();
        PushSettings { masses, contact_distance, dt, contact: ContactSettings::DEFAULT }
    }

    fn validate(settings: &Settings<Self>) -> Result<(), ConfigError> {
        let PushSettings { masses, contact_distance, dt, contact } = settings.system;
        masses.into_iter().try_for_each(|mass| positive("system.masses", mass))?;
        positive("system.contact_distance", contact_distance)?;
        positive("system.dt", dt)?;
        contact.validate()
    }

    fn task(settings: &Settings<Self>) -> DynTask {
        let PushSettings { masses, contact_distance, dt: _, contact } = settings.system;
        let system = TwoBodies {
            masses,
            contact_distance,
            dt: small_step(settings),
            contact: contact.contact(0.0),
        };
        in_scene(settings, tasks::Push { system, horizon: settings.horizon })
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

    fn animation(settings: &Settings<Self>, Trajectory { states, .. }: &Trajectory) -> Animation {
        let PushSettings { contact_distance, dt, .. } = settings.system;
        let height = 0.5 * contact_distance;
        let posture = |x: &Vec<f64>| Posture {
            boxes: vec![[x[0], height], [x[1], height]],
            chain: Vec::new(),
        };
        let stage = Stage {
            title: "A pusher and a box".into(),
            size: contact_distance,
            floor: Some(0.0),
            mark: Some([0.0, -0.2 * contact_distance]),
        };
        let animation = mechanics(&stage, &states.iter().map(posture).collect::<Vec<_>>(), dt);
        let boxes = ["pusher", "box"]
            .into_iter()
            .zip(physgrad_plot::BOXES)
            .map(|(name, color)| (name.to_owned(), color));
        Animation { legend: boxes.chain(animation.legend).collect(), ..animation }
    }
}
