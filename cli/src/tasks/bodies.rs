//! Articulated bodies from a file: settings, expressions and animation.

mod picture;
mod settings;

use crate::operations::trajectory::Trajectory;
use crate::settings::config_error::{ConfigError, allowed, count};
use crate::settings::reading::overlay;
use crate::tasks::equations::located;
use crate::tasks::hard::{Nothing, in_scene};
use crate::tasks::{FileSetting, ModelParts, Settings, TaskSpec};
use physgrad::graph::{Costs, Names, Replaced, Replacement};
use physgrad::{DynTask, Inputs, System as _};
use physgrad_bodies::{self as bodies, components};
use physgrad_plot::Animation;
use picture::{film, legend};
use settings::{BodiesSettings, Contacts, read_text};

/// Task `bodies`.
#[derive(Clone, Debug)]
pub struct Bodies;

/// The task of these settings, with its expressions.
fn task(settings: &Settings<Bodies>) -> Result<DynTask, ConfigError> {
    let system = &settings.system;
    let task = system.task(settings.integrator.count(), settings.horizon)?;
    let bodies = task.bodies().clone();
    let erased = task.erased();
    let replacement = Replacement {
        observe: system.observed(bodies.model())?,
        running: settings.loss.running.clone(),
        terminal: settings.loss.terminal.clone(),
        end: settings.loss.end.clone(),
        define: system.define.clone(),
    };
    if replacement == Replacement::default() {
        return Ok(erased);
    }
    let model = bodies.model();
    let varied = bodies.numbers().placed(0);
    let names = Names {
        states: components::states(model),
        controls: components::controls(model),
        params: varied.into_iter().map(|varied| format!("system.{}", varied.name)).collect(),
        dt: Bodies::dt(settings),
    };
    let replaced = Replaced::with_quantities(erased, names, &replacement, &bodies);
    replaced.map(DynTask::new).map_err(|error| {
        let section = if ["running", "terminal", "end"].contains(&error.key.as_str()) {
            "loss."
        } else {
            "system."
        };
        located(section, error)
    })
}

impl TaskSpec for Bodies {
    type System = BodiesSettings;
    type Effects = Nothing;
    type Loss = Costs;

    const NAME: &'static str = "bodies";
    const ABOUT: &'static str = "articulated bodies with contact, from an MJCF or URDF file";
    const EPOCHS: usize = 60;
    const FILE: Option<FileSetting> = Some(FileSetting { key: "system.model", read: read_text });

    fn horizon() -> usize {
        32
    }

    fn system() -> BodiesSettings {
        BodiesSettings::default()
    }

    fn validate(settings: &Settings<Self>) -> Result<(), ConfigError> {
        count("system.frames", settings.system.frames, 1..=1000)?;
        for (i, half) in settings.system.spread.into_iter().enumerate() {
            let key = format!("system.spread[{i}]");
            allowed(&key, half, half.is_finite() && half >= 0.0, "a number of 0 or more")?;
        }
        if settings.equations != Replacement::default() {
            let what = "is for other tasks; write `system.observe` and the expressions of `loss`";
            return Err(ConfigError::new("equations", what));
        }
        task(settings).map(drop)
    }

    fn task(settings: &Settings<Self>) -> DynTask {
        in_scene(settings, task(settings).expect("validated settings"))
    }

    fn variants() -> Vec<(String, Settings<Self>)> {
        let mut table = Settings::<Self>::defaults().table();
        let preset = include_str!("../scenes/presets/half_cheetah.toml");
        overlay(&mut table, &preset.parse().expect("presets are TOML"));
        vec![("half cheetah".into(), Settings::fill(table).expect("presets are valid"))]
    }

    fn dt(settings: &Settings<Self>) -> f64 {
        settings.system.frames as f64 * settings.system.known().options.dt
    }

    fn state_names(settings: &Settings<Self>) -> Vec<String> {
        components::states(&settings.system.known())
    }

