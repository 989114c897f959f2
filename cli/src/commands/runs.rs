//! `physgrad runs`: saved runs, with their losses.

use crate::platform::csv::csv;
use crate::platform::folder::{Folder, RUNS};
use crate::platform::json::{print_json, rows};
use crate::platform::table::Table;
use crate::platform::terminal::{counted, print_message, print_note, print_text};
use crate::runs::listed::{Listed, below};
use anyhow::Result;
use physgrad::text::short;
use physgrad_plot::{Curve, comparison, line_style};
use serde_json::json;
use std::collections::HashSet;
use std::fs;
use std::path::PathBuf;
use std::time::Duration;

/// List saved runs with their losses, and compare them.
#[derive(Debug, clap::Args)]
#[command(
    after_help = "Examples:\n  physgrad runs --sort loss\n  physgrad runs --task cart_pole --tag baseline -o runs/listed"
)]
pub struct Runs {
    /// Folders to search, with their subfolders
    #[arg(value_name = "DIR", default_value = RUNS)]
    pub folders: Vec<PathBuf>,
    /// List only runs of this task
    #[arg(long, value_name = "NAME")]
    pub task: Option<String>,
    /// List only runs with this tag (see `train --tag`)
    #[arg(long)]
    pub tag: Option<String>,
    /// Order of the runs
    #[arg(long, value_enum, default_value_t = Order::Path)]
    pub sort: Order,
    /// Write runs.csv and the learning curves curves.svg to this folder
    #[arg(short, long, value_name = "DIR")]
    pub out: Option<PathBuf>,
    /// Print the result as one JSON object; messages stay on standard error (docs/runs.md)
    #[arg(long)]
    pub json: bool,
}

/// Order of the listed runs.
#[derive(Clone, Copy, Debug, PartialEq, Eq, clap::ValueEnum)]
pub enum Order {
    /// By folder in the given order, then by path.
    Path,
    /// By the best test loss, the lowest first.
    Loss,
    /// By age, the newest first.
    Age,
}

/// Runs the command.
pub fn runs(args: &Runs) -> Result<()> {
    let mut runs = Vec::new();
    // Folders of the command line may contain one another.
    let mut seen = HashSet::new();
    let mut is_new = |run: &Listed| {
        let path = run.folder.path();
        seen.insert(fs::canonicalize(path).unwrap_or_else(|_| path.to_owned()))
    };
    for path in &args.folders {
        let (found, unreadable) = below(&Folder::existing(path)?);
        runs.extend(found.into_iter().filter(&mut is_new));
        unreadable.iter().for_each(|error| print_message(&format!("warning: {error:#}")));
    }
    runs.retain(|run| args.task.as_ref().is_none_or(|task| *task == run.task));
    runs.retain(|run| args.tag.as_ref().is_none_or(|tag| run.tags.contains(tag)));
    match args.sort {
        Order::Path => {}
        // NaN ranks above every number.
        Order::Loss => runs.sort_by(|a, b| {
            a.best().is_nan().cmp(&b.best().is_nan()).then(a.best().total_cmp(&b.best()))
        }),
        Order::Age => runs.sort_by_key(|run| std::cmp::Reverse(run.saved)),
    }
    let list = csv(CSV, runs.iter().map(row))?;
    if args.json {
        print_json(&json!({ "runs": rows(&list)? }))?;
    } else {
        print_text(&format!("{}\n{}", table(&runs), counted(runs.len(), "run")))?;
    }
    let Some(out) = &args.out else { return Ok(()) };
    let folder = Folder::named(Some(out), "")?;
    folder.write("runs.csv", list)?;
    let title = counted(runs.len(), "run");
    folder.write("curves.svg", comparison(&title, &curves(runs)).to_svg())?;
    let text = format!("results in {}: runs.csv, curves.svg", folder.path().display());
    print_note(&text, args.json)
}

/// One curve per run.
fn curves(runs: Vec<Listed>) -> Vec<Curve> {
    let curve = |(i, run): (usize, Listed)| {
        let (color, dash) = line_style(i);
        let label = run.folder.path().display().to_string();
        Curve { label, color, dash, runs: vec![run.losses] }
    };
    runs.into_iter().enumerate().map(curve).collect()
}

const CSV: [&str; 9] = [
    "run",
    "task",
    "field",
    "seed",
    "epochs",
    "total_epochs",
    "test_loss",
    "best_test_loss",
    "tags",
];

/// Row of `runs.csv`.
fn row(run: &Listed) -> [String; 9] {
    [
        run.folder.path().display().to_string(),
        run.task.clone(),
        run.field.clone(),
        run.seed.to_string(),
        run.losses.len().to_string(),
        run.epochs.to_string(),
        run.last().to_string(),
        run.best().to_string(),
        run.tags.join(" "),
    ]
}

fn table(runs: &[Listed]) -> Table {
    let header = ["run", "task", "field", "seed", "epochs", "test loss", "best", "age", "tags"];
    let mut table =
        Table::new(header).optional(&["epochs", "field", "seed", "task", "tags", "age"]);
    for run in runs {
        let [path, task, field, seed, done, total, _, _, tags] = row(run);
        let epochs = if done == total { done } else { format!("{done} of {total}") };
        let age = run.saved.elapsed().map_or_else(|_| "0 s".into(), age);
        table.row([
            path,
            task,
            field,
            seed,
            epochs,
            short(run.last()),
            short(run.best()),
            age,
            tags,
        ]);
    }
    table
}

/// Duration in seconds, minutes, hours or days. Hours extend to two days.
fn age(age: Duration) -> String {
    let seconds = age.as_secs();
    match seconds {
        0..60 => format!("{seconds} s"),
        60..3600 => format!("{} min", seconds / 60),
        3600..172_800 => format!("{} h", seconds / 3600),
        _ => format!("{} days", seconds / 86400),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_age_has_its_largest_unit() {
        let text =
            [59, 60, 3599, 3600, 172_799, 172_800].map(|seconds| age(Duration::from_secs(seconds)));
        assert_eq!(text, ["59 s", "1 min", "59 min", "1 h", "47 h", "2 days"]);
    }
}
