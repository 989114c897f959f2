//! Controllers with trained gains: misspelt names, gains at bounds, numbers that are not finite.

use crate::running::{error_of, physgrad};
use std::fs;
use std::path::Path;
use tempfile::TempDir;

/// A tank whose level should be 0.3. The best constant flow is 5.
const TANK: &str = r#"scene = 1
task = "equations"
precision = "f64"
field = "R"
horizon = 4
epochs = 200
[system]
states = ["level", "flow"]
controls = ["pump"]
dt = 0.1
parameters = { leak = 0.2, area = 1.0 }
start = { level = { uniform = [0.1, 0.2] } }
rate = { level = "flow / area", flow = "pump - leak * flow" }
observe = ["error", "2 * level"]
define = { error = "0.3 - level" }
[loss]
running = "(pump - 5)^2"
[policy]
kind = "equations"
control.pump = "kp + 0 * error + 0 * y_2"
parameters.kp = { start = 2.0, min = 0.0, max = 3.0 }
[training]
learning_rate = 0.3
train_samples = 8
test_samples = 8
"#;

/// The scene in a new folder, with another text in place of `from`.
fn folder(from: &str, to: &str) -> TempDir {
    let dir = TempDir::new().expect("a folder");
    let scene = TANK.replace(from, to);
    assert!(scene != TANK || from == to, "{from}");
    fs::write(dir.path().join("tank.toml"), scene).expect("a scene");
    dir
}

/// Output and messages of a command that succeeds.
fn output(at: &Path, args: &[&str]) -> [String; 2] {
    let output = physgrad(args).current_dir(at).output().expect("the command runs");
    let [out, messages] =
        [output.stdout, output.stderr].map(|bytes| String::from_utf8(bytes).expect("text"));
    assert!(output.status.success(), "{args:?}: {messages}");
    [out, messages]
}

fn assert_refused(at: &Path, args: &[&str], expected: &str) {
    let error = error_of(physgrad(args).current_dir(at));
    assert!(error.contains(expected), "{args:?}: {error} lacks {expected}");
}

#[test]
fn a_misspelt_name_of_an_option_is_refused_with_the_known_names() {
    let dir = folder("", "");
    let at = dir.path();
    output(at, &["train", "tank.toml", "--epochs", "1", "--out", "run"]);
    let leek = "`system.parameters.leek` is a name that no expression uses; known: `leak` or `area`; \
                did you mean `leak`?";
    for command in ["train", "check", "explain", "optimize", "compare"] {
        let refused = format!("--set system.parameters.leek=1: {leek}");
        assert_refused(at, &[command, "tank.toml", "--set", "system.parameters.leek=1"], &refused);
    }
    let gain = "`policy.parameters.kq` is a name that no expression uses; known: `kp`";
    assert_refused(at, &["eval", "run", "--set", "policy.parameters.kq=1"], gain);
    assert_refused(at, &["train", "tank.toml", "--set", "policy.next.integral=0"], "integral");
    // A saved scene has its names in alphabetical order.
    let sorted = leek.replace("`leak` or `area`", "`area` or `leak`");
    assert_refused(at, &["robust", "run", "--grid", "system.parameters.leek=0:1:3"], &sorted);
    assert_refused(at, &["robust", "run", "--grid", "policy.parameters.kq=0:1:3"], gain);
    let trained = "--grid policy.parameters.kp: the training of run has determined this number";
    assert_refused(at, &["robust", "run", "--grid", "policy.parameters.kp=0:1:3"], trained);
    let plan = "seeds = 1\nfields = [\"R\"]\n[grid]\n\"system.parameters.leek\" = [1.0, 2.0]\n\
                [[task]]\nscene = \"tank.toml\"\n";
    fs::write(at.join("plan.toml"), plan).expect("a plan");
    assert_refused(at, &["study", "plan.toml"], leek);
    // A name that the changed expressions use, and another value of a known name.
    let add =
        ["--set", "system.parameters.more=2.0", "--set", "system.rate.level=more * flow / area"];
    output(at, &[&["explain", "tank.toml"][..], &add].concat());
    output(at, &["robust", "run", "--grid", "system.parameters.leak=0:1:2", "--samples", "8"]);
    let dir = folder(
        "[training]",
        "[vary]\n\"system.parameters.leek\" = { uniform = [1, 2] }\n[training]",
    );
    assert_refused(dir.path(), &["explain", "tank.toml"], &format!("tank.toml:23: {leek}"));
}

