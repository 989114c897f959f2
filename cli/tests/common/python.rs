//! Independent readers of the files that the program writes, in Python.
//!
//! Tests install nothing. `PHYSGRAD_PYTHON` names an interpreter with the packages numpy,
//! onnxruntime, safetensors and tensorboard; `.ci/run` creates one.

use std::path::Path;
use std::process::Command;

/// Runs a script of the folder `tests/program` and returns its output.
///
/// Returns None and says so if `PHYSGRAD_PYTHON` is not set.
///
/// # Panics
/// If Python does not start, or the script fails.
pub fn run(script: &str, args: &[&Path]) -> Option<String> {
    let Some(python) = std::env::var_os("PHYSGRAD_PYTHON") else {
        println!(
            "skipped {script}: set PHYSGRAD_PYTHON to a Python with numpy, onnxruntime, safetensors and tensorboard"
        );
        return None;
    };
    let script = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/program").join(script);
    let output = Command::new(python).arg(&script).args(args).output().expect("Python starts");
    let text = String::from_utf8_lossy(&output.stdout).into_owned();
    let errors = String::from_utf8_lossy(&output.stderr);
    assert!(output.status.success(), "{}:\n{text}{errors}", script.display());
    Some(text)
}
