//! `--json`: one object on standard output, with the keys of docs/runs.md.

use crate::running::{SMALL, physgrad};
use serde_json::Value;
use std::fs;
use std::path::Path;
use tempfile::TempDir;

/// Runs a command in a folder with `--json`, and returns its object.
fn object(folder: &Path, args: &[&str]) -> Value {
    let output =
        physgrad(args).arg("--json").current_dir(folder).output().expect("the command runs");
    let text = String::from_utf8(output.stdout).expect("text");
    assert!(output.status.success(), "{args:?}: {}", String::from_utf8_lossy(&output.stderr));
    serde_json::from_str(&text).unwrap_or_else(|error| panic!("{args:?}: {error}: {text}"))
}

/// Keys of a command in docs/runs.md.
fn documented(command: &str) -> Vec<String> {
    let page = fs::read_to_string(crate::markdown::root().join("docs/runs.md")).expect("a page");
    let row = page
        .lines()
        .find_map(|line| line.strip_prefix(&format!("| `{command}` | ")))
        .expect("a row")
        .to_owned();
    row.split('`').skip(1).step_by(2).map(String::from).collect()
}

/// Checks that every key of the object is in the row of the command in docs/runs.md.
pub fn check(command: &str, object: &Value) {
    let documented = documented(command);
    for key in object.as_object().expect("an object").keys() {
        assert!(documented.contains(key), "docs/runs.md lacks the key {key} of {command}");
    }
}

/// Number of lines of a CSV file after the header.
fn lines(path: &Path) -> usize {
    fs::read_to_string(path).expect("a table").lines().count() - 1
}

#[test]
fn trainings_and_evaluations_print_one_object_with_the_numbers_of_their_files() {
    let dir = TempDir::new().expect("a folder");
    let run = |args: &[&str]| object(dir.path(), args);
    let small = |args: &[&'static str]| args.iter().chain(&SMALL).copied().collect::<Vec<_>>();

    let train = run(&small(&["train", "cart_pole", "--epochs", "2", "-o", "one"]));
    check("train", &train);
    let metrics = fs::read_to_string(dir.path().join("one/metrics.csv")).expect("metrics");
    let last: Vec<&str> = metrics.lines().last().expect("a row").split(',').collect();
    assert_eq!(train["test_loss"].as_f64(), last[3].parse().ok(), "{train}");
    assert_eq!(
        (train["end"].as_str(), train["epochs"].as_u64(), train["folder"].as_str()),
        (Some("complete"), Some(2), Some("one"))
    );

    let compare = run(&small(&[
        "compare",
        "cart_pole",
        "--fields",
        "R,C",
        "--seeds",
        "2",
        "--epochs",
        "1",
        "-o",
        "two",
    ]));
    check("compare", &compare);
    let runs = compare["runs"].as_array().expect("rows");
    assert_eq!(runs.len(), 4);
    assert_eq!((runs[3]["field"].as_str(), runs[3]["seed"].as_u64()), (Some("C"), Some(1)));
    assert!(
        runs.iter().all(|run| run["final_test_loss"].as_f64().is_some_and(|loss| loss > 0.0)),
        "{compare}"
    );

    let eval = run(&["eval", "one", "--samples", "8", "-o", "eval"]);
    check("eval", &eval);
    assert_eq!(
        (eval["runs"][0]["run"].as_str(), eval["runs"][0]["samples"].as_u64()),
        (Some("one"), Some(8))
    );
    let robust = run(&[
        "robust",
        "one",
        "--grid",
        "system.cart_mass=0.5:2:3",
        "--samples",
        "4",
        "-o",
        "robust",
    ]);
    check("robust", &robust);
    assert_eq!(robust["points"].as_array().map(Vec::len), Some(3));
    assert_eq!(robust["points"][2]["system.cart_mass"].as_f64(), Some(2.0));
    let listed = run(&["runs", "."]);
    check("runs", &listed);
    assert_eq!(listed["runs"].as_array().map(Vec::len), Some(5));
    let optimize = run(&[
        "optimize",
        "cart_pole_1",
        "--set",
        "horizon=5",
        "--iterations",
        "2",
        "--starts",
        "2",
        "-o",
        "plans",
    ]);
    check("optimize", &optimize);
    assert_eq!(
        optimize["plans"].as_array().map(Vec::len),
        Some(lines(&dir.path().join("plans/optimized.csv")))
    );
}

#[test]
fn descriptions_and_checks_print_one_object() {
    let dir = TempDir::new().expect("a folder");
    let run = |args: &[&str]| {
        let object = object(dir.path(), args);
        check(args[0], &object);
        object
    };
    let explain = run(&["explain", "cart_pole_windy"]);
    let counts = explain["operations"].as_array().expect("rows");
    let of = |part: &str, pass: &str| {
        counts.iter().find(|row| row["part"] == part && row["pass"] == pass).expect("a row")["all"]
            .as_u64()
    };
    assert!(of("together", "VJP") > of("system alone", "VJP"), "{explain}");
    let tasks = run(&["tasks", "cart_pole"]);
    let settings = tasks["tasks"][0]["settings"].as_array().expect("rows");
    assert!(
        settings
            .iter()
            .any(|row| row["setting"] == "system.dt" && row["meaning"] == "Time step, s."),
        "{tasks}"
    );
    let effects = run(&["effects", "steady_wind"]);
    assert!(effects["effects"][0]["schema"]["properties"]["speed"].is_object(), "{effects}");
    let unknown = physgrad(&["effects", "steady_win", "--json"])
        .assert()
        .failure()
        .get_output()
        .stderr
        .clone();
    assert!(
        String::from_utf8_lossy(&unknown).contains("steady_wind"),
        "the error does not suggest steady_wind"
    );
    assert!(
        run(&["check", "lqr"])["checks"]
            .as_array()
            .expect("rows")
            .iter()
            .all(|row| row["result"] == "ok")
    );
    let scene = object(dir.path(), &["scene", "cart_pole_windy"]);
    assert_eq!(scene["task"], "cart_pole");
    assert!(scene["effects"].is_object());
    check("scene", &object(dir.path(), &["scene"]));
}

#[test]
fn accuracy_and_paper_print_one_object() {
    let dir = TempDir::new().expect("a folder");
    let tiny = ["--set", "policy.widths=[4]", "--set", "horizon=5", "--quiet"];
    let command = ["accuracy", "cart_pole", "--target", "0.1", "--rounds", "1", "-o", "accuracy"];
    let accuracy = [&command[..], &tiny].concat();
    let accuracy = object(dir.path(), &accuracy);
    check("accuracy", &accuracy);
    assert_eq!(
        accuracy["settings"].as_array().map(Vec::len),
        Some(lines(&dir.path().join("accuracy/accuracy.csv")))
    );
    assert!(
        accuracy["cheapest"]["error"].as_f64().is_some_and(|error| error <= 0.1),
        "{}",
        accuracy["cheapest"]
    );
    assert!(
        dir.path().join("accuracy/scenes").is_dir(),
        "with --json, `accuracy` writes no folder `scenes`"
    );
    let paper = object(dir.path(), &["paper", "fig2", "--quick", "--out", "paper"]);
    check("paper", &paper);
    assert_eq!(
        (
            paper["figures"][0]["name"].as_str(),
            paper["figures"][0]["table"].as_array().map(Vec::len)
        ),
        (Some("fig2"), Some(3))
    );
}
