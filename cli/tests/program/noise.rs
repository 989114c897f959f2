//! Scenes with noise and sensors: checks, resumed runs, measurements, errors.

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

/// A cart whose mass is drawn, whose wind is noise, and whose policy sees it late and with errors.
const CART: &str = r#"scene = 1
task = "cart_pole"
horizon = 20
system.poles = 1
policy.widths = [8]
effects.steady_wind.speed = { noise = 2.0, hold = 2 }
[vary]
"system.cart_mass" = { uniform = [0.8, 1.2] }
[training]
train_samples = 16
test_samples = 4
[actuator]
delay = { steps = 1 }
[sensor]
lag = { time = 0.02 }
bias = { value = { normal = [0, 0.01] } }
noise = { deviation = [0.01, 0.02, 0.01, 0.02, 0] }
sampling = { steps = 2 }
delay = { steps = 2 }
"#;

fn folder() -> TempDir {
    let dir = TempDir::new().expect("a folder");
    fs::write(dir.path().join("cart.toml"), CART).expect("a scene");
    dir
}

#[test]
fn gradients_through_noise_and_sensors_pass_the_check() {
    let checked = output(folder().path(), &["check", "cart.toml"]);
    assert!(checked.contains("cart.toml: rollout, R") && !checked.contains("FAILED"), "{checked}");
}

#[test]
fn resumed_runs_and_other_numbers_of_threads_have_the_same_noise() {
    let dir = folder();
    let train = |out: &str, epochs: &str, more: &[&str]| {
        let args = ["train", "cart.toml", "--quiet", "--out", out, "--epochs", epochs];
        output(dir.path(), &[&args[..], more].concat());
        fs::read(dir.path().join(out).join("policy.safetensors")).expect("a policy")
    };
    let whole = train("whole", "4", &[]);
    train("part", "2", &[]);
    assert_eq!(whole, train("part", "4", &["--resume"]), "resumed");
    assert_eq!(whole, train("threads", "4", &["--threads", "3"]), "three threads");
    assert_ne!(whole, train("part2", "3", &[]));
    // The rows of a rollout show the noise of each step, held for two steps.
    let rows = fs::read_to_string(dir.path().join("whole/trajectory.csv")).expect("rollouts");
    let mut rows = rows.lines().map(|line| line.split(',').collect::<Vec<_>>());
    let header = rows.next().expect("a header");
    let column = |name: &str| header.iter().position(|cell| *cell == name).expect("a column");
    let [wind, mass] = ["effects.steady_wind.speed", "system.cart_mass"].map(column);
    let first: Vec<Vec<&str>> = rows.take(4).collect();
    assert_eq!(first[0][wind], first[1][wind]);
    assert_ne!(first[1][wind], first[2][wind]);
    assert_eq!(first[0][mass], first[2][mass]);
    assert!(header.contains(&"x_lagged") && header.contains(&"omega_1_2_ago"), "{header:?}");
}

#[test]
fn identification_leaves_out_the_sensor_and_noise_has_its_mean() {
    let dir = folder();
    let steady = CART
        .replace("{ noise = 2.0, hold = 2 }", "0.5")
        .replace("[actuator]\ndelay = { steps = 1 }\n", "")
        .replace("0.02, 0]", "0.02]");
    let (data, _) = steady.split_once("[sensor]").expect("a sensor");
    fs::write(dir.path().join("data.toml"), data).expect("a scene");
    let args = ["train", "data.toml", "--quiet", "--out", "run", "--epochs", "1"];
    output(dir.path(), &args);
    let fit = steady.replace("speed = 0.5", "speed = { noise = 2.0, mean = 0.5 }")
        + "\n[fit]\n\"system.half_length\" = { start = 0.6, min = 0.1 }\n";
    fs::write(dir.path().join("fit.toml"), fit).expect("a scene");
    let args = ["identify", "fit.toml", "--data", "run/trajectory.csv", "--exact-starts", "--json"];
    let fitted = output(dir.path(), &args);
    let fitted: serde_json::Value = serde_json::from_str(&fitted).expect("JSON");
    let value = fitted["numbers"][0]["value"].as_f64().expect("a number");
    // The data are rollouts in f32.
    assert!((value - 0.5).abs() < 1e-5, "{fitted}");
}

#[test]
fn noise_varies_by_key_and_parts_of_one_name_are_told_apart() {
    let dir = folder();
    let scene = CART.replace("effects.steady_wind.speed = { noise = 2.0, hold = 2 }\n", "");
    let scene =
        scene.replace("[vary]\n", "[vary]\n\"effects.steady_wind.speed\" = { noise = 2.0 }\n");
    fs::write(dir.path().join("vary.toml"), scene).expect("a scene");
    let shown = output(dir.path(), &["explain", "vary.toml"]);
    assert!(shown.contains("effects.steady_wind"), "{shown}");
    let args = ["explain", "vary.toml", "--without", "delay"];
    let error = error_of(physgrad(&args).current_dir(dir.path()));
    assert!(error.contains("has actuator.delay and sensor.delay; write one of these"), "{error}");
    let without = output(dir.path(), &["explain", "vary.toml", "--without", "sensor.delay"]);
    assert!(without.contains("present ┆ actuator.delay"), "{without}");
    let wind = ["explain", "vary.toml", "--set", "effects.steady_wind.speed=0.5"];
    output(dir.path(), &wind);
}

#[test]
fn wrong_noise_and_sensors_are_refused_with_their_key() {
    let dir = folder();
    for (setting, message) in [
        (
            "sensor.noise.deviation=[1,2]",
            "`sensor.noise.deviation` has 2 numbers, but the task has 5 observed components: x, x_dot",
        ),
        ("sensor.noise.deviation=-1", "`sensor.noise.deviation` is -1; allowed: 0 or more"),
        ("sensor.delay.steps=1001", "`sensor.delay.steps` is 1001; allowed: 0 to 1000"),
        ("sensor.noise.deviation=[]", "`sensor.noise.deviation` is empty"),
        ("sensor.bias.value={start=0.1}", "is trained; allowed: a number or a distribution"),
        ("sensor.bias.value={noise=0.1}", "is noise; allowed: a number or a distribution"),
        ("sensor.sampling.steps=0", "`sensor.sampling.steps` is 0; allowed: 1 to 1000000"),
        ("sensor.lag.time=0", "`sensor.lag.time` is 0"),
        ("sensor.bias.value={normal=[1]}", "allowed: [mean, deviation]"),
        ("system.pole_mass={noise=0.5,mean=1}", "system.pole_mass"),
        ("system.pole_mass={noise=-1}", "`noise = -1`; allowed: a standard deviation of 0 or more"),
        ("system.pole_mass={noise=0.01,mean=1,hold=0}", "`hold = 0`; allowed"),
        ("system.pole_mass={uniform=[1,2],hold=2}", "the table needs one of"),
    ] {
        let args = ["check", "cart.toml", "--set", setting];
        let error = error_of(physgrad(&args).current_dir(dir.path()));
        assert!(error.contains(message), "{setting}: {error}");
    }
}