#[test]
fn a_training_warns_of_a_gain_at_its_bound_or_far_away() {
    let dir = folder("", "");
    let at = dir.path();
    let [out, messages] = output(at, &["train", "tank.toml", "--out", "run"]);
    let warning =
        "a trained number is at its bound, or within 1 % of it: policy.parameters.kp = 2.9";
    assert!(messages.contains(warning), "{messages}");
    assert!(out.contains("trained: policy.parameters.kp = 2.9"), "{out}");
    assert!(out.contains(" (start 2.00000, between 0 and 3)"), "{out}");
    output(at, &["report", "run", "--out", "page"]);
    let page = fs::read_to_string(at.join("page/report.html")).expect("a page");
    for text in ["trained number", "policy.parameters.kp", ">2.00000<"] {
        assert!(page.contains(text), "the page lacks {text}");
    }
    // Far from its bounds.
    let dir = folder("max = 3.0", "max = 30.0");
    let [out, messages] = output(dir.path(), &["train", "tank.toml", "--out", "run"]);
    assert!(!messages.contains("warning"), "{messages}");
    assert!(out.contains("policy.parameters.kp = 4.9999") || out.contains("kp = 5.0000"), "{out}");
    let dir = folder("(pump - 5)^2", "-pump");
    fs::write(
        dir.path().join("tank.toml"),
        fs::read_to_string(dir.path().join("tank.toml"))
            .expect("a scene")
            .replace(", min = 0.0, max = 3.0", "")
            .replace("= 0.3\n", "= 1e5\n"),
    )
    .expect("a scene");
    let [_, messages] = output(dir.path(), &["train", "tank.toml", "--out", "run"]);
    assert!(messages.contains("training runs away: policy.parameters.kp = "), "{messages}");
}

#[test]
fn a_check_advises_the_gradient_for_a_few_parameters() {
    let dir = folder("", "");
    let advice = "field: with 1 parameter";
    assert!(!output(dir.path(), &["check", "tank.toml"])[0].contains(advice));
    let dir = folder("field = \"R\"\n", "");
    let [combined, _] = output(dir.path(), &["check", "tank.toml"]);
    assert!(combined.contains(advice) && combined.contains("`field = \"R\"`"), "{combined}");
    let network = TANK.split("[policy]").next().expect("a scene").replace("field = \"R\"\n", "");
    fs::write(dir.path().join("tank.toml"), network).expect("a scene");
    assert!(!output(dir.path(), &["check", "tank.toml"])[0].contains(advice));
}

#[test]
fn a_number_that_is_not_finite_has_the_key_of_its_expression() {
    for (from, to, key, line) in [
        ("kp + 0 * error", "kp * sqrt(0.1 - level)", "policy.control.pump", 20),
        ("kp + 0 * error", "kp + sum", "policy.next.sum", 21),
        // The level is not finite either, and comes first.
        ("pump - leak * flow", "log(-1 - level^2)", "system.rate.flow", 13),
    ] {
        let to = match key {
            "policy.next.sum" => format!("{to} + 0 * y_2\"\nnext.sum = \"sqrt(-error)"),
            _ => to.to_owned(),
        };
        // The policy observes the error, and not the level.
        let dir = folder(from, &to.replace("0.1 - level", "-error"));
        let at = dir.path();
        let error = error_of(physgrad(&["train", "tank.toml", "--out", "run"]).current_dir(at));
        assert!(error.contains(&format!("`{key}` is not finite: training stopped")), "{error}");
        let checked = physgrad(&["check", "tank.toml"]).current_dir(at).output().expect("it runs");
        let notes = String::from_utf8(checked.stdout).expect("text");
        let expected = format!("test rollouts: tank.toml:{line}: `{key}` is not finite: ");
        assert!(notes.contains(&expected), "{notes} lacks {expected}");
    }
}

#[test]
fn the_name_dt_is_that_of_the_time_step_only() {
    for (from, to, section) in [
        ("leak = 0.2", "leak = 0.2, dt = 2.0", "`system.parameters` has `dt`"),
        ("define = { ", "define = { dt = \"1\", ", "`system.define` has `dt`"),
        ("parameters.kp", "parameters.dt = 2.0\nparameters.kp", "`policy.parameters` has `dt`"),
        ("parameters.kp", "next.dt = \"1\"\nparameters.kp", "`policy.next` has `dt`"),
    ] {
        let dir = folder(from, to);
        let expected = format!("{section}, which has a meaning of its own; choose another name");
        assert_refused(dir.path(), &["explain", "tank.toml"], &expected);
    }
}

#[test]
fn an_observed_name_is_that_of_its_component_everywhere() {
    let dir = folder("[training]", "[sensor]\ndelay = { steps = 1 }\n[training]");
    let at = dir.path();
    output(at, &["train", "tank.toml", "--epochs", "1", "--out", "run"]);
    let rows = fs::read_to_string(at.join("run/trajectory.csv")).expect("rows");
    let header = rows.lines().next().expect("names");
    assert!(header.contains("level,flow,error_1_ago,y_2_1_ago,pump"), "{header}");
    let file = fs::read(at.join("run/policy.safetensors")).expect("a policy");
    let text = String::from_utf8_lossy(&file);
    assert!(text.contains(r#"[\"error\",\"y_2\"]"#), "{text}");
}

#[test]
fn a_training_without_epochs_or_numbers_says_what_it_lacks() {
    let dir = folder("control.pump = \"kp + 0 * error", "control.pump = \"kp");
    let at = dir.path();
    let args = ["train", "tank.toml", "--epochs", "0"];
    assert!(
        output(at, &[&args[..], &["--out", "a"]].concat())[0].contains("the policy is untrained")
    );
    let fixed = ["--set", "policy.parameters.kp=2.0", "--out", "b"];
    let [out, messages] = output(at, &[&args[..], &fixed].concat());
    assert!(
        out.contains("the losses of the policy, which has nothing to train, are unknown"),
        "{out}"
    );
    assert!(messages.contains("`epochs = 1` evaluates its losses"), "{messages}");
}
