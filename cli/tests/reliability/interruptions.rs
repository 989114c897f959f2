//! Concurrent processes, signals, closed pipes and full disks: the program loses no finished work,
//! and reports errors.
#![cfg(unix)]

use crate::running::{SMALL, error_of, physgrad, process, train};
use std::fs::{self, File};
use std::io::{BufRead, BufReader, Read};
use std::os::unix::fs::symlink;
use std::os::unix::process::ExitStatusExt;
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Output, Stdio};
use std::time::{Duration, Instant};
use tempfile::TempDir;

/// More epochs than any test waits for.
const ENDLESS: &str = "1000000";

fn folder() -> (TempDir, PathBuf) {
    let dir = TempDir::new().expect("a folder");
    let out = dir.path().join("run");
    (dir, out)
}

fn policy(out: &Path) -> Vec<u8> {
    fs::read(out.join("policy.safetensors")).expect("a policy")
}

/// Returns the header and rows of the metrics, without the column of seconds.
fn metrics(out: &Path) -> Vec<String> {
    let text = fs::read_to_string(out.join("metrics.csv")).expect("metrics");
    let row = |line: &str| {
        let mut fields: Vec<&str> = line.split(',').collect();
        assert_eq!(fields.len(), 17, "{line}");
        fields.remove(6);
        fields.join(",")
    };
    text.lines().map(row).collect()
}

fn wait_until(what: &str, mut holds: impl FnMut() -> bool) {
    let begin = Instant::now();
    while !holds() {
        assert!(begin.elapsed() < Duration::from_secs(120), "not within 120 s: {what}");
        std::thread::sleep(Duration::from_millis(5));
    }
}

/// Waits until the run has recorded at least `epochs` epochs.
fn wait_for_epochs(out: &Path, epochs: usize) {
    wait_until("the run completes the epochs", || {
        fs::read_to_string(out.join("metrics.csv")).is_ok_and(|text| text.lines().count() > epochs)
    });
}

fn signal(child: &Child, name: &str) {
    let killed = Command::new("kill").args([&format!("-{name}"), &child.id().to_string()]).status();
    assert!(killed.expect("kill runs").success());
}

/// Whether the program that this process starts will ignore the signal. False where unknown.
fn is_ignored(signal: i32) -> bool {
    let status = fs::read_to_string("/proc/self/status").unwrap_or_default();
    let mask = status.lines().find_map(|line| line.strip_prefix("SigIgn:"));
    mask.is_some_and(|mask| {
        u64::from_str_radix(mask.trim(), 16).is_ok_and(|mask| mask >> (signal - 1) & 1 == 1)
    })
}

fn text(bytes: &[u8]) -> String {
    String::from_utf8_lossy(bytes).into_owned()
}

fn assert_complete(out: &Path) {
    for name in [
        "run.toml",
        "checkpoint.bin",
        "metrics.csv",
        "policy.safetensors",
        "learning_curve.svg",
        "trajectory.csv",
    ] {
        assert!(fs::metadata(out.join(name)).is_ok_and(|file| file.len() > 0), "{name}");
    }
    let left: Vec<_> = fs::read_dir(out)
        .expect("a folder")
        .map(|entry| entry.expect("an entry").file_name())
        .collect();
    assert!(!left.iter().any(|name| name.to_string_lossy().ends_with(".new")), "{left:?}");
}

#[test]
fn one_of_100_simultaneous_starts_runs_and_99_are_refused() {
    let (_dir, out) = folder();
    let mut children: Vec<Child> = (0..100)
        .map(|_| {
            process(&out, &["--epochs", ENDLESS, "--threads", "1"])
                .spawn()
                .expect("the process starts")
        })
        .collect();
    let mut refused: Vec<Output> = Vec::new();
    wait_until("99 processes end", || {
        while let Some(ended) = children
            .iter_mut()
            .position(|child| child.try_wait().expect("the process is a child").is_some())
        {
            refused.push(
                children.swap_remove(ended).wait_with_output().expect("the process has ended"),
            );
        }
        refused.len() >= 99
    });
    assert_eq!(children.len(), 1);
    let survivor = children.remove(0);
    for output in &refused {
        let error = text(&output.stderr);
        assert_eq!(output.status.code(), Some(1), "{error}");
        assert!(
            error.contains("is in use by process") && error.contains(&survivor.id().to_string()),
            "{error}"
        );
    }
    wait_for_epochs(&out, 2);
    signal(&survivor, "TERM");
    assert_eq!(survivor.wait_with_output().expect("the process ends").status.code(), Some(143));
    assert_complete(&out);
    assert_eq!(
        fs::read_dir(out.parent().expect("a parent")).expect("a folder").count(),
        1,
        "a run was renamed"
    );
}

