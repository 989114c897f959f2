//! Kinds of policies in scenes: every kind through the commands, controllers as expressions,
//! policies without trained numbers, refusals.

use crate::running::physgrad;
use std::fs;
use std::path::Path;
use tempfile::TempDir;

fn run(at: &Path, args: &[&str]) -> Result<(String, String), String> {
    let output = physgrad(args).current_dir(at).output().expect("the command runs");
    let text = |bytes| String::from_utf8(bytes).expect("text");
    let (out, errors) = (text(output.stdout), text(output.stderr));
    if output.status.success() { Ok((out, errors)) } else { Err(errors) }
}

fn succeed(at: &Path, args: &[&str]) -> String {
    run(at, args).unwrap_or_else(|error| panic!("{args:?}: {error}")).0
}

fn fail(at: &Path, args: &[&str]) -> String {
    run(at, args).map(|(out, _)| panic!("{args:?} succeeds: {out}")).unwrap_err()
}

const SMALL: &str = "horizon = 20\ntraining.train_samples = 16\ntraining.test_samples = 8\n";

/// Swing-up of one pole with this section `policy`.
fn cart_pole(policy: &str) -> String {
    format!("scene = 1\ntask = \"cart_pole\"\nsystem.poles = 1\n{SMALL}[policy]\n{policy}\n")
}

fn write(at: &Path, name: &str, text: &str) {
    fs::write(at.join(name), text).expect("a scene");
}

/// A controller of cart-pole with a memory, trained and fixed numbers.
const CONTROLLER: &str = r#"kind = "equations"
control.force = "-k * (x + sum) - d * sin(theta_1)"
next.sum = "sum + dt * x"
define.d = "2 * lag + 0.1 * t"
parameters = { k = { start = 1.0, min = 0.0 }, lag = 0.5 }
"#;

/// Names, sections `policy`, and whether policies have an ONNX model.
fn kinds() -> Vec<(&'static str, String, bool)> {
    let of = |text: &str| text.to_owned();
    vec![
        ("default", of("widths = [6]"), true),
        ("mlp", of("kind = \"mlp\"\nwidths = [6]"), true),
        ("linear", of("kind = \"linear\""), false),
        ("linear without bias", of("kind = \"linear\"\nbias = false"), false),
        ("gru", of("kind = \"gru\"\nunits = 5"), false),
        ("elman", of("kind = \"elman\"\nunits = 5"), false),
        ("open loop", of("kind = \"open_loop\""), false),
        ("equations", of(CONTROLLER), false),
        ("bounded", of("widths = [6]\nbounds = [[-2.0, 3.0]]"), true),
        ("residual", format!("widths = [6]\n[policy.base]\n{CONTROLLER}"), false),
        (
            "feedback around a sequence",
            of("kind = \"linear\"\nbounds = [[-9.0, 9.0]]\nbase.kind = \"open_loop\""),
            false,
        ),
    ]
}

#[test]
fn every_kind_is_checked_trained_resumed_evaluated_and_exported_or_refused() {
    for (name, policy, has_model) in kinds() {
        let dir = TempDir::new().expect("a folder");
        let at = dir.path();
        write(at, "scene.toml", &cart_pole(&policy));
        let checked = succeed(at, &["check", "scene.toml"]);
        assert!(!checked.contains("FAILED"), "{name}: {checked}");
        succeed(at, &["train", "scene.toml", "--epochs", "4", "--out", "whole", "--quiet"]);
        succeed(at, &["train", "scene.toml", "--epochs", "2", "--out", "parts", "--quiet"]);
        let first = fs::read(at.join("parts/policy.safetensors")).expect("a policy");
        succeed(at, &["train", "--resume", "--epochs", "4", "--out", "parts", "--quiet"]);
        let [whole, parts] = ["whole", "parts"]
            .map(|run| fs::read(at.join(run).join("policy.safetensors")).expect("a policy"));
        assert_eq!(whole, parts, "{name}: a resumed training has the bits of one training");
        assert_ne!(first, parts, "{name}: two epochs change the policy");
        // The settings in the folder give the same run.
        let again = ["train", "whole/run.toml", "--out", "again", "--quiet"];
        succeed(at, &again);
        let again = fs::read(at.join("again/policy.safetensors")).expect("a policy");
        assert_eq!(whole, again, "{name}: run.toml repeats the run");
        succeed(at, &["eval", "whole", "--samples", "16"]);
        succeed(at, &["report", "whole", "--out", "page"]);
        let export = ["export", "whole", "--onnx", "policy.onnx"];
        if has_model {
            succeed(at, &export);
        } else {
            let error = fail(at, &export);
            let kind = fs::read_to_string(at.join("whole/run.toml")).expect("settings");
            let kind = kind.split_once("kind = \"").map_or("mlp", |(_, kind)| kind);
            let kind = kind.split('"').next().expect("a name");
            assert!(error.contains("of the kind") && error.contains(kind), "{name}: {error}");
        }
    }
}

