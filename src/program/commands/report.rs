//! `physgrad report`: an HTML page about a run or a comparison.

mod diagnostics;
mod figure;
mod inspected;
mod learning;
mod page;

use crate::program::platform::folder::{Folder, REPORT};
use crate::program::platform::terminal::print_result;
use crate::program::runs::saved;
use anyhow::Result;
use std::path::PathBuf;

/// Write an HTML page about a run or a comparison: results, curves, gradients, animation and
/// settings.
#[derive(Debug, clap::Args)]
pub struct Report {
    /// Folder of a run or of a comparison
    pub folder: PathBuf,
    /// Print only warnings and errors
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
        print_result(&folder.file(REPORT).display().to_string())?;
    }
    Ok(())
}
