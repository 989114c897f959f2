//! End-to-end tests of `physgrad accuracy`.

use crate::running::{error_of, physgrad, train};
use physgrad_cli::api::{Errors, Measured, Metric, Precision, Row, Setting};
use std::collections::HashMap;
use std::fs;
use std::path::Path;
use tempfile::TempDir;

/// Runs the command on a small scene. Returns its output, and the rows of its table by method,
/// substeps and precision.
fn run(out: &Path, args: &[&str]) -> (String, HashMap<String, HashMap<String, String>>) {
    let small = ["--set", "policy.widths=[4]", "--set", "horizon=20", "--quiet", "--rounds", "1"];
    let mut command = physgrad(&["accuracy", "cart_pole"]);
    let output = command
        .args(small)
        .args(args)
        .arg("--out")
        .arg(out)
        .assert()
        .success()
        .get_output()
        .clone();
    let mut csv = csv_of(&fs::read_to_string(out.join("accuracy.csv")).expect("a table"));
    let rows = csv
        .drain(..)
        .map(|row| (format!("{} {} {}", row["method"], row["substeps"], row["precision"]), row))
        .collect();
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
fn halving_the_step_reduces_errors_by_the_order_of_the_method_and_doubles_operations() {
    let dir = TempDir::new().expect("a folder");
    let (said, rows) = run(dir.path(), &["--target", "1e-4"]);
    assert_eq!(rows.len(), 2 * (5 + 8 * 5 + 1));
    for (method, order) in [
        ("native", 1.0),
        ("euler", 1.0),
        ("verlet", 2.0),
        ("heun", 2.0),
        ("implicit_midpoint", 2.0),
        ("sdirk2", 2.0),
        ("rk4", 4.0),
    ] {
        let [coarse, fine] = ["2", "4"].map(|substeps| &rows[&format!("{method} {substeps} f64")]);
        for error in ["trajectory_error", "r_error", "m_error"] {
            let found = (number(coarse, error) / number(fine, error)).log2();
            assert!((found - order).abs() < 0.5, "{method}, {error}: order {found}");
        }
        assert!(
            number(fine, "operations") > 1.9 * number(coarse, "operations"),
            "{method}: twice the substeps have at most 1.9 times the operations"
        );
        assert!(number(fine, "forward_us_lowest") <= number(fine, "forward_us"));
    }
    assert!(number(&rows["tsit5 4 f64"], "trajectory_error") < 1e-11);
    let rounding = number(&rows["tsit5 4 f32"], "trajectory_error");
    assert!(
        rounding > 1e-8 && rounding < 1e-4,
        "the error of tsit5 in f32 is {rounding:e}, not between 1e-8 and 1e-4"
    );
    assert!(
        said.contains("the cheapest setting with an error of the trajectory of at most 1e-4 is "),
        "{said}"
    );

    // The printed lines complete a valid scene.
    let lines = said.split("precision = ").nth(1).expect("lines of a scene");
    let scene = dir.path().join("scene.toml");
    fs::write(&scene, format!("scene = 1\ntask = \"cart_pole\"\nprecision = {lines}"))
        .expect("a file");
    physgrad(&["explain"]).arg(&scene).assert().success();

    let svg = fs::read_to_string(dir.path().join("accuracy.svg")).expect("diagrams");
    assert!(
        svg.starts_with("<svg")
            && svg.contains("rk4")
            && svg.contains("error of the gradient of R")
    );
    let table = fs::read_to_string(dir.path().join("accuracy.md")).expect("a table");
    assert!(table.contains("| rk4 x1 f32"), "{table}");
}

#[test]
fn diverged_settings_have_a_message_but_no_errors_and_no_times() {
    let dir = TempDir::new().expect("a folder");
    let (said, rows) =
        run(dir.path(), &["--set", "effects.cart_damping.damping=2e3", "--set", "horizon=100"]);
    assert!(said.contains("settings diverged"), "{said}");
    let row = &rows["euler 1 f32"];
    assert!(
        row["diverged"].contains("step")
            && row["trajectory_error"].is_empty()
            && row["forward_us"] == "NaN",
        "{row:?}"
    );
    // The implicit midpoint rule is stable.
    assert!(number(&rows["implicit_midpoint 2 f32"], "trajectory_error") < 1.0);
}

#[test]
fn an_error_of_1e_minus_30_is_unreached_and_reports_the_most_accurate_setting() {
    let dir = TempDir::new().expect("a folder");
    let args = [
        "accuracy",
        "cart_pole",
        "--set",
        "policy.widths=[4]",
        "--set",
        "horizon=5",
        "--rounds",
        "1",
        "--quiet",
        "--target",
        "1e-30",
    ];
    let output = physgrad(&args).arg("--json").arg("--out").arg(dir.path()).assert().code(1);
    let output = output.get_output();
    let json: serde_json::Value = serde_json::from_slice(&output.stdout).expect("an object");
    assert!(json["cheapest"].is_null(), "{json}");
    let said = String::from_utf8_lossy(&output.stderr);
    assert!(
        said.contains("no setting reaches this error of the trajectory; the most accurate is "),
        "{said}"
    );
    for (option, expected) in [
        ("--target=-1", "--target -1; allowed: a positive error"),
        ("--rounds=0", "allowed: an integer from 1 to 1000"),
    ] {
        let said = error_of(&mut physgrad(&["accuracy", "cart_pole", option]));
        assert!(said.contains(expected), "{said}");
    }
}

#[test]
fn invalid_integrators_and_budgets_are_refused_with_the_allowed_values() {
    for (task, set, message) in [
        (
            "cart_pole",
            "integrator.method=\"rk5\"",
            "`integrator.method` is `rk5`; allowed: euler, ",
        ),
        (
            "cart_pole",
            "integrator.method=\"pade\"",
            "`integrator.method` is pade; allowed: euler, semi_implicit, ",
        ),
        (
            "quantum",
            "integrator.method=\"rk4\"",
            "`integrator.method` is rk4; allowed: pade, strang; or omit it for the native scheme",
        ),
        ("cart_pole", "integrator.substeps=0", "`integrator.substeps` is 0; allowed: 1 to 1000000"),
        (
            "cart_pole",
            "integrator.rtol=1e-3",
            "`integrator.rtol` is 0.001, but has no effect: `integrator.method` is not adaptive",
        ),
        (
            "cart_pole",
            "training.memory=\"64\"",
            "`training.memory` is \"64\"; allowed: a number of bytes such as \"64MB\"",
        ),
    ] {
        let said = error_of(&mut physgrad(&["explain", task, "--set", set]));
        assert!(said.contains(message), "{message}\n{said}");
    }
    let newton = "`integrator.tolerance` is 2e-5; allowed: 3.1e-5 or more in f32, 5.7e-14 or more in f64, because of rounding";
    for (method, tight, message) in [
        (
            "adaptive",
            "rtol=1e-9",
            "`integrator.rtol` is 1e-9; allowed: 1.2e-5 or more in f32, 2.2e-14 or more in f64, because of rounding",
        ),
        // Newton's iteration uses at least 256 machine epsilons.
        ("implicit_midpoint", "tolerance=2e-5", newton),
        ("sdirk2", "tolerance=2e-5", newton),
        (
            "rk4",
            "tolerance=1e-3",
            "has no effect: `integrator.method` is not implicit_midpoint or sdirk2",
        ),
    ] {
        let sets = [format!("integrator.method={method}"), format!("integrator.{tight}")];
        let said = error_of(&mut physgrad(&[
            "explain",
            "cart_pole",
            "--set",
            &sets[0],
            "--set",
            &sets[1],
        ]));
        assert!(said.contains(message), "{message}\n{said}");
    }
    let dir = TempDir::new().expect("a folder");
    let args = [
        "train",
        "cart_pole",
        "--set",
        "horizon=1000",
        "--set",
        "training.memory=\"100kB\"",
        "--epochs",
        "1",
    ];
    let said = error_of(physgrad(&args).arg("--out").arg(dir.path().join("run")));
    assert!(
        said.contains("training.memory: 100000 bytes are not enough for the gradients: at least "),
        "{said}"
    );
}

#[test]
fn a_budget_of_1_mb_keeps_all_bits_of_a_policy_and_verlet_changes_them() {
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
    assert_ne!(
        parameters(&plain),
        parameters(&policy("verlet", &["integrator.method=\"verlet\""]))
    );
}

#[test]
fn reverse_and_forward_gradients_in_f64_agree_with_double_double_within_1e_minus_13() {
    let dir = TempDir::new().expect("a folder");
    let small = [
        "--set",
        "policy.widths=[4]",
        "--set",
        "horizon=20",
        "--horizons",
        "40,5",
        "--rounds",
        "1",
        "--quiet",
    ];
    let mut command = physgrad(&["accuracy", "cart_pole", "--gradients"]);
    let output =
        command.args(small).arg("--out").arg(dir.path()).assert().success().get_output().clone();
    let said = String::from_utf8(output.stdout).expect("UTF-8");
    assert!(said.contains("up to 40 steps, the longest horizon measured"), "{said}");
    let table = |name: &str| csv_of(&fs::read_to_string(dir.path().join(name)).expect("a table"));

    let methods = table("gradients.csv");
    let method = |name: &str, step: &str, precision: &str| {
        let found = methods.iter().find(|row| {
            row["method"] == name && row["step"] == step && row["precision"] == precision
        });
        found.unwrap_or_else(|| panic!("no row {name} {step} {precision}"))
    };
    for field in ["R", "M", "S", "C"] {
        let name = format!("reverse {field}");
        let [single, double] =
            ["f32", "f64"].map(|precision| number(method(&name, "", precision), "error"));
        assert!(
            double < 1e-13 && single > 1e-9 && single < 1e-4,
            "{field}: {single:e}, {double:e}"
        );
        assert!(number(method(&name, "", "f32"), "signs_as_in_f64") > 0.9);
        assert!(
            number(method(&name, "", "f64"), "peak_bytes")
                > number(method("loss alone", "", "f64"), "peak_bytes")
        );
    }
    assert!(number(method("forward mode", "", "f64"), "error") < 1e-13);
    // With an output layer of 0, R, M and C would be equal, and so would their errors.
    let [r, m] = ["reverse R", "reverse M"].map(|name| number(method(name, "", "f32"), "error"));
    assert_ne!(r, m, "R and M are equal, so the output layer is 0");
    // The truncation error dominates for large steps, the rounding error for small steps.
    let differences = |step: &str| number(method("central differences", step, "f64"), "error");
    assert!(
        differences("0.1") > 100.0 * differences("0.01"),
        "a step of 0.01 has at least 1 % of the error of a step of 0.1"
    );
    assert!(
        differences("0.0001") < 1e-6 && differences("0.0000000001") > 10.0 * differences("0.00001")
    );
    // Central differences evaluate the loss twice per parameter.
    let ratio = number(method("central differences", "0.1", "f64"), "ms")
        / number(method("loss alone", "", "f64"), "ms");
    assert!(ratio > 20.0, "central differences take {ratio} times a loss, not more than 20");

    let checkpoints = table("checkpoints.csv");
    assert_eq!(checkpoints.len(), 4);
    assert!(checkpoints[..3].iter().all(|row| row["same_bits"] == "true"), "{checkpoints:?}");
    assert!(number(&checkpoints[2], "peak_bytes") <= number(&checkpoints[2], "budget_bytes"));
    let horizons = table("horizons.csv");
    assert_eq!(horizons.iter().map(|row| &*row["horizon"]).collect::<Vec<_>>(), ["5", "40"]);
    assert!(
        horizons.iter().all(|row| number(row, "f64_error") < number(row, "f32_error")),
        "{horizons:?}"
    );
    roxmltree::Document::parse(
        &fs::read_to_string(dir.path().join("gradients.svg")).expect("diagrams"),
    )
    .expect("XML");
}

#[test]
fn halving_the_step_reduces_the_drift_of_the_energy_by_the_order_of_the_method() {
    let dir = TempDir::new().expect("a folder");
    let (said, rows) = run(dir.path(), &["--set", "system.poles=1"]);
    assert!(said.contains("drift of the energy"), "{said}");
    for (method, order) in [("euler", 1.0), ("verlet", 2.0), ("rk4", 4.0)] {
        let [coarse, fine] =
            ["2", "4"].map(|substeps| number(&rows[&format!("{method} {substeps} f64")], "drift"));
        let found = (coarse / fine).log2();
        assert!((found - order).abs() < 1.2, "{method}: order {found}");
    }
    // Two uncoupled poles have no conserved energy.
    let (said, rows) = run(dir.path(), &[]);
    assert!(!said.contains("drift") && rows["rk4 1 f64"]["drift"].is_empty(), "{said}");
}

#[test]
fn scenes_with_errors_below_1e_minus_3_are_written_and_compared_in_training() {
    let dir = TempDir::new().expect("a folder");
    let (said, _) = run(&dir.path().join("accuracy"), &["--target", "1e-3"]);
    assert!(said.contains("scenes with the cheapest setting of each method are in "), "{said}");
    let scene = |method: &str| dir.path().join(format!("accuracy/scenes/{method}.toml"));
    let (out, small) = (
        dir.path().join("compared"),
        ["--fields", "R,C", "--seeds", "1", "--epochs", "2", "--quiet"],
    );
    let sizes = ["--set", "training.train_samples=16", "--set", "training.test_samples=8"];
    let mut compare = physgrad(&["compare"]);
    compare
        .arg(scene("verlet"))
        .arg(scene("rk4"))
        .args(small)
        .args(sizes)
        .arg("--out")
        .arg(&out)
        .assert()
        .success();
    let rows = csv_of(&fs::read_to_string(out.join("summary.csv")).expect("a summary"));
    let names = |key: &str| rows.iter().map(|row| row[key].clone()).collect::<Vec<String>>();
    assert_eq!(names("task"), ["verlet", "verlet", "rk4", "rk4"]);
    assert_eq!(names("field"), ["R", "C", "R", "C"]);
    assert!(fs::read_to_string(out.join("curves.svg")).expect("curves").contains("verlet: R"));
    // The folder of each scene is a complete comparison.
    physgrad(&["report"]).arg(out.join("rk4")).assert().success();
    let said = error_of(physgrad(&["compare"]).arg(scene("rk4")).arg(scene("rk4")).args(small));
    assert!(said.contains("names rk4 twice"), "{said}");
}

#[test]
fn a_newton_iteration_that_does_not_converge_is_reported_with_step_and_residual() {
    let dir = TempDir::new().expect("a folder");
    let out = dir.path().join("run");
    let far = [
        "--epochs",
        "5",
        "--set",
        "integrator.method=implicit_midpoint",
        "--set",
        "system.dt=1e12",
    ];
    let said = error_of(&mut train(&out, &far));
    for part in ["did not converge for sample 0 at step 1", "residual ", "Use substeps"] {
        assert!(said.contains(part), "{part}: {said}");
    }
}

/// Measurement of one setting: error, operations, and lowest, median and highest microseconds.
fn measured(method: &'static str, error: f64, operations: u64, times: [f64; 3]) -> Row {
    let errors = Errors { trajectory: error, loss: error, gradients: [error; 2], signs: [1.0; 2] };
    Row {
        setting: Setting { method, substeps: 1, precision: Precision::F64 },
        errors: Ok(errors),
        drift: f64::NAN,
        operations,
        bytes: 0.0,
        seconds: [times, times.map(|time| 2.0 * time)],
    }
}

#[test]
fn operations_decide_between_settings_whose_times_overlap() {
    let noisy = [
        measured("rk4", 1e-5, 15_039, [9.0, 10.65, 13.0]),
        measured("heun", 1e-5, 1_558, [10.5, 11.54, 12.0]),
        measured("verlet", 1e-5, 1_558, [10.5, 11.60, 12.0]),
        // Fewest operations, but certainly slower, or too inaccurate.
        measured("euler", 1e-5, 900, [13.1, 14.0, 15.0]),
        measured("native", 1e-2, 100, [1.0, 1.0, 1.0]),
    ];
    let separate = [
        measured("rk4", 1e-5, 15_039, [9.0, 10.0, 10.4]),
        measured("heun", 1e-5, 1_558, [10.5, 11.54, 12.0]),
    ];
    let reference = || Errors { trajectory: 0.0, loss: 0.0, gradients: [0.0; 2], signs: [1.0; 2] };
    let cheapest = |rows: Vec<Row>, metric: Metric| {
        let measured = Measured { rows, rounds: 5, reference: reference() };
        let found = measured.cheapest(metric, 1e-4).expect("a setting");
        (found.row.setting.method, found.fastest.map(|row| row.setting.method))
    };
    // Errors below that of the reference, or below an unknown one, have no meaning.
    for error in [2e-4, f64::NAN] {
        let rows = noisy.iter().map(copy).collect();
        let measured =
            Measured { rows, rounds: 5, reference: Errors { trajectory: error, ..reference() } };
        assert!(measured.cheapest(Metric::Trajectory, 1e-4).is_none());
        assert!(measured.cheapest(Metric::R, 1e-4).is_some());
    }
    let [noisy, again] = [0, 1].map(|_| noisy.iter().map(copy).collect());
    assert_eq!(cheapest(noisy, Metric::Trajectory), ("heun", Some("rk4")));
    assert_eq!(cheapest(again, Metric::R), ("heun", Some("rk4")));
    assert_eq!(cheapest(separate.into(), Metric::Trajectory), ("rk4", None));
}

fn copy(row: &Row) -> Row {
    let error = row.errors.as_ref().map_or(f64::NAN, |errors| errors.trajectory);
    measured(row.setting.method, error, row.operations, row.seconds[0])
}

#[test]
fn settings_with_errors_as_large_as_the_states_are_not_pareto_optimal() {
    let dir = TempDir::new().expect("a folder");
    let (said, rows) =
        run(dir.path(), &["--set", "effects.cart_damping.damping=2e3", "--set", "horizon=6"]);
    let huge = &rows["euler 1 f64"];
    assert!(number(huge, "trajectory_error") > 1e6 && !said.contains("euler x1 f"), "{said}");
    assert!(said.contains("settings with an error of the trajectory of 1 or more"), "{said}");
}
