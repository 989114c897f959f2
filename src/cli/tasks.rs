//! `physgrad tasks`: what there is.

use super::scene::{NAMES, Scene, with_scene};
use super::settings::Settings;
use anyhow::Result;

/// Runs the command.
pub fn tasks() -> Result<()> {
    for name in NAMES {
        with_scene!(name, S => describe::<S>());
    }
    println!("Change a setting with --set KEY=VALUE, for example --set policy.widths=[64,64] --set training.clip=norm.");
    println!("field: combined, regular, modified, network, stopped; precision: f32, f64; training.clip: none, value, norm;");
    println!("training.optimizer: adam, sgd, momentum, rmsprop, adagrad, adadelta; loss.mode: final, continuous.");
    Ok(())
}

fn describe<S: Scene>() {
    println!("{}: {}\n", S::NAME, S::ABOUT);
    println!(
        "{}",
        Settings::<S>::defaults().to_table().to_string().trim_end().lines().map(|l| format!("    {l}\n")).collect::<String>()
    );
}
