//! `physgrad export`: the policy of a run as an ONNX model.

use crate::program::operations::onnx::{INPUT, OUTPUT};
use crate::program::operations::policy_file::About;
use crate::program::operations::session::Epoch;
use crate::program::platform::folder::Folder;
use crate::program::platform::terminal::print_result;
use crate::program::runs::saved;
use anyhow::{Context, Result, bail};
use std::fs::symlink_metadata;
use std::path::{Path, PathBuf};

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
    let model = run.onnx(args.epoch, &about).with_context(|| format!("cannot export {}", args.run.display()))?;
    let name = args.onnx.file_name().and_then(|name| name.to_str());
    let name = name.with_context(|| format!("--onnx {}: it is not a name of a file", args.onnx.display()))?;
    // Replacing a device or a symbolic link, for example /dev/stdout, would destroy it.
    if symlink_metadata(&args.onnx).is_ok_and(|found| !found.is_file()) {
        bail!("--onnx {}: it exists and is not a regular file; choose another name", args.onnx.display());
    }
    // The parent of a bare name is the empty path.
    let parent = args.onnx.parent().filter(|parent| !parent.as_os_str().is_empty()).unwrap_or(Path::new("."));
    Folder::existing(parent)?.write(name, model)?;
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
