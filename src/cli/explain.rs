//! `physgrad explain`: what a scene simulates, what it leaves out, and what that costs.

use super::document::OPTIONAL;
use super::kind::{Info, Visit};
use super::presets;
use super::scene::Scene;
use super::settings::{ACTUATORS, Precision};
use super::terminal::say;
use anyhow::Result;
use comfy_table::Table;
use comfy_table::presets::UTF8_FULL_CONDENSED;
use physgrad::{Adjoint, Cost, Counts, Field, Float, Policy, Rollout, Task};

/// Tell what a scene simulates and what it leaves out; operations of a step and its reverse, by effect; and what is stored.
///
/// Everything is counted, nothing is timed: the numbers are the same on every machine.
#[derive(Debug, clap::Args)]
pub struct Explain {
    /// A task, a preset (see `physgrad scene`), or the path of a scene
    pub scene: String,
    /// Take an effect or a part of the actuator away
    #[arg(long, value_name = "NAME")]
    pub without: Vec<String>,
}

/// Samples that go through a rollout together when its bytes are counted: all lanes are in use.
const SAMPLES: usize = 8;

/// Runs the command.
pub fn explain(args: &Explain) -> Result<()> {
    let mut document = presets::document(&args.scene)?;
    args.without.iter().try_for_each(|name| document.without(name))?;
    let scene = document.scene()?;
    say(&format!("{}: {}\n", args.scene, scene.kind.about()));
    let states = scene.state_names();
    say(&format!("state of {} numbers, {}", states.len(), names(&states)));
    let controls = scene.control_names();
    say(&format!("control of {} number{}, {}\n", controls.len(), if controls.len() == 1 { "" } else { "s" }, names(&controls)));
    say(&effects(&scene).to_string());
    say("\noperations of one step of one sample; its VJP to state and control (R, M), and to the control alone (N, S)");
    say(&operations(&scene)?.to_string());
    say(&format!(
        "\nstored for one sample, in {}; a rollout that is evaluated keeps no step, and there is no allocation in any time loop",
        scene.precision.name()
    ));
    say(&bytes(&scene)?.to_string());
    Ok(())
}

/// The first few of them.
fn names(names: &[String]) -> String {
    match names {
        [first, second, third, _, .., last] if names.len() > 12 => format!("{first}, {second}, {third} … {last}"),
        _ => names.join(", "),
    }
}

fn table(header: &[&str]) -> Table {
    let mut table = Table::new();
    table.load_style(UTF8_FULL_CONDENSED).set_header(header);
    table
}

/// The parts of a scene that may be absent: the section, and what is known of each.
fn parts(scene: &Scene) -> Vec<(&'static str, &'static Info)> {
    let sections = [scene.kind.effects(), &ACTUATORS];
    OPTIONAL.into_iter().zip(sections).flat_map(|(section, infos)| infos.iter().map(move |info| (section, info))).collect()
}

fn is_present(scene: &Scene, section: &str, name: &str) -> bool {
    scene.table.get(section).and_then(|section| section.get(name)).is_some()
}

/// What is in play, and what is available but absent.
fn effects(scene: &Scene) -> Table {
    let mut table = table(&["", "effect", "equation", "derivative"]);
    let parts = parts(scene);
    for present in [true, false] {
        for (section, info) in parts.iter().filter(|(section, info)| is_present(scene, section, info.name) == present) {
            let key = format!("{section}.{}", info.name);
            table.add_row([if present { "in play" } else { "absent" }, &key, info.equation, info.derivative]);
        }
    }
    table
}

/// Operations of the system alone, of each part that is present, and of all.
fn operations(scene: &Scene) -> Result<Table> {
    let mut table = table(&["", "step", "VJP", "VJP to control"]);
    let mut row = |name: &str, cost: &Cost| {
        let all = [cost.step, cost.vjp, cost.vjp_control].map(|counts| format!("{}: {counts}", counts.total()));
        table.add_row([name.to_owned()].into_iter().chain(all));
    };
    let present: Vec<_> = parts(scene).into_iter().filter(|(section, info)| is_present(scene, section, info.name)).collect();
    let mut bare = scene.table.clone();
    OPTIONAL.iter().for_each(|section| drop(bare.remove(*section)));
    row("system alone", &scene.kind.scene(bare)?.cost());
    let whole = scene.cost();
    for (section, info) in present {
        let mut without = scene.table.clone();
        if let Some(section) = without.get_mut(section).and_then(toml::Value::as_table_mut) {
            section.remove(info.name);
        }
        let rest = scene.kind.scene(without)?.cost();
        let own = |of: fn(&Cost) -> Counts| of(&whole) - of(&rest);
        let own = Cost { step: own(|c| c.step), vjp: own(|c| c.vjp), vjp_control: own(|c| c.vjp_control) };
        row(&format!("{section}.{}", info.name), &own);
    }
    row("all", &whole);
    Ok(table)
}

/// Bytes of a rollout and of the adjoint of each field, for each step and besides.
fn bytes(scene: &Scene) -> Result<Table> {
    let mut table = table(&["", "each step", "besides", "whole rollout"]);
    let steps = scene.horizon;
    let mut row = |name: &str, stored: &dyn Fn(&Scene) -> usize| -> Result<()> {
        // Two horizons tell what a step takes.
        let mut longer = scene.table.clone();
        longer.insert("horizon".into(), toml::Value::Integer(steps as i64 + 1));
        let (whole, longer) = (stored(scene), stored(&scene.kind.scene(longer)?));
        let each = (longer - whole) / SAMPLES;
        let whole = whole / SAMPLES;
        table.add_row([name.to_owned(), each.to_string(), (whole - each * steps).to_string(), whole.to_string()]);
        Ok(())
    };
    row("evaluation", &|scene| scene.stored(None))?;
    for field in Field::ALL {
        row(&field.to_string(), &|scene| scene.stored(Some(field)))?;
    }
    Ok(table)
}

/// Counts the operations of the physics.
pub struct Costing;

impl Visit for Costing {
    type Out = Cost;

    fn visit<T: Task, P: Policy>(self, task: T, _policy: P) -> Cost {
        Cost::of(task.system())
    }
}

/// Bytes that a rollout of [`SAMPLES`] samples and its adjoint hold.
pub struct Storing {
    pub precision: Precision,
    /// None: for evaluation.
    pub field: Option<Field>,
}

impl Visit for Storing {
    type Out = usize;

    fn visit<T: Task, P: Policy>(self, task: T, policy: P) -> usize {
        match self.precision {
            Precision::F32 => self.bytes::<f32>(&task, &policy),
            Precision::F64 => self.bytes::<f64>(&task, &policy),
        }
    }
}

impl Storing {
    fn bytes<F: Float>(&self, task: &impl Task, policy: &impl Policy) -> usize {
        let Some(field) = self.field else {
            return Rollout::<F>::for_evaluation(task, policy, SAMPLES).stored_bytes();
        };
        let rollout = Rollout::<F>::new(task, policy, SAMPLES);
        rollout.stored_bytes() + Adjoint::new(policy, &rollout, &field.flows()).stored_bytes()
    }
}
