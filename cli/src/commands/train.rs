//! `physgrad train`: one training run with progress output.

use crate::operations::session::AnyRun;
use crate::platform::folder::Folder;
use crate::platform::json::print_json;
use crate::platform::ranks::launched;
use crate::platform::terminal::{counted, print_message, print_note, print_text, program};
use crate::runs::metrics;
use crate::runs::progress::Progress;
use crate::runs::run::{self, End, Finished, NoUpdate, SAVE_EVERY};
use crate::runs::saved::resumed;
use crate::runs::statistics::best;
use crate::scenes::overrides::Overrides;
use crate::scenes::presets;
use crate::scenes::source::SceneSource;
use crate::tasks::Scene;
use anyhow::{Context, Result, anyhow, bail};
use physgrad::Policy as _;
use physgrad::engine::{Ranks, ranks};
use physgrad::text::{digits, short};
use physgrad::train::{Record, differences};
use serde_json::json;
use std::collections::BTreeMap;
use std::path::PathBuf;
use std::sync::Arc;
use std::time::Duration;

/// Train a policy on a task.
#[derive(Debug, clap::Args)]
#[command(
    after_help = "Examples:\n  physgrad train cart_pole --field C --epochs 300 -o runs/one\n  physgrad train cart_pole --resume --epochs 600 -o runs/one\n  physgrad train my_scene.toml --set training.learning_rate=0.003 --without gusty_wind"
)]
pub struct Train {
    /// A task or another preset (see `physgrad scene`), or the path of a scene; optional with
    /// --resume
    #[arg(required_unless_present = "resume")]
    pub scene: Option<String>,
    #[command(flatten)]
    pub overrides: Overrides,
    /// Number of threads of each rank [default: RAYON_NUM_THREADS, or all cores]; results do not
    /// depend on it
    #[arg(long, value_name = "N")]
    pub threads: Option<usize>,
    /// Folder for the results; an earlier run in it is moved, unless --resume is given [default: a
    /// new one in `runs`]
    #[arg(short, long, value_name = "DIR")]
    pub out: Option<PathBuf>,
    /// Resume the run in --out, up to --epochs in total
    #[arg(long, requires = "out")]
    pub resume: bool,
    /// Largest time between two checkpoints, in seconds, from 0 to 86400: bounds the work lost if
    /// the process is killed; checkpoints follow updates and evaluations
    #[arg(long, value_name = "SECONDS", default_value_t = SAVE_EVERY.as_secs_f64(), value_parser = seconds)]
    pub save_every: f64,
    /// Print only warnings and errors
    #[arg(short, long)]
    pub quiet: bool,
    /// Print the result as one JSON object; messages stay on standard error (docs/runs.md)
    #[arg(long)]
    pub json: bool,
}

/// Runs the command.
pub fn train(args: &Train) -> Result<()> {
    let workers = rayon::current_num_threads();
    let ranks = launched()?;
    let ranks = ranks.as_ref();
    // Reports invalid settings before writing anything.
    let (scene, mut run, note) = agreed(ranks, open(args, workers))?;
    if let Some(ranks) = ranks.filter(|ranks| ranks.rank() > 0) {
        return run::follow(&scene, &mut *run, ranks)
            .with_context(|| format!("rank {}", ranks.rank()));
    }
    let folder = match (&args.out, args.resume) {
        (Some(out), true) => Folder::existing(out)?.lock()?,
        (out, _) => {
            let name = presets::short_name(args.scene.as_deref().unwrap_or_default());
            Folder::named(out.as_deref(), &name)?.without_run()?
        }
    };
    let mut progress = Progress::new(scene.epochs, args.quiet);
    if !args.quiet {
        note.iter().for_each(|note| print_message(note));
        print_message(&description(&scene, workers, ranks));
        scene.notes().iter().for_each(|note| print_message(note));
    }
    let save_every = Duration::from_secs_f64(args.save_every);
    let finished =
        run::run(&folder, &scene, &mut *run, args.resume, save_every, ranks, &mut progress)?;
    progress.finish();
    let printed = match (args.json, args.quiet) {
        (true, _) => print_json(&object(&folder, &scene, &finished)),
        (false, true) => Ok(()),
        (false, false) => print_text(&summary(&folder, &scene, &finished)?),
    };
    let results = folder.path().display();
    match finished.end {
        End::Complete => printed,
        End::Interrupted => {
            print_how_to_resume(&folder, finished.records.len(), args.json);
            Ok(())
        }
        End::NoUpdate(error) => {
            let reason = error.map_or_else(String::new, |error| format!(" ({error:#})"));
            bail!(NoUpdate(format!("{results}{reason}")))
        }
        End::Failed(error) => Err(error)
            .with_context(|| format!("the run up to its last complete epoch is in {results}")),
    }
}

