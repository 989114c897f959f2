//! Extreme values for each number of each preset. The program trains or reports the faulty setting;
//! it neither panics nor hangs.
//!
//! By default, the first test runs a sample of the cases. To run all cases, in a few minutes:
//! `PHYSGRAD_EXTREMES=all cargo test --release --test program extreme_settings -- --nocapture`.

use assert_cmd::Command;
use physgrad::rng::{Purpose, stream};
use rand::RngExt;
use std::path::Path;
use std::sync::Mutex;
use std::time::Duration;
use tempfile::TempDir;
use toml::{Table, Value};

/// Time limit, far above the duration of any case.
const TIME_LIMIT: Duration = Duration::from_secs(120);
/// Number of cases in the samples of `train` and `explain`. `compare` runs a tenth.
const SAMPLE: usize = 150;

/// Extreme values of settings that are floating-point numbers.
const NUMBERS: [&str; 7] = ["0.0", "1e38", "-1e38", "1e300", "-1e300", "1e-300", "-1e-300"];
/// Extreme values of settings that are integers.
const COUNTS: [&str; 5] = ["0", "-1", "1", "9223372036854775807", "1e38"];

/// Fast training settings for any scene.
const TINY: [&str; 6] = [
    "epochs=1",
    "horizon=6",
    "training.train_samples=4",
    "training.test_samples=4",
    "training.batch=4",
    "seed=1",
];

/// Presets with changes: effects, actuators, integrators and precisions that no preset combines.
const MORE: [(&str, &[&str]); 9] = [
    (
        "cart_pole",
        &[
            "effects.steady_wind.speed=3",
            "effects.cart_damping.damping=0.1",
            "actuator.delay.steps=2",
        ],
    ),
    ("cart_pole", &["integrator.method=adaptive", "integrator.rtol=1e-4", "integrator.atol=1e-6"]),
    (
        "cart_pole",
        &[
            "integrator.method=implicit_midpoint",
            "integrator.tolerance=1e-4",
            "integrator.substeps=2",
        ],
    ),
    (
        "cart_pole",
        &["integrator.method=sdirk2", "integrator.tolerance=1e-4", "integrator.substeps=2"],
    ),
    (
        "cart_pole_windy",
        &["precision=f64", "integrator.method=rk4", "effects.cart_damping.damping=0.1"],
    ),
    (
        "guidance",
        &["effects.drive.strength=0.2", "integrator.method=tsit5", "actuator.lag.time=0.1"],
    ),
    (
        "quantum",
        &["effects.harmonic.stiffness=10", "integrator.method=pade", "integrator.substeps=2"],
    ),
    (
        "quantum",
        &["effects.barrier.height=10", "integrator.method=strang", "effects.cubic.strength=1"],
    ),
    ("quantum_double_well", &["precision=f64", "integrator.substeps=2", "training.clip=value"]),
];

/// Preset with settings, of which the last is extreme.
#[derive(Clone, Debug)]
struct Case {
    preset: String,
    settings: Vec<String>,
}

fn physgrad(args: &[&str]) -> Command {
    let mut command = Command::cargo_bin("physgrad").expect("the program is built");
    command.args(args);
    command
}

fn presets() -> Vec<String> {
    let output = physgrad(&["scene"]).output().expect("the command runs");
    let text = String::from_utf8(output.stdout).expect("text");
    text.lines().map(|line| line.split(' ').next().expect("a name").to_owned()).collect()
}

/// Returns all settings of a scene, as a run stores them.
fn settings(preset: &str, changes: &[&str], dir: &Path) -> Table {
    let mut command = physgrad(&["train", preset, "--epochs", "0", "--threads", "1", "--out"]);
    command.arg(dir).args(TINY.iter().chain(changes).flat_map(|change| ["--set", change]).skip(2));
    command.assert().success();
    std::fs::read_to_string(dir.join("run.toml")).expect("settings").parse().expect("TOML")
}

/// Collects assignments `key=value` of the extreme values to each number of a scene.
fn extremes(key: &str, value: &Value, found: &mut Vec<String>) {
    match value {
        Value::Table(table) => {
            for (name, value) in table {
                extremes(
                    &if key.is_empty() { name.clone() } else { format!("{key}.{name}") },
                    value,
                    found,
                );
            }
        }
        Value::Float(_) => found.extend(NUMBERS.map(|number| format!("{key}={number}"))),
        Value::Integer(_) => found.extend(COUNTS.map(|count| format!("{key}={count}"))),
        // Replaces one element of a list at a time.
        Value::Array(list) => {
            for i in 0..list.len() {
                let mut of_one = Vec::new();
                extremes("", &list[i], &mut of_one);
                found.extend(of_one.iter().map(|extreme| {
                    let of = |j: usize| {
                        if i == j {
                            extreme.trim_start_matches('=').to_owned()
                        } else {
                            list[j].to_string()
                        }
                    };
                    format!("{key}=[{}]", (0..list.len()).map(of).collect::<Vec<_>>().join(", "))
                }));
            }
        }
        _ => {}
    }
}

