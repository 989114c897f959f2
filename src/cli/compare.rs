//! `physgrad compare`: the same training along several fields and seeds, side by side.

use super::changes::{Changes, changed_settings};
use super::folder::Folder;
use super::scene::{Scene, with_scene};
use super::settings::FieldName;
use super::statistics::{quantile, sorted};
use super::sweep::{Comparison, Run, sweep};
use super::terminal::say;
use super::train::{best, threads};
use anyhow::{Result, bail};
use comfy_table::Table;
use comfy_table::presets::UTF8_FULL_CONDENSED;
use physgrad::Field;
use physgrad::report::{self, Curve, Point, field_color};
use std::path::PathBuf;

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

fn compare_scene<S: Scene>(args: &Compare) -> Result<()> {
    if args.changes.field.is_some() || args.changes.set.iter().any(|set| set.trim_start().starts_with("field")) {
        bail!("a comparison has --fields, not a single field");
    }
    let base = changed_settings::<S>(&args.changes)?;
    threads(args.threads)?;
    let folder = match &args.out {
        Some(path) => Folder::create(path)?,
        None => Folder::fresh(&format!("compare-{}", S::NAME))?,
    };
    let mut comparisons = [Comparison::plan("", &base, &args.fields, args.seeds, &folder)?];
    let outcome = sweep(&mut comparisons, args.quiet)?;
    let [comparison] = comparisons;
    if outcome.interrupted {
        say(&format!("interrupted; the same command with --out {} goes on", folder.path().display()));
    } else {
        folder.write("summary.csv", summary(&comparison)?)?;
        folder.write("curves.svg", report::comparison(&title(&comparison), &curves(&comparison)).to_svg())?;
        if !args.quiet {
            let files = "summary.csv, curves.svg, and every run in runs/";
            say(&format!("{}\nresults in {}: {files}", table(&comparison), folder.path().display()));
        }
    }
    outcome.into_result()
}

/// `summary.csv`: one row a run; a run that broke off has no final losses.
fn summary<S: Scene>(comparison: &Comparison<S>) -> Result<Vec<u8>> {
    let mut csv = csv::Writer::from_writer(Vec::new());
    csv.write_record(["field", "seed", "final_train_loss", "final_test_loss", "best_test_loss", "seconds"])?;
    for run in &comparison.runs {
        let numbers = [run.last(|r| r.train_loss), run.last(|r| r.test_loss), best(&run.records), run.seconds()];
        let names = [run.field.letter().to_owned(), run.seed.to_string()];
        csv.write_record(names.into_iter().chain(numbers.map(|x| x.to_string())))?;
    }
    Ok(csv.into_inner()?)
}

fn title<S: Scene>(comparison: &Comparison<S>) -> String {
    let seeds = comparison.by_field().map(|(_, runs)| runs.len()).max().unwrap_or(0);
    format!("{}, {seeds} seed{}", S::NAME, if seeds == 1 { "" } else { "s" })
}

fn curves<S: Scene>(comparison: &Comparison<S>) -> Vec<Curve> {
    let points = |run: &Run<S>| {
        let elapsed = run.records.iter().scan(0.0, |sum, r| {
            *sum += r.seconds;
            Some(*sum)
        });
        run.records.iter().zip(elapsed).map(|(r, seconds)| Point { epoch: r.epoch as f64, seconds, value: r.test_loss }).collect()
    };
    let curve = |(field, runs): (Field, &[Run<S>])| Curve {
        label: format!("{} ({field})", field.letter()),
        color: field_color(field.letter()),
        runs: runs.iter().map(points).collect(),
    };
    comparison.by_field().map(curve).collect()
}

/// Medians over the seeds. A loss that is not there is worse than any that is.
fn table<S: Scene>(comparison: &Comparison<S>) -> Table {
    let mut table = Table::new();
    let header = ["field", "seeds", "broke off", "median final test loss", "lowest", "highest", "median best", "median seconds"];
    table.load_style(UTF8_FULL_CONDENSED).set_header(header);
    for (field, runs) in comparison.by_field() {
        let median = |value: &dyn Fn(&Run<S>) -> f64| quantile(&sorted(runs.iter().map(value)), 0.5);
        let last = sorted(runs.iter().map(|run| run.last(|r| r.test_loss)));
        table.add_row([
            field.to_string(),
            runs.len().to_string(),
            runs.iter().filter(|run| run.broken.is_some()).count().to_string(),
            format!("{:.3e}", quantile(&last, 0.5)),
            format!("{:.3e}", last[0]),
            format!("{:.3e}", last[last.len() - 1]),
            format!("{:.3e}", median(&|run| best(&run.records))),
            format!("{:.1}", median(&Run::seconds)),
        ]);
    }
    table
}
