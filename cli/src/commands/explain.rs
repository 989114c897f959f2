//! `physgrad explain`: equations, operation counts and memory of a scene.

use crate::operations::costs::SAMPLES;
use crate::platform::json::print_json;
use crate::platform::table::Table;
use crate::platform::terminal::{counted, print_result, print_text};
use crate::scenes::overrides::{Overrides, hide, is_of_training, is_of_windows};
use crate::scenes::presets;
use crate::settings::{ACTUATORS, Info, OPTIONAL, SENSORS};
use crate::tasks::Scene;
use anyhow::Result;
use physgrad::count::{OpCount, Ops};
use physgrad::graph::Operations;
use physgrad::{Field, Policy as _};
use serde_json::{Value, json};

/// List the present and absent effects of a scene, and count operations and stored bytes.
///
/// Operations are counted for each effect, for the costs and for the observation.
///
/// All numbers are counts, not timings, so they are equal on every machine.
#[derive(Debug, clap::Args)]
#[command(after_help = "Example:\n  physgrad explain cart_pole --set effects.steady_wind.speed=4")]
#[command(mut_args(hide(is_unread)))]
pub struct Explain {
    /// A task, a preset (see `physgrad scene`), or the path of a scene
    pub scene: String,
    #[command(flatten)]
    pub overrides: Overrides,
    /// Print the result as one JSON object; messages stay on standard error (docs/runs.md)
    #[arg(long)]
    pub json: bool,
}

/// Whether the command does not read the setting with this key.
fn is_unread(key: &str) -> bool {
    is_of_training(key) && !is_of_windows(key) || ["seed", "training.memory"].contains(&key)
}

/// Time steps of the shorter of the two rollouts for the table of memory.
const FEW_STEPS: usize = 8;

/// Runs the command.
pub fn explain(args: &Explain) -> Result<()> {
    let mut source = presets::source(&args.scene)?;
    args.overrides.apply(&mut source)?;
    let scene = source.scene()?;
    args.overrides.refuse(is_unread, "counts of operations and bytes, which need no training")?;
    if args.json {
        return print_json(&json!({
            "scene": args.scene,
            "task": scene.task.name(),
            "states": scene.state_names(),
            "controls": scene.control_names(),
            "policy": scene.policy_kind(),
            "effects": effects(&scene).objects(),
            "operations": with_parts(operations(&scene)?.objects()),
            "memory": bytes(&scene)?.objects(),
        }));
    }
    print_text(&format!("{}: {}\n", args.scene, scene.task.about()))?;
    let states = scene.state_names();
    print_text(&format!("state, {}: {}", counted(states.len(), "component"), names(&states)))?;
    let controls = scene.control_names();
    print_text(&format!(
        "control, {}: {}",
        counted(controls.len(), "component"),
        names(&controls)
    ))?;
    print_text(&format!("{}\n", policy(&scene)))?;
    let equations = scene.equations();
    if !equations.is_empty() {
        let mut table = Table::new(["result", "equation"]);
        for (name, text) in equations {
            table.row([name, text]);
        }
        print_result(&table.to_string())?;
    }
    if let Some(Operations { written, evaluated }) = scene.operations() {
        print_text(&format!(
            "{} as written, {evaluated} to evaluate: equal ones are shared, and those with 0, 1 or constants simplified",
            counted(written, "operation")
        ))?;
    }
    scene.remarks().iter().try_for_each(|remark| print_text(remark))?;
    print_result(&effects(&scene).to_string())?;
    print_text(
        "\noperations per step and sample: of the step, of its VJP to state and control (R, M), of its VJP to the control (N, S)\n\
         add: with subtractions; func: sine, tanh and others; the count of an effect is the whole minus the scene without it",
    )?;
    print_result(&operations(&scene)?.to_string())?;
    print_text(&format!("\nmemory per sample in {}", scene.precision.name()))?;
    print_result(&bytes(&scene)?.to_string())?;
    Ok(())
}

