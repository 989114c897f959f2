//! `physgrad tasks`: lists the tasks and their settings.

use crate::platform::json::print_json;
use crate::platform::table::Table;
use crate::platform::terminal::{did_you_mean, print_result, print_text};
use crate::scenes::presets;
use crate::settings::{ACTUATORS, Info, SENSORS};
use crate::tasks::policy::COMMON;
use crate::tasks::{self, AnyTaskSpec};
use anyhow::{Result, bail};
use serde_json::{Value, json};

/// List the tasks with their settings and defaults; for a named task, also meanings.
#[derive(Debug, clap::Args)]
#[command(after_help = "Examples:\n  physgrad tasks\n  physgrad tasks cart_pole")]
pub struct Tasks {
    /// A task [default: all tasks]
    pub task: Option<String>,
    /// Print the result as one JSON object; messages stay on standard error (docs/runs.md)
    #[arg(long)]
    pub json: bool,
}

/// Runs the command.
pub fn tasks(args: &Tasks) -> Result<()> {
    let all = tasks::all()
        .iter()
        .filter(|task| args.task.as_ref().is_none_or(|name| name == task.name()));
    let all: Vec<_> = all.collect();
    if let (true, Some(name)) = (all.is_empty(), &args.task) {
        let names: Vec<&str> = tasks::all().iter().map(|task| task.name()).collect();
        let question = did_you_mean(name, names.iter().copied());
        bail!("there is no task `{name}`; tasks: {}{question}", names.join(", "));
    }
    if args.json {
        let object = |task: &&dyn AnyTaskSpec| {
            let effects: Vec<&str> = task.effects().iter().map(|info| info.name).collect();
            Ok(
                json!({ "name": task.name(), "about": task.about(), "effects": effects, "settings": settings(*task)?.objects() }),
            )
        };
        let tasks = all.iter().map(|task| object(task)).collect::<Result<Vec<_>>>()?;
        return print_json(&json!({ "tasks": tasks }));
    }
    if let (Some(_), [task]) = (&args.task, &all[..]) {
        let effects =
            if task.effects().is_empty() { "none".into() } else { names(&task.effects()) };
        let table = settings(**task)?;
        return print_text(&format!(
            "{}: {}\n{table}\neffects: {effects}\nactuators: {}\nsensors: {}\n`physgrad effects NAME` describes an effect, an actuator or a sensor",
            task.name(),
            task.about(),
            names(&ACTUATORS),
            names(&SENSORS)
        ));
    }
    for task in all {
        describe(*task)?;
    }
    print_text(&format!("actuators: {}; only limit for quantum", names(&ACTUATORS)))?;
    print_text(&format!("sensors: {}\n", names(&SENSORS)))?;
    print_text(
        "Each task is also a preset. `physgrad scene` lists all presets; `physgrad scene cart_pole` prints one as a template.
`physgrad explain cart_pole` prints equations, operation counts and memory of a scene; docs/effects.md describes all effects.
Change a setting with --set KEY=VALUE, for example --set 'policy.widths=[64,64]' --set effects.pole_damping.damping=0.01.
field: combined, regular, modified, network, stopped, projected, conflict_free, modified_signed, regular_scaled;
precision: f32, f64; training.clip: none, value, norm;
training.optimizer: adam, sgd, momentum, rmsprop, adagrad, adadelta; loss.mode: terminal, running.",
    )?;
    Ok(())
}

fn describe(task: &dyn AnyTaskSpec) -> Result<()> {
    let settings = presets::source(task.name())?.scene()?.table().to_string();
    let indented: String =
        settings.trim_end().lines().map(|line| format!("    {line}\n")).collect();
    let effects = if task.effects().is_empty() { "none".into() } else { names(&task.effects()) };
    print_text(&format!("{}: {}\neffects: {effects}\n", task.name(), task.about()))?;
    print_result(&indented)
}

/// Settings of a task with defaults and, from the schema, meanings and units.
fn settings(task: &dyn AnyTaskSpec) -> Result<Table> {
    let defaults = presets::source(task.name())?.scene()?.table();
    let mut table = Table::new(["setting", "default", "meaning"]);
    add_settings(&mut table, "", &task.schema()["properties"], Some(&defaults));
    Ok(table)
}

/// Adds a row per setting of a section and of its subsections.
fn add_settings(
    table: &mut Table,
    section: &str,
    properties: &Value,
    defaults: Option<&toml::Table>,
) {
    for (key, property) in properties.as_object().into_iter().flatten() {
        let name = if section.is_empty() { key.clone() } else { format!("{section}.{key}") };
        if HIDDEN.contains(&&*name) {
            continue;
        }
        let default = defaults.and_then(|defaults| defaults.get(key));
        let inner = default.and_then(toml::Value::as_table);
        if property["properties"].is_object() {
            add_settings(table, &name, &property["properties"], inner);
            continue;
        }
        if key == "policy" {
            add_kinds(table, property["oneOf"].as_array().into_iter().flatten(), inner);
            continue;
        }
        let choices =
            property["oneOf"].as_array().or(property["enum"].as_array()).into_iter().flatten();
        let choices = choices
            .filter_map(|choice| choice.as_str().or(choice["const"].as_str()))
            .collect::<Vec<_>>()
            .join(", ");
        let meaning = property["description"].as_str().unwrap_or_default().replace('\n', " ");
        let meaning = if choices.is_empty() {
            meaning
        } else {
            format!("{} ({choices})", meaning.trim_end_matches('.'))
        };
        table.row([name, default.map_or_else(String::new, ToString::to_string), meaning]);
    }
}

/// Adds the kinds of policies with their settings, the default kind first.
fn add_kinds<'a>(
    table: &mut Table,
    kinds: impl Iterator<Item = &'a Value> + Clone,
    defaults: Option<&toml::Table>,
) {
    let name = |kind: &Value| kind["title"].as_str().unwrap_or_default().to_owned();
    let names: Vec<String> = kinds.clone().map(name).collect();
    let meaning = format!("Kind of the policy ({})", names.join(", "));
    table.row(["policy.kind".to_owned(), format!("{:?}", names[0]), meaning]);
    for (i, kind) in kinds.enumerate() {
        for (key, property) in kind["properties"].as_object().into_iter().flatten() {
            let is_common = COMMON.contains(&key.as_str());
            if key == "kind" || is_common && i > 0 {
                continue;
            }
            let own = defaults.filter(|_| i == 0).and_then(|defaults| defaults.get(key));
            let default = own.map_or_else(
                || property.get("default").map_or_else(String::new, Value::to_string),
                ToString::to_string,
            );
            let meaning = property["description"].as_str().unwrap_or_default().replace('\n', " ");
            let meaning = if is_common { meaning } else { format!("{}: {meaning}", names[i]) };
            table.row([format!("policy.{key}"), default, meaning]);
        }
    }
}

/// Keys that no option sets, and the sections `effects` and `actuator`, whose entries the command
/// lists by name.
const HIDDEN: [&str; 7] = ["scene", "physgrad", "task", "effects", "actuator", "vary", "fit"];

fn names(infos: &[Info]) -> String {
    infos.iter().map(|info| info.name).collect::<Vec<_>>().join(", ")
}
