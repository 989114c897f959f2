//! Drawn and trained numbers of a scene, grids of settings, and identification.

use assert_cmd::Command;
use physgrad::text::digits;
use std::fs;
use std::path::Path;
use tempfile::TempDir;

const SCENE: &str = "scene = 1\ntask = \"cart_pole\"\nepochs = 2\n[system]\npoles = 1\n[training]\ntrain_samples = 16\ntest_samples = 8\n";

const VARIED: &str = "[vary]\n\"system.cart_mass\" = { log_uniform = [0.5, 2] }\n\"effects.gusty_wind.gust\" = { choice = [1, 2] }\n\
                      [fit]\n\"effects.pole_damping.damping\" = { start = 0.1, min = 0 }\n";

pub fn physgrad(args: &str, folder: &Path) -> Command {
    let mut command = Command::cargo_bin("physgrad").expect("the program is built");
    command.args(args.split(' ')).current_dir(folder);
    command
}

fn folder(scene: &str) -> TempDir {
    let dir = TempDir::new().expect("a folder");
    fs::write(dir.path().join("scene.toml"), scene).expect("a file");
    dir
}

pub fn read(dir: &TempDir, file: &str) -> Vec<Vec<String>> {
    let text = fs::read_to_string(dir.path().join(file)).expect(file);
    text.lines().map(|line| line.split(',').map(String::from).collect()).collect()
}

#[test]
fn a_scene_draws_masses_and_gusts_and_trains_a_damping() {
    let dir = folder(&format!("{SCENE}{VARIED}"));
    physgrad("train scene.toml --quiet --out run", dir.path()).assert().success();
    let numbers = read(&dir, "run/numbers.csv");
    assert_eq!((numbers.len(), numbers[1][0].as_str()), (2, "effects.pole_damping.damping"));
    let trained: f64 = numbers[1][1].parse().expect("a number");
    assert!(trained > 0.0 && trained != 0.1, "{trained}");

    let rows = read(&dir, "run/trajectory.csv");
    let column = |name: &str| {
        let index = rows[0]
            .iter()
            .position(|header| header == name)
            .unwrap_or_else(|| panic!("{name} in {:?}", rows[0]));
        rows[1..]
            .iter()
            .map(|row| row[index].parse::<f64>().expect("a number"))
            .collect::<Vec<f64>>()
    };
    // f32 rounds the trained value.
    assert!(
        column("effects.pole_damping.damping")
            .iter()
            .all(|damping| (damping - trained).abs() < 1e-7)
    );
    let masses = column("system.cart_mass");
    assert!(masses.iter().all(|mass| (0.5..=2.0).contains(mass)));
    assert!(masses.iter().any(|&mass| mass != masses[0]), "all samples have equal masses");
    assert!(column("effects.gusty_wind.gust").iter().all(|gust| [1.0, 2.0].contains(gust)));
    assert!(column("start_of_gusts").iter().all(|start| (0.0..=1.0).contains(start)));

    // The resumed run equals an uninterrupted run.
    physgrad("train scene.toml --quiet --out run --resume --epochs 3", dir.path())
        .assert()
        .success();
    physgrad("train scene.toml --quiet --out whole --epochs 3", dir.path()).assert().success();
    let policy =
        |run: &str| fs::read(dir.path().join(run).join("policy.safetensors")).expect("a policy");
    assert_eq!(policy("run"), policy("whole"));
    for command in [
        "check scene.toml --set policy.widths=[8]",
        "report run",
        "explain scene.toml",
        "compare scene.toml --fields R,C --seeds 1 --epochs 1",
    ] {
        physgrad(command, dir.path()).assert().success();
    }
}

/// An entry in `[vary]` or `[fit]` has the effect of a table in place of the number.
#[test]
fn scenes_with_inline_tables_and_with_vary_and_fit_train_equal_policies() {
    let dir = folder(&format!("{SCENE}{VARIED}"));
    let inline = "[effects]\npole_damping = { damping = { start = 0.1, min = 0 } }\ngusty_wind = { gust = { choice = [1, 2] } }\n";
    let scene = SCENE.replace("poles = 1", "poles = 1\ncart_mass = { log_uniform = [0.5, 2] }");
    fs::write(dir.path().join("inline.toml"), format!("{scene}{inline}")).expect("a file");
    for scene in ["scene", "inline"] {
        physgrad(&format!("train {scene}.toml --quiet --out {scene}"), dir.path())
            .assert()
            .success();
    }
    let file = |run: &str, file: &str| fs::read(dir.path().join(run).join(file)).expect(file);
    assert_eq!(file("scene", "policy.safetensors"), file("inline", "policy.safetensors"));
}

#[test]
fn errors_of_drawn_and_trained_numbers_name_line_and_allowed_values() {
    for (section, line, message) in [
        (
            "[vary]\n\"system.cart_mass\" = { uniform = [-1, 1] }",
            11,
            "`system.cart_mass` is -1 in { uniform = [-1, 1] }; allowed: a positive number",
        ),
        (
            "[vary]\n\"system.cart_mass\" = { uniform = [2, 1] }",
            11,
            "allowed: [low, high], with low <= high",
        ),
        (
            "[vary]\n\"system.cart_mass\" = { start = 1 }",
            11,
            "allowed in [vary]: { uniform = [low, high] }",
        ),
        (
            "[fit]\n\"system.cart_mass\" = { uniform = [1, 2] }",
            11,
            "allowed in [fit]: { start = value",
        ),
        (
            "[fit]\n\"system.cart_mass\" = { start = 1, min = 2 }",
            11,
            "`start = 1` is not strictly between its bounds",
        ),
        ("[fit]\n\"system.cart_mass\" = { start = 1, max = 2 }", 11, "`max` requires `min`"),
        (
            "[vary]\n\"system.mass\" = { uniform = [1, 2] }",
            11,
            "`system.mass` is unknown; allowed: `model`, `poles`",
        ),
        ("[vary]\n\"system.poles\" = { choice = [1, 2] }", 11, "`system.poles` is set twice"),
        (
            "[vary]\n\"training.batch\" = { choice = [1, 2] }",
            11,
            "`training.batch` cannot vary and cannot be fitted; settings that can: `system.cart_mass`, ",
        ),
        (
            "[effects.pole_damping]\ndamping = 1\n[vary]\n\"effects.pole_damping.damping\" = { uniform = [0, 1] }",
            13,
            "is set twice",
        ),
    ] {
        let dir = folder(&format!("{SCENE}\n{section}\n"));
        let output =
            physgrad("train scene.toml", dir.path()).assert().failure().get_output().stderr.clone();
        let output = String::from_utf8(output).expect("text");
        assert!(
            output.contains(&format!("scene.toml:{line}: ")) && output.contains(message),
            "{section}: {output}"
        );
    }
}

