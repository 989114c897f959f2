//! `physgrad effects`: the reference page of all effects.

use crate::platform::json::print_json;
use crate::platform::terminal::{did_you_mean, print_result, wrapped};
use crate::settings::{ACTUATORS, Info, SENSORS};
use crate::tasks::{self, AnyTaskSpec};
use anyhow::{Result, bail};
use physgrad::count::Ops;
use serde_json::{Value, json};
use std::fmt::Write;
use toml::Table;

/// Print the reference page of all effects, in Markdown: equation, parameters with units and
/// defaults, derivative, cost.
#[derive(Debug, clap::Args)]
#[command(after_help = "Example:\n  physgrad effects steady_wind")]
pub struct Effects {
    /// An effect or an actuator [default: the whole page]
    pub effect: Option<String>,
    /// Print the result as one JSON object; messages stay on standard error (docs/runs.md)
    #[arg(long)]
    pub json: bool,
}

/// Width of a paragraph, in characters.
const WIDTH: usize = 100;

const HEAD: &str = "\
# Effects

Effects are optional physics that a scene adds to its system. [scenes.md](scenes.md) gives examples.
The command `physgrad effects` generates this page.

Costs are operation counts of one step of one sample, in the task's default system. The column VJP
counts the vector-Jacobian product of this step with respect to state and control. A test compares
this page with the counts. An effect costs the same with and without other effects. Two actuators
may share operations. Absent effects cost nothing. Counts exclude the precomputation of constants,
such as a static potential.

Tests compare the analytic derivatives with dual numbers; `physgrad check SCENE` does so for any
scene. *Smoothed*: a smooth function replaces a jump in the physics. *One-sided*: the derivative
jumps at a point and takes the value of one side there.
";

/// Runs the command.
pub fn effects(args: &Effects) -> Result<()> {
    let infos = tasks::all().iter().flat_map(|task| task.effects());
    let infos = infos.chain(ACTUATORS).chain(SENSORS);
    let names: Vec<&str> = infos.map(|info| info.name).collect();
    if let Some(name) = args.effect.as_deref().filter(|name| !names.contains(name)) {
        let question = did_you_mean(name, names.iter().copied());
        bail!(
            "there is no effect or actuator `{name}`; effects and actuators: {}{question}",
            names.join(", ")
        );
    }
    if args.json {
        return print_json(&json!({ "effects": objects(args.effect.as_deref())? }));
    }
    let page = page()?;
    let Some(name) = &args.effect else { return print_result(page.trim_end()) };
    let entries = page.split("\n### ").skip(1);
    let of_name = entries
        .filter(|entry| entry.lines().next() == Some(name))
        .map(|entry| entry.split("\n## ").next());
    of_name.flatten().try_for_each(|entry| print_result(&format!("### {}", entry.trim_end())))
}

/// Returns one object per effect and task, and one per actuator. With `name`, returns only the
/// objects of that name.
fn objects(name: Option<&str>) -> Result<Vec<Value>> {
    let all = tasks::all()
        .iter()
        .flat_map(|&task| task.effects().into_iter().map(move |info| (task, "effects", info)));
    let actuators = ACTUATORS.iter().map(|&info| (tasks::all()[0], "actuator", info));
    let sensors = SENSORS.iter().map(|&info| (tasks::all()[0], "sensor", info));
    let chosen = all
        .chain(actuators)
        .chain(sensors)
        .filter(|(.., info)| name.is_none_or(|name| name == info.name));
    let object = |(task, section, info): (&'static dyn AnyTaskSpec, &str, Info)| {
        let [step, vjp] = cost(task, section, info.name)?.map(|ops| ops.total());
        let schema = task.schema()["properties"][section]["properties"][info.name].clone();
        let Info { name, equation, derivative } = info;
        Ok(json!({
            "name": name, "task": task.name(), "section": section, "equation": equation, "derivative": derivative,
            "step": step, "vjp": vjp, "schema": schema,
        }))
    };
    chosen.map(object).collect()
}

fn page() -> Result<String> {
    let mut page = HEAD.to_owned();
    for &kind in tasks::all().iter().filter(|kind| !kind.effects().is_empty()) {
        let intro = wrapped(&format!("{} {}", sentence(kind.about()), kind.symbols()), WIDTH);
        let _ = writeln!(page, "\n## {}\n\n{intro}\n", kind.name());
        section(&mut page, kind, "effects", &kind.effects())?;
    }
    let actuators = wrapped(
        "Every task accepts actuators; `quantum` accepts only `limit`. Actuators map the policy's control u to the control u' \
         of the physics. They act in the order of the table. Their state starts at 0. Costs are for cart_pole, which has one control.",
        WIDTH,
    );
    let _ = writeln!(page, "\n## Actuators\n\n{actuators}\n");
    section(&mut page, tasks::all()[0], "actuator", &ACTUATORS)?;
    let sensors = wrapped(
        "Every task accepts sensors. They map the observation y to what the policy sees, y', in the order of the table; costs do \
         not see them. The first measurement is that of the initial state. Costs are for cart_pole, whose policy observes the \
         four components of the state.",
        WIDTH,
    );
    let _ = writeln!(page, "\n## Sensors\n\n{sensors}\n");
    section(&mut page, tasks::all()[0], "sensor", &SENSORS)?;
    Ok(page)
}

