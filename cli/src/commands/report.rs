//! `physgrad report`: an HTML page about a run, a comparison or an identification.

mod diagnostics;
mod figure;
pub mod identification;
mod inspected;
mod learning;
mod page;

use crate::operations::session::AnyRun;
use crate::platform::folder::{Folder, REPORT};
use crate::platform::terminal::print_result;
use crate::runs::saved;
use crate::runs::statistics::{Method, Outcome};
use crate::tasks::Scene;
use anyhow::Result;
use inspected::{Inspected, InspectedScene};
use std::path::PathBuf;

/// Write an HTML page about a run, a comparison or an identification.
///
/// For runs: results, curves, gradients, animation and settings. For an identification: numbers,
/// measured and simulated states, and residuals.
#[derive(Debug, clap::Args)]
#[command(after_help = "Example:\n  physgrad report runs/fields")]
pub struct Report {
    /// Folder of a run, a comparison or an identification
    pub folder: PathBuf,
    /// Folder for report.html, for example if that of the run is read-only [default: that of the
    /// run]
    #[arg(short, long, value_name = "DIR")]
    pub out: Option<PathBuf>,
    /// Print only warnings and errors
    #[arg(short, long)]
    pub quiet: bool,
}

/// Runs the command.
pub fn report(args: &Report) -> Result<()> {
    let folder = Folder::existing(&args.folder)?;
    let html = html(&folder)?;
    let out = args.out.as_ref().map_or(folder, Folder::at);
    out.create()?;
    out.write(REPORT, html)?;
    if !args.quiet {
        print_result(&out.file(REPORT).display().to_string())?;
    }
    Ok(())
}

/// The page about the run, the comparison or the identification in the folder.
pub fn html(folder: &Folder) -> Result<String> {
    if folder.has(identification::IDENTIFIED) {
        identification::page(folder)
    } else {
        of_runs(folder)
    }
}

/// The page about a run in memory. `folder` is the name of its folder, if it has one.
pub fn of_run(folder: Option<&str>, scene: &Scene, run: &dyn AnyRun) -> Result<String> {
    Ok(page::run(folder, &Inspected::of(scene, run)?))
}

/// The chart of the losses of a run in memory, as SVG.
pub fn losses(scene: &Scene, run: &dyn AnyRun) -> String {
    let (field, records) = (scene.field.0, run.records());
    let method = Method::Field(field);
    let seed = scene.seed;
    let outcome = Outcome { method, field, seed, records, untrained: f64::NAN, diverged: false };
    learning::by_epoch(&outcome).drawing().to_svg()
}

/// The page about the run or the comparison in the folder.
fn of_runs(folder: &Folder) -> Result<String> {
    let scenes =
        saved::scenes(folder)?.into_iter().map(InspectedScene::read).collect::<Result<Vec<_>>>()?;
    Ok(match &scenes[..] {
        [InspectedScene { runs, .. }] if saved::has_run(folder) => {
            page::run(Some(&folder.name()), &runs[0])
        }
        _ => page::comparison(&folder.name(), &scenes),
    })
}
