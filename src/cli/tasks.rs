//! `physgrad tasks`: what there is.

use super::kind::{AnyKind, KINDS};
use super::terminal::say;
use anyhow::Result;

/// Runs the command.
pub fn tasks() -> Result<()> {
    for kind in KINDS {
        describe(kind);
    }
    say("These are presets too: `physgrad scene` lists all of them, and `physgrad scene cart_pole` prints a file to start from.
Change a setting with --set KEY=VALUE, for example --set policy.widths=[64,64] --set training.clip=norm.
field: combined, regular, modified, network, stopped; precision: f32, f64; training.clip: none, value, norm;
training.optimizer: adam, sgd, momentum, rmsprop, adagrad, adadelta; loss.mode: final, continuous.");
    Ok(())
}

fn describe(kind: &dyn AnyKind) {
    let settings = kind.defaults().to_string();
    let indented: String = settings.trim_end().lines().map(|line| format!("    {line}\n")).collect();
    say(&format!("{}: {}\n\n{indented}", kind.name(), kind.about()));
}
