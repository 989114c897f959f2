//! `physgrad compare`: the same training along several fields and seeds, side by side.

use super::changes::{Changes, changed};
use super::folder::Folder;
use super::presets;
use super::run::threads;
use super::settings::FieldName;
use super::statistics::{self, Outcome, best, by_field, curves};
use super::sweep::{Comparison, check_options, sweep};
use super::terminal::say;
use anyhow::{Result, bail};
use comfy_table::Table;
use comfy_table::presets::UTF8_FULL_CONDENSED;
use physgrad::report::comparison;
use std::path::PathBuf;

/// Train along several fields and seeds, and compare.
#[derive(Debug, clap::Args)]
pub struct Compare {
    /// A task or another preset (see `physgrad scene`), or the path of a scene
    pub scene: String,
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
    if args.changes.field.is_some() || args.changes.set.iter().any(|set| set.trim_start().starts_with("field")) {
        bail!("a comparison has --fields, not a single field");
    }
    let base = changed(&args.scene, &args.changes)?;
    check_options(&args.fields, args.seeds, base.epochs)?;
    threads(args.threads)?;
    let folder = match &args.out {
        Some(path) => Folder::create(path)?,
        None => Folder::fresh(&format!("compare-{}", presets::short_name(&args.scene)))?,
    };
    let mut comparisons = [Comparison::plan("", &base, &args.fields, args.seeds, &folder)?];
    let swept = sweep(&mut comparisons, args.quiet)?;
    if swept.interrupted {
        say(&format!("interrupted; the same command with --out {} goes on", folder.path().display()));
    } else {
        let outcomes = comparisons[0].outcomes();
        folder.write("summary.csv", summary(&outcomes)?)?;
        folder
            .write("curves.svg", comparison(&title(base.kind.name(), &outcomes), &curves(&outcomes, |r| r.test_loss)).to_svg())?;
        if !args.quiet {
            let files = "summary.csv, curves.svg, and every run in runs/";
            say(&format!("{}\nresults in {}: {files}", table(&outcomes), folder.path().display()));
        }
    }
    swept.into_result()
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
