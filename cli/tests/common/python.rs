//! A Python environment, shared by all tests and kept in the target directory.

use std::fs::{self, File};
use std::path::{Path, PathBuf};
use std::process::Command;
use std::sync::LazyLock;

/// Packages of the environment: readers of the files that the program writes.
const PACKAGES: [&str; 4] = ["numpy", "onnxruntime", "safetensors", "tensorboard"];

/// Runs a script of the folder `tests/program` and returns its output.
///
/// Returns None and prints the reason if the environment cannot be created, for example without
/// Python or without access to the packages.
///
/// # Panics
/// If Python does not start, or the script fails.
pub fn run(script: &str, args: &[&Path]) -> Option<String> {
    // A process does not repeat a failed installation.
    static INTERPRETER: LazyLock<Result<PathBuf, String>> = LazyLock::new(interpreter);
    let python =
        INTERPRETER.as_ref().map_err(|reason| println!("skipped {script}: {reason}")).ok()?;
    let script = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/program").join(script);
    let output = Command::new(python).arg(&script).args(args).output().expect("Python starts");
    let text = String::from_utf8_lossy(&output.stdout).into_owned();
    assert!(
        output.status.success(),
        "{}:\n{text}{}",
        script.display(),
        String::from_utf8_lossy(&output.stderr)
    );
    Some(text)
}

/// Installs the packages, unless they are present, and returns the path of the interpreter.
fn interpreter() -> Result<PathBuf, String> {
    let folder = Path::new(env!("CARGO_TARGET_TMPDIR")).join("python");
    fs::create_dir_all(&folder).map_err(|error| error.to_string())?;
    // Other tests and other processes wait for the installation.
    let lock = File::create(folder.join("lock")).map_err(|error| error.to_string())?;
    lock.lock().map_err(|error| error.to_string())?;
    let (python, installed) = (folder.join("venv/bin/python"), folder.join("installed"));
    let packages = PACKAGES.join(" ");
    if python.exists() && fs::read_to_string(&installed).is_ok_and(|text| text == packages) {
        return Ok(python);
    }
    // Removes the previous list, which would remain if the installation fails.
    if installed.exists() {
        fs::remove_file(&installed).map_err(|error| error.to_string())?;
    }
    command(Command::new("python3").args(["-m", "venv", "--clear"]).arg(folder.join("venv")))?;
    let pip = [
        "-m",
        "pip",
        "install",
        "--quiet",
        "--only-binary",
        ":all:",
        "--retries",
        "1",
        "--timeout",
        "10",
    ];
    command(Command::new(&python).args(pip).args(PACKAGES))?;
    fs::write(installed, packages).map_err(|error| error.to_string())?;
    Ok(python)
}

fn command(command: &mut Command) -> Result<(), String> {
    let output = command
        .output()
        .map_err(|error| format!("{}: {error}", command.get_program().display()))?;
    let errors = String::from_utf8_lossy(&output.stderr);
    output
        .status
        .success()
        .then_some(())
        .ok_or_else(|| errors.lines().last().unwrap_or("no message").to_owned())
}
