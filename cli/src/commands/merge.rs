//! `physgrad merge`: tables and pictures of a comparison or study from its runs, without training.

use crate::commands::compare::{self, Output};
use crate::commands::{paper, study};
use crate::platform::folder::{COMPARISON, Folder, STUDY};
use anyhow::{Result, bail};
use std::path::PathBuf;

/// Make the tables and pictures of a comparison or study from the runs in its folder, without
/// training.
///
/// Reports missing runs, and shows the others. Use it after `compare`, `study` or `paper` with
/// `--shard`.
#[derive(Debug, clap::Args)]
#[command(after_help = "Examples:\n  physgrad merge runs/fields\n  physgrad merge runs/paper -q")]
pub struct Merge {
    /// Folder of a comparison, of a study, or of figures of the paper
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
        return compare::merge(&folder, output)?.into_result();
    }
    if folder.has(STUDY) {
        return study::merge(&folder, output)?.into_result();
    }
    if !paper::merge(&folder, output)? {
        bail!(
            "{} is not the folder of a comparison, a study or figures: it has no {COMPARISON}, no {STUDY} and no figure with runs; \
             create one with `compare`, `study` or `paper`",
            folder.path().display()
        );
    }
    Ok(())
}
