//! Plans: the runs of several processes, some of them interrupted or killed, equal those of one
//! process.

use crate::running::{SMALL, error_of, physgrad, train};
use std::collections::BTreeMap;
use std::fs;
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};
use std::time::{Duration, Instant};
use tempfile::TempDir;

/// Returns the arguments of a comparison of `fields`, with `seeds` seeds and `epochs` epochs.
fn options(fields: &str, seeds: usize, epochs: usize) -> Vec<String> {
    let text = format!(
        "compare cart_pole_1 --fields {fields} --seeds {seeds} --epochs {epochs} --threads 1 --set training.train_samples=8 \
         --set training.test_samples=4 --set policy.widths=[4] --set horizon=5"
    );
    text.split(' ').map(String::from).collect()
}

fn start(options: &[String], out: &Path, more: &[&str]) -> Child {
    let mut command = Command::new(assert_cmd::cargo::cargo_bin!("physgrad"));
    command.args(options).args(more).arg("--out").arg(out);
    command
        .stdin(Stdio::null())
        .stdout(Stdio::piped())
        .stderr(Stdio::piped())
        .spawn()
        .expect("the process starts")
}

fn shard(options: &[String], out: &Path, shard: &str) -> Child {
    start(options, out, &["--shard", shard])
}

/// Trains all runs in one process.
fn whole(options: &[String], out: &Path) {
    let options: Vec<&str> = options.iter().map(String::as_str).collect();
    physgrad(&options).arg("--quiet").arg("--out").arg(out).assert().success();
}

/// Number of runs below the folder that have ended.
fn ended(folder: &Path) -> usize {
    let entries = fs::read_dir(folder).into_iter().flatten().flatten().map(|entry| entry.path());
    let count = |path: PathBuf| match path.is_dir() {
        true => ended(&path),
        false => usize::from(path.ends_with("end.toml")),
    };
    entries.map(count).sum()
}

/// Returns all files below the folder, without lock files, temporary files and wall times.
///
/// Wall times are in the columns `seconds`, in `times.csv`, in the picture with a time axis, and in
/// the checkpoints. A killed process may leave a temporary file of an unfinished write, with a name
/// of the form `.NAME.*.new`.
fn files(folder: &Path) -> BTreeMap<PathBuf, Vec<u8>> {
    let mut found = BTreeMap::new();
    let mut folders = vec![folder.to_owned()];
    while let Some(inner) = folders.pop() {
        for entry in fs::read_dir(&inner).expect("a folder") {
            let path = entry.expect("an entry").path();
            let name = path.file_name().expect("a name").to_string_lossy().into_owned();
            match &*name {
                _ if path.is_dir() => folders.push(path),
                _ if name.starts_with('.') && name.ends_with(".new") => {}
                ".physgrad.lock" | "checkpoint.bin" | "curves.svg" | "times.csv" => {}
                _ => {
                    let bytes = fs::read(&path).expect("a file");
                    let bytes = if name.ends_with("metrics.csv") || name == "summary.csv" {
                        without_seconds(&bytes)
                    } else {
                        bytes
                    };
                    found.insert(
                        path.strip_prefix(folder).expect("a path below the folder").to_owned(),
                        bytes,
                    );
                }
            }
        }
    }
    found
}

fn without_seconds(csv: &[u8]) -> Vec<u8> {
    let text = std::str::from_utf8(csv).expect("text");
    let rows: Vec<Vec<&str>> = text.lines().map(|line| line.split(',').collect()).collect();
    let column = rows[0].iter().position(|name| *name == "seconds").expect("a column of seconds");
    let row = |row: &Vec<&str>| [&row[..column], &row[column + 1..]].concat().join(",");
    rows.iter().map(row).collect::<Vec<_>>().join("\n").into_bytes()
}

fn assert_equal(one: &Path, other: &Path) {
    let [one, other] = [one, other].map(files);
    assert_eq!(one.keys().collect::<Vec<_>>(), other.keys().collect::<Vec<_>>());
    for (path, bytes) in &one {
        assert!(*bytes == other[path], "{} differs", path.display());
    }
}

fn wait_until(event: &str, mut holds: impl FnMut() -> bool) {
    let begin = Instant::now();
    while !holds() {
        assert!(begin.elapsed() < Duration::from_secs(240), "not within 240 s: {event}");
        std::thread::sleep(Duration::from_millis(5));
    }
}

