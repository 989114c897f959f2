//! `physgrad report`: one page on a run or on a comparison.

mod diagnostics;
mod figure;
mod inspected;
mod learning;
pub mod lengths;
mod page;

use super::folder::{Folder, REPORT};
use super::saved;
use super::terminal::say;
use anyhow::Result;
use std::path::PathBuf;

/// Write one page (HTML) on a run or a comparison: results, curves, gradients, film and settings.
#[derive(Debug, clap::Args)]
pub struct Report {
    /// Folder of a run or of a comparison
    pub folder: PathBuf,
    /// Print nothing but warnings and errors
    #[arg(long)]
    pub quiet: bool,
}

/// Runs the command.
pub fn report(args: &Report) -> Result<()> {
    let folder = Folder::existing(&args.folder)?;
    let inspected = inspected::inspect(&saved::runs(&folder)?)?;
    let html = match &inspected[..] {
        [run] if saved::has_run(&folder) => page::run(&folder.name(), run),
        _ => page::comparison(&folder.name(), &inspected),
    };
    folder.write(REPORT, html)?;
    if !args.quiet {
        say(&folder.file(REPORT).display().to_string())?;
    }
    Ok(())
}

/// A number and its noun, which the regular plural serves.
fn counted(count: usize, noun: &str) -> String {
    format!("{count} {noun}{}", if count == 1 { "" } else { "s" })
}