/// Kind of the policy, and numbers of its parameters and of its memory.
fn policy(scene: &Scene) -> String {
    let policy = scene.policy();
    let trained = counted(policy.param_count(), "trained number");
    let memory = match policy.memory_dim() {
        0 => String::new(),
        count => format!(", {} of memory", counted(count, "component")),
    };
    format!("policy, {trained}{memory}: {}", scene.policy_kind())
}

/// Joins the names. Abbreviates a list of more than 12 names.
fn names(names: &[String]) -> String {
    match names {
        [first, second, third, _, .., last] if names.len() > 12 => {
            format!("{first}, {second}, {third} … {last}")
        }
        _ => names.join(", "),
    }
}

/// Section and documentation of every effect, actuator and sensor available in a scene.
fn parts(scene: &Scene) -> Vec<(&'static str, Info)> {
    let sections = [scene.task.effects(), ACTUATORS.to_vec(), SENSORS.to_vec()];
    OPTIONAL
        .into_iter()
        .zip(sections)
        .flat_map(|(section, infos)| infos.into_iter().map(move |info| (section, info)))
        .collect()
}

fn is_present(scene: &Scene, section: &str, name: &str) -> bool {
    scene.table().get(section).and_then(|section| section.get(name)).is_some()
}

/// Table of the effects and actuators: those present, then those absent.
fn effects(scene: &Scene) -> Table {
    let mut table =
        Table::new(["state", "effect", "equation", "derivative"]).optional(&["derivative"]);
    let parts = parts(scene);
    for present in [true, false] {
        for (section, info) in
            parts.iter().filter(|(section, info)| is_present(scene, section, info.name) == present)
        {
            let key = format!("{section}.{}", info.name);
            table.row([
                if present { "present" } else { "absent" },
                &*key,
                info.equation,
                info.derivative,
            ]);
        }
    }
    table
}

/// Operation counts by pass and kind. The first entry of each pass is the total.
fn numbers(cost: &OpCount) -> [[i64; 8]; 3] {
    [cost.step, cost.vjp, cost.vjp_control].map(by_kind)
}

/// Titles of the counts of [`by_kind`].
const KINDS: [&str; 8] = ["all", "add", "neg", "mul", "div", "root", "func", "cmp"];

/// The total, then the count of each kind.
fn by_kind(counts: Ops) -> [i64; 8] {
    let Ops { add, negate, multiply, divide, sqrt, transcendental, compare } = counts;
    [counts.total(), add, negate, multiply, divide, sqrt, transcendental, compare]
        .map(|count| count as i64)
}

