//! `physgrad report`: one page on a run or on a comparison.

mod diagnostics;
mod figure;
mod growth;
mod inspected;
mod learning;
mod page;

use super::folder::{Folder, REPORT};
use super::saved;
use super::scene::{Scene, with_scene};
use super::terminal::say;
use anyhow::{Result, bail};
use std::path::PathBuf;

/// Write one page (HTML) on a run or a comparison: results, curves, gradients, film and settings.
#[derive(Debug, clap::Args)]
pub struct Report {
    /// Folder of a run or of a comparison
    pub folder: PathBuf,
    /// Print nothing but errors
    #[arg(long)]
    pub quiet: bool,
}

/// Runs the command.
pub fn report(args: &Report) -> Result<()> {
    let folder = Folder::existing(&args.folder)?;
    let runs = saved::runs(&folder)?;
    let task = saved::task(&runs[0])?;
    for run in &runs {
        let other = saved::task(run)?;
        if other != task {
            let (first, run) = (runs[0].path().display(), run.path().display());
            bail!("{first} ({task}) and {run} ({other}) are not runs of one comparison; report each by itself");
        }
    }
    let html = with_scene!(task.as_str(), S => html::<S>(&folder, &runs))?;
    folder.write(REPORT, html)?;
    if !args.quiet {
        say(&folder.file(REPORT).display().to_string());
    }
    Ok(())
}

fn html<S: Scene>(folder: &Folder, runs: &[Folder]) -> Result<String> {
    let inspected = inspected::inspect::<S>(runs)?;
    Ok(match &inspected[..] {
        [run] if saved::has_run(folder) => page::run(&folder.name(), run),
        _ => page::comparison(&folder.name(), &inspected),
    })
}

/// A number and its noun, which the regular plural serves.
fn counted(count: usize, noun: &str) -> String {
    format!("{count} {noun}{}", if count == 1 { "" } else { "s" })
}
