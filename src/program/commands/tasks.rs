//! `physgrad tasks`: lists the tasks and their settings.

use crate::program::platform::terminal::say;
use crate::program::scenes::presets;
use crate::program::settings::{ACTUATORS, Info};
use crate::program::tasks::{AnyTaskSpec, TASKS};
use anyhow::Result;

/// Runs the command.
pub fn tasks() -> Result<()> {
    for kind in TASKS {
        describe(kind)?;
    }
    say(&format!("actuators of all tasks: {}\n", names(&ACTUATORS)))?;
    say("These are presets: `physgrad scene` lists all of them, and `physgrad scene cart_pole` prints a file to start from.
`physgrad explain cart_pole` tells what a scene simulates and what it costs; docs/effects.md describes every effect.
Change a setting with --set KEY=VALUE, for example --set policy.widths=[64,64] --set effects.pole_damping.damping=0.01.
field: combined, regular, modified, network, stopped; precision: f32, f64; training.clip: none, value, norm;
training.optimizer: adam, sgd, momentum, rmsprop, adagrad, adadelta; loss.mode: terminal, running.")?;
    Ok(())
}

fn describe(kind: &dyn AnyTaskSpec) -> Result<()> {
    let settings = presets::document(kind.name())?.scene()?.table.to_string();
    let indented: String = settings.trim_end().lines().map(|line| format!("    {line}\n")).collect();
    let effects = if kind.effects().is_empty() { "none".into() } else { names(kind.effects()) };
    say(&format!("{}: {}\neffects: {effects}\n\n{indented}", kind.name(), kind.about()))?;
    Ok(())
}

fn names(infos: &[Info]) -> String {
    infos.iter().map(|info| info.name).collect::<Vec<_>>().join(", ")
}