#[test]
fn two_policies_are_evaluated_over_a_grid_of_4_by_2_settings() {
    let dir = folder(SCENE);
    physgrad("train scene.toml --quiet --out first", dir.path()).assert().success();
    fs::write(dir.path().join("varied.toml"), format!("{SCENE}{VARIED}")).expect("a file");
    physgrad("train varied.toml --quiet --out second", dir.path()).assert().success();
    let grid = "robust first second --grid system.cart_mass=0.5:2:4 --grid effects.cart_damping.damping=0:1:2 --samples 16 --out grid";
    physgrad(grid, dir.path()).assert().success();
    let rows = read(&dir, "grid/robust.csv");
    assert_eq!(rows[0][..3], ["run", "system.cart_mass", "effects.cart_damping.damping"]);
    assert_eq!(rows.len(), 1 + 2 * 4 * 2);
    let losses: Vec<f64> = rows[1..].iter().map(|row| row[4].parse().expect("a number")).collect();
    assert!(losses.iter().all(|loss| loss.is_finite() && *loss > 0.0));
    let svg = fs::read_to_string(dir.path().join("grid/robust.svg")).expect("a picture");
    roxmltree::Document::parse(&svg).expect("an SVG is XML");
    for label in ["system.cart_mass", "first", "second", "effects.cart_damping.damping = 1.000"] {
        assert!(svg.contains(label), "{label}");
    }
    // Whole numbers may be on a grid.
    physgrad("robust first --grid horizon=10:20:3 --samples 4 --out horizons", dir.path())
        .assert()
        .success();
    let horizons: Vec<String> =
        read(&dir, "horizons/robust.csv").into_iter().skip(1).map(|row| row[1].clone()).collect();
    assert_eq!(horizons, ["10", "15", "20"]);
    for (command, message) in [
        ("robust first --grid system.cart_mass=1:2", "KEY=LOW:HIGH:COUNT"),
        ("robust first --grid system.mass=1:2:3", "`system.mass` is unknown"),
        (
            "robust first --grid system.dt=1:2:3 --grid system.dt=3:4:2",
            "--grid gives system.dt twice",
        ),
        ("robust first --grid system.poles=1:3:3 --samples 4", "but this scene has 6 and 1"),
        (
            "robust first --grid system.poles=1:2:3 --samples 4",
            "`system.poles` is floating point `1.5`; allowed: a whole number",
        ),
        (
            "robust first --grid system.cart_mass=-1:2:3",
            "`system.cart_mass` is -1; allowed: a positive number",
        ),
        ("robust third --grid system.cart_mass=1:2:3", "there is no folder third"),
    ] {
        let stderr = physgrad(command, dir.path()).assert().failure().get_output().stderr.clone();
        assert!(
            String::from_utf8_lossy(&stderr).contains(message),
            "{command}: {}",
            String::from_utf8_lossy(&stderr)
        );
    }
}

/// Every rollout of a run has another pole mass and another phase of the gusts. The fit and the
/// validation simulate with these values.
#[test]
fn measured_parameters_are_those_of_their_columns() {
    let drawn = "[vary]\n\"system.pole_mass\" = { uniform = [0.05, 0.3] }\n[effects.gusty_wind]\n";
    let dir = folder(&format!("{SCENE}{drawn}"));
    let run = |command: &str| physgrad(command, dir.path()).assert();
    run("train scene.toml --epochs 1 --precision f64 --quiet --out run").success();
    let fit = "identify scene.toml --set system.cart_mass={start=1.3} --data run/trajectory.csv --every 2 --out fit";
    run(fit).success();
    let found: f64 = read(&dir, "fit/identified.csv")[1][2].parse().expect("a number");
    assert!((found - 1.0).abs() < 1e-6, "{found}");
    for file in ["fit/trajectories.csv", "fit/validation.csv"] {
        let rows = read(&dir, file);
        for (i, row) in rows.iter().enumerate().skip(1) {
            let numbers: Vec<f64> =
                row[2..].iter().map(|number| number.parse().expect("a number")).collect();
            assert!(
                numbers.chunks(2).all(|pair| (pair[0] - pair[1]).abs() < 1e-5),
                "{file}, row {i}: {row:?}"
            );
        }
    }
    let text = |output: assert_cmd::assert::Assert| {
        String::from_utf8_lossy(&output.get_output().stderr).into_owned()
    };
    let overwriting = fit.replace("identify scene.toml", "identify fit/scene.toml");
    assert!(text(run(&overwriting).failure()).contains("the results would replace fit/scene.toml"));
    assert!(
        text(run(&fit.replace("--out fit", "--out run")).failure())
            .contains("run holds a run; choose another folder")
    );
    // The first 7 columns have no parameters.
    let rows = read(&dir, "run/trajectory.csv");
    let lines: Vec<String> = rows.iter().map(|row| row[..7].join(",")).collect();
    fs::write(dir.path().join("less.csv"), lines.join("\n")).expect("a file");
    let error = text(run(&fit.replace("run/trajectory.csv", "less.csv")).failure());
    assert!(error.contains("segment 0: the parameter `start_of_gusts` has no value"), "{error}");
}

/// Text of a CSV file with a header and rows.
fn text(rows: &[Vec<String>]) -> String {
    rows.iter().map(|row| row.join(",") + "\n").collect()
}

