//! The list of saved runs.

use super::numbers::{physgrad, read};
use std::fs;
use tempfile::TempDir;

pub const SMALL: &str = "--set training.train_samples=16 --set training.test_samples=8 --epochs 1";

pub fn succeed(dir: &TempDir, args: &str) -> String {
    String::from_utf8(physgrad(args, dir.path()).assert().success().get_output().stdout.clone())
        .expect("text")
}

pub fn error(dir: &TempDir, args: &str) -> String {
    String::from_utf8(physgrad(args, dir.path()).assert().failure().get_output().stderr.clone())
        .expect("text")
}

#[test]
fn runs_are_listed_filtered_sorted_and_drawn() {
    let dir = TempDir::new().expect("a folder");
    let train = format!("train cart_pole_1 {SMALL} --quiet");
    succeed(&dir, &format!("{train} --seed 3 --tag first --tag both --out runs/a"));
    succeed(
        &dir,
        &format!("{train} --set training.learning_rate=0.1 --tag both --out runs/deep/b"),
    );
    succeed(&dir, "train push --epochs 0 --quiet --out runs/c");
    let listed = |args: &str| -> Vec<String> {
        let output = succeed(&dir, &format!("runs{args}"));
        let cells = output.lines().filter_map(|line| line.strip_prefix("│ runs/"));
        cells.map(|line| line.split_whitespace().next().expect("a path").to_owned()).collect()
    };
    assert_eq!(listed(""), ["a", "c", "deep/b"]);
    assert_eq!(
        listed(" --sort loss"),
        ["deep/b", "a", "c"],
        "a run without epochs does not come last"
    );
    assert_eq!(listed(" --sort age"), ["c", "deep/b", "a"]);
    assert_eq!(listed(" --tag both"), ["a", "deep/b"]);
    assert_eq!(listed(" --task push"), ["c"]);
    assert_eq!(listed(" runs/deep runs ./runs"), ["deep/b", "a", "c"], "a run is listed twice");
    succeed(&dir, "runs runs/a runs/deep --out listed");
    let rows = read(&dir, "listed/runs.csv");
    assert_eq!(rows[1][..6], ["runs/a", "cart_pole", "combined", "3", "1", "1"]);
    assert_eq!(
        (&rows[1][6], &rows[1][8]),
        (&read(&dir, "runs/a/metrics.csv")[1][3], &"first both".to_owned())
    );
    assert!(error(&dir, "runs nowhere").contains("there is no folder nowhere"));

    // A tag does not change the identity of a run.
    succeed(&dir, "train --resume --epochs 2 --tag later --quiet --out runs/a");
    assert_eq!(listed(" --tag later"), ["a"]);

    fs::write(dir.path().join("runs/deep/b/metrics.csv"), "epoch\n1\n").expect("a file");
    assert_eq!(listed(""), ["a", "c"], "a damaged run is omitted");
    let output = physgrad("runs", dir.path()).output().expect("the command runs");
    let warning = String::from_utf8_lossy(&output.stderr).into_owned();
    assert!(
        warning.contains("warning: omitted a run: runs/deep/b/metrics.csv is damaged"),
        "{warning}"
    );
}
