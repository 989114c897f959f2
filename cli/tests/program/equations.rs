//! Scenes with equations: the template, errors with their lines, runs that stand alone.

use crate::running::{error_of, physgrad};
use std::fs;
use std::path::Path;
use tempfile::TempDir;

/// Output of a command that succeeds in a folder.
fn output(folder: &Path, args: &[&str]) -> String {
    let output = physgrad(args).current_dir(folder).output().expect("the command runs");
    assert!(output.status.success(), "{args:?}: {}", String::from_utf8_lossy(&output.stderr));
    String::from_utf8(output.stdout).expect("text")
}

/// A pendulum in f64, whose mass may be drawn.
const PENDULUM: &str = r#"scene = 1
task = "equations"
precision = "f64"
horizon = 30
epochs = 2
[system]
states = ["angle", "rate"]
controls = ["torque"]
angles = ["angle"]
dt = 0.05
observe = ["sin(angle)", "cos(angle)", "rate"]
parameters = { mass = 1.0, length = 0.5 }
start = { angle = { normal = [3.14, 0.2] } }
[system.define]
inertia = "mass * length ^ 2"
[system.rate]
angle = "rate"
rate = "torque / inertia + 9.81 / length * sin(angle)"
[loss]
running = "1e-4 * torque ^ 2"
terminal = "1 - cos(angle) + 0.05 * rate ^ 2"
[policy]
widths = [8]
[training]
train_samples = 16
test_samples = 16
"#;

fn folder(scene: &str) -> TempDir {
    let dir = TempDir::new().expect("a folder");
    fs::write(dir.path().join("own.toml"), scene).expect("a scene");
    dir
}

#[test]
fn a_new_scene_with_equations_passes_its_check_and_overwrites_nothing() {
    let dir = TempDir::new().expect("a folder");
    output(dir.path(), &["new", "--scene", "my_tanks"]);
    let checked = output(dir.path(), &["check", "my_tanks.toml"]);
    assert!(checked.contains("my_tanks.toml: system") && !checked.contains("FAILED"), "{checked}");
    let message = error_of(physgrad(&["new", "--scene", "my_tanks"]).current_dir(dir.path()));
    assert!(message.contains("cannot create my_tanks.toml; choose another name"), "{message}");
}

#[test]
fn every_command_takes_equations_and_a_run_stands_alone() {
    let dir = folder(PENDULUM);
    let at = dir.path();
    let explained = output(at, &["explain", "own.toml"]);
    assert!(explained.contains("state, 2 components: angle, rate"), "{explained}");
    assert!(explained.contains("d angle / dt") && explained.contains("mass * length ^ 2"));
    output(at, &["train", "own.toml", "--out", "run"]);
    fs::remove_file(at.join("own.toml")).expect("the scene is not needed any more");
    output(at, &["train", "--resume", "--out", "run", "--epochs", "3"]);
    output(at, &["eval", "run"]);
    output(at, &["report", "run", "-o", "page"]);
    output(at, &["export", "run", "--onnx", "policy.onnx"]);
    output(at, &["optimize", "run/run.toml", "--iterations", "3"]);
    let drawn = "system.parameters.mass={ uniform = [0.8, 1.2] }";
    output(at, &["train", "run/run.toml", "--epochs", "1", "--set", drawn, "--out", "drawn"]);
    output(at, &["robust", "drawn", "--grid", "system.parameters.mass=0.5:2:3"]);
    let header = fs::read_to_string(at.join("drawn/trajectory.csv")).expect("a table");
    assert!(header.lines().next().expect("names").contains("system.parameters.mass"), "{header}");
}

#[test]
fn an_identification_recovers_a_parameter_of_the_equations() {
    let torque = PENDULUM.replace("torque / inertia", "(torque + sin(3 * t)) / inertia");
    let dir = folder(&torque.replace("mass = 1.0", "mass = { start = 1.0, min = 0.1 }"));
    let at = dir.path();
    fs::write(at.join("true.toml"), torque.replace("mass = 1.0", "mass = 1.3")).expect("a scene");
    output(at, &["train", "true.toml", "--out", "data"]);
    let found = output(at, &["identify", "own.toml", "--data", "data/trajectory.csv"]);
    assert!(found.contains("1.30"), "{found}");
}