#[test]
fn the_default_kind_with_its_name_is_the_default() {
    let dir = TempDir::new().expect("a folder");
    for (name, kind) in [("plain", ""), ("named", "kind = \"mlp\"\n")] {
        write(dir.path(), "scene.toml", &cart_pole(&format!("{kind}widths = [6]")));
        succeed(dir.path(), &["train", "scene.toml", "--epochs", "1", "--out", name, "--quiet"]);
    }
    for file in ["run.toml", "policy.safetensors", "checkpoint.bin"] {
        let read = |run: &str| fs::read(dir.path().join(run).join(file)).expect("a file");
        if file != "checkpoint.bin" {
            assert_eq!(read("plain"), read("named"), "{file}");
        }
    }
    let settings = fs::read_to_string(dir.path().join("plain/run.toml")).expect("settings");
    assert!(!settings.contains("kind"), "{settings}");
}

#[test]
fn an_option_chooses_another_kind_and_leaves_the_settings_of_the_first() {
    let dir = TempDir::new().expect("a folder");
    let at = dir.path();
    write(at, "scene.toml", &cart_pole("widths = [6]\nactivation = \"relu\""));
    let gru = ["--set", "policy.units=3", "--set", "policy.kind=gru"];
    let explained = succeed(at, &[&["explain", "scene.toml"][..], &gru].concat());
    assert!(explained.contains("3 components of memory: gru"), "{explained}");
    // The kind that the scene has keeps its settings.
    let explained = succeed(at, &["explain", "scene.toml", "--set", "policy.kind=mlp"]);
    assert!(explained.contains("policy, 37 trained numbers: mlp"), "{explained}");
    let grid = "policy.kind=linear,elman,open_loop";
    succeed(
        at,
        &["compare", "scene.toml", "--set", grid, "--epochs", "1", "--fields", "R", "--out", "all"],
    );
    let listed = succeed(at, &["tasks", "cart_pole"]);
    for text in ["policy.kind", "policy.units", "policy.bounds", "policy.base", "policy.widths"] {
        assert!(listed.contains(text), "{listed}");
    }
}

#[test]
fn trained_numbers_of_a_controller_are_results() {
    let dir = TempDir::new().expect("a folder");
    let at = dir.path();
    write(at, "scene.toml", &cart_pole(CONTROLLER));
    let rate = ["--set", "training.learning_rate=0.1"];
    let train = ["train", "scene.toml", "--epochs", "3", "--out", "run"];
    let out = succeed(at, &[&train[..], &rate].concat());
    assert!(out.contains("trained: policy.parameters.k = "), "{out}");
    let numbers = fs::read_to_string(at.join("run/numbers.csv")).expect("numbers");
    let (name, value) =
        numbers.lines().nth(1).and_then(|line| line.split_once(',')).expect("a row");
    let value: f64 = value.parse().expect("a number");
    assert_eq!(name, "policy.parameters.k");
    assert!(value > 0.0 && (value - 1.0).abs() > 0.01, "{value}");
    // A number of the base stands after the parameters of none, that of the sum after the base.
    write(at, "sum.toml", &cart_pole(&format!("{CONTROLLER}[policy.base]\nkind = \"linear\"\n")));
    let out = succeed(at, &["train", "sum.toml", "--epochs", "0", "--out", "sum"]);
    assert!(out.contains("trained: policy.parameters.k = 1.00000"), "{out}");
}