/// Writes a table of the effects of a section, then an entry for each: equation, note, derivative,
/// costs and parameters.
fn section(
    page: &mut String,
    kind: &'static dyn AnyTaskSpec,
    section: &str,
    infos: &[Info],
) -> Result<()> {
    let schema = kind.schema();
    let of = |info: &Info| &schema["properties"][section]["properties"][info.name];
    let costs: Vec<[Ops; 2]> =
        infos.iter().map(|info| cost(kind, section, info.name)).collect::<Result<_>>()?;
    let _ = writeln!(page, "| | | step | VJP |\n|---|---|--:|--:|");
    for (info, [step, vjp]) in infos.iter().zip(&costs) {
        let name = info.name;
        let _ = writeln!(
            page,
            "| [{name}](#{name}) | {} | {} | {} |",
            description(of(info)),
            step.total(),
            vjp.total()
        );
    }
    for (info, [step, vjp]) in infos.iter().zip(&costs) {
        let (equation, note) = info.equation.split_once("; ").unwrap_or((info.equation, ""));
        let _ = writeln!(page, "\n### {}\n\n```text\n{}\n```\n", info.name, lines(equation));
        let note = if note.is_empty() { String::new() } else { format!("{} ", sentence(note)) };
        let costs = wrapped(
            &format!("{note}Derivative: {}. Step: {step}. VJP: {vjp}.", info.derivative),
            WIDTH,
        );
        let _ = writeln!(page, "{costs}\n");
        parameters(page, &of(info)["properties"]);
    }
    Ok(())
}

/// Operations that an effect, actuator or sensor adds to a step and to its VJP, in a scene without others.
fn cost(kind: &'static dyn AnyTaskSpec, section: &str, name: &str) -> Result<[Ops; 2]> {
    let mut settings = kind.defaults(&Table::new());
    let alone = kind.scene(settings.clone())?.cost().system;
    let part: Table = [(name.to_owned(), toml::Value::Table(required(name)))].into_iter().collect();
    settings.insert(section.into(), toml::Value::Table(part));
    let with = kind.scene(settings)?.cost().system;
    Ok([with.step - alone.step, with.vjp - alone.vjp])
}

/// Splits into one line per equation, at each comma before an equation. Commas within parentheses
/// do not split.
fn lines(equations: &str) -> String {
    let mut lines = String::new();
    for part in equations.split(", ") {
        let open = lines.matches('(').count() > lines.matches(')').count();
        lines += match (lines.is_empty(), part.contains(" = ") && !open) {
            (true, _) => "",
            (false, true) => "\n",
            (false, false) => ", ",
        };
        lines += part;
    }
    lines
}

fn sentence(text: &str) -> String {
    let mut letters = text.chars();
    letters
        .next()
        .map_or_else(String::new, |first| format!("{}{}.", first.to_uppercase(), letters.as_str()))
}

/// Schema description as one line, with `|` escaped for Markdown tables.
fn description(of: &Value) -> String {
    of["description"].as_str().unwrap_or_default().replace('\n', " ").replace('|', "\\|")
}

/// Table of parameter names, defaults and descriptions, from the schema.
fn parameters(page: &mut String, schema: &Value) {
    let _ = writeln!(page, "| parameter | default | |\n|---|---|---|");
    for (name, of) in schema.as_object().into_iter().flatten() {
        let default = match &of["default"] {
            Value::Null => "required".to_owned(),
            Value::String(word) => format!("`{word}`"),
            default => default.to_string(),
        };
        // Appends the description of every variant of an enumeration.
        let choices = of["oneOf"].as_array().into_iter().flatten();
        let choices = choices.map(|choice| {
            format!(
                "<br>`{}`: {}",
                choice["const"].as_str().unwrap_or_default(),
                description(choice)
            )
        });
        let _ = writeln!(
            page,
            "| `{name}` | {default} | {}{} |",
            description(of),
            choices.collect::<String>()
        );
    }
}

/// Values for the parameters of actuators and sensors that have no default. Empty for effects.
fn required(name: &str) -> Table {
    match name {
        "limit" => toml::toml! { bound = 10.0 },
        "delay" => toml::toml! { steps = 1 },
        "lag" => toml::toml! { time = 0.05 },
        "bias" => toml::toml! { value = 0.1 },
        "noise" => toml::toml! { deviation = 0.1 },
        "sampling" => toml::toml! { steps = 2 },
        _ => Table::new(),
    }
}
