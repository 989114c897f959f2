//! `physgrad study`: the trainings of a plan. `compare` and `paper` make plans and run them here.

mod pictures;
mod results;

use crate::commands::animate::draw;
use crate::platform::folder::{COMPARISON, Folder, RUNS, SETTINGS};
use crate::platform::json::{print_json, rows};
use crate::platform::lock::Locked;
use crate::platform::terminal::{print_message, print_note, print_text, program};
use crate::runs::comparison::{
    Comparison, Ended, check_sessions, read_all, train_all, train_shard, write_plan,
};
use crate::runs::saved;
use crate::runs::shard::Shard;
use crate::scenes::plan::{Cell, Expanded, Plan};
use crate::scenes::presets::short_name;
use anyhow::{Context, Result, bail};
use results::Results;
use serde_json::{Value, json};
use std::path::{Path, PathBuf};

/// Train several methods on several tasks, with several settings and seeds, from a plan.
///
/// docs/runs.md describes plans and results. `compare` and `paper` are short forms.
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
    #[command(flatten)]
    pub running: Running,
}

/// Options of all commands that train a plan.
#[derive(Debug, clap::Args)]
pub struct Running {
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

impl Running {
    /// Locks the folder for the results. Without `--out`, locks a new folder with this name.
    pub fn folder(&self, name: &str) -> Result<Locked> {
        match (self.shard, &self.out) {
            (Some(_), Some(out)) => Folder::at(out).share(),
            (_, out) => Folder::named(out.as_deref(), name),
        }
    }

    pub fn output(&self) -> Output {
        Output { quiet: self.quiet, json: self.json }
    }
}

/// Output on the terminal.
#[derive(Clone, Copy, Debug)]
pub struct Output {
    pub quiet: bool,
    pub json: bool,
}

/// Runs the command.
pub fn study(args: &Study) -> Result<()> {
    let plan = Plan::read(&args.plan)?;
    let trainings = Trainings::new(if args.quick { plan.quick() } else { plan })?;
    let name = short_name(&args.plan.to_string_lossy());
    let folder = args.running.folder(&format!("study-{name}"))?;
    trainings.train(&folder, &args.running, folder.path())?.print(args.running.output())
}

/// The trainings of a plan, which can start.
pub struct Trainings {
    plan: Plan,
    expanded: Expanded,
}

/// Results of trainings, if they were written, and the ends of the runs.
pub struct Made {
    pub results: Option<Value>,
    pub ended: Ended,
}

impl Made {
    /// Prints the results if `output.json` is true. Returns the failures of the runs.
    pub fn print(self, output: Output) -> Result<()> {
        if let Some(results) = self.results.filter(|_| output.json) {
            print_json(&results)?;
        }
        self.ended.into_result()
    }
}

impl Trainings {
    /// Validates all trainings.
    ///
    /// # Errors
    /// As [`Plan::expand`], or a scene cannot open a session.
    pub fn new(plan: Plan) -> Result<Self> {
        let expanded = plan.expand()?;
        for Cell { scene, fields, .. } in &expanded.cells {
            check_sessions(scene, fields)?;
        }
        Ok(Self { plan, expanded })
    }

    /// Returns whether at least one run of the plan is in the folder.
    pub fn has_runs(&self, folder: &Folder) -> Result<bool> {
        Ok(comparisons(&self.plan, &self.expanded, folder)?.iter().any(Comparison::has_runs))
    }

