//! `physgrad compare`: the same training along several fields and seeds, side by side.

use super::changes::{Changes, changed_settings, check_resumable};
use super::folder::{Folder, RUNS};
use super::run::{self, Finished, Watch};
use super::saved;
use super::scene::{Scene, with_scene};
use super::settings::{FieldName, Settings};
use super::statistics::{self, Outcome, by_field, curves};
use super::terminal::{Progress, say};
use super::train::{best, threads};
use anyhow::{Context, Result, bail};
use comfy_table::Table;
use comfy_table::presets::UTF8_FULL_CONDENSED;
use physgrad::report::comparison;
use physgrad::{Divergence, Field, Record, Skip};
use rayon::prelude::*;
use std::path::PathBuf;
use std::sync::Mutex;

/// Train along several fields and seeds, and compare.
#[derive(Debug, clap::Args)]
pub struct Compare {
    /// The task; see `physgrad tasks`
    pub task: String,
    /// Fields to compare
    #[arg(long, value_delimiter = ',', default_value = "R,M,S,C", value_parser = |name: &str| name.parse().map(FieldName))]
    pub fields: Vec<FieldName>,
    /// Number of seeds, counted from --seed
    #[arg(long, value_name = "K", default_value_t = 3)]
    pub seeds: u64,
    #[command(flatten)]
    pub changes: Changes,
    /// Number of threads, one run each [default: RAYON_NUM_THREADS, or all cores]
    #[arg(long, value_name = "N")]
    pub threads: Option<usize>,
    /// Folder for the results; runs that are already there are taken up where they stopped [default: a new one in `runs`]
    #[arg(long, value_name = "DIR")]
    pub out: Option<PathBuf>,
    /// Print nothing but errors
    #[arg(long)]
    pub quiet: bool,
}

/// Runs the command.
pub fn compare(args: &Compare) -> Result<()> {
    with_scene!(args.task.as_str(), S => compare_scene::<S>(args))
}

/// One field and seed, and what came of it.
struct Run<S: Scene> {
    field: Field,
    seed: u64,
    folder: Folder,
    settings: Settings<S>,
    records: Vec<Record>,
    broken: bool,
}

impl<S: Scene> Run<S> {
    fn label(&self) -> String {
        format!("{} seed {}", self.field.letter(), self.seed)
    }

    /// Goes on where an earlier comparison stopped; that must have been the same run.
    fn resumes(&self) -> Result<bool> {
        if !saved::has_run(&self.folder) {
            return Ok(false);
        }
        check_resumable(&self.folder, &self.settings).map(|()| true)
    }

    fn outcome(&self) -> Outcome<'_> {
        Outcome { field: self.field, seed: self.seed, records: &self.records, broken: self.broken }
    }
}

fn compare_scene<S: Scene>(args: &Compare) -> Result<()> {
    let base = changed_settings::<S>(&args.changes)?;
    let fields = fields(args)?;
    threads(args.threads)?;
    let folder = match &args.out {
        Some(path) => Folder::create(path)?,
        None => Folder::fresh(&format!("compare-{}", S::NAME))?,
    };
    let mut runs = plan(&base, &fields, args.seeds, &folder)?;
    let resumes = runs.iter().map(Run::resumes).collect::<Result<Vec<bool>>>()?;
    let total = runs.iter().map(|r| r.settings.epochs).sum();
    let progress = Mutex::new(Progress::new(total, args.quiet));
    if !args.quiet {
        eprintln!("{}: {} runs of {} epochs on {} threads", S::NAME, runs.len(), base.epochs, rayon::current_num_threads());
    }
    let outcomes: Vec<Result<Finished>> = runs
        .par_iter()
        .zip(resumes)
        .map(|(run, resume)| {
            let mut watch = Watched { progress: &progress, label: run.label() };
            // One thread a run: the runs themselves fill the cores.
            run::run(&run.folder, &run.settings, 1, resume, &mut watch)
        })
        .collect();
    if let Ok(progress) = progress.lock() {
        progress.bar.finish_and_clear();
    }

    let (mut interrupted, mut failures) = (false, Vec::new());
    for (run, outcome) in runs.iter_mut().zip(outcomes) {
        let broken = outcome.map(|finished| {
            interrupted |= finished.interrupted;
            run.records = finished.records;
            finished.broken
        });
        let failure = match broken {
            Ok(None) => continue,
            Ok(Some(error)) => error.to_string(),
            Err(error) => format!("{error:#}"),
        };
        run.broken = true;
        failures.push(format!("{}: {failure}", run.label()));
    }
    if interrupted {
        say(&format!("interrupted; the same command with --out {} goes on", folder.path().display()));
    } else {
        let outcomes: Vec<Outcome> = runs.iter().map(Run::outcome).collect();
        folder.write("summary.csv", summary(&outcomes)?)?;
        folder.write("curves.svg", comparison(&title(S::NAME, &outcomes), &curves(&outcomes, |r| r.test_loss)).to_svg())?;
        if !args.quiet {
            let files = "summary.csv, curves.svg, and every run in runs/";
            say(&format!("{}\nresults in {}: {files}", table(&outcomes), folder.path().display()));
        }
    }
    if failures.is_empty() {
        return Ok(());
    }
    bail!("{} of {} runs broke off:\n{}", failures.len(), runs.len(), failures.join("\n"))
}

