//! `physgrad compare`: the same training along several fields and seeds, side by side.

use super::folder::{CHECKPOINT, Folder, SETTINGS};
use super::run::{self, Finished, Watch};
use super::scene::{Scene, with_scene};
use super::settings::{FieldName, Settings};
use super::train::{Changes, Progress, threads};
use anyhow::{Context, Result, bail};
use comfy_table::Table;
use comfy_table::presets::UTF8_FULL_CONDENSED;
use physgrad::report::{Curve, Point, comparison, field_color};
use physgrad::{Field, Record, Skip};
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

/// One field and seed.
struct Run<S: Scene> {
    field: Field,
    seed: u64,
    folder: Folder,
    settings: Settings<S>,
    records: Vec<Record>,
}

fn compare_scene<S: Scene>(args: &Compare) -> Result<()> {
    if args.seeds == 0 {
        bail!("--seeds is 0; allowed: 1 or more");
    }
    if args.changes.field.is_some() {
        bail!("a comparison has --fields, not --field");
    }
    let mut runs = plan::<S>(args)?;
    threads(args.threads)?;
    let total = runs.iter().map(|r| r.settings.epochs).sum();
    let progress = Mutex::new(Progress::new(total, args.quiet));
    if !args.quiet {
        eprintln!(
            "{}: {} runs of {} epochs on {} threads",
            S::NAME,
            runs.len(),
            runs[0].settings.epochs,
            rayon::current_num_threads()
        );
    }
    let outcomes: Vec<Result<Finished>> = runs
        .par_iter()
        .map(|run| {
            let mut watch = Watched { progress: &progress, label: format!("{} seed {}", run.field.letter(), run.seed) };
            let resume = run.folder.has(SETTINGS) && run.folder.has(CHECKPOINT);
            // One thread a run: the runs themselves fill the cores.
            run::run(&run.folder, &run.settings, 1, resume, &mut watch).with_context(|| format!("the run {}", watch.label))
        })
        .collect();
    if let Ok(progress) = progress.lock() {
        progress.bar.finish_and_clear();
    }
    let mut interrupted = false;
    let mut failed = None;
    for (run, outcome) in runs.iter_mut().zip(outcomes) {
        match outcome {
            Ok(finished) => {
                interrupted |= finished.interrupted;
                run.records = finished.records;
            }
            Err(error) => failed = failed.or(Some(error)),
        }
    }
    let folder = Folder::create(
        runs[0].folder.path().parent().and_then(|p| p.parent()).context("a run lies in the comparison's folder")?,
    )?;
    if interrupted {
        println!("interrupted; the same command with --out {} goes on", folder.path().display());
        return Ok(());
    }
    runs.retain(|run| !run.records.is_empty());
    folder.write("summary.csv", summary(&runs)?)?;
    folder.write("curves.svg", comparison(&title(&runs), &curves(&runs)))?;
    if !args.quiet && !runs.is_empty() {
        println!("{}", table(&runs));
        println!("results in {}: summary.csv, curves.svg, and every run in runs/", folder.path().display());
    }
    failed.map_or(Ok(()), Err)
}