#[test]
fn eight_shards_with_three_kills_give_the_bytes_of_one_process() {
    let dir = TempDir::new().expect("a folder");
    let (one, many) = (dir.path().join("one"), dir.path().join("many"));
    let options = options("R,M,S,C", 25, 2);
    whole(&options, &one);

    let start = |number: usize| shard(&options, &many, &format!("{number}/8"));
    let mut shards: Vec<Child> = (1..=8).map(start).collect();
    for (number, enough) in [(2, 5), (5, 20), (8, 40)] {
        wait_until("some runs end", || ended(&many) >= enough);
        let mut killed = std::mem::replace(&mut shards[number - 1], start(number));
        killed.kill().expect("the process is killed");
        killed.wait().expect("the process ends");
    }
    let (mut trained, mut finished) = (0, 0);
    for child in shards {
        let output = child.wait_with_output().expect("the process ends");
        let text = String::from_utf8_lossy(&output.stderr).into_owned();
        assert!(output.status.success(), "{text}");
        // `shard 1/8: trained 13 runs; ...`
        let line = text.lines().find(|line| line.contains(": trained ")).expect("a summary");
        let count = line.split("trained ").nth(1).and_then(|rest| rest.split(' ').next());
        trained += count.and_then(|count| count.parse::<usize>().ok()).expect("a number of runs");
        finished = finished.max(ended(&many));
    }
    assert_eq!(finished, 100);
    assert!(trained <= 100, "a run is trained twice: {trained} trainings of 100 runs");
    physgrad(&["merge", "--quiet"]).arg(&many).assert().success();
    assert_equal(&one, &many);

    // Runs resumed from both checkpoints write equal files.
    for out in [&one, &many] {
        physgrad(&["train", "--resume", "--epochs", "3", "--quiet", "--out"])
            .arg(out.join("runs/C-24"))
            .assert()
            .success();
    }
    assert_equal(&one.join("runs/C-24"), &many.join("runs/C-24"));
}

#[test]
fn a_comparison_that_starts_from_policies_is_merged() {
    let dir = TempDir::new().expect("a folder");
    for seed in ["0", "1"] {
        train(&dir.path().join(seed), &["--epochs", "1", "--seed", seed]).assert().success();
    }
    // The policy is an option of all points, or differs between the points of a grid.
    let [first, second] = ["0", "1"]
        .map(|seed| dir.path().join(seed).join("policy.safetensors").display().to_string());
    for (name, policies) in [("one", vec![first.clone()]), ("two", vec![first, second])] {
        let out = dir.path().join(name);
        let set = format!(
            "initial_policy={}",
            policies.iter().map(|path| format!("{path:?}")).collect::<Vec<_>>().join(",")
        );
        let mut compare = physgrad(&[
            "compare",
            "cart_pole",
            "--fields",
            "C",
            "--seeds",
            "1",
            "--epochs",
            "1",
            "--set",
            &set,
        ]);
        compare.args(SMALL).arg("--out").arg(&out).assert().success();
        let summary = fs::read(out.join("summary.csv")).expect("a summary");
        fs::remove_file(out.join("summary.csv")).expect("a summary");
        physgrad(&["merge", "--quiet"]).arg(&out).assert().success();
        assert_eq!(fs::read(out.join("summary.csv")).expect("a summary"), summary, "{name}");
    }
}

#[test]
fn the_next_shard_completes_a_killed_one_and_merge_names_missing_runs() {
    let dir = TempDir::new().expect("a folder");
    let (one, many) = (dir.path().join("one"), dir.path().join("many"));
    let options = options("R,C", 2, 40);
    whole(&options, &one);

    let mut killed = shard(&options, &many, "2/2");
    wait_until("a run ends", || ended(&many) > 0);
    // The program refuses a command without `--shard` while a shard runs.
    let args: Vec<&str> = options.iter().map(String::as_str).collect();
    assert!(error_of(physgrad(&args).arg("--out").arg(&many)).contains("in use by process"));
    killed.kill().expect("the process is killed");
    killed.wait().expect("the process ends");
    if ended(&many) < 4 {
        let error = error_of(physgrad(&["merge"]).arg(&many));
        let missing = 4 - ended(&many);
        assert!(
            error.contains(&format!("{missing} of 4 runs are missing or not complete")),
            "{error}"
        );
        assert!(error.contains("C seed 1") || error.contains("R seed 0"), "{error}");
        assert!(many.join("summary.csv").exists(), "merge writes no tables of the other runs");
    }
    let output = shard(&options, &many, "1/2").wait_with_output().expect("the process ends");
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    physgrad(&["merge", "--quiet"]).arg(&many).assert().success();
    assert_equal(&one, &many);
    assert!(
        error_of(physgrad(&["merge"]).arg(one.join("runs")))
            .contains("is not the folder of a comparison")
    );
}

