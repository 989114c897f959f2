//! `physgrad paper`: reproduces the figures of the paper.

mod fig1;
mod fig2;
mod study;

use crate::commands::compare::Output;
use crate::platform::folder::{COMPARISON, Folder};
use crate::platform::json::print_json;
use crate::platform::signals;
use crate::platform::table::Table;
use crate::platform::terminal::print_text;
use crate::runs::comparison::{check_distinct, check_options};
use crate::runs::run::NoUpdate;
use crate::runs::shard::Shard;
use crate::settings::{ClipName, FieldName};
use anyhow::{Result, bail};
use clap::ValueEnum;
use physgrad_plot::Drawing;
use serde::{Deserialize, Serialize};
use serde_json::{Value, json};
use std::path::{Path, PathBuf};
use study::{FIG3, FIG4, FIG5};

/// Reproduce a figure of the paper, with several seeds: picture, numbers and table.
#[derive(Debug, clap::Args)]
#[command(
    after_help = "Examples:\n  physgrad paper fig4 --quick\n  physgrad paper all --seeds 8 -o runs/paper\n  physgrad paper fig4 --shard 3/16 -o runs/paper"
)]
pub struct Paper {
    /// Figure to reproduce
    #[arg(value_enum)]
    pub figure: Figure,
    #[command(flatten)]
    pub options: Options,
    /// Number of threads, one run each [default: RAYON_NUM_THREADS, or all cores]
    #[arg(long, value_name = "N")]
    pub threads: Option<usize>,
    /// Folder for the results; runs already in it are resumed [default: runs/paper, or
    /// runs/paper-quick with --quick]
    #[arg(short, long, value_name = "DIR")]
    pub out: Option<PathBuf>,
    /// Train share K of N of the runs, then all other runs that no process holds. Other shards may
    /// train in the same folder, on any machine. Run `physgrad merge` afterwards
    /// (docs/runs.md). Shard 1 makes figures 1 and 2
    #[arg(long, value_name = "K/N", requires = "out", conflicts_with = "json")]
    pub shard: Option<Shard>,
}

/// Options of the figures. Figures 1 and 2 train nothing.
#[derive(Debug, clap::Args, Serialize, Deserialize)]
pub struct Options {
    /// Number of seeds, counted from 0
    #[arg(long, value_name = "K", default_value_t = 3)]
    pub seeds: u64,
    /// Epochs of every run [default: 1000, or 5 with --quick]
    #[arg(long, value_name = "N")]
    pub epochs: Option<usize>,
    /// Fields to compare
    #[arg(long, value_delimiter = ',', default_value = "R,M,S,C", value_parser = |name: &str| name.parse().map(FieldName))]
    pub fields: Vec<FieldName>,
    /// Kinds of clipping, one row of panels each
    #[arg(long, value_delimiter = ',', default_value = "none,value,norm", value_enum)]
    pub clip: Vec<ClipName>,
    /// Make a fast trial run: few epochs, small data sets, coarse grids
    #[arg(long)]
    pub quick: bool,
    /// Print only warnings and errors
    #[arg(short, long)]
    #[serde(skip)]
    pub quiet: bool,
    /// Print the result as one JSON object; messages stay on standard error (docs/runs.md)
    #[arg(long)]
    #[serde(skip)]
    pub json: bool,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, clap::ValueEnum)]
pub enum Figure {
    /// Toy example: loss landscape, gradient and modified field
    Fig1,
    /// Toy example: Adam along a gradient, a rotating field, and their combination
    Fig2,
    /// Guidance by repulsion with four weights of regularization
    Fig3,
    /// Cart-pole with 1 to 4 poles
    Fig4,
    /// Quantum control towards the eigenstates 3, 4 and 5, and the update size
    Fig5,
    /// All figures
    All,
}

impl Figure {
    /// Name on the command line and in file names.
    fn name(self) -> String {
        self.to_possible_value().map(|value| value.get_name().to_owned()).unwrap_or_default()
    }
}

impl Options {
    /// Number of epochs of every run.
    fn epochs(&self) -> usize {
        self.epochs.unwrap_or(if self.quick { 5 } else { 1000 })
    }
}

/// A finished figure.
pub struct FinishedFigure {
    pub drawing: Drawing,
    /// Figure 1: loss, R and M at the parameters of the maps. Figure 2: parameters and losses along
    /// the paths. Figures 3 to 5: final and best losses, one row per run.
    pub csv: Vec<u8>,
    /// Summary.
    pub table: Table,
    /// Note below the table. May be empty.
    pub note: &'static str,
}