#[test]
fn two_simultaneous_resumes_give_the_metrics_of_one_uninterrupted_run() {
    let (dir, out) = folder();
    let whole = dir.path().join("whole");
    train(&whole, &["--epochs", "12"]).assert().success();
    train(&out, &["--epochs", "2"]).assert().success();
    for epochs in ["6", "12"] {
        let resume = || {
            let mut command = process(&out, &["--resume", "--epochs", epochs]);
            command.spawn().expect("the process starts")
        };
        let pair =
            [resume(), resume()].map(|child| child.wait_with_output().expect("the process ends"));
        assert!(pair.iter().any(|output| output.status.success()));
        for output in pair {
            assert!(
                output.status.success() || text(&output.stderr).contains("in use by"),
                "{}",
                text(&output.stderr)
            );
        }
    }
    assert_eq!(metrics(&out), metrics(&whole));
    assert!(policy(&out) == policy(&whole));
}

#[test]
fn a_comparison_waits_for_a_run_of_another_process() {
    let dir = TempDir::new().expect("a folder");
    let run = dir.path().join("runs/C-0");
    let mut first = process(&run, &["--epochs", ENDLESS]).spawn().expect("the process starts");
    wait_for_epochs(&run, 1);
    let mut compare = Command::new(assert_cmd::cargo::cargo_bin!("physgrad"));
    compare
        .args([
            "compare",
            "cart_pole",
            "--fields",
            "C",
            "--seeds",
            "1",
            "--epochs",
            ENDLESS,
            "--out",
        ])
        .arg(dir.path());
    let mut compare = compare
        .args(SMALL)
        .stdout(Stdio::null())
        .stderr(Stdio::piped())
        .spawn()
        .expect("the process starts");
    let mut messages = BufReader::new(compare.stderr.take().expect("a pipe"));
    let mut printed = String::new();
    while !printed.contains("waiting for the folder") {
        assert!(messages.read_line(&mut printed).expect("text") > 0, "{printed}");
    }
    // The program refuses a second comparison in the folder.
    let mut second = physgrad(&[
        "compare",
        "cart_pole",
        "--fields",
        "C",
        "--seeds",
        "1",
        "--epochs",
        ENDLESS,
        "--out",
    ]);
    assert!(error_of(second.arg(dir.path()).args(SMALL)).contains("in use by process"));
    let done = metrics(&run).len();
    first.kill().expect("the process is killed");
    first.wait().expect("the process ends");
    wait_for_epochs(&run, done + 5);
    signal(&compare, "TERM");
    messages.read_to_string(&mut printed).expect("text");
    assert_eq!(compare.wait().expect("the process ends").code(), Some(143), "{printed}");
    assert_complete(&run);
}

#[test]
fn closed_output_pipes_do_not_stop_the_training() {
    for closed in ["stdout", "stderr", "both"] {
        let (_dir, out) = folder();
        let mut command = process(&out, &["--epochs", "3"]);
        let pipe = || {
            let (reader, writer) = std::io::pipe().expect("a pipe");
            drop(reader);
            writer
        };
        if closed != "stderr" {
            command.stdout(pipe());
        }
        if closed != "stdout" {
            command.stderr(pipe());
        }
        let status = command.status().expect("the command runs");
        assert!(status.success(), "{closed}: {status}");
        assert_complete(&out);
    }
}

#[cfg(target_os = "linux")]
fn full() -> File {
    File::options().write(true).open("/dev/full").expect("a device that is always full")
}

