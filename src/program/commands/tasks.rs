//! `physgrad tasks`: lists the tasks and their settings.

use crate::program::platform::terminal::{did_you_mean, print_result};
use crate::program::scenes::presets;
use crate::program::settings::{ACTUATORS, Info};
use crate::program::tasks::{self, AnyTaskSpec};
use anyhow::{Result, bail};

/// List the tasks with all settings and their defaults
#[derive(Debug, clap::Args)]
pub struct Tasks {
    /// A task [default: all tasks]
    pub task: Option<String>,
}

/// Runs the command.
pub fn tasks(args: &Tasks) -> Result<()> {
    let all = tasks::all().iter().filter(|task| args.task.as_ref().is_none_or(|name| name == task.name()));
    let all: Vec<_> = all.collect();
    if let (true, Some(name)) = (all.is_empty(), &args.task) {
        let names: Vec<&str> = tasks::all().iter().map(|task| task.name()).collect();
        let question = did_you_mean(name, names.iter().copied());
        bail!("there is no task `{name}`; tasks: {}{question}", names.join(", "));
    }
    for task in all {
        describe(*task)?;
    }
    if args.task.is_some() {
        return Ok(());
    }
    print_result(&format!("actuators: {}; only limit for quantum\n", names(&ACTUATORS)))?;
    print_result(
        "Each task is also a preset. `physgrad scene` lists all presets; `physgrad scene cart_pole` prints one as a template.
`physgrad explain cart_pole` prints equations, operation counts and memory of a scene; docs/effects.md describes all effects.
Change a setting with --set KEY=VALUE, for example --set policy.widths=[64,64] --set effects.pole_damping.damping=0.01.
field: combined, regular, modified, network, stopped; precision: f32, f64; training.clip: none, value, norm;
training.optimizer: adam, sgd, momentum, rmsprop, adagrad, adadelta; loss.mode: terminal, running.",
    )?;
    Ok(())
}

fn describe(task: &dyn AnyTaskSpec) -> Result<()> {
    let settings = presets::source(task.name())?.scene()?.table.to_string();
    let indented: String = settings.trim_end().lines().map(|line| format!("    {line}\n")).collect();
    let effects = if task.effects().is_empty() { "none".into() } else { names(&task.effects()) };
    print_result(&format!("{}: {}\neffects: {effects}\n\n{indented}", task.name(), task.about()))?;
    Ok(())
}

fn names(infos: &[Info]) -> String {
    infos.iter().map(|info| info.name).collect::<Vec<_>>().join(", ")
}