#[test]
fn a_policy_without_trained_numbers_needs_no_training() {
    let dir = TempDir::new().expect("a folder");
    let at = dir.path();
    // The gain of the Riccati equation for a mass on a spring, and a worse one.
    let scene = |gain: &str| {
        format!(
            "scene = 1\ntask = \"lqr\"\nprecision = \"f64\"\n{SMALL}[policy]\nkind = \"equations\"\n\
             control.force = \"{gain}\"\n"
        )
    };
    write(at, "good.toml", &scene("-0.3 * x - 0.9 * x_dot"));
    write(at, "idle.toml", &scene("0"));
    let mut losses = Vec::new();
    for name in ["good", "idle"] {
        let (out, notes) =
            run(at, &["train", &format!("{name}.toml"), "--out", name]).expect("an evaluation");
        assert!(notes.contains("no trained numbers"), "{notes}");
        assert!(out.contains("1 epoch in"), "{out}");
        let metrics = fs::read_to_string(at.join(name).join("metrics.csv")).expect("metrics");
        let rows: Vec<Vec<&str>> = metrics.lines().map(|row| row.split(',').collect()).collect();
        let column = rows[0].iter().position(|&name| name == "test_loss").expect("a column");
        assert_eq!(rows.len(), 2, "{metrics}");
        losses.push(rows[1][column].parse::<f64>().expect("a loss"));
    }
    assert!(losses[0] < 0.9 * losses[1], "{losses:?}");
    succeed(at, &["check", "good.toml"]);
    succeed(at, &["explain", "good.toml"]);
    succeed(at, &["eval", "good", "idle", "--samples", "32"]);
    succeed(at, &["robust", "good", "--grid", "system.spread=0.5:2:3", "--samples", "8"]);
    succeed(at, &["report", "good", "--out", "page"]);
    succeed(at, &["animate", "good"]);
    succeed(at, &["train", "--resume", "--out", "good"]);
    succeed(at, &["compare", "good.toml", "--fields", "R,C", "--seeds", "2", "--out", "compared"]);
    succeed(at, &["report", "compared"]);
}

#[test]
fn refusals_name_the_key_and_the_reason() {
    let dir = TempDir::new().expect("a folder");
    let at = dir.path();
    for (policy, expected) in [
        (
            "kind = \"gur\"",
            "scene.toml:8: `policy.kind` is \"gur\"; allowed: `mlp`, `linear`, `gru`",
        ),
        ("kind = 3", "`policy.kind` is 3"),
        (
            "kind = \"gru\"\nwidths = [3]",
            "scene.toml:9: `policy.widths` is unknown; allowed: `units`, `kind`",
        ),
        ("kind = \"gru\"\nunits = 0", "scene.toml:9: `policy.units` is 0; allowed: 1 to 10000"),
        ("kind = \"gru\"\nunits = -1", "allowed: a whole number, 1 to 10000"),
        ("kind = \"open_loop\"\nunits = 3", "`policy.units` is unknown"),
        ("kind = \"conv\"", "`policy.kind` is conv, which reads pairs"),
        ("units = 3", "`policy.units` is unknown; allowed: `widths`"),
        ("bounds = [[1, 0]]", "scene.toml:8: `policy.bounds` is [[1, 0]]; allowed: true"),
        ("bounds = [[0, 1], [0, 1]]", "`policy.bounds` has 2 pairs, but there are 1 controls"),
        ("base = 3", "`policy.base` is 3; allowed: a section with the `kind`"),
        ("[policy.base]\nunits = 3", "`policy.base.kind` is missing; allowed: `mlp`"),
        ("[policy.base]\nkind = \"gru\"\nunits = 0", "`policy.base.units` is 0"),
        ("kind = \"equations\"", "`policy.control.force` is missing"),
        (
            "kind = \"equations\"\ncontrol.force = \"k * y\"",
            "scene.toml:9: `policy.control.force` has an error in column 1",
        ),
        ("kind = \"equations\"\ncontrol.force = \"x_dott\"", "did you mean `x_dot`?"),
        (
            "kind = \"equations\"\ncontrol.force = \"k\"\nparameters.k = { uniform = [0, 1] }",
            "`policy.parameters.k` is drawn; allowed: a number, or { start = value }",
        ),
    ] {
        write(at, "scene.toml", &cart_pole(policy));
        let error = fail(at, &["explain", "scene.toml"]);
        assert!(error.contains(expected), "{policy}: {error} lacks {expected}");
    }
}

