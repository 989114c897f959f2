//! `physgrad animate`: a film of a trained policy at work.

use super::folder::{ANIMATION, Folder};
use super::outputs;
use super::saved;
use super::scene::{Scene, with_scene};
use super::settings::{Precision, Settings};
use super::terminal::say;
use anyhow::{Result, bail};
use physgrad::{Float, System};
use std::path::PathBuf;

/// Film a trained policy, starting from a state it was not trained on.
#[derive(Debug, clap::Args)]
pub struct Animate {
    /// Folder of a run or of a comparison; of a comparison, every run is filmed
    pub folder: PathBuf,
    /// Number of the test start state, from 0
    #[arg(long, value_name = "N", default_value_t = 0)]
    pub sample: usize,
    /// Print nothing but errors
    #[arg(long)]
    pub quiet: bool,
}

/// Runs the command.
pub fn animate(args: &Animate) -> Result<()> {
    for folder in saved::runs(&Folder::existing(&args.folder)?)? {
        with_scene!(saved::task(&folder)?.as_str(), S => film::<S>(&folder, args.sample))?;
        if !args.quiet {
            say(&folder.file(ANIMATION).display().to_string());
        }
    }
    Ok(())
}

fn film<S: Scene>(folder: &Folder, sample: usize) -> Result<()> {
    let settings = saved::settings::<S>(folder)?;
    match settings.precision {
        Precision::F32 => film_in::<S, f32>(folder, &settings, sample),
        Precision::F64 => film_in::<S, f64>(folder, &settings, sample),
    }
}

fn film_in<S: Scene, F: Float>(folder: &Folder, settings: &Settings<S>, sample: usize) -> Result<()> {
    let mut session = saved::fresh::<S, F>(settings, 1)?;
    saved::restore(folder, settings, &mut session)?;
    let samples = session.test_starts().len() / session.task().system().state_dim();
    if sample >= samples {
        bail!("--sample is {sample}; allowed: 0 to {}, the test start states of {}", samples - 1, folder.path().display());
    }
    folder.write(ANIMATION, outputs::film(&session, sample))
}