/// Description of the training before it starts: task, field, seed, precision, threads and ranks.
fn description(scene: &Scene, workers: usize, ranks: Option<&Arc<dyn Ranks>>) -> String {
    format!(
        "{} ({}): field {}, seed {}, {}, {workers} thread{}{}",
        scene.task.name(),
        scene.task.about(),
        scene.field.0,
        scene.seed,
        scene.precision.name(),
        if workers == 1 { "" } else { "s" },
        ranks.map_or_else(String::new, |ranks| format!(" on each of {} ranks", ranks.count()))
    )
}

/// Prints the command that resumes the run in a folder, interrupted after `done` epochs.
fn print_how_to_resume(folder: &Folder, done: usize, json: bool) {
    let command = format!("{} train --resume --out {}", program(), folder.path().display());
    // Ignores errors: the terminal may be closed, and the signal determines the exit status.
    let text = format!("interrupted after epoch {done}; to resume:\n{command}");
    let _ = print_note(&text, json);
}

/// A scene with its session, and a note on settings of a resumed run.
type Opened = (Scene, Box<dyn AnyRun>, Option<String>);

/// Reads the scene, or the settings of the run to resume, and opens a session.
fn open(args: &Train, workers: usize) -> Result<Opened> {
    let mut note = None;
    let scene = match (&args.out, args.resume) {
        (Some(out), true) => {
            let folder = Folder::existing(out)?;
            let scene = resumed(&folder, &args.overrides)?;
            if let Some(name) = &args.scene {
                note = check_scene(&folder, &scene, name, &args.overrides)?;
            }
            scene
        }
        _ => {
            let mut source = presets::source(args.scene.as_deref().context("name a scene")?)?;
            args.overrides.apply(&mut source)?;
            let scene = source.scene()?;
            scene.check_field().map_err(|error| source.located(&error))?;
            scene
        }
    };
    let run = scene.open(workers)?;
    Ok((scene, run, note))
}

/// Checks that every rank has opened a session with equal settings.
///
/// # Errors
/// On the first rank with an error, or else on the first with other settings than rank 0. Other
/// ranks wait until that rank ends them, so that one rank prints the error.
fn agreed(ranks: Option<&Arc<dyn Ranks>>, opened: Result<Opened>) -> Result<Opened> {
    let Some(ranks) = ranks else { return opened };
    let settings =
        |(scene, ..): &Opened| format!("epochs = {}\n{}", scene.epochs, scene.identity());
    let messages =
        ranks::gather(&**ranks, opened.as_ref().map_or(String::new(), settings).as_bytes());
    let failed = messages.iter().position(Vec::is_empty);
    let unlike = || messages.iter().position(|message| *message != messages[0]);
    match failed.or_else(unlike) {
        None => opened,
        Some(rank) if rank == ranks.rank() => {
            let unlike = |_| {
                Err(anyhow!(
                    "its settings differ from those of rank 0; give all ranks the same scene and options"
                ))
            };
            opened.and_then(unlike).with_context(|| format!("rank {rank}"))
        }
        Some(_) => loop {
            std::thread::park();
        },
    }
}

/// Parses a number of seconds from 0 to 86400 (one day).
fn seconds(text: &str) -> Result<f64, String> {
    let allowed = |seconds: &f64| (0.0..=86400.0).contains(seconds);
    text.parse()
        .ok()
        .filter(allowed)
        .ok_or_else(|| "allowed: 0 (after every update) to 86400 s".to_owned())
}

