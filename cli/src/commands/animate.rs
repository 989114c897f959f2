//! `physgrad animate`: animates a rollout of a trained policy.

use crate::platform::folder::{ANIMATION, Folder};
use crate::platform::parallel;
use crate::platform::terminal::print_result;
use crate::runs::saved;
use anyhow::{Result, bail};
use physgrad_plot::Animation;
use std::path::PathBuf;

/// Animate a trained policy, from an initial state of the test set.
#[derive(Debug, clap::Args)]
#[command(after_help = "Example:\n  physgrad animate runs/one --sample 7")]
pub struct Animate {
    /// Folder of a run or of a comparison; for a comparison, animate every run, with one scale per
    /// scene
    pub folder: PathBuf,
    /// Index of the test initial state, from 0
    #[arg(long, value_name = "N", default_value_t = 0)]
    pub sample: usize,
    /// Folder for the animations, for example if that of the run is read-only; has the subfolders of
    /// a comparison [default: the folder of each run]
    #[arg(short, long, value_name = "DIR")]
    pub out: Option<PathBuf>,
    /// Print only warnings and errors
    #[arg(short, long)]
    pub quiet: bool,
}

/// Runs the command.
pub fn animate(args: &Animate) -> Result<()> {
    for scene in saved::scenes(&Folder::existing(&args.folder)?)? {
        let to = |run: &Folder| match &args.out {
            Some(out) => {
                Folder::at(out.join(run.path().strip_prefix(&args.folder).unwrap_or(run.path())))
            }
            None => run.clone(),
        };
        let drawn: Vec<Folder> = scene.runs.iter().map(to).collect();
        draw(&scene.runs, args.sample, &drawn)?;
        for folder in drawn.iter().filter(|_| !args.quiet) {
            print_result(&folder.file(ANIMATION).display().to_string())?;
        }
    }
    Ok(())
}

/// Writes the animation of each run of one scene, with one scale, to the folder of equal index in
/// `to`.
pub fn draw(runs: &[Folder], sample: usize, to: &[Folder]) -> Result<()> {
    let animations = parallel::map(runs, |folder| animation(folder, sample));
    let mut animations = animations.into_iter().collect::<Result<Vec<_>>>()?;
    Animation::share_scale(&mut animations.iter_mut().collect::<Vec<_>>());
    to.iter().zip(&animations).try_for_each(|(folder, animation)| {
        folder.create()?;
        folder.write(ANIMATION, animation.to_svg())
    })
}

fn animation(folder: &Folder, sample: usize) -> Result<Animation> {
    let scene = saved::scene(folder)?;
    let mut run = scene.open(1)?;
    saved::restore(folder, &scene, &mut *run)?;
    let samples = run.test_samples();
    if sample >= samples {
        bail!(
            "--sample is {sample}; allowed: 0 to {}, the test initial states of {}",
            samples - 1,
            folder.path().display()
        );
    }
    Ok(scene.animation(&run.rollouts(sample..sample + 1)[0]))
}
