//! `physgrad train`: one run, watched.

use super::folder::{CHECKPOINT, Folder, SETTINGS};
use super::run::{self, Watch};
use super::scene::{Scene, with_scene};
use super::settings::{self as settings_table, FieldName, Precision, Settings};
use anyhow::{Context, Result, bail};
use indicatif::{ProgressBar, ProgressDrawTarget, ProgressStyle};
use physgrad::{Divergence, Record, Skip, differences};
use std::io::Write;
use std::path::PathBuf;
use toml::{Table, Value};

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

/// What differs from a task's defaults.
#[derive(Clone, Debug, Default, clap::Args)]
pub struct Changes {
    /// Vector field to follow: combined, regular, modified, network, stopped (C, R, M, N, S)
    #[arg(long, value_parser = |name: &str| name.parse().map(FieldName))]
    pub field: Option<FieldName>,
    /// Epochs in all, those before a --resume included
    #[arg(long, value_name = "N")]
    pub epochs: Option<usize>,
    /// Seed of start states and initial parameters
    #[arg(long, value_name = "S")]
    pub seed: Option<u64>,
    /// Precision of all numbers
    #[arg(long, value_enum)]
    pub precision: Option<Precision>,
    /// Change a setting, for example system.poles=4; `physgrad tasks` lists them
    #[arg(long, value_name = "KEY=VALUE")]
    pub set: Vec<String>,
}

impl Changes {
    /// Makes the changes in a table of settings.
    pub fn apply(&self, table: &mut Table) -> Result<()> {
        for assignment in &self.set {
            settings_table::set(table, assignment)?;
        }
        let named = [
            ("field", self.field.map(|f| Value::String(f.into()))),
            ("epochs", self.epochs.map(|e| integer("--epochs", e as u64)).transpose()?),
            ("seed", self.seed.map(|s| integer("--seed", s)).transpose()?),
            ("precision", self.precision.map(Value::try_from).transpose()?),
        ];
        for (key, value) in named {
            if let Some(value) = value {
                settings_table::put(table, key, value)?;
            }
        }
        Ok(())
    }
}

/// TOML's integers are signed.
fn integer(option: &str, value: u64) -> Result<Value> {
    let value = i64::try_from(value).ok().with_context(|| format!("{option} is {value}; allowed: up to {}", i64::MAX))?;
    Ok(Value::Integer(value))
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
            let settings = settings::<S>(&args.changes)?;
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

/// A task's defaults with these changes.
pub fn settings<S: Scene>(changes: &Changes) -> Result<Settings<S>> {
    let mut table = Settings::<S>::defaults().to_table();
    changes.apply(&mut table)?;
    Settings::from_table(table)
}

/// Prints to the standard output. Who reads it may have stopped reading.
pub fn say(text: &str) {
    let _ = writeln!(std::io::stdout(), "{text}");
}

/// The settings of the run in the folder, which must be there.
fn saved_settings<S: Scene>(folder: &Folder) -> Result<Settings<S>> {
    if !folder.has(SETTINGS) || !folder.has(CHECKPOINT) {
        bail!("there is no run to resume in {}; without --resume, a new one starts there", folder.path().display());
    }
    let context = || format!("{} is not usable", folder.file(SETTINGS).display());
    let saved: Table = folder.read_text(SETTINGS)?.parse().with_context(context)?;
    let own = env!("CARGO_PKG_VERSION");
    if let Some(version) = saved.get("physgrad").and_then(Value::as_str).filter(|&version| version != own) {
        bail!("this run was made by physgrad {version}, and this is {own}: its numbers would not be those of one run");
    }
    Settings::from_table(saved).with_context(context)
}

/// An error unless the run in the folder has these settings; only the number of epochs may differ.
pub fn check_resumable<S: Scene>(folder: &Folder, settings: &Settings<S>) -> Result<()> {
    let saved = saved_settings::<S>(folder)?.identity();
    if settings.identity() != saved {
        bail!(
            "a resumed run keeps its settings (only the number of epochs may change); in {}, these differ:\n{}",
            folder.path().display(),
            differences(&saved, &settings.identity())
        );
    }
    Ok(())
}

/// The settings of the run in the folder, with these changes.
fn resumed_settings<S: Scene>(folder: &Folder, changes: &Changes) -> Result<Settings<S>> {
    let mut table = saved_settings::<S>(folder)?.to_table();
    changes.apply(&mut table)?;
    let settings = Settings::<S>::from_table(table)?;
    check_resumable(folder, &settings)?;
    Ok(settings)
}

/// Sets up the thread pool and says how many threads it has.
pub fn threads(asked: Option<usize>) -> Result<usize> {
    if let Some(threads) = asked {
        if threads == 0 {
            bail!("--threads is 0; allowed: 1 or more");
        }
        rayon::ThreadPoolBuilder::new().num_threads(threads).build_global()?;
    }
    Ok(rayon::current_num_threads())
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

/// The lowest test loss; NaN if there is none.
pub fn best(records: &[Record]) -> f64 {
    records.iter().map(|r| r.test_loss).fold(f64::NAN, f64::min)
}

/// A progress bar with the losses and the time left; ten lines of text where there is no terminal.
pub struct Progress {
    pub bar: ProgressBar,
    quiet: bool,
}

impl Progress {
    pub fn new(epochs: usize, quiet: bool) -> Self {
        let bar = ProgressBar::new(epochs as u64);
        if quiet {
            bar.set_draw_target(ProgressDrawTarget::hidden());
        }
        let style = ProgressStyle::with_template("{bar:30} epoch {pos}/{len}  {msg}  {elapsed} gone, {eta} left");
        bar.set_style(style.expect("a fixed template"));
        Self { bar, quiet }
    }
}

impl Watch for Progress {
    fn resumed(&mut self, epochs: usize) {
        self.bar.set_position(epochs as u64);
        self.bar.reset_eta();
        if !self.quiet {
            eprintln!("resumed after epoch {epochs}");
        }
    }

    fn epoch(&mut self, record: &Record, skips: &[Skip], diverged: [Option<Divergence>; 2]) {
        self.advance(format!("train {:.3e}  test {:.3e}", record.train_loss, record.test_loss));
        self.trouble("", record, skips, diverged);
    }
}

impl Progress {
    /// One more epoch.
    pub fn advance(&mut self, message: String) {
        self.bar.set_message(message);
        self.bar.inc(1);
        let (done, all) = (self.bar.position(), self.bar.length().unwrap_or(0).max(1));
        if !self.quiet && self.bar.is_hidden() && done * 10 / all != (done - 1) * 10 / all {
            eprintln!("epoch {done}/{all}: {}", self.bar.message());
        }
    }

    /// Says what was not finite in an epoch.
    pub fn trouble(&self, run: &str, record: &Record, skips: &[Skip], diverged: [Option<Divergence>; 2]) {
        let epoch = record.epoch;
        let skipped = skips.first().map(|skip| {
            let (count, update) = (skips.len(), skip.update);
            format!("{run}epoch {epoch}: {count} update(s) skipped, the first being update {update} ({})", skip.divergence)
        });
        let evaluated = ["training", "test"].into_iter().zip(diverged).filter_map(|(set, divergence)| {
            divergence.map(|divergence| format!("{run}epoch {epoch}: the {set} loss is not finite ({divergence})"))
        });
        for text in skipped.into_iter().chain(evaluated).filter(|_| !self.quiet) {
            // Above the bar where there is one.
            if self.bar.is_hidden() { eprintln!("{text}") } else { self.bar.println(text) }
        }
    }
}