#[cfg(target_os = "linux")]
#[test]
fn a_full_standard_error_is_ignored_and_a_full_standard_output_is_an_error() {
    let (_dir, out) = folder();
    let status =
        process(&out, &["--epochs", "2"]).stderr(full()).status().expect("the command runs");
    assert!(status.success(), "{status}");
    assert_complete(&out);
    let (_dir, out) = folder();
    let output =
        process(&out, &["--epochs", "2"]).stdout(full()).output().expect("the command runs");
    assert_eq!(output.status.code(), Some(1));
    assert!(text(&output.stderr).contains("standard output"), "{}", text(&output.stderr));
    assert_complete(&out);
    for args in [
        &["scene"][..],
        &["scene", "cart_pole"],
        &["schema"],
        &["tasks"],
        &["effects"],
        &["explain", "lqr"],
    ] {
        let mut command = Command::new(assert_cmd::cargo::cargo_bin!("physgrad"));
        let output = command
            .args(args)
            .stdout(full())
            .stderr(Stdio::piped())
            .output()
            .expect("the command runs");
        assert_eq!(output.status.code(), Some(1), "{args:?}");
        assert!(
            text(&output.stderr).contains("No space left"),
            "{args:?}: {}",
            text(&output.stderr)
        );
    }
}

#[test]
fn an_earlier_run_is_renamed_and_a_folder_with_foreign_files_is_refused() {
    let (dir, out) = folder();
    let again = || train(&out, &["--epochs", "1", "--seed", "9"]);
    train(&out, &["--epochs", "1"]).assert().success();
    let first = policy(&out);
    assert!(error_of(&mut train(&out, &["--threads", "0"])).contains("--threads"));
    assert!(policy(&out) == first, "an invalid option renames the run");

    fs::write(out.join("notes.txt"), "mine").expect("a file");
    let error = error_of(&mut again());
    assert!(error.contains("notes.txt") && error.contains("--out"), "{error}");
    assert!(policy(&out) == first);
    fs::remove_file(out.join("notes.txt")).expect("a file");

    let output = again().output().expect("the command runs");
    assert!(output.status.success() && text(&output.stderr).contains("run.previous-1"));
    assert!(policy(&dir.path().join("run.previous-1")) == first && policy(&out) != first);
    again().assert().success();
    assert!(policy(&dir.path().join("run.previous-2")) == policy(&out));
    assert!(policy(&dir.path().join("run.previous-1")) == first);

    for name in ["checkpoint.bin", "metrics.csv", "policy.safetensors"] {
        let (_dir, out) = folder();
        fs::create_dir(&out).expect("a folder");
        fs::write(out.join(name), "mine").expect("a file");
        let error = error_of(&mut train(&out, &["--epochs", "1"]));
        assert!(error.contains(name) && error.contains("no run.toml"), "{error}");
        assert_eq!(fs::read_to_string(out.join(name)).expect("a file"), "mine");
    }
}

#[test]
fn sixty_staggered_starts_lose_no_finished_run() {
    let (dir, out) = folder();
    let start = |seed: usize| {
        std::thread::sleep(Duration::from_millis(7));
        let seed = seed.to_string();
        (
            seed.clone(),
            process(&out, &["--epochs", "1", "--seed", &seed]).spawn().expect("the process starts"),
        )
    };
    let children: Vec<(String, Child)> = (0..60).map(start).collect();
    let mut finished = Vec::new();
    for (seed, child) in children {
        let output = child.wait_with_output().expect("the process ends");
        let error = text(&output.stderr);
        assert!(output.status.success() || error.contains("in use by process"), "{error}");
        finished.extend(output.status.success().then_some(format!("seed = {seed}")));
    }
    let folders =
        fs::read_dir(dir.path()).expect("a folder").map(|entry| entry.expect("an entry").path());
    let seed_of = |folder: PathBuf| {
        assert_complete(&folder);
        let settings = fs::read_to_string(folder.join("run.toml")).expect("settings");
        settings.lines().find(|line| line.starts_with("seed")).expect("a seed").to_owned()
    };
    let mut kept: Vec<String> = folders.map(seed_of).collect();
    kept.sort();
    finished.sort();
    assert_eq!(kept, finished);
}

#[test]
fn an_earlier_run_behind_a_symbolic_link_is_renamed() {
    let (dir, out) = folder();
    let link = dir.path().join("link");
    fs::create_dir(&out).expect("a folder");
    symlink(&out, &link).expect("a link");
    for path in [&link, &link.join("."), &out.join("")] {
        train(path, &["--epochs", "1"]).assert().success();
        assert_complete(&link);
    }
    assert_complete(&dir.path().join("run.previous-2"));
}