    /// Trains or resumes all runs in the folder, then writes tables and pictures. A shard and an
    /// interrupted training write neither. `out` is the folder of the command.
    ///
    /// # Errors
    /// The folder has other contents. A run has other settings, or cannot start or be saved.
    pub fn train(&self, folder: &Folder, running: &Running, out: &Path) -> Result<Made> {
        let (plan, output) = (&self.plan, running.output());
        let mut comparisons = comparisons(plan, &self.expanded, folder)?;
        check_folder(folder, plan.is_single())?;
        let is_other = folder.has(COMPARISON) && !comparisons.iter().any(Comparison::has_folder);
        if is_other && saved::scenes(folder).is_ok() {
            let path = folder.path().display();
            bail!("{path} holds another comparison; choose another folder with --out");
        }
        // Shards compare their plan with that of the folder.
        if running.shard.is_none() {
            comparisons.iter().try_for_each(Comparison::check_resumable)?;
        }
        for (name, policy) in plan.policies() {
            folder.write(name, policy)?;
        }
        write_plan(folder, &plan.to_toml()?, running.shard.is_some())?;
        if !output.quiet {
            let mut notes = self.expanded.cells.iter().map(|cell| cell.scene.notes());
            let first = notes.find(|notes| !notes.is_empty());
            first.iter().flatten().for_each(|note| print_message(note));
        }
        let ended = match running.shard {
            Some(shard) => train_shard(&comparisons, shard, output.quiet)?,
            None => train_all(&mut comparisons, output.quiet)?,
        };
        let out = out.display();
        let mut results = None;
        if ended.interrupted {
            let text = match running.shard {
                Some(_) => format!(
                    "interrupted; to resume in {out}, repeat the command, or start any other shard"
                ),
                None => format!("interrupted; to resume, repeat the command with --out {out}"),
            };
            let _ = print_note(&text, output.json);
        } else if running.shard.is_none() {
            results = Some(write_outputs(plan, &self.expanded, &comparisons, folder, output)?);
        } else if !output.quiet {
            print_message(&format!(
                "to make tables and pictures of all runs:\n{} merge {out}",
                program()
            ));
        }
        Ok(Made { results, ended })
    }
}

/// Makes the tables and pictures of the plan in the folder from its runs, without training.
pub fn merge(folder: &Folder, output: Output) -> Result<Made> {
    let plan = Plan::stored(folder)?;
    let expanded = plan.expand()?;
    let mut comparisons = comparisons(&plan, &expanded, folder)?;
    let ended = read_all(&mut comparisons)?;
    let results = write_outputs(&plan, &expanded, &comparisons, folder, output)?;
    Ok(Made { results: Some(results), ended })
}

/// Plans the runs of all cells, in folders that `report` and `animate` accept.
fn comparisons(plan: &Plan, expanded: &Expanded, folder: &Folder) -> Result<Vec<Comparison>> {
    let comparison = |Cell { folder: name, scene, fields, .. }: &Cell| {
        let inner = if name.is_empty() { folder.clone() } else { folder.inside(name)? };
        Comparison::plan(name, scene, fields, plan.contents.seeds, &inner)
    };
    expanded.cells.iter().map(comparison).collect()
}

/// Checks that the folder has no other contents than runs of a plan with this layout: the runs of a
/// single cell without a name are in `runs`, all other cells have a subfolder each.
fn check_folder(folder: &Folder, is_single: bool) -> Result<()> {
    let refuse = |found: &str| {
        let path = folder.path().display();
        bail!("{path} holds {found}; choose another folder with --out")
    };
    if folder.has(SETTINGS) {
        return refuse("a run and is not a comparison");
    }
    if folder.has(COMPARISON) {
        let other = || format!("{} holds other results", folder.path().display());
        let saved = Plan::stored(folder).with_context(other)?;
        if is_single != saved.is_single() {
            let several = "a comparison of several scenes or combinations";
            let one = "a comparison of one scene";
            return refuse(if is_single { several } else { one });
        }
    } else if !is_single && folder.has(RUNS) {
        return refuse("a comparison of one scene");
    }
    Ok(())
}

/// Writes tables and pictures. Returns the results as JSON.
fn write_outputs(
    plan: &Plan,
    expanded: &Expanded,
    comparisons: &[Comparison],
    folder: &Folder,
    output: Output,
) -> Result<Value> {
    let results = Results::of(plan, expanded, comparisons)?;
    let (runs, methods, note) = (results.runs_csv()?, results.methods_csv()?, results.note());
    folder.write("summary.csv", &runs)?;
    folder.write("table.csv", &methods)?;
    folder.write("table.md", format!("{}\n\n{note}\n", results.table(false).markdown()))?;
    folder.write("times.csv", results.times_csv()?)?;
    let mut files = vec!["summary.csv", "table.csv", "table.md", "times.csv"];
    files.extend(pictures::write(&results, folder)?);
    if expanded.cells.len() <= pictures::MAX_CURVES {
        // Redraws the animations of the runs, with one scale per cell.
        comparisons
            .iter()
            .try_for_each(|comparison| draw(&comparison.ended(), 0, &comparison.ended()))?;
    }
    if !output.json && !output.quiet {
        let is_single = plan.is_single();
        files.push(if is_single { "all runs in runs/" } else { "one folder per combination" });
        let path = folder.path().display();
        print_text(&format!("{}\n{note}{}", results.table(true), results.lowest()))?;
        print_text(&format!("results in {path}: {}", files.join(", ")))?;
    }
    Ok(json!({ "folder": folder.path(), "methods": rows(&methods)?, "runs": rows(&runs)? }))
}
