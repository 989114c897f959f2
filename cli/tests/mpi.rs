//! Training on several MPI ranks. Skipped without the feature `mpi`, or if `mpirun` cannot start
//! two processes.
#![cfg(unix)]

#[path = "common/running.rs"]
mod running;

use running::{SMALL, train};
use std::fs;
use std::path::Path;
use std::process::{Child, Command, Output, Stdio};
use std::time::{Duration, Instant};
use tempfile::TempDir;

/// Returns whether the tests can run. Prints the reason if not.
fn available() -> bool {
    if !cfg!(feature = "mpi") {
        println!(
            "skipped: the feature `mpi` is off; run `cargo test -p physgrad-cli --features mpi --test mpi`"
        );
        return false;
    }
    let dir = TempDir::new().expect("a folder");
    match launcher(2, dir.path()).arg("true").output() {
        Ok(output) if output.status.success() => true,
        Ok(output) => {
            println!("skipped: mpirun cannot start two processes: {}", text(&output));
            false
        }
        Err(error) => {
            println!("skipped: cannot start mpirun, of the Debian package openmpi-bin: {error}");
            false
        }
    }
}

/// Returns the `mpirun` command that starts `ranks` ranks on this machine, with its files in `dir`: in
/// a common folder, launches at the same moment disturb one another.
fn launcher(ranks: usize, dir: &Path) -> Command {
    let mut command = Command::new("mpirun");
    command.env("TMPDIR", dir);
    command.args([
        "--oversubscribe",
        "--allow-run-as-root",
        "--bind-to",
        "none",
        "-n",
        &ranks.to_string(),
    ]);
    // Containers may forbid reads of the memory of another process.
    command.args(["--mca", "btl_vader_single_copy_mechanism", "none"]);
    command
}

/// Mini-batches of 30 and 20 samples, in 8 and 5 groups of up to four samples. The last group of
/// the first mini-batch has only two samples.
const SETTINGS: [&str; 6] = [
    "--set",
    "training.batch=30",
    "--set",
    "training.train_samples=50",
    "--set",
    "training.resample=true",
];

/// Starts `train cart_pole` on several ranks.
fn start(ranks: usize, out: &Path, args: &[&str]) -> Child {
    let dir = out.parent().expect("a folder inside another");
    let mut command = launcher(ranks, dir);
    command.arg(assert_cmd::cargo::cargo_bin!("physgrad")).args([
        "train",
        "cart_pole",
        "--threads",
        "2",
        "--out",
    ]);
    // The second value of `training.train_samples` replaces that of `SMALL`.
    command.arg(out).args(SMALL).args(SETTINGS).args(args);
    command
        .stdin(Stdio::null())
        .stdout(Stdio::piped())
        .stderr(Stdio::piped())
        .spawn()
        .expect("mpirun starts")
}

fn finish(child: Child) -> Output {
    child.wait_with_output().expect("mpirun ends")
}

fn text(output: &Output) -> String {
    format!(
        "{}{}",
        String::from_utf8_lossy(&output.stdout),
        String::from_utf8_lossy(&output.stderr)
    )
}

/// Returns the last policy, the best policy, and the metrics without the column of seconds.
fn results(out: &Path) -> (Vec<u8>, Vec<u8>, Vec<String>) {
    let read = |name: &str| {
        fs::read(out.join(name))
            .unwrap_or_else(|error| panic!("{}: {error}", out.join(name).display()))
    };
    let metrics = String::from_utf8(read("metrics.csv")).expect("text");
    let row = |line: &str| {
        line.split(',')
            .enumerate()
            .filter(|(i, _)| *i != 6)
            .map(|(_, cell)| cell.to_owned() + ",")
            .collect()
    };
    (
        read("policy.safetensors"),
        read("best_policy.safetensors"),
        metrics.lines().map(row).collect(),
    )
}

/// Returns the process ids of the ranks, in increasing order.
fn ranks_of(launcher: &Child) -> Vec<u32> {
    let output = Command::new("pgrep")
        .args(["-P", &launcher.id().to_string(), "physgrad"])
        .output()
        .expect("pgrep runs");
    let mut ids: Vec<u32> = String::from_utf8_lossy(&output.stdout)
        .lines()
        .filter_map(|line| line.parse().ok())
        .collect();
    ids.sort_unstable();
    ids
}

fn signal(id: u32, name: &str) {
    assert!(
        Command::new("kill")
            .args([&format!("-{name}"), &id.to_string()])
            .status()
            .expect("kill runs")
            .success()
    );
}

fn wait_for_epochs(out: &Path, epochs: usize) {
    let begin = Instant::now();
    while !fs::read_to_string(out.join("metrics.csv"))
        .is_ok_and(|text| text.lines().count() > epochs)
    {
        assert!(
            begin.elapsed() < Duration::from_secs(120),
            "the run did not complete {epochs} epochs within 120 s"
        );
        std::thread::sleep(Duration::from_millis(5));
    }
}