/// A recording under gusts that depend on time, and parts of it with their own beginnings. The
/// true mass is 1. The results keep the times of the data.
#[test]
fn recordings_begin_at_their_time() {
    let dir =
        folder(&format!("{SCENE}[effects.gusty_wind]\nspeed = 1.0\ngust = 8.0\nperiod = 1.3\n"));
    let run = |command: &str| physgrad(command, dir.path()).assert();
    run("train scene.toml --epochs 1 --precision f64 --quiet --out run").success();
    let rows = read(&dir, "run/trajectory.csv");
    let time = rows[0].iter().position(|name| name == "time").expect("times");
    let part = |key: &str, steps: std::ops::Range<usize>, shift: f64| -> Vec<Vec<String>> {
        let rows = rows[1..]
            .iter()
            .filter(|row| row[0] == "0" && steps.contains(&row[1].parse().expect("a step")));
        let moved = |row: &Vec<String>| {
            let mut row = row.clone();
            row[0] = key.to_owned();
            row[time] = format!("{}", row[time].parse::<f64>().expect("a time") + shift);
            row
        };
        rows.map(moved).collect()
    };
    let fit = |parts: &[Vec<Vec<String>>], set: &str| {
        let data = text(&[vec![rows[0].clone()], parts.concat()].concat());
        fs::write(dir.path().join("part.csv"), data).expect("data");
        run(&format!(
            "identify scene.toml --set system.cart_mass={{start=1.3}} {set}--data part.csv --out fit"
        ))
    };
    for (parts, begins) in [
        (vec![part("a", 17..90, 0.0)], vec!["0.17"]),
        (vec![part("a", 30..60, 0.0), part("b", 65..95, 0.0)], vec!["0.3", "0.65"]),
    ] {
        fit(&parts, "").success();
        let found: f64 = read(&dir, "fit/identified.csv")[1][2].parse().expect("a number");
        assert!((found - 1.0).abs() < 1e-6, "{begins:?}: {found}");
        let written = read(&dir, "fit/trajectories.csv");
        for (i, begin) in begins.iter().enumerate() {
            assert!(
                written.iter().any(|row| row[0] == ["a", "b"][i] && row[1] == *begin),
                "{begin}: {:?}",
                written[1]
            );
        }
    }
    for shift in [-0.3, 0.004] {
        let stderr = fit(&[part("a", 17..60, shift)], "").failure().get_output().stderr.clone();
        let stderr = String::from_utf8_lossy(&stderr).into_owned();
        assert!(
            stderr.contains("part.csv:2: the segment begins at ")
                && stderr.contains("depends on time"),
            "{stderr}"
        );
    }
    // Without gusts, the physics does not depend on time.
    let still = dir.path().join("still");
    fs::create_dir(&still).expect("a folder");
    fs::write(still.join("scene.toml"), SCENE).expect("a scene");
    physgrad("train scene.toml --epochs 1 --precision f64 --quiet --out run", &still)
        .assert()
        .success();
    let still_rows = fs::read_to_string(still.join("run/trajectory.csv")).expect("rows");
    let moved: Vec<String> = still_rows
        .lines()
        .enumerate()
        .map(|(i, line)| {
            let mut cells: Vec<String> = line.split(',').map(String::from).collect();
            if i > 0 {
                cells[2] = format!("{}", cells[2].parse::<f64>().expect("a time") - 0.304);
            }
            cells.join(",")
        })
        .collect();
    fs::write(still.join("moved.csv"), moved.join("\n")).expect("data");
    physgrad(
        "identify scene.toml --set system.cart_mass={start=1.3} --data moved.csv --out fit",
        &still,
    )
    .assert()
    .success();
}

/// Free swings of the pendulum of the scene, `[t, θ, ω]` every `dt` in s.
fn swings(theta: f64, steps: usize, dt: f64) -> Vec<[f64; 3]> {
    use physgrad::integrator::RungeKutta;
    use physgrad::tasks::{Arm, MultiPendulum};
    use physgrad::{Inputs, Integrated, System};
    let arm = Arm { center: 0.15.into(), viscous: 0.004.into(), ..Arm::default() };
    let system = Integrated {
        ode: MultiPendulum { arms: vec![arm], gravity: 9.81.into() },
        integrator: RungeKutta::RK4,
        dt,
    };
    let mut x = vec![theta, 0.0];
    (0..steps)
        .map(|t| {
            let row = [t as f64 * dt, x[0], x[1]];
            let mut next = vec![0.0; 2];
            system.step::<f64>(Inputs { x: &x, u: &[0.0], p: &[], t }, &mut next);
            x = next;
            row
        })
        .collect()
}

const PENDULUM: &str = "scene = 1\ntask = \"pendulum\"\n[system]\ndt = DT\n[[system.arms]]\n[fit]\n\
                        \"system.arms[0].center\" = { start = 0.13, min = 0.01 }\n\
                        \"system.arms[0].viscous\" = { start = 0.003, min = 0 }\n[integrator]\nmethod = \"rk4\"\n";

/// Checks that the fit of these rows finds the center and the friction of [`swings`] up to the
/// relative error `tolerance`. Returns the standard output.
fn check_pendulum(dt: &str, rows: &str, tolerance: f64) -> (TempDir, String) {
    let dir = folder(&PENDULUM.replace("DT", dt));
    fs::write(dir.path().join("data.csv"), rows).expect("data");
    let output = physgrad("identify scene.toml --data data.csv --out found", dir.path())
        .assert()
        .success()
        .get_output()
        .stdout
        .clone();
    let found = read(&dir, "found/identified.csv");
    for (row, truth) in found[1..].iter().zip([0.15, 0.004]) {
        let value: f64 = row[2].parse().expect("a number");
        assert!((value / truth - 1.0).abs() < tolerance, "{row:?}, {truth}");
    }
    (dir, String::from_utf8(output).expect("text"))
}