#[test]
fn errors_in_equations_name_the_line_and_the_column() {
    for (from, to, message) in [
        (
            "/ inertia +",
            "/ inertial +",
            "own.toml:18: `system.rate.rate` has an error in column 10",
        ),
        (
            "angle = \"rate\"",
            "angle = \"rate +\"",
            "own.toml:17: `system.rate.angle` has an error in column 7",
        ),
        (
            "1e-4 * torque ^ 2",
            "1e-4 * torque ^ next",
            "own.toml:20: `loss.running` has an error in column 17",
        ),
        (
            "1 - cos(angle)",
            "1 - cos(torque)",
            "own.toml:21: `loss.terminal` depends on the control",
        ),
        (
            "mass = 1.0",
            "mass = \"heavy\"",
            "own.toml:12: `system.parameters.mass` is string \"heavy\"; allowed: a number",
        ),
        ("dt = 0.05", "dt = 0", "own.toml:10: `system.dt` is 0; allowed: a positive number"),
        ("rate = \"torque", "rat = \"torque", "`system.rate` has `rat`, which is not a state"),
        ("[policy]", "[integrator]\nsubsteps = 0\n[policy]", "`integrator.substeps` is 0"),
    ] {
        let scene = PENDULUM.replace(from, to);
        assert_ne!(scene, PENDULUM, "{from}");
        let dir = folder(&scene);
        let found = error_of(physgrad(&["check", "own.toml"]).current_dir(dir.path()));
        assert!(found.contains(message), "{to}: {found}");
    }
    let discrete = PENDULUM.replace("[system.rate]", "[system.next]");
    let dir = folder(&discrete);
    assert!(output(dir.path(), &["explain", "own.toml"]).contains("torque"));
    for (setting, message) in [
        ("integrator.method=rk4", "`integrator.method` is rk4, but has no effect"),
        ("integrator.substeps=2", "`system.next` gives the state after a whole step"),
    ] {
        let mut command = physgrad(&["check", "own.toml", "--set", setting]);
        let found = error_of(command.current_dir(dir.path()));
        assert!(found.contains(message), "{setting}: {found}");
    }
}

#[test]
fn a_name_has_one_meaning_in_observations_and_trajectories() {
    let scene = |speed: &str, observe: &str| {
        format!(
            "scene = 1\ntask = \"equations\"\nprecision = \"f64\"\nhorizon = 5\nepochs = 1\n[system]\n\
             states = [\"x\", \"{speed}\"]\ncontrols = [\"u\"]\ndt = 0.1\nobserve = [{observe}]\n\
             start = {{ x = {{ uniform = [1, 2] }} }}\nrate = {{ x = \"{speed}\", {speed} = \"u\" }}\n\
             [loss]\nrunning = \"x^2\"\n[policy]\nkind = \"equations\"\ncontrol.u = \"-x - {speed}\"\n"
        )
    };
    let [swapped, plain, time] = [
        scene("y_1", "\"x + 1\", \"x\", \"y_1\""),
        scene("y_1", "\"x\", \"y_1\""),
        scene("time", "\"x\", \"time\""),
    ];
    let error = |scene: &str| {
        let dir = folder(scene);
        error_of(physgrad(&["check", "own.toml"]).current_dir(dir.path()))
    };
    let found = error(&swapped);
    assert!(found.contains("`system.observe` component 1 has no name of its own"), "{found}");
    let found = error(&time);
    assert!(found.contains("`time` is also the name of another column"), "{found}");
    let dir = folder(&plain);
    output(dir.path(), &["train", "own.toml", "--out", "run"]);
    let rows = fs::read_to_string(dir.path().join("run/trajectory.csv")).expect("rows");
    let row: Vec<&str> = rows.lines().nth(2).expect("a row").split(',').collect();
    let [x, y_1, u] = [3, 4, 5].map(|column| row[column].parse::<f64>().expect("a number"));
    assert!((x + y_1 + u).abs() < 1e-12 && y_1 != 0.0, "{row:?}");
}

#[test]
fn equations_replace_the_costs_and_the_observation_of_a_built_in_task() {
    let scene = r#"scene = 1
task = "cart_pole"
system.poles = 1
system.cart_mass = { uniform = [0.8, 1.2] }
horizon = 20
[actuator.lag]
time = 0.1
[equations]
observe = ["x", "x_dot", "sin(theta_1)", "cos(theta_1)", "omega_1", "force_before", "system.cart_mass"]
running = "lean + 1e-3 * force ^ 2 + t * next.x ^ 2"
terminal = "10 * lean"
define = { lean = "1 - cos(theta_1)" }
[policy]
widths = [8]
"#;
    let dir = folder(scene);
    let checked = output(dir.path(), &["check", "own.toml"]);
    assert!(checked.contains("own.toml: costs") && !checked.contains("FAILED"), "{checked}");
    assert!(output(dir.path(), &["explain", "own.toml"]).contains("actuator.lag"));
    output(dir.path(), &["train", "own.toml", "--epochs", "1", "--out", "run"]);
    output(dir.path(), &["eval", "run"]);
    for (from, to, message) in [
        ("force ^ 2", "push ^ 2", "own.toml:10: `equations.running` has an error in column 15"),
        ("sin(theta_1)", "sin(force)", "`equations.observe` depends on the control"),
        (
            "\"cart_pole\"\nsystem.poles = 1\nsystem.cart_mass = { uniform = [0.8, 1.2] }",
            "\"equations\"",
            "`system.states` is empty",
        ),
    ] {
        let changed = scene.replace(from, to);
        assert_ne!(changed, scene, "{from}");
        let dir = folder(&changed);
        let found = error_of(physgrad(&["check", "own.toml"]).current_dir(dir.path()));
        assert!(found.contains(message), "{to}: {found}");
    }
}