/// The fields asked for, each once.
fn fields(args: &Compare) -> Result<Vec<FieldName>> {
    if args.seeds == 0 {
        bail!("--seeds is 0; allowed: 1 or more");
    }
    if args.changes.field.is_some() || args.changes.set.iter().any(|set| set.trim_start().starts_with("field")) {
        bail!("a comparison has --fields, not a single field");
    }
    for (i, field) in args.fields.iter().enumerate() {
        if args.fields[..i].contains(field) {
            bail!("--fields names {} twice", field.0);
        }
    }
    Ok(args.fields.clone())
}

/// Every run with its folder and settings.
fn plan<S: Scene>(base: &Settings<S>, fields: &[FieldName], seeds: u64, folder: &Folder) -> Result<Vec<Run<S>>> {
    let last = base.seed.checked_add(seeds - 1).filter(|&last| i64::try_from(last).is_ok());
    let last = last.with_context(|| format!("{seeds} seeds from {} on are more than there are", base.seed))?;
    let each = fields.iter().flat_map(|&field| (base.seed..=last).map(move |seed| (field, seed)));
    each.map(|(field, seed)| {
        let settings = Settings { field, seed, ..base.clone() };
        let folder = Folder::create(&folder.file(RUNS).join(format!("{}-{seed}", field.0.letter())))?;
        Ok(Run { field: field.0, seed, folder, settings, records: Vec::new(), broken: false })
    })
    .collect()
}

/// Tells one bar of the epochs of all runs.
struct Watched<'a> {
    progress: &'a Mutex<Progress>,
    label: String,
}

impl Watch for Watched<'_> {
    fn resumed(&mut self, epochs: usize) {
        if let Ok(progress) = self.progress.lock() {
            progress.bar.inc(epochs as u64);
        }
    }

    fn epoch(&mut self, record: &Record, skips: &[Skip], diverged: [Option<Divergence>; 2]) {
        if let Ok(mut progress) = self.progress.lock() {
            progress.advance(format!("{}: test {:.3e}", self.label, record.test_loss));
            progress.trouble(&format!("{}, ", self.label), record, skips, diverged);
        }
    }
}

/// `summary.csv`: one row a run; a run that broke off has no final losses.
fn summary(runs: &[Outcome]) -> Result<Vec<u8>> {
    let mut csv = csv::Writer::from_writer(Vec::new());
    csv.write_record(["field", "seed", "final_train_loss", "final_test_loss", "best_test_loss", "seconds"])?;
    for run in runs {
        let numbers = [run.last(|r| r.train_loss), run.last(|r| r.test_loss), best(run.records), run.seconds()];
        let names = [run.field.letter().to_owned(), run.seed.to_string()];
        csv.write_record(names.into_iter().chain(numbers.map(|x| x.to_string())))?;
    }
    Ok(csv.into_inner()?)
}

fn title(task: &str, runs: &[Outcome]) -> String {
    let seeds = by_field(runs).map(|(_, runs)| runs.len()).max().unwrap_or(0);
    format!("{task}, {seeds} seed{}", if seeds == 1 { "" } else { "s" })
}

fn table(runs: &[Outcome]) -> Table {
    let mut table = Table::new();
    table.load_style(UTF8_FULL_CONDENSED).set_header(statistics::TABLE_HEADER);
    table.add_rows(statistics::table(runs));
    table
}
