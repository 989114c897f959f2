//! `physgrad tasks`: what there is.

use super::scene::{NAMES, Scene, with_scene};
use super::settings::Settings;
use super::terminal::say;
use anyhow::Result;

/// Runs the command.
pub fn tasks() -> Result<()> {
    for name in NAMES {
        with_scene!(name, S => describe::<S>());
    }
    say("Change a setting with --set KEY=VALUE, for example --set policy.widths=[64,64] --set training.clip=norm.
field: combined, regular, modified, network, stopped; precision: f32, f64; training.clip: none, value, norm;
training.optimizer: adam, sgd, momentum, rmsprop, adagrad, adadelta; loss.mode: final, continuous.");
    Ok(())
}

fn describe<S: Scene>() {
    let settings = Settings::<S>::defaults().to_table().to_string();
    let indented: String = settings.trim_end().lines().map(|line| format!("    {line}\n")).collect();
    say(&format!("{}: {}\n\n{indented}", S::NAME, S::ABOUT));
}