/// Angles in (-π, π], as an encoder delivers them, swing about hanging at π.
#[test]
fn wrapped_angles_identify_center_and_friction() {
    use std::f64::consts::{PI, TAU};
    let rows = [PI + 0.5, PI - 0.8].into_iter().enumerate().flat_map(|(segment, theta)| {
        let wrap = |theta: f64| PI - (PI - theta).rem_euclid(TAU);
        swings(theta, 150, 0.01)
            .into_iter()
            .map(move |[t, theta, omega]| format!("{segment},{t},{},{omega}\n", wrap(theta)))
    });
    let data = format!("segment,t,theta_1,omega_1\n{}", rows.collect::<String>());
    let (dir, output) = check_pendulum("0.01", &data, 1e-6);
    assert!(!output.contains("warning"), "{output}");
    assert!(output.contains("note: theta_1 wraps: the fit removes "), "{output}");
    for row in &read(&dir, "found/trajectories.csv")[1..] {
        let [measured, simulated] = [2, 3].map(|i| row[i].parse::<f64>().expect("a number"));
        assert!((measured - simulated).abs() < 1e-6, "{row:?}");
    }
}

/// Only the speed is measured. The fit first begins at an angle of 0, far from the swings.
#[test]
fn unmeasured_angles_begin_at_half_a_turn_too() {
    use std::f64::consts::PI;
    let rows = [PI + 0.5, PI - 0.8].into_iter().enumerate().flat_map(|(segment, theta)| {
        let rows = swings(theta, 150, 0.01).into_iter();
        rows.map(move |[t, _, omega]| format!("{segment},{t},{omega}\n"))
    });
    let data = format!("segment,t,omega_1\n{}", rows.collect::<String>());
    let (_, output) = check_pendulum("0.01", &data, 1e-6);
    assert!(!output.contains("warning"), "{output}");
}

/// Samples of a swing are far apart: the angle moves by more than half a turn between two rows, and
/// stays within one turn, as an angle that wraps does. The fit as recorded explains the data.
#[test]
fn motion_by_more_than_half_a_turn_is_no_wrap() {
    use std::f64::consts::PI;
    let all = swings(0.3, 200, 0.01);
    let rows = |every: usize| -> Vec<[f64; 3]> { all.iter().copied().step_by(every).collect() };
    let largest = |rows: &[[f64; 3]]| {
        rows.windows(2).map(|pair| (pair[1][1] - pair[0][1]).abs()).fold(0.0, f64::max)
    };
    let rows = (10..60).map(rows).find(|rows| largest(rows) > 1.03 * PI).expect("a fast swing");
    assert!(largest(&rows) < 1.4 * PI);
    let text: String =
        rows.iter().map(|[t, theta, omega]| format!("{t},{theta},{omega}\n")).collect();
    let (_, output) = check_pendulum("0.01", &format!("t,theta_1,omega_1\n{text}"), 1e-6);
    assert!(!output.contains("the fit removes"), "{output}");
}

/// The speed has the wrong sign, so no pendulum explains the data.
#[test]
fn residuals_as_large_as_the_motion_are_named() {
    let dir = folder(&PENDULUM.replace("DT", "0.01"));
    let rows: String = { swings(2.0, 100, 0.01).into_iter() }
        .map(|[t, theta, omega]| format!("{t},{theta},{}\n", -omega))
        .collect();
    fs::write(dir.path().join("data.csv"), format!("t,theta_1,omega_1\n{rows}")).expect("data");
    let run = |noise: &str| {
        let command = format!("identify scene.toml --data data.csv --out found{noise}");
        let output = physgrad(&command, dir.path()).assert().success().get_output().stdout.clone();
        String::from_utf8(output).expect("text")
    };
    let output = run("");
    let warning = "warning: the residuals are nearly as large as the deviation of the data";
    assert!(output.contains(warning) && output.contains("theta_1 ("), "{output}");
    // χ² shows the misfit if the noise is known.
    let output = run(" --noise theta_1=0.01,omega_1=0.1");
    assert!(!output.contains(warning) && output.contains("χ² per degree of freedom"), "{output}");
}

/// Rows of a cart at rest without a force, in two segments.
#[test]
fn controls_and_parameters_without_a_value_are_named() {
    let fit = "[actuator.limit]\nbound = 3.0\n[fit]\n\"effects.cart_damping.damping\" = { start = 0.3 }\n\
               [effects.cart_damping]\n[vary]\n\"system.cart_mass\" = { uniform = [0.5, 2] }\n";
    let dir = folder(&format!("{SCENE}{fit}"));
    let identify = |columns: &str, cells: [[&str; 2]; 2], every: usize| {
        let rows = ["a", "b"].iter().zip(cells).flat_map(|(key, cells)| {
            let row = move |t: usize| {
                let time = t as f64 * 0.01;
                let x = 1.0 + 0.5 * time - 0.01 * time * time;
                format!("{key},{time},{x}{}\n", cells[usize::from(t > 5)])
            };
            (0..20).step_by(every).map(row)
        });
        let data = format!("segment,t,x{columns}\n{}", rows.collect::<String>());
        fs::write(dir.path().join("data.csv"), data).expect("data");
        let command = "identify scene.toml --data data.csv --out found --window 0";
        let output = physgrad(command, dir.path()).output().expect("the command runs");
        let text = [output.stdout, output.stderr].concat();
        (output.status.success(), String::from_utf8(text).expect("text"))
    };
    let both = |cells| [cells; 2];
    for (columns, cells, succeeds, message) in [
        (
            ",force_applied",
            both([",0.5", ",0.4"]),
            false,
            "data.csv: the column `force` is missing; `force_applied` is the output of the actuator",
        ),
        (",force,force_applied", both([",,0.5", ",,0.4"]), false, "the column `force` is empty"),
        (
            "",
            both(["", ""]),
            true,
            "note: there is no column force, which is taken as 0 in all rows",
        ),
        (
            ",force",
            [[",0", ",0"], [",", ","]],
            true,
            "note: force has no value in segment b, and is taken as 0 there",
        ),
        (
            ",force",
            both([",0", ",0.001"]),
            true,
            "note: the rows are 2 steps apart, and the fit holds each control over these steps",
        ),
        (
            ",force,system.cart_mass",
            [[",0,1", ",0,"], [",0,", ",0,"]],
            false,
            "data.csv:22: segment b: the column `system.cart_mass` has no value; give it in every segment",
        ),
        (
            ",force,system.cart_mass",
            [[",0,1", ",0,"], [",0,", ",0,-0.24"]],
            false,
            "data.csv:22: segment b: ",
        ),
        (
            ",force,system.cart_mass",
            [[",0,1", ",0,"], [",0,", ",0,-0.24"]],
            false,
            "`system.cart_mass` is -0.24; allowed: a positive number",
        ),
    ] {
        let every = if message.contains("2 steps apart") { 2 } else { 1 };
        let (success, output) = identify(columns, cells, every);
        assert!(success == succeeds && output.contains(message), "{message}: {output}");
        if success {
            let facts = fs::read_to_string(dir.path().join("found/fit.csv")).expect("facts");
            assert!(facts.contains("note,"), "{facts}");
            let nominal = "note: 2 segments without system.cart_mass: the fit uses 1.25";
            assert!(output.contains(nominal), "{output}");
            assert!(!output.contains("warning: "), "{output}");
        }
    }
    // The second segment validates the fit of the first. Its data are examined, too.
    identify(",force", [[",0", ",0"], [",", ","]], 1);
    let command = "identify scene.toml --data data.csv --out found --window 0 --every 2";
    let output = physgrad(command, dir.path()).output().expect("the command runs").stdout;
    let output = String::from_utf8(output).expect("text");
    let message = "note: validation: force has no value in segment b, and is taken as 0 there";
    assert!(output.contains(message), "{output}");
}