/// Checks that a named scene has the task of the resumed run. Returns a note on the settings that
/// differ between a scene file and the run, if any.
fn check_scene(
    folder: &Folder,
    scene: &Scene,
    file: &str,
    overrides: &Overrides,
) -> Result<Option<String>> {
    let mut source = presets::source(file)?;
    // The run has a copy of its initial policy, so the file may be gone.
    let named_scene = |source: &SceneSource| {
        source.scene().or_else(|_| source.starting_from(scene.initial_policy()))
    };
    let [named, saved] = [named_scene(&source)?.task.name(), scene.task.name()];
    if named != saved {
        let folder = folder.path().display();
        bail!(
            "the run in {folder} has the task {saved}, but {file} has the task {named}; name a scene of {saved}"
        );
    }
    if !presets::is_path(file) {
        return Ok(None);
    }
    overrides.apply_again(&mut source)?;
    let (saved, named) = (scene.identity(), named_scene(&source)?.identity());
    let note = || {
        let (folder, differences) = (folder.path().display(), differences(&saved, &named));
        format!(
            "note: the run in {folder} resumes with its saved settings; {file} differs in:\n{differences}"
        )
    };
    Ok((saved != named).then(note))
}

/// Result of `--json`.
fn object(
    folder: &Folder,
    scene: &Scene,
    Finished { records, numbers, end }: &Finished,
) -> serde_json::Value {
    let last = |loss: fn(&Record) -> f64| records.last().map(loss);
    json!({
        "folder": folder.path(),
        "task": scene.task.name(),
        "field": scene.field.0.letter(),
        "seed": scene.seed,
        "epochs": records.len(),
        "end": match end {
            End::Complete => "complete",
            End::Interrupted => "interrupted",
            End::Failed(_) => "failed",
            End::NoUpdate(_) => "no update",
        },
        "train_loss": last(|record| record.train_loss),
        "test_loss": last(|record| record.test_loss),
        "best_test_loss": best(records),
        "length": records.last().and_then(|record| record.length),
        // A sum of no numbers would be -0.
        "seconds": records.iter().fold(0.0, |sum, record| sum + record.seconds),
        "skipped": records.iter().map(|record| record.skipped).sum::<usize>(),
        "numbers": numbers.iter().cloned().collect::<BTreeMap<_, _>>(),
    })
}

fn summary(
    folder: &Folder,
    scene: &Scene,
    Finished { records, numbers, .. }: &Finished,
) -> Result<String> {
    let mut text = String::new();
    if let Some(last) = records.last() {
        let seconds: f64 = records.iter().map(|r| r.seconds).sum();
        let [train, test, best] = [last.train_loss, last.test_loss, best(records)].map(short);
        let epochs = counted(records.len(), "epoch");
        let length = |length| format!(", {} of {} steps on average", short(length), scene.horizon);
        let length = last.length.map_or_else(String::new, length);
        text += &format!(
            "{epochs} in {seconds:.1} s: training loss {train}, test loss {test} (best {best}){length}\n"
        );
        let skipped: usize = records.iter().map(|r| r.skipped).sum();
        if skipped > 0 {
            text += &format!(
                "skipped because a number was non-finite: {}\n",
                counted(skipped, "update")
            );
        }
    }
    if records.is_empty() {
        text += match scene.policy().param_count() {
            0 => "no epoch: the losses of the policy, which has nothing to train, are unknown\n",
            _ => "no epoch: the policy is untrained\n",
        };
    }
    let ranges = scene.trained_numbers().into_iter().map(|number| number.map.bounds());
    let known = scene.starts_of_numbers()?.into_iter().zip(ranges);
    for ((name, value), (start, [low, high])) in numbers.iter().zip(known) {
        let bounds = match [low, high].map(f64::is_finite) {
            [true, true] => format!(", between {low} and {high}"),
            [true, false] => format!(", above {low}"),
            _ => String::new(),
        };
        let [value, start] = [*value, start].map(|value| digits(value, 6));
        text += &format!("trained: {name} = {value} (start {start}{bounds})\n");
    }
    text += &format!("results in {}:\n", folder.path().display());
    text += "  learning_curve.svg, animation.svg   pictures\n";
    text += "  metrics.csv, trajectory.csv         data\n";
    for &format in &scene.logs {
        text += &format!("  {:<36}metrics, for other tools\n", metrics::file(format));
    }
    text += "  policy.safetensors                  the trained policy\n";
    text += "  best_policy.safetensors             the policy with the lowest test loss\n";
    if !numbers.is_empty() {
        text += "  numbers.csv                         the trained numbers\n";
    }
    text += "  run.toml, checkpoint.bin            settings and state, to resume";
    Ok(text)
}
