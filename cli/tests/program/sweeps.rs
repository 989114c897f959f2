//! Sweeps over settings, and the list of saved runs.

use super::numbers::{physgrad, read};
use std::fs;
use tempfile::TempDir;

const SMALL: &str = "--set training.train_samples=16 --set training.test_samples=8 --epochs 1";

const SWEEP: &str = "scene = 1\ntask = \"cart_pole\"\n[system]\npoles = 1\n[policy]\nwidths = [8]\n\
                     [sweep.grid]\n\"training.batch\" = [4, 8]\n\
                     [sweep.random]\n\"training.learning_rate\" = { log_uniform = [1e-3, 1e-1] }\n[sweep]\nsamples = 2\n";

fn succeed(dir: &TempDir, args: &str) -> String {
    String::from_utf8(physgrad(args, dir.path()).assert().success().get_output().stdout.clone())
        .expect("text")
}

fn error(dir: &TempDir, args: &str) -> String {
    String::from_utf8(physgrad(args, dir.path()).assert().failure().get_output().stderr.clone())
        .expect("text")
}

#[test]
fn runs_of_a_sweep_equal_single_runs() {
    let dir = TempDir::new().expect("a folder");
    let compare = format!(
        "compare cart_pole_1 {SMALL} --set training.learning_rate=0.001,0.1 --fields R,C --seeds 2 --out sweep"
    );
    let output = succeed(&dir, &compare);
    assert!(output.contains("lowest median final test loss: learning_rate=0.1, "), "{output}");
    let rows = read(&dir, "sweep/summary.csv");
    assert_eq!(rows[0][..4], ["scene", "training.learning_rate", "field", "seed"]);
    assert_eq!(rows.len(), 1 + 2 * 2 * 2);
    succeed(
        &dir,
        &format!(
            "train cart_pole_1 {SMALL} --set training.learning_rate=0.1 --field R --seed 1 --quiet --out one"
        ),
    );
    let bytes = |path: &str| fs::read(dir.path().join(path)).expect(path);
    assert_eq!(
        bytes("one/policy.safetensors"),
        bytes("sweep/learning_rate=0.1/runs/R-1/policy.safetensors")
    );
    let row = rows
        .iter()
        .find(|row| row[..4] == ["learning_rate=0.1", "0.1", "R", "1"])
        .expect("the row of the run");
    assert_eq!(row[5], read(&dir, "one/metrics.csv")[1][3]);
    let svg = String::from_utf8(bytes("sweep/sweep.svg")).expect("text");
    roxmltree::Document::parse(&svg).expect("an SVG is XML");
    assert!(
        ["training.learning_rate", "final test loss", "C (combined)"]
            .iter()
            .all(|label| svg.contains(label))
    );

    // Repeats the command: the runs are complete, and nothing changes.
    let before = bytes("sweep/learning_rate=0.1/runs/R-1/metrics.csv");
    succeed(&dir, &compare);
    assert_eq!(bytes("sweep/learning_rate=0.1/runs/R-1/metrics.csv"), before);
}

#[test]
fn a_scene_with_a_sweep_is_trained_by_compare_only() {
    let dir = TempDir::new().expect("a folder");
    fs::write(dir.path().join("sweep.toml"), SWEEP).expect("a file");
    succeed(&dir, &format!("compare sweep.toml {SMALL} --fields C --seeds 1 --quiet --out sweep"));
    let rows = read(&dir, "sweep/summary.csv");
    let values =
        |column: usize| rows[1..].iter().map(|row| row[column].clone()).collect::<Vec<_>>();
    assert_eq!(rows[0][..3], ["scene", "training.batch", "training.learning_rate"]);
    assert_eq!(values(1), ["4", "4", "8", "8"]);
    assert_eq!(values(2)[..2], values(2)[2..], "random draws differ between values of the grid");
    for row in &rows[1..] {
        let settings =
            fs::read_to_string(dir.path().join("sweep").join(&row[0]).join("runs/C-0/run.toml"))
                .expect("settings");
        assert!(settings.contains(&format!("batch = {}\n", row[1])), "{settings}");
        assert!(settings.contains(&format!("learning_rate = {}\n", row[2])), "{settings}");
    }
    for (args, message) in [
        ("train sweep.toml", "sweep.toml:11: the scene has a sweep, which only `compare` trains"),
        (
            "train cart_pole --set training.batch=4,8",
            "has several values, which only `compare` trains",
        ),
        ("compare sweep.toml --set training.batch=4,8", "`training.batch` is in the sweep twice"),
        ("compare cart_pole --set seed=1,2", "choose them with --fields, --seed and --seeds"),
        ("compare cart_pole --set training.batch=4,4", "the sweep names batch=4 twice"),
        ("compare cart_pole --set training.batch=4,x", "`training.batch` is string"),
    ] {
        let found = error(&dir, args);
        assert!(found.contains(message), "{args}: {found}");
    }
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

/// A comparison of one scene writes to `runs`, one of several scenes or points to `NAME/runs`. One
/// folder cannot hold both. It cannot hold comparisons of two different single scenes either.
#[test]
fn a_comparison_of_one_scene_does_not_mix_with_one_of_several() {
    let dir = tempfile::TempDir::new().expect("a folder");
    let small = "--fields R --seeds 1 --epochs 1 --set training.train_samples=8 --set training.test_samples=4 --quiet";
    let one = format!("compare cart_pole_1 {small}");
    let several = format!("{one} --set training.batch=2,4");
    let run = |command: &str, folder: &str| {
        crate::numbers::physgrad(&format!("{command} --out {folder}"), dir.path()).assert()
    };
    run(&one, "first").success();
    run(&several, "second").success();
    let other = one.replace("cart_pole_1", "cart_pole_2").replace("--fields R", "--fields M");
    for (command, folder, found) in [
        (several, "first", "one scene"),
        (one, "second", "several scenes"),
        (other, "first", "cart_pole_1"),
    ] {
        let stderr = run(&command, folder).failure().get_output().stderr.clone();
        let expected = format!("{folder} holds a comparison of {found}");
        assert!(
            String::from_utf8_lossy(&stderr).contains(&expected),
            "{}",
            String::from_utf8_lossy(&stderr)
        );
    }
}