/// Every run with its folder and settings.
fn plan<S: Scene>(args: &Compare) -> Result<Vec<Run<S>>> {
    let mut table = Settings::<S>::defaults().to_table();
    args.changes.apply(&mut table)?;
    let base = Settings::<S>::from_table(table)?;
    let folder = match &args.out {
        Some(path) => Folder::create(path)?,
        None => Folder::fresh(&format!("compare-{}", S::NAME))?,
    };
    let each = args.fields.iter().flat_map(|&field| (0..args.seeds).map(move |k| (field, k)));
    each.map(|(field, k)| {
        let seed = base.seed + k;
        let settings = Settings { field, seed, ..base.clone() };
        let folder = Folder::create(&folder.file("runs").join(format!("{}-{seed}", field.0.letter())))?;
        Ok(Run { field: field.0, seed, folder, settings, records: Vec::new() })
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

    fn epoch(&mut self, record: &Record, skips: &[Skip]) {
        if let Ok(mut progress) = self.progress.lock() {
            progress.advance(format!("{}: test {:.3e}", self.label, record.test_loss), skips);
        }
    }
}

fn best(records: &[Record]) -> f64 {
    records.iter().map(|r| r.test_loss).fold(f64::INFINITY, f64::min)
}

fn seconds(records: &[Record]) -> f64 {
    records.iter().map(|r| r.seconds).sum()
}

/// `summary.csv`: one row a run.
fn summary<S: Scene>(runs: &[Run<S>]) -> Result<Vec<u8>> {
    let mut csv = csv::Writer::from_writer(Vec::new());
    csv.write_record(["field", "seed", "final_train_loss", "final_test_loss", "best_test_loss", "seconds"])?;
    for run in runs {
        if let Some(last) = run.records.last() {
            let numbers = [last.train_loss, last.test_loss, best(&run.records), seconds(&run.records)].map(|x| x.to_string());
            csv.write_record([run.field.letter().to_owned(), run.seed.to_string()].into_iter().chain(numbers))?;
        }
    }
    Ok(csv.into_inner()?)
}

/// The runs of one field after the other.
fn by_field<S: Scene>(runs: &[Run<S>]) -> impl Iterator<Item = (Field, &[Run<S>])> {
    runs.chunk_by(|a, b| a.field == b.field).map(|runs| (runs[0].field, runs))
}

fn title<S: Scene>(runs: &[Run<S>]) -> String {
    let seeds = by_field(runs).map(|(_, runs)| runs.len()).max().unwrap_or(0);
    format!("{}, {seeds} seed{}", S::NAME, if seeds == 1 { "" } else { "s" })
}

fn curves<S: Scene>(runs: &[Run<S>]) -> Vec<Curve> {
    let points = |run: &Run<S>| {
        let elapsed = run.records.iter().scan(0.0, |sum, r| {
            *sum += r.seconds;
            Some(*sum)
        });
        run.records.iter().zip(elapsed).map(|(r, seconds)| Point { epoch: r.epoch as f64, seconds, loss: r.test_loss }).collect()
    };
    let curve = |(field, runs): (Field, &[Run<S>])| Curve {
        label: format!("{} ({field})", field.letter()),
        color: field_color(field.letter()),
        runs: runs.iter().map(points).collect(),
    };
    by_field(runs).map(curve).collect()
}

/// Medians over the seeds.
fn table<S: Scene>(runs: &[Run<S>]) -> Table {
    let mut table = Table::new();
    table.load_style(UTF8_FULL_CONDENSED).set_header([
        "field",
        "seeds",
        "median final test loss",
        "lowest",
        "highest",
        "median best",
        "median seconds",
    ]);
    for (field, runs) in by_field(runs) {
        let sorted = |value: &dyn Fn(&Run<S>) -> f64| {
            let mut values: Vec<f64> = runs.iter().map(value).collect();
            values.sort_by(f64::total_cmp);
            values
        };
        let last = sorted(&|r| r.records.last().map_or(f64::NAN, |r| r.test_loss));
        table.add_row([
            field.to_string(),
            runs.len().to_string(),
            format!("{:.3e}", median(&last)),
            format!("{:.3e}", last[0]),
            format!("{:.3e}", last[last.len() - 1]),
            format!("{:.3e}", median(&sorted(&|r| best(&r.records)))),
            format!("{:.1}", median(&sorted(&|r| seconds(&r.records)))),
        ]);
    }
    table
}

fn median(sorted: &[f64]) -> f64 {
    let n = sorted.len();
    if n % 2 == 1 { sorted[n / 2] } else { 0.5 * (sorted[n / 2 - 1] + sorted[n / 2]) }
}