/// Returns an override that shrinks the network, if the policy has hidden layers.
fn small_network(settings: &Table) -> Option<&'static str> {
    let policy = settings.get("policy")?.as_table()?;
    let key = |name: &str| {
        policy.get(name).is_some_and(|value| {
            value.is_integer() || value.as_array().is_some_and(|w| !w.is_empty())
        })
    };
    ["width", "widths"]
        .into_iter()
        .find(|name| key(name))
        .map(|name| if name == "width" { "policy.width=2" } else { "policy.widths=[3]" })
}

fn cases(dir: &Path) -> Vec<Case> {
    let names = presets();
    assert!(names.len() >= 23, "{names:?}");
    // A window is at most as long as the horizon.
    let has_windows = |name: &str| {
        let text = physgrad(&["scene", name]).output().expect("the command runs").stdout;
        String::from_utf8_lossy(&text).contains("\n[window]\n")
    };
    let short =
        |name: &str| -> &[&str] { if has_windows(name) { &["window.steps=3"] } else { &[] } };
    let plain = names.iter().map(|name| (name.as_str(), short(name)));
    let mut cases = Vec::new();
    for (i, (preset, changes)) in plain.chain(MORE).enumerate() {
        let table = settings(preset, changes, &dir.join(i.to_string()));
        let mut found = Vec::new();
        extremes("", &Value::Table(table.clone()), &mut found);
        // Excludes the scene version, which is fixed, and an epoch count that no run completes.
        let no_case = |setting: &String| {
            setting.starts_with("scene=") || setting == "epochs=9223372036854775807"
        };
        found.retain(|setting| !no_case(setting));
        let tiny: Vec<&str> =
            TINY.iter().chain(changes).copied().chain(small_network(&table)).collect();
        cases.extend(found.into_iter().map(|extreme| Case {
            preset: preset.to_owned(),
            settings: tiny.iter().map(|&setting| setting.to_owned()).chain([extreme]).collect(),
        }));
    }
    cases
}

/// Outcome of a run of the program.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
enum End {
    /// Success without the key of an effect in a message.
    Done,
    /// An error without the key of an effect.
    Refused,
    /// A message with the key of an effect.
    Blamed,
}

/// Returns the outcome of the run, or a description of its fault.
fn run(mut args: Vec<String>, case: &Case) -> Result<End, String> {
    // `explain` refuses settings of trainings, the extreme one after its validation.
    let is_unread = |setting: &&String| {
        let keys = ["training.", "epochs=", "seed=", "field="];
        args[0] == "explain"
            && keys.iter().any(|key| setting.starts_with(key))
            && case.settings.last() != Some(*setting)
    };
    let read: Vec<&String> = case.settings.iter().filter(|setting| !is_unread(setting)).collect();
    args.extend(read.into_iter().flat_map(|setting| ["--set".to_owned(), setting.clone()]));
    let args: Vec<&str> = args.iter().map(String::as_str).collect();
    let output = physgrad(&args).timeout(TIME_LIMIT).output().expect("the command runs");
    let errors = String::from_utf8_lossy(&output.stderr);
    let describe = || format!("physgrad {}\n{:?}\n{errors}", args.join(" "), output.status.code());
    if errors.contains("panicked") || !matches!(output.status.code(), Some(0..=100)) {
        return Err(describe());
    }
    let Some(blamed) =
        errors.split("the forces of ").nth(1).and_then(|rest| rest.split(' ').next())
    else {
        let silent = !output.status.success() && errors.trim().is_empty();
        return if silent {
            Err(describe())
        } else {
            Ok(if output.status.success() { End::Done } else { End::Refused })
        };
    };
    let known =
        ["pole_damping", "cart_damping", "dry_friction", "steady_wind", "gusty_wind", "bumpers"]
            .into_iter()
            .chain(["friction", "spread", "evade", "flock", "drive", "obstacles", "walls"])
            .chain(["harmonic", "barrier", "double_well", "cubic"]);
    if known.map(|name| format!("effects.{name}")).any(|key| key == blamed) {
        Ok(End::Blamed)
    } else {
        Err(describe())
    }
}

