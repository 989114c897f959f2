//! `physgrad export`: the policy of a run as an ONNX model.

use crate::operations::onnx::{INPUT, OUTPUT};
use crate::operations::policy_file::About;
use crate::operations::session::Epoch;
use crate::platform::folder::Folder;
use crate::platform::terminal::print_result;
use crate::runs::saved;
use anyhow::{Context, Result};
use std::path::PathBuf;

/// Write the policy of a run as an ONNX model, for other programs and machines.
///
/// The model maps a batch of observations to the controls that the policy computes in a rollout.
#[derive(Debug, clap::Args)]
#[command(after_help = "Example:\n  physgrad export runs/one --onnx policy.onnx")]
pub struct Export {
    /// Folder of a run
    #[arg(value_name = "RUN")]
    pub run: PathBuf,
    /// File of the model, for example policy.onnx; replaces a file of this name
    #[arg(long, value_name = "FILE")]
    pub onnx: PathBuf,
    /// Epoch of the policy
    #[arg(long, value_enum, default_value_t = Epoch::Last)]
    pub epoch: Epoch,
    /// Print only warnings and errors
    #[arg(short, long)]
    pub quiet: bool,
}

/// Runs the command.
pub fn export(args: &Export) -> Result<()> {
    let folder = Folder::existing(&args.run)?;
    let scene = saved::scene(&folder)?;
    let mut run = scene.open(1)?;
    saved::restore(&folder, &scene, &mut *run)?;
    let about = scene.about();
    let model = run
        .onnx(args.epoch, &about)
        .with_context(|| format!("cannot export {}", args.run.display()))?;
    Folder::write_at(&args.onnx, model).context("--onnx")?;
    if args.quiet {
        return Ok(());
    }
    let About { observations, controls, .. } = &about;
    print_result(&format!(
        "{}, precision {}:\n  input {INPUT} [batch, {}]: {}\n  output {OUTPUT} [batch, {}]: {}",
        args.onnx.display(),
        scene.precision.name(),
        observations.len(),
        observations.join(", "),
        controls.len(),
        controls.join(", ")
    ))
}
