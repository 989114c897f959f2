//! `physgrad merge`: tables and pictures of a plan from its runs, without training.

use crate::commands::study::{self, Made, Output};
use crate::platform::folder::{COMPARISON, Folder};
use crate::platform::json::print_json;
use crate::runs::run::NoUpdate;
use crate::runs::saved::folders;
use anyhow::{Result, bail};
use serde_json::{Value, json};
use std::path::PathBuf;

/// Make the tables and pictures of a comparison or study from the runs in its folder, without
/// training.
///
/// Reports missing runs, and shows the others. Use it after `compare`, `study` or `paper` with
/// `--shard`.
#[derive(Debug, clap::Args)]
#[command(after_help = "Examples:\n  physgrad merge runs/fields\n  physgrad merge runs/paper -q")]
pub struct Merge {
    /// Folder of a comparison or study, or of several, as of figures of the paper
    pub folder: PathBuf,
    /// Print only warnings and errors
    #[arg(short, long)]
    pub quiet: bool,
    /// Print the result as one JSON object; messages stay on standard error (docs/runs.md)
    #[arg(long)]
    pub json: bool,
}

/// Runs the command.
pub fn merge(args: &Merge) -> Result<()> {
    let folder = Folder::existing(&args.folder)?;
    let output = Output { quiet: args.quiet, json: args.json };
    if folder.has(COMPARISON) {
        return study::merge(&folder, output)?.print(output);
    }
    let mut plans = folders(&folder)?;
    plans.retain(|folder| folder.has(COMPARISON));
    if plans.is_empty() {
        bail!(
            "{} is not the folder of a comparison: neither it nor a folder in it has {COMPARISON}; create one with `compare`, \
             `study` or `paper`",
            folder.path().display()
        );
    }
    let mut all = AllMade::default();
    for folder in plans {
        all.add(&folder.name(), study::merge(&folder, output));
    }
    all.print(&folder, output)
}

/// Results and failures of several plans in one folder.
#[derive(Default)]
pub struct AllMade {
    results: Vec<Value>,
    failures: Vec<(String, anyhow::Error)>,
}

impl AllMade {
    /// Adds the results of a plan under this name.
    pub fn add(&mut self, name: &str, made: Result<Made>) {
        let failures = made.and_then(|Made { results, ended }| {
            let table = results.and_then(|mut results| Some(results.get_mut("methods")?.take()));
            self.results.extend(table.map(|table| json!({ "name": name, "table": table })));
            ended.into_result()
        });
        self.add_table(name, failures.map(|()| None));
    }

    /// Adds a table with its name, if any, or a failure.
    pub fn add_table(&mut self, name: &str, made: Result<Option<Value>>) {
        match made {
            Ok(table) => self.results.extend(table),
            Err(error) => self.failures.push((name.to_owned(), error)),
        }
    }

    /// Prints the tables if `output.json` is true. Returns one error that lists all failures, if
    /// there are any. It is [`NoUpdate`] if every failure is.
    pub fn print(self, folder: &Folder, output: Output) -> Result<()> {
        if output.json {
            print_json(&json!({ "folder": folder.path(), "figures": self.results }))?;
        }
        let no_update = |(name, error): &(String, anyhow::Error)| {
            error.downcast_ref::<NoUpdate>().map(|NoUpdate(runs)| format!("{name}: {runs}"))
        };
        if self.failures.is_empty() {
            return Ok(());
        }
        match self.failures.iter().map(no_update).collect::<Option<Vec<_>>>() {
            Some(runs) => bail!(NoUpdate(runs.join(", "))),
            None => {
                let lines = self.failures.iter().map(|(name, error)| format!("{name}: {error:#}"));
                bail!("{}", lines.collect::<Vec<_>>().join("\n"))
            }
        }
    }
}