/// Operation counts of the system alone, of each part that is present, and of the whole; then of
/// the costs and the observation. Omits an observation without operations.
///
/// The count of a part is the count of the whole scene minus the count without the part. Two
/// chained actuators share operations, which the counts of both include. The row "counted twice"
/// shows these operations.
fn operations(scene: &Scene) -> Result<Table> {
    let mut table = Table::new([&["part", "pass"][..], &KINDS].concat())
        .optional(&["mul", "add", "func", "div", "cmp", "neg", "root"]);
    let mut add_rows = |name: &str, passes: &[&str], numbers: &[[i64; 8]]| {
        for (i, (pass, numbers)) in passes.iter().zip(numbers).enumerate() {
            let names = [if i == 0 { name } else { "" }, pass].map(str::to_owned);
            table.row(names.into_iter().chain(numbers.map(|count| count.to_string())));
        }
    };
    let mut rows = |name: &str, numbers: [[i64; 8]; 3]| {
        add_rows(name, &["step", "VJP", "VJP to control"], &numbers)
    };
    // Expressions of observation and costs may name components of actuators that are left out.
    let mut all = scene.table();
    all.remove("equations");
    let mut bare = all.clone();
    OPTIONAL.iter().for_each(|section| drop(bare.remove(*section)));
    let alone = numbers(&scene.task.scene(bare)?.cost().system);
    rows("system alone", alone);
    let counts = scene.cost();
    let whole = numbers(&counts.system);
    let mut shared = difference(alone, whole);
    // Lists of a sensor have one number for each observed component, also for those of actuators.
    let mut unsensed = all.clone();
    unsensed.remove("sensor");
    let whole_unsensed = numbers(&scene.task.scene(unsensed.clone())?.cost().system);
    for (section, info) in parts(scene) {
        if !is_present(scene, section, info.name) {
            continue;
        }
        let (mut without, whole) = match section {
            "sensor" => (all.clone(), whole),
            _ => (unsensed.clone(), whole_unsensed),
        };
        if let Some(section) = without.get_mut(section).and_then(toml::Value::as_table_mut) {
            section.remove(info.name);
        }
        let rest = numbers(&scene.task.scene(without)?.cost().system);
        rows(&format!("{section}.{}", info.name), difference(whole, rest));
        shared = difference(shared, difference(rest, whole));
    }
    if shared.as_flattened().iter().any(|&count| count != 0) {
        rows("counted twice", shared);
    }
    rows("together", whole);
    let mut pair = |name: &str, passes: [&str; 2], counts: [Ops; 2]| {
        add_rows(name, &passes, &counts.map(by_kind))
    };
    pair(
        "running cost",
        ["value", "gradient"],
        [counts.running_cost, counts.running_cost_gradient],
    );
    pair(
        "terminal cost",
        ["value", "gradient"],
        [counts.terminal_cost, counts.terminal_cost_gradient],
    );
    if counts.observe != Ops::default() {
        pair("observation", ["value", "VJP"], [counts.observe, counts.observe_vjp]);
    }
    Ok(table)
}

/// Copies the name of a part, which only its first row has, to its other rows.
fn with_parts(mut rows: Value) -> Value {
    let mut part = Value::Null;
    for row in rows.as_array_mut().into_iter().flatten() {
        if row["part"].is_null() {
            row["part"] = part.clone();
        }
        part = row["part"].clone();
    }
    rows
}

fn difference(a: [[i64; 8]; 3], b: [[i64; 8]; 3]) -> [[i64; 8]; 3] {
    std::array::from_fn(|pass| std::array::from_fn(|kind| a[pass][kind] - b[pass][kind]))
}

/// Table of the memory of a rollout: in evaluation mode, and with the adjoint of each field of the
/// paper. Columns per sample: bytes per step, constant bytes, and bytes of the whole rollout, or with
/// an adjoint of the window if the scene has one.
fn bytes(scene: &Scene) -> Result<Table> {
    let whole = if scene.steps() < scene.horizon { "rollout or window" } else { "whole rollout" };
    let mut table = Table::new(["field", "bytes per step", "constant", whole]);
    let with_horizon = |horizon: usize| {
        let mut table = scene.table();
        table.insert("horizon".into(), toml::Value::Integer(horizon as i64));
        table.remove("window");
        scene.task.scene(table)
    };
    // Measures two horizons to separate the bytes per step from the constant bytes.
    let (short, long) = (with_horizon(FEW_STEPS)?, with_horizon(2 * FEW_STEPS)?);
    let mut row = |name: &str, field: Option<Field>| {
        let [short, long] = [&short, &long].map(|scene| scene.stored(field));
        let per_step = (long - short) / (FEW_STEPS * SAMPLES);
        let constant = short / SAMPLES - per_step * FEW_STEPS;
        let steps = if field.is_some() { scene.steps() } else { scene.horizon };
        table.row([
            name.to_owned(),
            per_step.to_string(),
            constant.to_string(),
            (constant + per_step * steps).to_string(),
        ]);
    };
    row("evaluation", None);
    for field in Field::PAPER {
        row(&field.to_string(), Some(field));
    }
    Ok(table)
}
