//! The program, and a training run small enough for a test.

use assert_cmd::Command;
use std::path::Path;
use std::process::Stdio;

/// Settings of the small training run.
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

/// Returns `train cart_pole` with the small settings, writing to `out`.
#[allow(dead_code)]
pub fn train(out: &Path, args: &[&str]) -> Command {
    let mut command = physgrad(&["train", "cart_pole", "--out"]);
    command.arg(out).args(SMALL).args(args);
    command
}

#[allow(dead_code)]
pub fn error_of(command: &mut Command) -> String {
    let output = command.output().expect("physgrad starts");
    assert!(!output.status.success(), "the command succeeded; expected an error");
    String::from_utf8(output.stderr).expect("text")
}

/// Returns the command of [`train`] as a process that a test can kill.
#[allow(dead_code)]
pub fn process(out: &Path, args: &[&str]) -> std::process::Command {
    let mut command = std::process::Command::new(assert_cmd::cargo::cargo_bin!("physgrad"));
    command.args(["train", "cart_pole", "--out"]).arg(out).args(SMALL).args(args);
    command.stdin(Stdio::null()).stdout(Stdio::piped()).stderr(Stdio::piped());
    command
}