impl FinishedFigure {
    /// Writes `<name>.svg`, `.png`, `.csv` and `.md`. Prints the table, unless `options.quiet` or
    /// `options.json` is true. Returns name and table as JSON.
    pub fn write(&self, name: &str, folder: &Folder, options: &Options) -> Result<Value> {
        folder.write(&format!("{name}.svg"), self.drawing.to_svg())?;
        folder.write(&format!("{name}.png"), self.drawing.to_png())?;
        folder.write(&format!("{name}.csv"), &self.csv)?;
        let note = if self.note.is_empty() { String::new() } else { format!("\n\n{}", self.note) };
        folder.write(&format!("{name}.md"), format!("{}{note}\n", self.table.markdown()))?;
        if !options.quiet && !options.json {
            let path = folder.path().display();
            print_text(&format!(
                "{}{note}\n{name}.svg, {name}.png, {name}.csv and {name}.md are in {path}\n",
                self.table
            ))?;
        }
        Ok(json!({ "name": name, "table": self.table.objects() }))
    }
}

/// Runs the command.
pub fn paper(args: &Paper) -> Result<()> {
    let options = &args.options;
    check_options(&options.fields, options.seeds, options.epochs())?;
    check_distinct("--clip", options.clip.iter().map(|clip| clip.name()))?;
    let default = if options.quick { "runs/paper-quick" } else { "runs/paper" };
    let folder = Folder::at(args.out.as_deref().unwrap_or(Path::new(default)));
    let folder = if args.shard.is_some() { folder.share()? } else { folder.lock()? };
    let first = args.shard.is_none_or(Shard::is_first);
    let write = |figure: Figure, finished: Result<FinishedFigure>| {
        Ok((Some(finished?.write(&figure.name(), &folder, options)?), Ok(())))
    };
    // Puts the figure with the longest computing time last.
    let none = || Ok((None, Ok(())));
    let figures: [(Figure, &dyn Fn() -> Result<Made>); 5] = [
        (Figure::Fig1, &|| {
            if first { write(Figure::Fig1, fig1::fig1(options.quick)) } else { none() }
        }),
        (Figure::Fig2, &|| {
            if first { write(Figure::Fig2, fig2::fig2(options.quick)) } else { none() }
        }),
        (Figure::Fig4, &|| FIG4.run(options, &folder, args.shard)),
        (Figure::Fig3, &|| FIG3.run(options, &folder, args.shard)),
        (Figure::Fig5, &|| FIG5.run(options, &folder, args.shard)),
    ];
    // Continues with the other figures after an error.
    let mut all = AllMade::default();
    for (figure, make) in figures {
        if [figure, Figure::All].contains(&args.figure) && signals::received().is_none() {
            all.add(&figure.name(), make());
        }
    }
    if options.json {
        print_json(&json!({ "folder": folder.path(), "figures": all.tables }))?;
    }
    all.into_result()
}

/// Name and table of a figure, if it was written, and the failures of its runs.
type Made = (Option<Value>, Result<()>);

/// Tables and failures of several figures.
#[derive(Default)]
struct AllMade {
    tables: Vec<Value>,
    failures: Vec<(String, anyhow::Error)>,
}

impl AllMade {
    fn add(&mut self, name: &str, made: Result<Made>) {
        let (table, failures) = made.unwrap_or_else(|error| (None, Err(error)));
        self.tables.extend(table);
        self.failures.extend(failures.err().map(|error| (name.to_owned(), error)));
    }

    /// Returns one error that lists all failures, if there are any. It is [`NoUpdate`] if every
    /// failure is.
    fn into_result(self) -> Result<()> {
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

/// Makes the figures in the folder from their runs, without training. Returns false if the folder
/// has no figure with runs.
pub fn merge(folder: &Folder, output: Output) -> Result<bool> {
    let (mut all, mut any) = (AllMade::default(), false);
    for study in [FIG3, FIG4, FIG5] {
        if Folder::at(folder.file(study.name)).has(COMPARISON) {
            any = true;
            all.add(study.name, study.merge(folder, output));
        }
    }
    if output.json && !all.tables.is_empty() {
        print_json(&json!({ "folder": folder.path(), "figures": all.tables }))?;
    }
    all.into_result().map(|()| any)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Checks the figure. The SVG is valid XML below 500 kB without NaN. The CSV has this header
    /// and more than 100 lines without NaN. The table has at least 4 lines.
    fn check(header: &str, figure: &FinishedFigure) {
        let svg = figure.drawing.to_svg();
        roxmltree::Document::parse(&svg).expect("an SVG is XML");
        assert!(
            !svg.contains("NaN") && svg.len() < 500_000,
            "an SVG without NaN and below 500 kB, not {} bytes",
            svg.len()
        );
        let csv = std::str::from_utf8(&figure.csv).expect("CSV is text");
        assert_eq!(csv.lines().next(), Some(header));
        assert!(csv.lines().count() > 100 && !csv.contains("NaN"));
        assert!(figure.table.markdown().lines().count() >= 4);
    }

    #[test]
    fn figures_1_and_2_have_an_svg_below_500_kb_and_a_csv_without_nan() {
        for quick in [true, false] {
            check("theta_1,theta_2,loss,r_1,r_2,m_1,m_2", &fig1::fig1(quick).expect("figure 1"));
            check("method,iteration,theta_1,theta_2,loss", &fig2::fig2(quick).expect("figure 2"));
        }
    }
}
