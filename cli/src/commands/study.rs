//! `physgrad study`: trainings for all tasks, methods, learning rates and seeds of a plan.

mod results;

use crate::commands::compare::{Output, check_folder, train};
use crate::platform::folder::{COMPARISON, Folder, SETTINGS, STUDY};
use crate::platform::json::{print_json, rows};
use crate::platform::terminal::{counted, print_text};
use crate::runs::comparison::{
    Comparison, Ended, check_runs, check_sessions, read_all, write_plan_file,
};
use crate::runs::shard::Shard;
use crate::scenes::plan::{Cell, Plan};
use crate::scenes::presets::short_name;
use anyhow::Result;
use results::{NOTE, Results};
use serde_json::json;
use std::path::PathBuf;

/// Train several methods on several tasks, with several seeds and learning rates, from a plan.
///
/// Shows each method at its best learning rate. docs/runs.md describes plans and results.
#[derive(Debug, clap::Args)]
#[command(
    after_help = "Examples:\n  physgrad study examples/plans/fields.toml --quick\n  physgrad study examples/plans/fields.toml -o runs/study\n  physgrad study examples/plans/fields.toml --shard 3/16 -o runs/study"
)]
pub struct Study {
    /// Path of the plan
    pub plan: PathBuf,
    /// Make a fast trial run: 5 epochs, small data sets
    #[arg(long)]
    pub quick: bool,
    /// Number of threads, one run each [default: RAYON_NUM_THREADS, or all cores]
    #[arg(long, value_name = "N")]
    pub threads: Option<usize>,
    /// Folder for the results; runs already in it are resumed [default: a new one in `runs`]
    #[arg(short, long, value_name = "DIR")]
    pub out: Option<PathBuf>,
    /// Train share K of N of the runs, then all other runs that no process holds. Other shards may
    /// train in the same folder, on any machine. Run `physgrad merge` afterwards (docs/runs.md)
    #[arg(long, value_name = "K/N", requires = "out", conflicts_with = "json")]
    pub shard: Option<Shard>,
    /// Print only warnings and errors
    #[arg(short, long)]
    pub quiet: bool,
    /// Print the result as one JSON object; messages stay on standard error (docs/runs.md)
    #[arg(long)]
    pub json: bool,
}

/// Runs the command.
pub fn study(args: &Study) -> Result<()> {
    let plan = Plan::read(&args.plan)?;
    let plan = if args.quick { plan.quick() } else { plan };
    check_runs(plan.combinations(), 1, plan.seeds())?;
    let cells = plan.cells()?;
    for Cell { scene, .. } in &cells {
        check_sessions([scene].into_iter(), &[scene.field])?;
    }
    let name = short_name(&args.plan.to_string_lossy());
    let folder = match (args.shard, &args.out) {
        (Some(_), Some(out)) => Folder::at(out).share()?,
        (_, out) => Folder::named(out.as_deref(), &format!("study-{name}"))?,
    };
    check_folder(&folder, "study", &[(SETTINGS, "run"), (COMPARISON, "comparison")])?;
    let mut comparisons = comparisons(&plan, &cells, &folder)?;
    // Shards compare their plan with that of the folder.
    if args.shard.is_none() {
        comparisons.iter().try_for_each(Comparison::check_resumable)?;
    }
    write_plan_file(&folder, STUDY, &plan.to_toml()?, args.shard.is_some())?;
    let output = Output { quiet: args.quiet, json: args.json };
    train(&mut comparisons, args.shard, &folder, output, |comparisons| {
        write_outputs(&plan, &cells, comparisons, &folder, output)
    })
}

/// Makes the tables and pictures of the study in the folder from its runs, without training.
pub fn merge(folder: &Folder, output: Output) -> Result<Ended> {
    let plan = Plan::read(&folder.readable(STUDY)?)?;
    check_runs(plan.combinations(), 1, plan.seeds())?;
    let cells = plan.cells()?;
    let mut comparisons = comparisons(&plan, &cells, folder)?;
    let ended = read_all(&mut comparisons)?;
    write_outputs(&plan, &cells, &comparisons, folder, output)?;
    Ok(ended)
}

/// Plans the runs of all cells, in folders that `report` and `animate` accept.
fn comparisons(plan: &Plan, cells: &[Cell], folder: &Folder) -> Result<Vec<Comparison>> {
    let comparison = |cell: &Cell| {
        let inner = folder.inside(&cell.folder)?;
        Comparison::plan(&cell.folder, &cell.scene, &[cell.scene.field], plan.seeds(), &inner)
    };
    cells.iter().map(comparison).collect()
}

fn write_outputs(
    plan: &Plan,
    cells: &[Cell],
    comparisons: &[Comparison],
    folder: &Folder,
    output: Output,
) -> Result<()> {
    let results = Results::of(cells, comparisons)?;
    let methods = results.methods_csv()?;
    folder.write("study.csv", &methods)?;
    folder.write("summary.csv", results.runs_csv()?)?;
    folder.write("times.csv", results.times_csv()?)?;
    folder.write("study.md", format!("{}\n\n{NOTE}\n", results.table(false).markdown()))?;
    let title =
        format!("{}, each at its best learning rate", counted(plan.seeds() as usize, "seed"));
    folder.write("study.svg", results.picture(&title).to_svg())?;
    if output.json {
        print_json(&json!({ "folder": folder.path(), "methods": rows(&methods)? }))?;
    } else if !output.quiet {
        let files = "study.svg, study.csv, study.md, summary.csv, times.csv, one folder per task, method and learning rate";
        print_text(&format!(
            "{}\n{NOTE}\nresults in {}: {files}",
            results.table(true),
            folder.path().display()
        ))?;
    }
    Ok(())
}
