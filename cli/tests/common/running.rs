//! Runs of the program, with small training settings.

use assert_cmd::Command;
use std::path::Path;
use std::process::Stdio;

/// Settings of a small training run.
pub const SMALL: [&str; 8] = [
    "--set",
    "training.train_samples=24",
    "--set",
    "training.test_samples=12",
    "--set",
    "policy.widths=[12, 8]",
    "--set",
    "horizon=25",
];

pub fn physgrad(args: &[&str]) -> Command {
    let mut command = Command::cargo_bin("physgrad").expect("the program is built");
    command.args(args);
    command
}

/// Returns the command `train cart_pole` with the settings [`SMALL`] and the folder `out`.
#[allow(dead_code)]
pub fn train(out: &Path, args: &[&str]) -> Command {
    let mut command = physgrad(&["train", "cart_pole", "--out"]);
    command.arg(out).args(SMALL).args(args);
    command
}

/// Returns the error output of a command. Panics if the command succeeds.
#[allow(dead_code)]
pub fn error_of(command: &mut Command) -> String {
    let output = command.output().expect("physgrad starts");
    assert!(!output.status.success(), "the command succeeded; expected an error");
    String::from_utf8(output.stderr).expect("text")
}

/// Returns the command of [`train`] as a `std::process::Command`, so that a test can kill the
/// process.
#[allow(dead_code)]
pub fn process(out: &Path, args: &[&str]) -> std::process::Command {
    let mut command = std::process::Command::new(assert_cmd::cargo::cargo_bin!("physgrad"));
    command.args(["train", "cart_pole", "--out"]).arg(out).args(SMALL).args(args);
    command.stdin(Stdio::null()).stdout(Stdio::piped()).stderr(Stdio::piped());
    command
}