/// A plan file, and the short forms that make plans, with a change that a shard refuses, and the
/// name of the folder of the plan.
#[cfg(unix)]
#[test]
#[ignore = "long: many processes"]
fn interrupted_killed_and_shared_plans_give_the_bytes_of_one_process() {
    let dir = TempDir::new().expect("a folder");
    let small = "set = { horizon = 5, policy.widths = [4], \"training.train_samples\" = 8, \"training.test_samples\" = 4 }";
    let plan = format!(
        "seeds = 3\nepochs = 20\nbest = {{ \"training.learning_rate\" = [0.001, 0.01] }}\n[[task]]\nscene = \"cart_pole_1\"\n{small}\n\
         [[task]]\nscene = \"cart_pole_2\"\n{small}\n[[method]]\nname = \"R\"\nset = {{ field = \"R\" }}\n\
         [[method]]\nname = \"C\"\nset = {{ field = \"C\" }}\n"
    );
    let path = dir.path().join("plan.toml");
    fs::write(&path, plan).expect("a file");
    let study = ["study", path.to_str().expect("a path in UTF-8"), "--threads", "1"];
    let mut compare = options("R,C", 3, 20);
    compare.extend(["--set", "training.batch=2,4"].map(String::from));
    let paper = "paper fig3 --quick --epochs 2 --seeds 1 --fields R --clip none,norm --threads 1";
    for (name, options, change, inner) in [
        ("study", study.map(String::from).to_vec(), ["--quick", "epochs = 5"], ""),
        ("compare", compare, ["--seed=7", "seed = 7"], ""),
        (
            "paper",
            paper.split(' ').map(String::from).collect(),
            ["--epochs=3", "epochs = 3"],
            "fig3",
        ),
    ] {
        let [one, resumed, many] =
            ["one", "resumed", "many"].map(|folder| dir.path().join(name).join(folder));
        whole(&options, &one);
        let runs = ended(&one);

        // A signal, and then a kill, after some runs.
        let child = start(&options, &resumed, &[]);
        wait_until("a run ends", || ended(&resumed) >= 1);
        let signal = Command::new("kill").args(["-TERM", &child.id().to_string()]).status();
        assert!(signal.expect("kill runs").success());
        let output = child.wait_with_output().expect("the process ends");
        assert_eq!(output.status.code(), Some(143), "{name}");
        let text = String::from_utf8_lossy(&output.stdout).into_owned();
        assert!(text.contains("interrupted; to resume, repeat the command with --out"), "{text}");
        let begun = ended(&resumed);
        let mut child = start(&options, &resumed, &["--quiet"]);
        wait_until("another run ends", || ended(&resumed) > begun);
        child.kill().expect("the process is killed");
        child.wait().expect("the process ends");
        assert!(ended(&resumed) < runs, "{name}: the kill comes too late");
        assert!(!resumed.join(inner).join("summary.csv").exists(), "{name}: tables of some runs");
        whole(&options, &resumed);
        assert_equal(&one, &resumed);

        for child in ["1/2", "2/2"].map(|number| shard(&options, &many, number)) {
            let output = child.wait_with_output().expect("the process ends");
            assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
        }
        assert!(!many.join(inner).join("summary.csv").exists(), "{name}: a shard writes tables");
        physgrad(&["merge", "--quiet"]).arg(&many).assert().success();
        assert_equal(&one, &many);

        // The program refuses a shard with other options.
        let [change, line] = change;
        let changed: Vec<&str> = options.iter().map(String::as_str).collect();
        let changed: Vec<&str> = match change.split_once('=') {
            Some((option, value)) => {
                let at = changed.iter().position(|word| *word == option);
                let rest = changed
                    .iter()
                    .enumerate()
                    .filter(|(i, _)| at.is_none_or(|at| *i != at && *i != at + 1));
                rest.map(|(_, word)| *word).chain([option, value]).collect()
            }
            None => changed.into_iter().chain([change]).collect(),
        };
        let error = error_of(physgrad(&changed).args(["--shard", "1/2", "--out"]).arg(&many));
        assert!(
            error.contains("plan of another comparison") && error.contains(line),
            "{name}: {error}"
        );
    }
}
