//! `physgrad train`: one run, watched.

use super::folder::{CHECKPOINT, Folder, SETTINGS};
use super::run::{self, Watch};
use super::scene::{Scene, with_scene};
use super::settings::{self, FieldName, Precision, Settings};
use anyhow::{Context, Result, bail};
use indicatif::{ProgressBar, ProgressDrawTarget, ProgressStyle};
use physgrad::{Record, Skip};
use std::path::{Path, PathBuf};
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
            settings::set(table, assignment)?;
        }
        let named = [
            ("field", self.field.map(|f| Value::String(f.into()))),
            ("epochs", self.epochs.map(|e| integer("--epochs", e as u64)).transpose()?),
            ("seed", self.seed.map(|s| integer("--seed", s)).transpose()?),
            ("precision", self.precision.map(Value::try_from).transpose()?),
        ];
        for (key, value) in named {
            if let Some(value) = value {
                settings::put(table, key, value)?;
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
    let (folder, settings) = if let (Some(out), true) = (&args.out, args.resume) {
        let folder = Folder::create(out)?;
        let settings = resumed_settings::<S>(&folder, &args.changes)?;
        (folder, settings)
    } else {
        let mut table = Settings::<S>::defaults().to_table();
        args.changes.apply(&mut table)?;
        let settings = Settings::<S>::from_table(table)?;
        let folder = args.out.as_deref().map_or_else(|| Folder::fresh(S::NAME), Folder::create)?;
        if let Some(aside) = folder.move_aside()? {
            eprintln!("{} held another run; it is now in {}", folder.path().display(), aside.display());
        }
        (folder, settings)
    };
    let workers = threads(args.threads)?;
    let mut progress = Progress::new(settings.epochs, args.quiet);
    if !args.quiet {
        eprintln!(
            "{} ({}): field {}, seed {}, {:?}, {workers} thread{}",
            S::NAME,
            S::ABOUT,
            settings.field.0,
            settings.seed,
            settings.precision,
            if workers == 1 { "" } else { "s" }
        );
    }
    let finished = run::run(&folder, &settings, workers, args.resume, &mut progress)?;
    progress.bar.finish_and_clear();
    if args.quiet {
        return Ok(());
    }
    summary(&folder, &finished.records);
    if finished.interrupted {
        let done = finished.records.len();
        println!("interrupted after epoch {done}; to go on: physgrad train {} --resume --out {}", S::NAME, show(folder.path()));
    }
    Ok(())
}

/// The settings of the run in the folder; only the number of epochs may differ.
fn resumed_settings<S: Scene>(folder: &Folder, changes: &Changes) -> Result<Settings<S>> {
    if !folder.has(SETTINGS) || !folder.has(CHECKPOINT) {
        bail!("there is no run to resume in {}; without --resume, a new one starts there", folder.path().display());
    }
    let context = || format!("{} is not usable", folder.file(SETTINGS).display());
    let saved: Table = folder.read_text(SETTINGS)?.parse().with_context(context)?;
    if let Some(version) = saved.get("physgrad").and_then(Value::as_str)
        && version != env!("CARGO_PKG_VERSION")
    {
        let own = env!("CARGO_PKG_VERSION");
        bail!("this run was made by physgrad {version}, and this is {own}: its numbers would not be those of one run");
    }
    let saved = Settings::<S>::from_table(saved).with_context(context)?;
    let mut table = saved.to_table();
    changes.apply(&mut table)?;
    let settings = Settings::<S>::from_table(table)?;
    if settings.identity() != saved.identity() {
        bail!(
            "a resumed run keeps its settings (only --epochs may change). The run in {} was made with\n{}\nand asked for is\n{}",
            folder.path().display(),
            saved.identity(),
            settings.identity()
        );
    }
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

fn summary(folder: &Folder, records: &[Record]) {
    let Some(last) = records.last() else { return };
    let best = records.iter().map(|r| r.test_loss).fold(f64::INFINITY, f64::min);
    let seconds: f64 = records.iter().map(|r| r.seconds).sum();
    let skipped: usize = records.iter().map(|r| r.skipped).sum();
    println!(
        "{} epochs in {seconds:.1} s: training loss {:.3e}, test loss {:.3e} (best {best:.3e})",
        records.len(),
        last.train_loss,
        last.test_loss
    );
    if skipped > 0 {
        println!("{skipped} updates were skipped because a number was not finite");
    }
    println!("results in {}:", show(folder.path()));
    println!("  learning_curve.svg, animation.svg   to look at");
    println!("  metrics.csv, trajectory.csv         numbers");
    println!("  policy.safetensors                  the trained policy");
    println!("  run.toml, checkpoint.bin            to repeat or resume");
}

fn show(path: &Path) -> std::path::Display<'_> {
    path.display()
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

    fn epoch(&mut self, record: &Record, skips: &[Skip]) {
        self.advance(format!("train {:.3e}  test {:.3e}", record.train_loss, record.test_loss), skips);
    }
}

impl Progress {
    /// One more epoch.
    pub fn advance(&mut self, message: String, skips: &[Skip]) {
        self.bar.set_message(message);
        self.bar.inc(1);
        if self.quiet {
            return;
        }
        let (done, all) = (self.bar.position(), self.bar.length().unwrap_or(0).max(1));
        if self.bar.is_hidden() && done * 10 / all != (done - 1) * 10 / all {
            eprintln!("epoch {done}/{all}: {}", self.bar.message());
        }
        if let Some(skip) = skips.first() {
            let (count, epoch, update) = (skips.len(), skip.epoch, skip.update);
            let text = format!("epoch {epoch}: {count} update(s) skipped, the first being update {update} ({})", skip.divergence);
            // Above the bar where there is one.
            if self.bar.is_hidden() { eprintln!("{text}") } else { self.bar.println(text) }
        }
    }
}