#[test]
fn bounds_are_those_of_the_task_and_observations_have_their_names() {
    let dir = TempDir::new().expect("a folder");
    let at = dir.path();
    let scene = |policy: &str| {
        format!(
            r#"scene = 1
task = "equations"
{SMALL}
[system]
states = ["h"]
controls = ["pump"]
dt = 0.1
bounds = {{ pump = [0.0, 0.4] }}
observe = ["0.3 - h", "h"]
start = {{ h = 0.1 }}
rate = {{ h = "pump - 0.2 * h" }}
[loss]
running = "(next.h - 0.3)^2"
[policy]
{policy}
"#
        )
    };
    let largest = |name: &str, policy: &str| {
        write(at, "scene.toml", &scene(policy));
        succeed(at, &["train", "scene.toml", "--epochs", "0", "--out", name, "--quiet"]);
        let rows = fs::read_to_string(at.join(name).join("trajectory.csv")).expect("rows");
        let column = rows.lines().next().expect("names").split(',').position(|name| name == "pump");
        let value = |row: &str| row.split(',').nth(column.expect("a control"))?.parse::<f64>().ok();
        rows.lines().skip(1).filter_map(value).fold(f64::NEG_INFINITY, f64::max)
    };
    let equations = "kind = \"equations\"\ncontrol.pump = \"10 * y_1 + 0 * h\"";
    assert!(largest("free", equations) > 1.9);
    let bounded = largest("bounded", &format!("{equations}\nbounds = true"));
    assert!((0.399..0.400001).contains(&bounded), "{bounded}");
    assert_eq!(largest("network", "bounds = true") as f32, 0.2, "0 is the middle of the range");
    let without = scene("bounds = true").replace("bounds = { pump = [0.0, 0.4] }\n", "");
    write(at, "scene.toml", &without);
    let error = fail(at, &["explain", "scene.toml"]);
    assert!(error.contains("`policy.bounds` is true, but the task has no bounds"), "{error}");
    assert_eq!(largest("limited", "bounds = [[0.1, 0.2]]") as f32, 0.15);
}

#[test]
fn a_scene_without_trained_numbers_is_evaluated_like_its_run() {
    let dir = TempDir::new().expect("a folder");
    let at = dir.path();
    let fixed = "kind = \"equations\"\ncontrol.force = \"-2 * x - x_dot\"\n";
    write(at, "fixed.toml", &cart_pole(fixed));
    write(at, "trained.toml", &cart_pole(CONTROLLER));
    succeed(at, &["train", "fixed.toml", "--out", "run", "--quiet"]);
    let losses = |path: &str, out: &str| {
        succeed(at, &["eval", path, "--samples", "32", "--out", out, "--worst", "0"]);
        let rows = fs::read_to_string(at.join(out).join("losses.csv")).expect("losses");
        let row = |line: &str| line.split_once(',').map(|(_, loss)| loss.to_owned());
        rows.lines().filter_map(row).collect::<Vec<_>>()
    };
    assert_eq!(losses("fixed.toml", "of_scene"), losses("run", "of_run"));
    succeed(at, &["robust", "fixed.toml", "--grid", "system.gravity=9:10:2", "--samples", "8"]);
    let error = fail(at, &["eval", "trained.toml"]);
    assert!(error.contains("1 number to train; run `physgrad train trained.toml`"), "{error}");
}

/// Other bounds of a trained gain, and other bounds of the controls, would change what the same
/// parameters mean. Fixed gains may differ.
#[test]
fn trained_parameters_keep_their_meaning() {
    let dir = TempDir::new().expect("a folder");
    let at = dir.path();
    write(at, "scene.toml", &cart_pole(CONTROLLER));
    succeed(at, &["train", "scene.toml", "--epochs", "1", "--out", "run", "--quiet"]);
    let other = "policy.parameters.k={start=1.0,min=0.0,max=50.0}";
    let expected = "its parameters belong to a policy whose `parameters.k.max` is absent, but 50.0";
    let refused = fail(at, &["eval", "run", "--set", other]);
    assert!(refused.contains(expected), "{refused}");
    let refused = fail(at, &["train", "scene.toml", "--policy", "run", "--set", other]);
    assert!(refused.contains(expected), "{refused}");
    let refused = fail(at, &["eval", "run", "--set", "policy.bounds=[[-9,9]]"]);
    assert!(refused.contains("`bounds` is absent, but [[-9.0, 9.0]]"), "{refused}");
    succeed(at, &["eval", "run", "--set", "policy.parameters.lag=0.7", "--samples", "8"]);
    succeed(at, &["eval", "run", "--set", "system.gravity=9", "--samples", "8"]);
}
