//! End-to-end tests of `physgrad optimize`.

use crate::numbers::{physgrad, read};
use physgrad::tasks::Lqr;
use std::fs;
use tempfile::TempDir;

/// Returns the columns `names` of a CSV file, row by row. Cells that are not numbers become NaN.
fn columns(dir: &TempDir, file: &str, names: &[&str]) -> Vec<Vec<f64>> {
    let rows = read(dir, file);
    let index = |name: &&str| {
        rows[0]
            .iter()
            .position(|known| known == name)
            .unwrap_or_else(|| panic!("{name} in {:?}", rows[0]))
    };
    let indices: Vec<usize> = names.iter().map(index).collect();
    rows[1..]
        .iter()
        .map(|row| indices.iter().map(|&i| row[i].parse().unwrap_or(f64::NAN)).collect())
        .collect()
}

/// The loss of an upright pendulum at rest is 0, the least one. The search ends there at a gradient
/// above any share of the cost.
#[test]
fn a_search_that_ends_at_a_cost_of_0_has_no_warning() {
    let dir = TempDir::new().expect("a folder");
    let output = physgrad("optimize pendulum --out plan", dir.path()).assert().success();
    let costs = columns(&dir, "plan/optimized.csv", &["cost"]);
    assert!(costs[0][0].abs() < 1e-9, "{costs:?}");
    let messages = String::from_utf8_lossy(&output.get_output().stderr).into_owned();
    assert!(!messages.contains("warning"), "{messages}");
}

/// The plan is stuck beside the end: all files end with the episode, and a note says so.
#[test]
fn a_plan_ends_with_its_episode() {
    let dir = TempDir::new().expect("a folder");
    let scene = "scene = 1\ntask = \"equations\"\nhorizon = 30\n[system]\nstates = [\"x\"]\ncontrols = [\"u\"]\n\
        dt = 0.1\nrate.x = \"1 + u\"\n[loss]\nrunning = \"next.x^2 + u^2\"\nend = \"x > 0.55\"\n";
    fs::write(dir.path().join("scene.toml"), scene).expect("a scene");
    let output =
        physgrad("optimize scene.toml --starts 1 --out plan", dir.path()).assert().success();
    let messages = String::from_utf8_lossy(&output.get_output().stderr).into_owned();
    assert!(messages.contains("end early: initial state 0 after 6 steps"), "{messages}");
    assert_eq!(columns(&dir, "plan/trajectory.csv", &["step"]).len(), 7);
    assert_eq!(columns(&dir, "plan/gains.csv", &["step"]).len(), 6);
}

/// The task is meant for forces of up to 50 N.
#[test]
fn a_note_names_controls_beyond_those_that_the_task_is_meant_for() {
    let dir = TempDir::new().expect("a folder");
    let note = "note: force reaches ";
    for (options, is_noted) in [("", true), (" --bound=-1000:1000", false), (" --quiet", false)] {
        let command = format!("optimize lqr --set system.spread=100{options}");
        let output = physgrad(&command, dir.path()).assert().success();
        let said = String::from_utf8_lossy(&output.get_output().stderr).into_owned();
        assert_eq!(said.contains(note), is_noted, "{command}: {said}");
        let example = "but the task is meant for -50.00 to 50.00; the search has no bounds without --bound, as in --bound force=-50.00:50.00";
        assert!(!is_noted || said.contains(example), "{said}");
    }
}

/// The Riccati equation gives the least loss from every initial state, and one optimal gain for all
/// steps.
#[test]
fn costs_and_gains_of_lqr_equal_the_riccati_solution_within_1e_minus_9_and_1e_minus_6() {
    let dir = TempDir::new().expect("a folder");
    let output = physgrad("optimize lqr --starts 3 --out plan", dir.path())
        .assert()
        .success()
        .get_output()
        .stdout
        .clone();
    let printed = String::from_utf8(output).expect("text");
    let states = ["x", "x_dot", "theta_1", "omega_1"];
    let trajectory = columns(&dir, "plan/trajectory.csv", &[&["step"][..], &states].concat());
    let starts: Vec<&[f64]> =
        trajectory.iter().filter(|row| row[0] == 0.0).map(|row| &row[1..]).collect();
    let costs = columns(&dir, "plan/optimized.csv", &["cost", "iterations"]);
    assert_eq!((starts.len(), costs.len()), (3, 3), "{printed}");
    let lqr = Lqr::upright_cart_pole();
    for (start, cost) in starts.iter().zip(&costs) {
        let least = lqr.least_loss(start);
        assert!((cost[0] / least - 1.0).abs() < 1e-9, "{} against {least}", cost[0]);
        let mut cells = printed.split([' ', '│', '┆']).filter_map(|cell| cell.parse::<f64>().ok());
        assert!(
            cells.any(|cell| (cell / cost[0] - 1.0).abs() < 5e-6),
            "six digits of {}: {printed}",
            cost[0]
        );
    }
    let gains = columns(
        &dir,
        "plan/gains.csv",
        &states.map(|state| format!("force by {state}")).each_ref().map(String::as_str),
    );
    let gain = &lqr.optimum().gain;
    assert_eq!(gains.len(), 3 * 100);
    assert!(
        gains
            .iter()
            .flatten()
            .zip(gain.iter().cycle())
            .all(|(found, gain)| (found - gain).abs() < 1e-6),
        "{gain:?} {:?}",
        gains[0]
    );
}