#[test]
fn two_and_three_ranks_give_the_bytes_of_one_process() {
    if !available() {
        return;
    }
    let dir = TempDir::new().expect("a folder");
    let one = dir.path().join("one");
    for field in ["C", "R"] {
        let args = ["--field", field, "--epochs", "3"];
        train(&one, &SETTINGS).args(args).args(["--threads", "1"]).assert().success();
        for ranks in [2, 3] {
            let out = dir.path().join(format!("{field}-{ranks}"));
            let output = finish(start(ranks, &out, &args));
            assert!(output.status.success(), "{}", text(&output));
            assert!(
                text(&output).contains(&format!("2 threads on each of {ranks} ranks")),
                "{}",
                text(&output)
            );
            assert_eq!(
                text(&output).matches("results in").count(),
                1,
                "not exactly one rank prints"
            );
            assert!(results(&out) == results(&one), "{field}, {ranks} ranks");
        }
    }
}

#[test]
fn ranks_skip_the_updates_that_one_process_skips() {
    if !available() {
        return;
    }
    // A large learning rate makes the rollouts of several ranks diverge from the second epoch on.
    let dir = TempDir::new().expect("a folder");
    let (one, out) = (dir.path().join("one"), dir.path().join("ranks"));
    let args = [
        "--field",
        "R",
        "--epochs",
        "3",
        "--set",
        "training.learning_rate=1e6",
        "--set",
        "training.optimizer=sgd",
    ];
    let whole = train(&one, &SETTINGS).args(args).output().expect("the program runs");
    let output = finish(start(3, &out, &args));
    let warnings = |text: &str| {
        text.lines().filter(|line| line.contains("warning:")).map(String::from).collect::<Vec<_>>()
    };
    let expected = warnings(&String::from_utf8_lossy(&whole.stderr));
    assert!(expected.iter().any(|line| line.contains("updates skipped")), "{expected:?}");
    assert_eq!(warnings(&String::from_utf8_lossy(&output.stderr)), expected);
    assert!(results(&out) == results(&one));
}

#[test]
fn an_error_is_printed_once_and_other_settings_of_a_rank_are_refused() {
    if !available() {
        return;
    }
    let dir = TempDir::new().expect("a folder");
    let out = dir.path().join("out");
    let output = finish(start(3, &out, &["--set", "system.masses=1"]));
    assert!(!output.status.success());
    assert_eq!(text(&output).matches("error:").count(), 1, "{}", text(&output));

    // Rank 1 has more epochs. The identity of a run does not contain the number of epochs.
    let mut ranks = launcher(1, dir.path());
    for (rank, epochs) in ["2", "3"].into_iter().enumerate() {
        if rank > 0 {
            ranks.args([":", "-n", "1"]);
        }
        ranks.arg(assert_cmd::cargo::cargo_bin!("physgrad")).args([
            "train",
            "cart_pole",
            "--threads",
            "1",
            "--out",
        ]);
        ranks.arg(&out).args(SMALL).args(["--epochs", epochs]);
    }
    let output = ranks.output().expect("mpirun runs");
    assert!(!output.status.success() && !out.exists());
    assert!(
        text(&output).contains("rank 1: its settings differ from those of rank 0"),
        "{}",
        text(&output)
    );
}

#[test]
fn a_killed_rank_ends_the_run_and_another_number_of_ranks_resumes_it() {
    if !available() {
        return;
    }
    let dir = TempDir::new().expect("a folder");
    let (one, out) = (dir.path().join("one"), dir.path().join("ranks"));
    let endless = start(2, &out, &["--epochs", "1000000", "--save-every", "0"]);
    wait_for_epochs(&out, 3);
    signal(ranks_of(&endless)[1], "KILL");
    let output = finish(endless);
    assert!(!output.status.success());
    assert!(text(&output).contains("signal 9"), "{}", text(&output));

    // A signal to one rank ends the training on all ranks, and rank 0 saves.
    let endless = start(3, &out, &["--resume", "--epochs", "1000000"]);
    wait_for_epochs(&out, 6);
    let begin = Instant::now();
    while ranks_of(&endless).len() < 3 {
        assert!(
            begin.elapsed() < Duration::from_secs(60),
            "fewer than three ranks started within 60 s"
        );
        std::thread::sleep(Duration::from_millis(20));
    }
    wait_for_epochs(
        &out,
        fs::read_to_string(out.join("metrics.csv")).expect("metrics").lines().count() + 2,
    );
    signal(ranks_of(&endless)[2], "TERM");
    let output = finish(endless);
    assert!(text(&output).contains("interrupted after epoch"), "{}", text(&output));

    let done = results(&out).2.len() - 1;
    train(&one, &SETTINGS).args(["--epochs", &done.to_string()]).assert().success();
    assert!(results(&out) == results(&one), "{done} epochs");
}