/// A camera at 30 Hz writes 0.033, 0.067, 0.1. The angles are exact.
#[test]
fn times_may_be_rounded_to_their_decimals() {
    let dt = 1.0 / 30.0;
    let rows = swings(2.0, 200, dt).into_iter().map(|[t, theta, omega]| {
        let t = format!("{t:.3}");
        format!("{},{theta},{omega}\n", t.trim_end_matches('0'))
    });
    let data = format!("t,theta_1,omega_1\n{}", rows.collect::<String>());
    assert!(data.contains("\n0.033,") && data.contains("\n0.1,"));
    let (dir, _) = check_pendulum(&dt.to_string(), &data, 1e-6);
    assert_eq!(read(&dir, "found/trajectories.csv")[2][1], "0.033");
}

/// Rows are missing while the torque changes from 0 to 0.01 N m. A state without angles jumps.
#[test]
fn missing_rows_and_turns_are_named() {
    let dir = folder(
        "scene = 1\ntask = \"cart_pole\"\n[system]\npoles = 1\n[fit]\n\"system.cart_mass\" = { start = 1.0 }\n",
    );
    let row = |t: usize| {
        let x = if t < 30 { 3.0 } else { -3.0 };
        format!("{},{x},0,3.14159,0,{}\n", t as f64 * 0.01, if t < 20 { 0.0 } else { 0.01 })
    };
    let rows: String = (0..60).filter(|t| !(15..25).contains(t)).map(row).collect();
    fs::write(dir.path().join("data.csv"), format!("t,x,x_dot,theta_1,omega_1,force\n{rows}"))
        .expect("data");
    let output = physgrad("identify scene.toml --data data.csv --out found", dir.path())
        .assert()
        .success()
        .get_output()
        .stdout
        .clone();
    let output = String::from_utf8(output).expect("text");
    let missing = "note: a new segment begins at 1 row after a gap in which a control changes (first: data.csv:17)";
    assert!(output.contains(missing), "{output}");
    assert!(output.contains("segments 2, "), "{output}");
    assert!(
        output.contains(
            "warning: data.csv:22: x jumps by -6.000 from the row before; if it is an angle"
        ),
        "{output}"
    );
}

/// Identifies the measured pendulum of the example. The length of the first arm agrees with the
/// published value within 1 %, the center of mass of the second arm within 2 %.
#[test]
fn measured_trajectories_identify_length_within_1_and_center_within_2_percent() {
    let dir = TempDir::new().expect("a folder");
    let example = crate::markdown::root().join("examples/data");
    for file in ["double_pendulum.toml", "double_pendulum.csv"] {
        fs::copy(example.join(file), dir.path().join(file)).expect(file);
    }
    let noise = "theta_1=0.003,omega_1=0.1,theta_2=0.003,omega_2=0.1";
    let command = format!(
        "identify double_pendulum.toml --data double_pendulum.csv --noise {noise} --every 2 --out found"
    );
    let output = physgrad(&command, dir.path()).assert().success().get_output().stdout.clone();
    let output = String::from_utf8(output).expect("text");
    assert!(output.contains("validation with 2 other segments"), "{output}");
    // The fit uses every second segment. The fitted dry friction of the second joint is 0, the
    // lower bound.
    let warnings: Vec<&str> = output.lines().filter(|line| line.starts_with("warning")).collect();
    // The residuals are errors of the model.
    let correlated = "warning: successive residuals are correlated for theta_1 (";
    assert!(
        matches!(warnings[..], ["warning: system.arms[1].dry is at its bound", second] if second.starts_with(correlated)),
        "{output}"
    );
    let rows = read(&dir, "found/identified.csv");
    let value = |name: &str| -> f64 {
        let row =
            rows.iter().find(|row| row[0] == name).unwrap_or_else(|| panic!("{name} in {rows:?}"));
        row[2].parse().expect("a number")
    };
    assert!((value("system.arms[0].length") / 0.172719 - 1.0).abs() < 0.01);
    assert!((value("system.arms[1].center") / 0.116779 - 1.0).abs() < 0.02);
    let svg = fs::read_to_string(dir.path().join("found/identified.svg")).expect("a picture");
    roxmltree::Document::parse(&svg).expect("an SVG is XML");
    // The report depends on the files only.
    for _ in 0..2 {
        let page = fs::read_to_string(dir.path().join("found/report.html")).expect("a page");
        for text in [
            "Residuals of theta_1",
            "Validation",
            "system.arms[1].dry is at its bound",
            "Correlations",
        ] {
            assert!(page.contains(text), "{text}");
        }
        fs::remove_file(dir.path().join("found/report.html")).expect("a page");
        physgrad("report found", dir.path()).assert().success();
    }
    // The segments keep their numbers.
    assert_eq!(
        (
            &*read(&dir, "found/trajectories.csv")[500][0],
            &*read(&dir, "found/validation.csv")[1][0]
        ),
        ("2", "1")
    );
    // Validation segments have free initial states, even if those of the fitted segments are exact.
    let exact = command.replace("found", "exact --exact-starts --window 0 --json");
    let output = physgrad(&exact, dir.path()).assert().success().get_output().stdout.clone();
    let object = serde_json::from_slice(&output).expect("an object");
    super::json::check("identify", &object);
    assert_eq!(object["numbers"].as_array().map(Vec::len), Some(rows.len() - 1));
    assert_eq!(read(&dir, "exact/validation.csv").len(), read(&dir, "found/validation.csv").len());
    // Trains a controller for the measured pendulum in the fitted scene.
    physgrad(
        "train found/scene.toml --epochs 1 --set training.train_samples=8 --quiet --out run",
        dir.path(),
    )
    .assert()
    .success();

    for (command, message) in [
        (
            "identify pendulum --data double_pendulum.csv",
            "pendulum has no unknown numbers; list them in [fit]",
        ),
        ("identify double_pendulum.toml --data none.csv", "cannot read none.csv"),
        ("identify double_pendulum.toml --data double_pendulum.toml", "unknown column"),
        (
            "identify double_pendulum.toml --data double_pendulum.csv --noise theta_1=0",
            "write NAME=VALUE with a positive value",
        ),
        (
            "identify double_pendulum.toml --data double_pendulum.csv --noise theta_1=1",
            "--noise lacks omega_1, theta_2, omega_2; give all measured states: theta_1",
        ),
        (
            "identify double_pendulum.toml --data double_pendulum.csv --noise theta_1=1,theta_1=2",
            "theta_1 is given twice",
        ),
        (
            "identify double_pendulum.toml --data double_pendulum.csv --field S",
            "--field has no effect on an identification, which trains no policy",
        ),
        (
            "identify double_pendulum.toml --data double_pendulum.csv --set horizon=3",
            "--set horizon=3 has no effect on an identification",
        ),
        (
            "identify double_pendulum.toml --data double_pendulum.csv --seed 1",
            "--seed has no effect on an identification",
        ),
        (
            "identify double_pendulum.toml --data double_pendulum.csv --set system.dt=0.007",
            "is not a later step of 0.007 s",
        ),
    ] {
        let stderr = physgrad(command, dir.path()).assert().failure().get_output().stderr.clone();
        assert!(
            String::from_utf8_lossy(&stderr).contains(message),
            "{command}: {}",
            String::from_utf8_lossy(&stderr)
        );
    }
}