#[test]
fn a_run_is_refused_in_the_folder_of_a_comparison_and_vice_versa() {
    let (_dir, out) = folder();
    let compare = || {
        let mut compare = physgrad(&[
            "compare",
            "cart_pole",
            "--fields",
            "C",
            "--seeds",
            "1",
            "--epochs",
            "1",
            "--out",
        ]);
        compare.arg(&out).args(SMALL);
        compare
    };
    compare().assert().success();
    assert!(error_of(&mut train(&out, &["--epochs", "1"])).contains("holds a comparison"));
    // The runs of several scenes are in subfolders with the names of the scenes.
    let (_dir, out) = folder();
    let mut scenes = physgrad(&[
        "compare",
        "cart_pole_1",
        "cart_pole_2",
        "--fields",
        "C",
        "--seeds",
        "1",
        "--epochs",
        "1",
        "--out",
    ]);
    scenes.arg(&out).args(SMALL).assert().success();
    assert!(error_of(&mut train(&out, &["--epochs", "1"])).contains("holds a comparison"));
    let (_dir, out) = folder();
    train(&out, &["--epochs", "1"]).assert().success();
    let mut compare = physgrad(&["compare", "cart_pole", "--out"]);
    assert!(error_of(compare.arg(&out).args(SMALL)).contains("is not a comparison"));
}

#[test]
fn a_run_starts_in_a_folder_with_the_initial_policy_of_a_killed_run() {
    let (dir, out) = folder();
    let first = dir.path().join("first");
    train(&first, &["--epochs", "1"]).assert().success();
    fs::create_dir(&out).expect("a folder");
    // A kill between the first two files of a run leaves this file only.
    fs::copy(first.join("policy.safetensors"), out.join("initial_policy.safetensors"))
        .expect("a copy");
    let policy = first.to_str().expect("a path in UTF-8");
    train(&out, &["--epochs", "1", "--policy", policy]).assert().success();
    assert_complete(&out);
}

#[test]
fn named_pipes_are_refused_and_hard_links_are_not_written_through() {
    let fifo = |path: &Path| {
        assert!(Command::new("mkfifo").arg(path).status().expect("the command runs").success())
    };
    let (_dir, out) = folder();
    fs::create_dir(&out).expect("a folder");
    fifo(&out.join(".physgrad.lock"));
    let error = error_of(train(&out, &["--epochs", "1"]).timeout(Duration::from_secs(20)));
    assert!(error.contains(".physgrad.lock is a link or not a regular file"), "{error}");

    for name in ["run.toml", "checkpoint.bin"] {
        let (_dir, out) = folder();
        train(&out, &["--epochs", "1"]).assert().success();
        fs::remove_file(out.join(name)).expect("a file");
        fifo(&out.join(name));
        let mut resume = train(&out, &["--resume", "--epochs", "2"]);
        for command in
            [&mut resume, physgrad(&["report"]).arg(&out), physgrad(&["animate"]).arg(&out)]
        {
            let error = error_of(command.timeout(Duration::from_secs(20)));
            assert!(error.contains(name) && error.contains("not a file"), "{error}");
        }
    }

    let (dir, out) = folder();
    let precious = dir.path().join("precious");
    fs::write(&precious, "mine").expect("a file");
    fs::create_dir(&out).expect("a folder");
    fs::hard_link(&precious, out.join(".physgrad.lock")).expect("a link");
    assert!(error_of(&mut train(&out, &["--epochs", "1"])).contains("is a link"));
    assert_eq!(fs::read_to_string(&precious).expect("a file"), "mine");
}

#[cfg(target_os = "linux")]
#[test]
fn a_folder_that_cannot_be_made_is_an_error() {
    let error = error_of(
        train(Path::new("/proc/physgrad/run"), &["--epochs", "1"]).timeout(Duration::from_secs(20)),
    );
    assert!(error.contains("cannot be written to"), "{error}");
}

