//! `physgrad train`: one run, watched.

use super::changes::{Changes, changed_settings, resumed_settings};
use super::folder::Folder;
use super::run::{self, threads};
use super::scene::{Scene, with_scene};
use super::statistics::best;
use super::terminal::{Progress, say};
use anyhow::{Context, Result};
use physgrad::Record;
use std::path::PathBuf;

/// Train a policy on a task.
#[derive(Debug, clap::Args)]
pub struct Train {
    /// The task; see `physgrad tasks`
    pub task: String,
    #[command(flatten)]
    pub changes: Changes,
    /// Number of threads [default: RAYON_NUM_THREADS, or all cores]; results do not depend on it
    #[arg(long, value_name = "N")]
    pub threads: Option<usize>,
    /// Folder for the results [default: a new one in `runs`]
    #[arg(long, value_name = "DIR")]
    pub out: Option<PathBuf>,
    /// Go on with the run in --out, up to --epochs in all
    #[arg(long, requires = "out")]
    pub resume: bool,
    /// Print nothing but errors
    #[arg(long)]
    pub quiet: bool,
}

/// Runs the command.
pub fn train(args: &Train) -> Result<()> {
    with_scene!(args.task.as_str(), S => train_scene::<S>(args))
}

fn train_scene<S: Scene>(args: &Train) -> Result<()> {
    let workers = threads(args.threads)?;
    let (folder, settings) = match (&args.out, args.resume) {
        (Some(out), true) => {
            let folder = Folder::create(out)?;
            let settings = resumed_settings::<S>(&folder, &args.changes)?;
            (folder, settings)
        }
        (out, _) => {
            let settings = changed_settings::<S>(&args.changes)?;
            let folder = out.as_deref().map_or_else(|| Folder::fresh(S::NAME), Folder::create)?;
            if let Some(aside) = folder.move_aside()? {
                eprintln!("{} held another run; it is now in {}", folder.path().display(), aside.display());
            }
            (folder, settings)
        }
    };
    let mut progress = Progress::new(settings.epochs, args.quiet);
    if !args.quiet {
        eprintln!(
            "{} ({}): field {}, seed {}, {}, {workers} thread{}",
            S::NAME,
            S::ABOUT,
            settings.field.0,
            settings.seed,
            settings.precision.name(),
            if workers == 1 { "" } else { "s" }
        );
    }
    let finished = run::run(&folder, &settings, workers, args.resume, &mut progress)?;
    progress.bar.finish_and_clear();
    if !args.quiet {
        say(&summary(&folder, &finished.records));
    }
    if finished.interrupted {
        let done = finished.records.len();
        let command = format!("physgrad train {} --resume --out {}", S::NAME, folder.path().display());
        say(&format!("interrupted after epoch {done}; to go on: {command}"));
    }
    match finished.broken {
        Some(error) => {
            Err(error).with_context(|| format!("the run up to its last whole epoch is in {}", folder.path().display()))
        }
        None => Ok(()),
    }
}

fn summary(folder: &Folder, records: &[Record]) -> String {
    let mut text = String::new();
    if let Some(last) = records.last() {
        let seconds: f64 = records.iter().map(|r| r.seconds).sum();
        let (train, test, best) = (last.train_loss, last.test_loss, best(records));
        let epochs = records.len();
        text +=
            &format!("{epochs} epochs in {seconds:.1} s: training loss {train:.3e}, test loss {test:.3e} (best {best:.3e})\n");
        let skipped: usize = records.iter().map(|r| r.skipped).sum();
        if skipped > 0 {
            text += &format!("{skipped} updates were skipped because a number was not finite\n");
        }
    }
    text += &format!("results in {}:\n", folder.path().display());
    text += "  learning_curve.svg, animation.svg   to look at\n";
    text += "  metrics.csv, trajectory.csv         numbers\n";
    text += "  policy.safetensors                  the trained policy\n";
    text += "  run.toml, checkpoint.bin            to repeat or resume";
    text
}