    fn angles(settings: &Settings<Self>) -> Vec<usize> {
        components::angles(&settings.system.known())
    }

    fn control_names(settings: &Settings<Self>) -> Vec<String> {
        components::controls(&settings.system.known())
    }

    fn observe(settings: &Settings<Self>) -> Vec<String> {
        settings.system.observed(&settings.system.known()).unwrap_or_default()
    }

    fn model_numbers(settings: &Settings<Self>) -> Vec<(String, f64)> {
        let numbers = bodies::Bodies::known_numbers(&settings.system.known());
        numbers.into_iter().map(|(name, value)| (format!("system.{name}"), value)).collect()
    }

    fn model(settings: &Settings<Self>) -> Option<ModelParts> {
        let model = settings.system.known();
        let words = |names: &mut dyn Iterator<Item = &String>| -> Vec<String> {
            names.map(|name| components::word(name)).collect()
        };
        Some(ModelParts {
            name: model.name.clone(),
            parts: vec![
                ("bodies", words(&mut model.bodies.iter().skip(1).map(|body| &body.name))),
                ("joints", words(&mut model.joints.iter().map(|joint| &joint.name))),
                ("sites", words(&mut model.sites.iter().map(|site| &site.name))),
                ("shapes", words(&mut model.shapes.iter().map(|shape| &shape.name))),
                ("actuators", words(&mut model.actuators.iter().map(|actuator| &actuator.name))),
            ],
            remarks: model.remarks.clone(),
        })
    }

    /// The softness of contacts, limits and dry friction depends on typical inertias.
    fn with_typical(settings: &Settings<Self>, values: &[(String, f64)]) -> Option<Settings<Self>> {
        let is_inertia = |key: &str| key.starts_with("system.body.") || key.ends_with(".armature");
        let task = settings.system.task(1, settings.horizon).ok()?;
        let depends =
            values.iter().any(|(key, _)| is_inertia(key)) && task.bodies().has_constraints();
        depends
            .then(|| Settings { system: settings.system.with_typical(values), ..settings.clone() })
    }

    fn remarks(settings: &Settings<Self>) -> Vec<String> {
        let mut remarks = settings.system.known().remarks.clone();
        if settings.loss == Costs::default() {
            remarks.push("there is no cost, so a training has nothing to minimize".into());
        }
        remarks
    }

    fn smoother(settings: &Settings<Self>) -> Option<(&'static str, &'static str)> {
        let task = settings.system.task(1, settings.horizon).expect("validated settings");
        let is_stiff = settings.system.contacts == Contacts::File && task.bodies().can_touch();
        is_stiff.then_some(("system.contacts", "smooth"))
    }

    fn animation(
        settings: &Settings<Self>,
        Trajectory { states, controls, params }: &Trajectory,
    ) -> Animation {
        let task = settings.system.task(1, settings.horizon).expect("validated settings");
        let bodies = task.bodies();
        let poses = |x: &Vec<f64>| bodies.poses(x, &params[0]);
        let poses: Vec<_> = states.iter().map(poses).collect();
        let rest = vec![0.0; bodies.control_dim()];
        let touching: Vec<_> = { states.iter().zip(params).enumerate() }
            .map(|(t, (x, p))| {
                let u = controls.get(t).or(controls.last()).unwrap_or(&rest);
                bodies.contact_forces(Inputs { x, u, p, t })
            })
            .collect();
        let model = bodies.model();
        film(model, &poses, &touching, Self::dt(settings), &model.name)
    }

    fn unfinished(
        settings: &Settings<Self>,
        rollout: &Trajectory,
        _bounds: Option<&[[f64; 2]]>,
    ) -> Animation {
        let task = settings.system.task(1, settings.horizon).expect("validated settings");
        // A legend from the first force on would change the size of the picture.
        let legend = legend(task.bodies().can_touch());
        Animation { legend, ..Self::animation(settings, rollout) }
    }
}
