//! `physgrad accuracy`, run as a user would.

mod running;

use running::{error_of, physgrad, train};
use std::collections::HashMap;
use std::fs;
use std::path::Path;
use tempfile::TempDir;

/// Runs it on a small scene, and returns what it says and its rows, by method, substeps and precision.
fn run(out: &Path, args: &[&str]) -> (String, HashMap<String, HashMap<String, String>>) {
    let small = ["--set", "policy.widths=[4]", "--set", "horizon=20", "--quiet"];
    let mut command = physgrad(&["accuracy", "cart_pole"]);
    let output = command.args(small).args(args).arg("--out").arg(out).assert().success().get_output().clone();
    let mut csv = csv_of(&fs::read_to_string(out.join("accuracy.csv")).expect("a table"));
    let rows = csv.drain(..).map(|row| (format!("{} {} {}", row["method"], row["substeps"], row["precision"]), row)).collect();
    (String::from_utf8(output.stdout).expect("UTF-8"), rows)
}

fn csv_of(text: &str) -> Vec<HashMap<String, String>> {
    let mut lines = text.lines().map(|line| line.split(',').map(str::to_owned));
    let header: Vec<String> = lines.next().expect("a header").collect();
    lines.map(|line| header.iter().cloned().zip(line).collect()).collect()
}

fn number(row: &HashMap<String, String>, key: &str) -> f64 {
    row[key].parse().unwrap_or_else(|_| panic!("{key}: {:?}", row[key]))
}

#[test]
fn errors_fall_with_the_order_of_the_method_and_work_is_counted() {
    let dir = TempDir::new().expect("a folder");
    let (said, rows) = run(dir.path(), &["--target", "1e-4"]);
    assert_eq!(rows.len(), 2 * (5 + 7 * 5 + 1));
    for (method, order) in
        [("own", 1.0), ("euler", 1.0), ("verlet", 2.0), ("heun", 2.0), ("implicit_midpoint", 2.0), ("rk4", 4.0)]
    {
        let [coarse, fine] = ["2", "4"].map(|substeps| &rows[&format!("{method} {substeps} f64")]);
        for error in ["trajectory_error", "r_error", "m_error"] {
            let found = (number(coarse, error) / number(fine, error)).log2();
            assert!((found - order).abs() < 0.5, "{method}, {error}: order {found}");
        }
        assert!(number(fine, "operations") > 1.9 * number(coarse, "operations"), "{method}");
        assert!(number(fine, "forward_us_lowest") <= number(fine, "forward_us"));
    }
    assert!(number(&rows["tsit5 4 f64"], "trajectory_error") < 1e-11);
    let rounding = number(&rows["tsit5 4 f32"], "trajectory_error");
    assert!(rounding > 1e-8 && rounding < 1e-4, "f32 has a floor: {rounding:e}");
    assert!(said.contains("the cheapest with an error of the trajectory of at most 1e-4 is "), "{said}");

    // The lines it prints are those of a scene.
    let lines = said.split("precision = ").nth(1).expect("lines of a scene");
    let scene = dir.path().join("scene.toml");
    fs::write(&scene, format!("scene = 1\ntask = \"cart_pole\"\nprecision = {lines}")).expect("a file");
    physgrad(&["explain"]).arg(&scene).assert().success();

    let svg = fs::read_to_string(dir.path().join("accuracy.svg")).expect("diagrams");
    assert!(svg.starts_with("<svg") && svg.contains("rk4") && svg.contains("error of the gradient of R"));
    let table = fs::read_to_string(dir.path().join("accuracy.md")).expect("a table");
    assert!(table.contains("| rk4 x1 f32"), "{table}");
}