/// Runs the command on all cases in parallel. Panics with the list of all faults, if there are any.
fn run_all(command: &str, cases: &[Case]) {
    let dir = TempDir::new().expect("a folder");
    let (next, ends, wrong) =
        (Mutex::new(cases.iter().enumerate()), Mutex::new(Vec::new()), Mutex::new(Vec::new()));
    let work = || {
        loop {
            let Some((i, case)) = next.lock().expect("no panic").next() else { break };
            let mut args = vec![command.to_owned(), case.preset.clone()];
            let out = dir.path().join(i.to_string());
            if command != "explain" {
                args.extend(["--threads", "1", "--out"].map(str::to_owned));
                args.push(out.to_str().expect("a name").to_owned());
            }
            if command == "compare" {
                args.extend(["--seeds", "1"].map(str::to_owned));
            }
            match run(args, case) {
                Ok(end) => ends.lock().expect("no panic").push(end),
                Err(what) => wrong.lock().expect("no panic").push(what),
            }
            // Ignores an error, because the folder may not exist.
            let _ = std::fs::remove_dir_all(out);
        }
    };
    std::thread::scope(|scope| {
        let workers = std::thread::available_parallelism().map_or(2, |count| count.get());
        (0..workers).for_each(|_| drop(scope.spawn(work)));
    });
    let (ends, wrong) =
        (ends.into_inner().expect("no panic"), wrong.into_inner().expect("no panic"));
    let count = |end| ends.iter().filter(|&&other| other == end).count();
    println!(
        "{command}: {} cases, {} done, {} refused, {} messages with the key of an effect, {} faults",
        cases.len(),
        count(End::Done),
        count(End::Refused),
        count(End::Blamed),
        wrong.len()
    );
    assert!(
        wrong.is_empty(),
        "{} faults in {} cases:\n{}",
        wrong.len(),
        cases.len(),
        wrong.join("\n")
    );
}

/// Returns all cases if `PHYSGRAD_EXTREMES` is `all`. Otherwise returns a deterministic sample of
/// `count` cases, in which cases may repeat.
fn sample(cases: &[Case], count: usize) -> Vec<Case> {
    if std::env::var("PHYSGRAD_EXTREMES").is_ok_and(|which| which == "all") {
        return cases.to_vec();
    }
    let mut rng = stream(19, Purpose::Test, 0);
    (0..count).map(|_| cases[rng.random_range(0..cases.len())].clone()).collect()
}

#[test]
fn extreme_settings_train_or_are_refused_without_a_panic() {
    let dir = TempDir::new().expect("a folder");
    let cases = cases(dir.path());
    assert!(cases.len() > 2000, "{} cases, not more than 2000", cases.len());
    run_all("train", &sample(&cases, SAMPLE));
    run_all("explain", &sample(&cases, SAMPLE));
    run_all("compare", &sample(&cases, SAMPLE / 10));
}

/// No command panics for extreme parameters of an effect. The messages of `train` and `compare`
/// name the effect.
#[test]
fn errors_of_extreme_effects_name_the_key_of_the_effect() {
    let dir = TempDir::new().expect("a folder");
    let few = [
        "--epochs",
        "1",
        "--set",
        "training.train_samples=8",
        "--set",
        "training.test_samples=8",
        "--set",
        "horizon=6",
    ];
    let errors = |command: &str, preset: &str, setting: &str| -> String {
        let mut program = physgrad(&[command, preset, "--set", setting]);
        if command == "explain" {
            program.args(["--set", "horizon=6"]);
        } else {
            program.args(few);
            program.arg("--out").arg(dir.path().join(format!("{command} {setting}")));
        }
        let output = program.timeout(TIME_LIMIT).output().expect("the command runs");
        let errors = String::from_utf8_lossy(&output.stderr).into_owned();
        assert!(
            !errors.contains("panicked") && output.status.code() != Some(101),
            "{command} {preset} {setting}: {errors}"
        );
        errors
    };
    for (preset, setting, key) in [
        ("quantum", "effects.cubic.strength=1e38", "effects.cubic"),
        ("quantum_double_well", "effects.double_well.height=1e300", "effects.double_well"),
        ("quantum", "effects.harmonic.stiffness=1e300", "effects.harmonic"),
        ("cart_pole_windy", "effects.gusty_wind.speed=1e300", "effects.gusty_wind"),
        ("cart_pole", "effects.steady_wind.speed=1e30", "effects.steady_wind"),
        ("guidance", "effects.evade.strength=1e300", "effects.evade"),
        ("guidance_walled", "effects.walls.stiffness=1e300", "effects.walls"),
    ] {
        errors("explain", preset, setting);
        for command in ["train", "compare"] {
            let errors = errors(command, preset, setting);
            assert!(
                errors.contains(&format!("the forces of {key} ")),
                "{command} {preset} {setting}: {errors}"
            );
        }
    }
    // The messages about an excessive time step name no effect.
    for command in ["train", "explain", "compare"] {
        let errors = errors(command, "quantum_double_well", "system.dt=1e30");
        assert!(!errors.contains("the forces of"), "{errors}");
    }
}
