//! `physgrad effects`: every effect there is, as a page.

use super::kind::{AnyKind, Info, KINDS};
use super::settings::ACTUATORS;
use super::terminal::say;
use anyhow::Result;
use serde_json::Value;
use std::fmt::Write;
use toml::Table;

/// Write the page of all effects, in Markdown: equation, parameters with units and defaults, derivative, cost.
#[derive(Debug, clap::Args)]
pub struct Effects {}

const HEAD: &str = "\
# Effects

What a scene can name beyond its system. This page is made by `physgrad effects`. Costs are operations of one step of one sample and of
its VJP to state and control, in the task's default scene beside nothing else: an effect costs the same whatever else is there. They are
counted, not estimated, and a test holds this page to them. What a scene does not name costs nothing.

Derivatives by hand are compared with dual numbers by `physgrad check` and in the tests. *Smoothed*: a leap in the physics was made a
slope. *One-sided*: the derivative leaps at a point, where that of one side is taken.
";

/// Runs the command.
pub fn effects(_args: &Effects) -> Result<()> {
    say(page()?.trim_end());
    Ok(())
}

fn page() -> Result<String> {
    let mut page = HEAD.to_owned();
    for kind in KINDS {
        let _ = writeln!(page, "\n## {}\n\n{}.\n", kind.name(), kind.about());
        section(&mut page, kind, "effects", kind.effects())?;
    }
    let _ = writeln!(
        page,
        "\n## Actuators\n\nFor every task, between the policy's control u and the physics; the costs are those in cart_pole.\n"
    );
    section(&mut page, KINDS[0], "actuator", &ACTUATORS)?;
    Ok(page)
}

fn section(page: &mut String, kind: &'static dyn AnyKind, section: &str, infos: &[Info]) -> Result<()> {
    let _ = writeln!(page, "| effect | equation | parameters | derivative | step | VJP |\n|---|---|---|---|---|---|");
    let schema = kind.schema();
    let alone = kind.scene(kind.defaults())?.cost();
    for info in infos {
        let schema = &schema["properties"][section]["properties"][info.name]["properties"];
        let mut settings = kind.defaults();
        let with: Table = [(info.name.to_owned(), toml::Value::Table(required(info.name)))].into_iter().collect();
        settings.insert(section.into(), toml::Value::Table(with));
        let with = kind.scene(settings)?.cost();
        let (step, vjp) = (with.step - alone.step, with.vjp - alone.vjp);
        let equation = info.equation.replace('|', "\\|");
        let _ =
            writeln!(page, "| `{}` | {equation} | {} | {} | {step} | {vjp} |", info.name, parameters(schema), info.derivative);
    }
    Ok(())
}

/// What has no default, with a value for it.
fn required(name: &str) -> Table {
    match name {
        "limit" => toml::toml! { bound = 10.0 },
        "delay" => toml::toml! { steps = 1 },
        "lag" => toml::toml! { time = 0.05 },
        _ => Table::new(),
    }
}

/// Names, defaults and descriptions from the schema.
fn parameters(schema: &Value) -> String {
    let all = schema.as_object().into_iter().flatten().map(|(name, of)| {
        let default = match &of["default"] {
            Value::Null => String::new(),
            default => format!(" = {default}"),
        };
        let about = of["description"].as_str().unwrap_or_default().replace('\n', " ").replace('|', "\\|");
        format!("`{name}{default}`: {about}")
    });
    all.collect::<Vec<_>>().join("<br>")
}