#[test]
fn unusable_measurements_are_refused_with_place_and_advice() {
    let dir = TempDir::new().expect("a folder");
    let scene = crate::markdown::root().join("examples/data/double_pendulum.toml");
    fs::copy(scene, dir.path().join("scene.toml")).expect("a scene");
    let [long, long_name] = [
        format!("t,theta_1\n0,1\n0.005,{}x", "0".repeat(100_000)),
        format!("{},theta_1\n0,1", "t".repeat(1000)),
    ];
    let (long, long_name, utf_16) = (long.as_str(), long_name.as_str(), "\0t\0,\0x");
    for (data, message) in [
        (
            "t,theta_1,theta_1\n0,1,2",
            "data.csv: the columns `theta_1` and `theta_1` have one meaning; remove one of them",
        ),
        ("t,theta_1,time\n0,1,2", "data.csv: the columns `t` and `time` have one meaning"),
        (
            "segment,t,sample\n0,1,2",
            "data.csv: the columns `segment` and `sample` have one meaning",
        ),
        (
            "t,theta_1\n0,1\n0.005,-inf",
            "data.csv:3: `theta_1` is infinite; leave the cell of a missing sample empty",
        ),
        ("t,theta_1\n0,1\n0.005,x", "data.csv:3: `x` in column `theta_1` is not a number"),
        (
            "# made by a sensor\nsegment,t,theta_1\n0,0,1\n#1,0,1",
            "data.csv:4: the line begins with `#`; comments are allowed before the header only",
        ),
        (
            long,
            "data.csv:3: `0000000000000000000000000000000000000000…` in column `theta_1` is not a number",
        ),
        (
            long_name,
            "unknown column `tttttttttttttttttttttttttttttttttttttttt…`; leave it out; allowed: segment, t, theta_1",
        ),
        (
            "t;theta_1\n0;1",
            "data.csv: the columns are separated by semicolons; allowed: commas, and points in numbers",
        ),
        (
            "t;theta_1\n0;1,5",
            "data.csv: the columns are separated by semicolons, and numbers have decimal commas; allowed: commas, and points in \
             numbers; replace commas by points first, and then semicolons by commas",
        ),
        ("t\ttheta_1\n0\t1", "data.csv: the columns are separated by tabs"),
        ("t,torque\n0,1", "data.csv: there is no column of a state; states: theta_1"),
        ("t,theta_1\r\n0,1\r\n\r\n0.005,x", "data.csv:4: `x` in column `theta_1` is not a number"),
        (
            "t,theta_1,\n0,1,",
            "data.csv: column 3 has no name; remove the column, or the comma at the end of each line",
        ),
        (
            "t,theta_1\n0,1\n0.005,1,",
            "data.csv:3: the line ends in a comma, but the header does not",
        ),
        ("t,theta_1\n0,1\n0.005", "data.csv:3: the row has 1 cells; expected 2, as in the header"),
        (utf_16, "data.csv is in UTF-16 or is no text; save it as text in UTF-8"),
        (
            "t,theta_1\n0,1\n10,2\n15,3",
            "data.csv: all rows are 1000 or more steps of 0.005 s apart; give `t` in s, not in ms",
        ),
        (
            "t,theta_1\n0,1\n0.005,1e200",
            "data.csv:3: theta_1 is 1e200; allowed: angles in rad up to 1e9, or an empty cell",
        ),
        // Segments of 2e6 steps each exceed the limit only together.
        (
            "segment,t,theta_1\na,0,1\na,0.005,1\na,1e4,2\nb,0,1\nb,1e4,2",
            "data.csv:6: the segments have 4000002 steps of 0.005 s up to here; allowed: ",
        ),
        // Two decimals do not show steps of 5 ms.
        (
            "t,theta_1\n0,1\n0.01,2\n0.03,2\n0.042,3",
            "data.csv:5: the time 0.042 s is not a later step",
        ),
        (
            "segment,t,theta_1\na,0,1\nb,0,1\na,0.005,1",
            "data.csv:4: the rows of segment a are not contiguous; sort the rows by segment",
        ),
        (
            "t,theta_1\n0,1\n0.005,1\n0.01,1\n0.015,1\n1000,2",
            "data.csv:6: the row is 199997 steps of 0.005 s after the row before, but the median of the 5 rows",
        ),
        ("t,theta_1\n0,1\n,2", "data.csv:3: the time is missing"),
        (
            "t,theta_1\n0,1\n0.01,2\n0.005,3",
            "data.csv:4: the time 0.005 s is not later than in the row before",
        ),
        ("t,theta_1\n0,1\n0.007,2", "data.csv:3: the time 0.007 s is not a later step of 0.005 s"),
        (
            "t,theta_1\n0,1\n1e6,2",
            "data.csv:3: the segments have 200000001 steps of 0.005 s up to here; allowed: ",
        ),
        // Fits the first and the third segment. Messages have the name in the file.
        (
            "segment,t,theta_1,theta_2,omega_1,omega_2\n3,0,1,1,0,0\n1,0,1,1,0,0\nlast,0,,1,0,",
            "segment last: the first row lacks theta_1, omega_2, but",
        ),
        (
            "segment,t,theta_1,theta_2,omega_1,omega_2\nb,0,1,1,0,0\nb,0.005,1,1,1e300,0\nb,0.01,1,1,0,0\nb,0.015,1,1,0,0\nc,0,1,1,0,0",
            "segment b diverges at step 1 with",
        ),
        (
            "t,theta_1,torque\n0,1,\n0.005,1,",
            "data.csv: the column `torque` is empty; give the control of every row, or zeros if it was 0",
        ),
    ] {
        fs::write(dir.path().join("data.csv"), format!("{data}\n")).expect("a file");
        let command = "identify scene.toml --data data.csv --every 2 --exact-starts";
        let stderr = physgrad(command, dir.path()).assert().failure().get_output().stderr.clone();
        assert!(
            String::from_utf8_lossy(&stderr).contains(message),
            "{message}: {}",
            String::from_utf8_lossy(&stderr)
        );
    }
}