#[test]
fn symbolic_links_are_not_written_through() {
    let (dir, out) = folder();
    let other = dir.path().join("other");
    fs::write(&other, "mine").expect("a file");
    train(&out, &["--epochs", "1"]).assert().success();
    for name in ["metrics.csv", "policy.safetensors"] {
        let _ = fs::remove_file(out.join(name));
        symlink(&other, out.join(name)).expect("a link");
    }
    train(&out, &["--resume", "--epochs", "3"]).assert().success();
    assert_eq!(fs::read_to_string(&other).expect("a file"), "mine");
    let (_dir, out) = folder();
    fs::create_dir(&out).expect("a folder");
    symlink(&other, out.join(".physgrad.lock")).expect("a link");
    assert!(error_of(&mut train(&out, &["--epochs", "1"])).contains("is a link"));
    assert_eq!(fs::read_to_string(&other).expect("a file"), "mine");
}

#[test]
fn the_first_signal_saves_a_complete_run_that_resumes() {
    for (name, status) in [("INT", 130), ("TERM", 143), ("HUP", 129)] {
        // Background jobs of a shell ignore INT, and `nohup` makes them ignore HUP.
        if is_ignored(status - 128) {
            println!("skipped the signal {name}, which the parent process ignores");
            continue;
        }
        let (_dir, out) = folder();
        let child = process(&out, &["--epochs", ENDLESS]).spawn().expect("the process starts");
        wait_for_epochs(&out, 2);
        signal(&child, name);
        let output = child.wait_with_output().expect("the process ends");
        assert_eq!(output.status.code(), Some(status), "{name}");
        assert!(text(&output.stdout).contains("--resume"), "{name}");
        assert_complete(&out);
        let done = metrics(&out).len() - 1;
        train(&out, &["--resume", "--epochs", &(done + 1).to_string()]).assert().success();
    }
}

/// Settings whose epochs last for minutes.
const LONG_EPOCHS: [&str; 4] =
    ["--set", "training.train_samples=100000", "--set", "training.batch=1"];

#[test]
fn the_second_signal_stops_within_the_epoch_and_keeps_the_checkpoint() {
    let (_dir, out) = folder();
    let mut train = process(&out, &["--epochs", "2", "--threads", "1", "--save-every", "0"]);
    let mut child = train.args(LONG_EPOCHS).spawn().expect("the process starts");
    // Before the first epoch, a signal ends the run without a message.
    let checkpoint = || fs::read(out.join("checkpoint.bin")).ok();
    wait_until("the run begins", || checkpoint().is_some());
    let first = checkpoint();
    wait_until("the run saves within the epoch", || checkpoint() != first);
    signal(&child, "TERM");
    // After the first signal, the program prints a message within the epoch. A newer checkpoint is
    // no evidence of the signal, because the program also saves periodically.
    let messages = BufReader::new(child.stderr.take().expect("standard error is piped")).lines();
    let answer = messages
        .map(|line| line.expect("the messages are text"))
        .find(|line| line.contains("a second signal stops immediately"));
    assert!(answer.is_some(), "no message follows the first signal");
    signal(&child, "TERM");
    assert_eq!(child.wait().expect("the process ends").code(), Some(143));
    assert!(!out.join("policy.safetensors").exists());
    physgrad(&["animate"]).arg(&out).assert().success();
}

#[cfg(target_os = "linux")]
#[test]
fn an_ignored_signal_stays_ignored() {
    let (_dir, out) = folder();
    let mut shell = Command::new("sh");
    shell.args(["-c", "trap '' HUP; exec \"$@\"", "sh"]);
    let train = process(&out, &["--epochs", ENDLESS]);
    shell
        .arg(train.get_program())
        .args(train.get_args())
        .stdout(Stdio::null())
        .stderr(Stdio::null());
    let mut child = shell.spawn().expect("the process starts");
    wait_for_epochs(&out, 1);
    signal(&child, "HUP");
    let done = metrics(&out).len();
    wait_for_epochs(&out, done + 3);
    signal(&child, "TERM");
    assert_eq!(child.wait().expect("the process ends").code(), Some(143));
}

#[test]
fn a_run_killed_within_an_epoch_resumes_there_to_the_same_bits() {
    let (dir, out) = folder();
    let args = [
        "--epochs",
        "2",
        "--save-every",
        "0",
        "--set",
        "training.train_samples=2000",
        "--set",
        "training.shuffle=true",
    ];
    let mut child = process(&out, &args).spawn().expect("the process starts");
    let mut states = Vec::new();
    wait_until("the run writes six checkpoints in its first epoch", || {
        states.extend(
            fs::read(out.join("checkpoint.bin")).ok().filter(|state| states.last() != Some(state)),
        );
        states.len() > 5
    });
    child.kill().expect("the process is killed");
    assert_eq!(child.wait().expect("the process ends").signal(), Some(9));
    assert_eq!(metrics(&out).len(), 1, "lines of the metrics: a header and no epoch");
    train(&out, &args).arg("--resume").assert().success();
    let whole = dir.path().join("whole");
    train(&whole, &args[..2]).args(&args[4..]).assert().success();
    assert!(policy(&out) == policy(&whole));
    assert_eq!(metrics(&out), metrics(&whole));
}