#[test]
fn optimized_forces_stay_within_minus_4_and_5_n_and_cost_less_than_the_policy() {
    let dir = TempDir::new().expect("a folder");
    // With one test sample, the test loss is the cost of the policy.
    let settings = "--set training.train_samples=32 --set training.test_samples=1 --set horizon=40 --precision f64 --epochs 3";
    physgrad(&format!("train cart_pole_1 {settings} --quiet --out run"), dir.path())
        .assert()
        .success();
    // The bound of one control replaces that of all controls.
    let optimize = "optimize --from run --bound force=-4:5 --bound=-1:1 --out plan --quiet";
    let output = physgrad(optimize, dir.path()).assert().success().stdout("");
    let said = String::from_utf8_lossy(&output.get_output().stderr).into_owned();
    let expected = "--bound -1:1 has no effect, because each control has a bound of its own";
    assert!(said.contains(expected), "{said}");
    physgrad("optimize --from run --iterations 0 --out policy --quiet", dir.path())
        .assert()
        .success();
    let costs = |plan: &str| {
        columns(&dir, &format!("{plan}/optimized.csv"), &["initial_cost", "cost"]).remove(0)
    };
    let policy = columns(&dir, "run/metrics.csv", &["test_loss"])[2][0];
    assert!(
        (costs("policy")[1] / policy - 1.0).abs() < 1e-9,
        "{:?} against {policy}",
        costs("policy")
    );
    assert!(costs("plan")[1] < policy, "{:?} against {policy}", costs("plan"));
    let forces: Vec<f64> = columns(&dir, "plan/trajectory.csv", &["force"]).concat();
    let forces = &forces[..40];
    assert!(forces.iter().all(|force| (-4.0..=5.0).contains(force)), "{forces:?}");
    assert!(forces.iter().any(|force| [-4.0, 5.0].contains(force)), "{forces:?}");
    for picture in ["optimized.svg", "animation-0.svg"] {
        let svg = fs::read_to_string(dir.path().join("plan").join(picture)).expect(picture);
        roxmltree::Document::parse(&svg).expect("an SVG is XML");
    }
    for (command, message) in [
        (
            "optimize --from run --bound torque=-1:1",
            "write [NAME=]LOW:HIGH with LOW below HIGH, as in force=-10:10; names: force",
        ),
        (
            "optimize --from run --bound force=-1:1 --bound force=-2:2",
            "--bound force=-2:2: force has two bounds; give one",
        ),
        (
            "optimize cart_pole --bound 1:-1",
            "--bound 1:-1: write [NAME=]LOW:HIGH with LOW below HIGH",
        ),
        ("optimize cart_pole --starts 0", "--starts is 0; allowed: 1 to "),
        ("optimize cart_pole --from run", "cannot be used with"),
        ("optimize --from run --set horizon=30", "cannot be used with"),
        ("optimize cart_pole --field S", "--field has no effect on optimized controls"),
        (
            "optimize cart_pole --set training.batch=3",
            "--set training.batch=3 has no effect on optimized controls",
        ),
        ("optimize", "required arguments were not provided"),
    ] {
        let stderr = physgrad(command, dir.path()).assert().failure().get_output().stderr.clone();
        assert!(
            String::from_utf8_lossy(&stderr).contains(message),
            "{command}: {}",
            String::from_utf8_lossy(&stderr)
        );
    }
}

/// A gravity of 1e300 is infinite in f32.
#[test]
fn plans_of_other_initial_states_are_written_if_one_fails() {
    let dir = TempDir::new().expect("a folder");
    let command = "optimize scene.toml --starts 6 --out plan --set horizon=5 --iterations 3";
    let scene =
        "scene = 1\ntask = \"cart_pole\"\n[vary]\n\"system.gravity\" = { choice = [9.8, 1e300] }\n";
    fs::write(dir.path().join("scene.toml"), scene).expect("a scene");
    let stderr = physgrad(command, dir.path()).assert().failure().get_output().stderr.clone();
    let stderr = String::from_utf8(stderr).expect("text");
    assert!(stderr.contains(" of 6 optimizations failed:\ninitial state "), "{stderr}");
    let samples: Vec<f64> = columns(&dir, "plan/optimized.csv", &["sample"]).concat();
    assert!((1..6).contains(&samples.len()), "{samples:?}");
    for sample in &samples {
        assert!(!stderr.contains(&format!("initial state {sample}: number")), "{sample}: {stderr}");
    }
    let failed = stderr.lines().filter(|line| line.contains(": number ")).count();
    assert_eq!(samples.len() + failed, 6, "{stderr}");
}

#[test]
fn the_folder_of_a_run_is_not_overwritten_by_plans() {
    let dir = TempDir::new().expect("a folder");
    physgrad(
        "train cart_pole_1 --epochs 1 --set training.train_samples=8 --quiet --out run",
        dir.path(),
    )
    .assert()
    .success();
    let stderr = physgrad("optimize --from run --out run", dir.path())
        .assert()
        .failure()
        .get_output()
        .stderr
        .clone();
    assert!(
        String::from_utf8_lossy(&stderr).contains("run holds a run; choose another folder"),
        "{stderr:?}"
    );
    let stderr =
        physgrad("eval run --out run", dir.path()).assert().failure().get_output().stderr.clone();
    assert!(
        String::from_utf8_lossy(&stderr).contains("run holds a run; choose another folder"),
        "{stderr:?}"
    );
}