/// Only the angle of a cart-pole is measured. The position does not affect the angle. The noise is
/// far below that of `--noise`.
#[test]
fn messages_about_unmeasured_states_name_measured_ones_only() {
    let dir = TempDir::new().expect("a folder");
    let scene = "scene = 1\ntask = \"cart_pole\"\n[system]\npoles = 1\n[fit]\n\"system.gravity\" = { start = 9.81 }\n";
    fs::write(dir.path().join("scene.toml"), scene).expect("a scene");
    let row = |t: i32| {
        format!(
            "{},{}",
            f64::from(t) * 0.01,
            0.1 * (f64::from(t) * 0.05).cos() + if t % 2 == 0 { 1e-3 } else { 0.0 }
        )
    };
    let data = |first: &str| {
        let rows: Vec<String> = (1..60).map(|t| format!("{},,,", row(t))).collect();
        fs::write(
            dir.path().join("data.csv"),
            format!("t,theta_1,x,x_dot,omega_1\n{}{first}\n{}\n", row(0), rows.join("\n")),
        )
    };
    data(",,,").expect("data");
    let command = "identify scene.toml --data data.csv --out found --noise theta_1=10";
    let output = physgrad(command, dir.path()).assert().success().get_output().stdout.clone();
    let output = String::from_utf8(output).expect("text");
    assert!(
        output.contains("warning: the data do not determine the initial values of x"),
        "{output}"
    );
    assert!(output.contains("warning: χ² per degree of freedom is "), "{output}");
    assert!(
        output.contains("root mean square of the residuals: theta_1 ") && !output.contains("NaN"),
        "{output}"
    );
    let picture =
        || fs::read_to_string(dir.path().join("found/identified.svg")).expect("a picture");
    assert!(picture().contains("residual of theta_1") && !picture().contains("omega_1"));
    // An exact initial state has no noise.
    data(",0,0,0").expect("data");
    let stderr = physgrad(command, dir.path()).assert().failure().get_output().stderr.clone();
    assert!(
        String::from_utf8_lossy(&stderr).contains("--noise lacks x, x_dot, omega_1"),
        "{}",
        String::from_utf8_lossy(&stderr)
    );
    physgrad(&format!("{command} --exact-starts"), dir.path()).assert().success();
    assert!(!picture().contains("omega_1"));
}

/// Data of a cart whose speed grows without a force, so that the fitted damping is negative.
#[test]
fn a_fit_outside_of_the_range_of_a_setting_is_written() {
    let dir = TempDir::new().expect("a folder");
    let scene = "scene = 1\ntask = \"cart_pole\"\n[effects.cart_damping]\n[fit]\n\"effects.cart_damping.damping\" = { start = 0.1 }\n";
    fs::write(dir.path().join("scene.toml"), scene).expect("a scene");
    // The cart accelerates without a force.
    let rows: Vec<String> = (0..30)
        .map(|t| {
            format!(
                "0,{},{},{},0,0",
                f64::from(t) * 0.01,
                0.01 * f64::from(t * t),
                f64::from(t) * 0.5 + 1.0
            )
        })
        .collect();
    fs::write(
        dir.path().join("data.csv"),
        format!("segment,t,x,x_dot,theta_1,omega_1\n{}\n", rows.join("\n")),
    )
    .expect("data");
    let command = "identify scene.toml --data data.csv --out found --window 0";
    let output = physgrad(command, dir.path()).assert().success().get_output().stdout.clone();
    let output = String::from_utf8(output).expect("text");
    assert!(output.contains("warning: there is no scene.toml and no validation: "), "{output}");
    assert!(output.contains("; add bounds to [fit]"), "{output}");
    assert!(
        read(&dir, "found/identified.csv")[1][2].parse::<f64>().is_ok_and(|damping| damping < 0.0)
    );
    assert!(
        !dir.path().join("found/scene.toml").exists()
            && dir.path().join("found/report.html").exists()
    );
}