#[test]
fn a_training_without_an_update_exits_with_status_3() {
    let diverges =
        ["--set", "system.gravity=1e38", "--set", "system.dt=1e5", "--quiet", "--epochs", "2"];
    let (_dir, out) = folder();
    let output = train(&out, &diverges).output().expect("the command runs");
    let error = text(&output.stderr);
    assert_eq!(output.status.code(), Some(3), "{error}");
    assert!(
        error.contains("no update was applied") && error.contains("3 update(s) skipped"),
        "{error}"
    );
    let (_dir, out) = folder();
    let output = train(&out, &[&diverges[..5], &["--epochs", "100"]].concat())
        .output()
        .expect("the command runs");
    assert_eq!(
        output.status.code(),
        Some(3),
        "too many skipped updates in a row: {}",
        text(&output.stderr)
    );

    let (_dir, out) = folder();
    let mut compare =
        physgrad(&["compare", "cart_pole", "--fields", "R,C", "--seeds", "1", "--out"]);
    let output = compare.arg(&out).args(SMALL).args(diverges).output().expect("the command runs");
    let error = text(&output.stderr);
    assert_eq!(output.status.code(), Some(3), "{error}");
    assert!(error.contains("2 of 2 runs (R seed 0, C seed 0)"), "{error}");
    assert!(out.join("summary.csv").exists());
}

#[test]
fn commands_with_invalid_settings_change_and_create_no_folder() {
    let (dir, out) = folder();
    train(&out, &["--epochs", "1"]).assert().success();
    let first = policy(&out);
    let error = error_of(&mut train(&out, &["--epochs", "1", "--set", "training.memory=\"1kB\""]));
    assert!(error.contains("training.memory"), "{error}");
    assert!(policy(&out) == first && fs::read_dir(dir.path()).expect("a folder").count() == 1);

    let error = error_of(
        physgrad(&["train", "cart_pole", "--resume", "--out"]).arg(dir.path().join("typo/a/b")),
    );
    assert!(error.contains("there is no folder"), "{error}");
    assert!(!dir.path().join("typo").exists());

    let compare = dir.path().join("compare");
    let mut command =
        physgrad(&["compare", "cart_pole", "--set", "training.memory=\"1kB\"", "--out"]);
    assert!(error_of(command.arg(&compare)).contains("training.memory"));
    assert!(!compare.exists());
}

#[test]
fn exceeding_the_file_size_limit_is_an_error() {
    let (_dir, out) = folder();
    let mut shell = Command::new("sh");
    // Blocks have 512 bytes in POSIX, 1,024 in some shells.
    shell.args(["-c", "ulimit -f 4; exec \"$@\"", "sh"]);
    let train = process(&out, &["--epochs", "60"]);
    let output =
        shell.arg(train.get_program()).args(train.get_args()).output().expect("the command runs");
    let error = text(&output.stderr);
    assert_eq!(output.status.code(), Some(1), "{error}");
    assert!(error.contains("cannot write") && error.contains("File too large"), "{error}");
}

#[test]
fn a_folder_that_is_renamed_or_replaced_during_the_run_is_an_error() {
    for replaced in [false, true] {
        let (dir, out) = folder();
        let child = process(&out, &["--epochs", "2000", "--save-every", "0.05"])
            .spawn()
            .expect("the process starts");
        wait_for_epochs(&out, 2);
        fs::rename(&out, dir.path().join("moved")).expect("a folder");
        if replaced {
            fs::create_dir(&out).expect("a folder");
        }
        let output = child.wait_with_output().expect("the process ends");
        let error = text(&output.stderr);
        assert_eq!(output.status.code(), Some(1), "{error}");
        assert!(error.contains("was removed or replaced"), "{error}");
    }
}