#[test]
fn what_blew_up_is_shown_as_such_and_never_as_fast() {
    let dir = TempDir::new().expect("a folder");
    let (said, rows) = run(dir.path(), &["--set", "effects.cart_damping.damping=2e3", "--set", "horizon=100"]);
    assert!(said.contains("settings diverged"), "{said}");
    let row = &rows["euler 1 f32"];
    assert!(row["diverged"].contains("step") && row["trajectory_error"].is_empty() && row["forward_us"] == "NaN", "{row:?}");
    // The implicit rule is stable.
    assert!(number(&rows["implicit_midpoint 2 f32"], "trajectory_error") < 1.0);
}

#[test]
fn a_target_that_nothing_reaches_says_what_was_the_best_and_why() {
    let dir = TempDir::new().expect("a folder");
    let args = ["accuracy", "cart_pole", "--set", "policy.widths=[4]", "--set", "horizon=5", "--quiet", "--target", "1e-30"];
    let said = error_of(physgrad(&args).arg("--out").arg(dir.path()));
    assert!(said.contains("no setting has so small an error of the trajectory; the best is "), "{said}");
    let said = error_of(&mut physgrad(&["accuracy", "cart_pole", "--target=-1"]));
    assert!(said.contains("an error to reach is more than 0"), "{said}");
}

#[test]
fn integrators_and_budgets_that_cannot_be_used_are_told_with_what_is_allowed() {
    for (task, set, message) in [
        ("cart_pole", "integrator.method=\"rk5\"", "`integrator.method` is `rk5`; allowed: `euler`, "),
        ("cart_pole", "integrator.method=\"pade\"", "`integrator.method` is pade; allowed: euler, semi_implicit, "),
        ("quantum", "integrator.method=\"rk4\"", "`integrator.method` is rk4; allowed: pade, strang here, or none"),
        ("cart_pole", "integrator.substeps=0", "`integrator.substeps` is 0; allowed: 1 to 1000000"),
        (
            "cart_pole",
            "integrator.rtol=1e-3",
            "`integrator.rtol` is 0.001, but nothing reads it: `integrator.method` is not adaptive",
        ),
        ("cart_pole", "training.memory=\"64\"", "`training.memory` is \"64\"; allowed: bytes, as in \"64MB\""),
    ] {
        let said = error_of(&mut physgrad(&["explain", task, "--set", set]));
        assert!(said.contains(message), "{message}\n{said}");
    }
    let tight = ["explain", "cart_pole", "--set", "integrator.method=\"adaptive\"", "--set", "integrator.rtol=1e-9"];
    let said = error_of(&mut physgrad(&tight));
    assert!(said.contains("`integrator.rtol` is 1e-9; allowed: 1.2e-5 or more: rounding in f32 is no less"), "{said}");
    let dir = TempDir::new().expect("a folder");
    let args = ["train", "cart_pole", "--set", "horizon=1000", "--set", "training.memory=\"100kB\"", "--epochs", "1"];
    let said = error_of(physgrad(&args).arg("--out").arg(dir.path().join("run")));
    assert!(said.contains("training.memory: 100000 bytes are not enough for the gradients: at least "), "{said}");
}

#[test]
fn a_budget_of_memory_changes_no_bit_and_an_integrator_does() {
    let dir = TempDir::new().expect("a folder");
    let policy = |name: &str, set: &[&str]| {
        let out = dir.path().join(name);
        let set: Vec<&str> = set.iter().flat_map(|set| ["--set", set]).collect();
        let args = [&["--epochs", "2", "--set", "horizon=600", "--quiet"][..], &set].concat();
        train(&out, &args).assert().success();
        fs::read(out.join("policy.safetensors")).expect("a policy")
    };
    let parameters = |file: &[u8]| {
        let header = u64::from_le_bytes(file[..8].try_into().expect("a length")) as usize;
        file[8 + header..].to_vec()
    };
    let plain = policy("plain", &[]);
    assert_eq!(parameters(&plain), parameters(&policy("budget", &["training.memory=\"1MB\""])));
    assert_ne!(parameters(&plain), parameters(&policy("verlet", &["integrator.method=\"verlet\""])));
}