/// A force does not move a cart that is held, so the fitted mass grows without limit. Numbers
/// without a result have no error, and do not enter a scene.
#[test]
fn a_number_that_runs_away_has_no_error_and_no_scene() {
    let scene = SCENE.to_owned() + "[fit]\n\"system.cart_mass\" = { start = 1, min = 0.1 }\n";
    let dir = folder(&scene);
    let row = |t: u32| {
        format!(
            "{},{},0,0,0,1",
            f64::from(t) * 0.01,
            if t.is_multiple_of(2) { 1e-4 } else { -1e-4 }
        )
    };
    let rows: Vec<String> = (0..30).map(row).collect();
    fs::write(
        dir.path().join("data.csv"),
        format!("t,x,x_dot,theta_1,omega_1,force\n{}\n", rows.join("\n")),
    )
    .expect("data");
    fs::create_dir(dir.path().join("found")).expect("a folder");
    let command = "identify scene.toml --data data.csv --out found --json";
    let output = physgrad(command, dir.path()).assert().success().get_output().stdout.clone();
    let object: serde_json::Value = serde_json::from_slice(&output).expect("an object");
    let number = &object["numbers"][0];
    assert!(number["status"] == "ran away" && number["standard_error"].is_null(), "{object}");
    let warnings = object["warnings"].to_string();
    for text in [
        "system.cart_mass ran away from 1.00000 to ",
        "there is no scene.toml and no validation: the fit has not converged",
    ] {
        assert!(warnings.contains(text), "{text}: {warnings}");
    }
    assert!(!warnings.contains("do not determine system.cart_mass"), "{warnings}");
    assert!(
        !dir.path().join("found/scene.toml").exists()
            && dir.path().join("found/report.html").exists()
    );
}

/// Nothing bounds the masses, so a large learning rate leads past 0.
#[test]
fn trained_numbers_outside_of_their_ranges_are_named_at_the_first_and_the_last_epoch() {
    let train = |cart: &str| {
        let scene = format!(
            "scene = 1\ntask = \"cart_pole\"\nprecision = \"f64\"\nepochs = 12\nhorizon = 20\n[system]\npoles = 1\n\
             [policy]\nwidths = []\n[training]\ntrain_samples = 8\ntest_samples = 8\nlearning_rate = 0.3\n\
             [fit]\n\"system.cart_mass\" = {cart}\n"
        );
        let dir = folder(&scene);
        let output = physgrad("train scene.toml --quiet --out run", dir.path())
            .assert()
            .success()
            .get_output()
            .clone();
        let mass: f64 = read(&dir, "run/numbers.csv")[1][1].parse().expect("a number");
        (String::from_utf8(output.stderr).expect("UTF-8"), mass)
    };
    let (said, mass) = train("{ start = 1 }");
    assert!(mass < 0.0, "{mass}");
    let lines: Vec<&str> =
        said.lines().filter(|line| line.contains("training moves system.cart_mass to -")).collect();
    assert_eq!(lines.len(), 2, "{said}");
    for line in &lines {
        for text in
            ["outside of its range; allowed: a positive number", "to [fit]: min, or min and max"]
        {
            assert!(line.contains(text), "{line}");
        }
    }
    assert!(lines[1].starts_with("warning: epoch 12: "), "{said}");
    assert!(lines[1].contains(&format!("to {}, ", digits(mass, 6))), "{said}");
    assert!(lines[1].contains(" times, first in epoch "), "{said}");
    let (said, mass) = train("{ start = 1, min = 0.5, max = 2 }");
    assert!((0.5..=2.0).contains(&mass) && !said.contains("outside of its range"), "{said}");
}

#[test]
fn a_note_says_that_a_set_number_no_longer_varies_or_is_no_longer_unknown() {
    let varied = "[vary]\n\"system.gravity\" = { uniform = [9, 10] }\n";
    let fitted = "[fit]\n\"system.gravity\" = { start = 9 }\n";
    for (section, set, note) in [
        (
            varied,
            "system.gravity=9.8",
            "{ uniform = [9, 10] }, so that the number no longer varies",
        ),
        (fitted, "system.gravity=9.8", "{ start = 9 }, so that the number no longer is unknown"),
        (fitted, "system.pole_mass=0.2", ""),
    ] {
        let dir = folder(&format!("{SCENE}\n{section}"));
        for command in ["explain", "check"] {
            let command =
                format!("{command} scene.toml --set horizon=5 --set policy.widths=[2] --set {set}");
            let output = physgrad(&command, dir.path()).assert().success().get_output().clone();
            let said = String::from_utf8(output.stderr).expect("UTF-8");
            let expected = format!("note: --set {set} replaces {note}\n");
            let is_noted = said.matches(&expected).count() == 1;
            assert_eq!(is_noted, !note.is_empty(), "{command}: {said}");
            assert_eq!(said.contains("note: "), is_noted, "{command}: {said}");
        }
    }
}

/// The value in the message is one that the reader accepts.
#[test]
fn advice_on_varied_and_trained_numbers_is_accepted() {
    let dir = folder(SCENE);
    for section in ["vary", "fit"] {
        for key in [
            "system.cart_mass",
            "\"system.cart_mass\"",
            "\"system.cart_mass\".start",
            "system.cart_mass.start",
            "system.cart_mass.uniform",
        ] {
            let refused = format!("explain scene.toml --set {section}.{key}=1");
            let output = physgrad(&refused, dir.path()).assert().failure().get_output().clone();
            let said = String::from_utf8(output.stderr).expect("UTF-8");
            let advice =
                said.split("as in --set '").nth(1).and_then(|rest| rest.split('\'').next());
            let advice = advice.unwrap_or_else(|| panic!("no advice: {said}"));
            let mut accepted = physgrad("explain scene.toml --set", dir.path());
            accepted.arg(advice).assert().success();
        }
    }
}
