//! Evaluation of saved policies, the best policy, and trainings that start from a policy.

use super::numbers::{physgrad, read};
use std::fs;
use tempfile::TempDir;

const SMALL: &str =
    "--set training.train_samples=16 --set training.test_samples=8 --set policy.widths=[8]";

fn succeed(dir: &TempDir, args: &str) {
    physgrad(args, dir.path()).assert().success();
}

fn error(dir: &TempDir, args: &str) -> String {
    String::from_utf8(physgrad(args, dir.path()).assert().failure().get_output().stderr.clone())
        .expect("text")
}

fn bytes(dir: &TempDir, file: &str) -> Vec<u8> {
    fs::read(dir.path().join(file)).expect(file)
}

fn column(rows: &[Vec<String>], name: &str) -> Vec<f64> {
    let index = rows[0]
        .iter()
        .position(|header| header == name)
        .unwrap_or_else(|| panic!("{name} in {:?}", rows[0]));
    rows[1..].iter().map(|row| row[index].parse().expect("a number")).collect()
}

#[test]
fn a_summary_agrees_with_its_losses_and_with_robust_at_unchanged_settings() {
    let dir = TempDir::new().expect("a folder");
    succeed(&dir, &format!("train cart_pole_1 {SMALL} --epochs 2 --quiet --out a"));
    succeed(&dir, "eval a --samples 40 --worst 2 --out many");
    succeed(&dir, "eval a --samples 10 --out few");
    succeed(&dir, "robust a --grid system.cart_mass=1:2:2 --samples 40 --seed 0 --out grid");

    let losses = column(&read(&dir, "many/losses.csv"), "loss");
    assert_eq!(losses.len(), 40);
    assert_eq!(
        column(&read(&dir, "few/losses.csv"), "loss"),
        losses[..10],
        "a sample depends on the number of samples"
    );
    let summary = read(&dir, "many/summary.csv");
    let number = |name: &str| column(&summary, name)[0];
    let mean = losses.iter().sum::<f64>() / 40.0;
    let variance = losses.iter().map(|loss| (loss - mean) * (loss - mean)).sum::<f64>() / 39.0;
    assert!(
        (number("mean") - mean).abs() < 1e-12
            && (number("standard_error") - (variance / 40.0).sqrt()).abs() < 1e-12
    );
    let mut sorted = losses.clone();
    sorted.sort_by(f64::total_cmp);
    assert_eq!((number("median"), number("worst")), (0.5 * (sorted[19] + sorted[20]), sorted[39]));
    let grid = read(&dir, "grid/robust.csv");
    assert_eq!(
        column(&grid, "median")[0],
        number("median"),
        "`robust` at the mass of the run has another median than `eval`"
    );

    // The rollouts in `worst.csv` belong to the samples with the largest losses, the worst first.
    // None of their states is an initial state of the test rollouts in the run's `trajectory.csv`.
    let worst = read(&dir, "many/worst.csv");
    let mut samples = column(&worst, "sample");
    samples.dedup();
    let ranked = [sorted[39], sorted[38]]
        .map(|loss| losses.iter().position(|&l| l == loss).expect("a loss") as f64);
    assert_eq!(samples, ranked);
    let tested: Vec<String> = read(&dir, "a/trajectory.csv")
        .iter()
        .filter(|row| row[1] == "0")
        .map(|row| row[3..].concat())
        .collect();
    assert!(worst[1..].iter().all(|row| !tested.contains(&row[3..].concat())));
    for rank in 1..=2 {
        let svg = String::from_utf8(bytes(&dir, &format!("many/worst_{rank}.svg"))).expect("text");
        roxmltree::Document::parse(&svg).expect("an SVG is XML");
    }
}

/// The loss of `push` is the squared distance of the box from 0 at the end.
#[test]
fn losses_are_the_costs_of_the_written_rollouts() {
    let dir = TempDir::new().expect("a folder");
    succeed(&dir, &format!("train push {SMALL} --epochs 1 --quiet --out run"));
    succeed(&dir, "eval run --samples 5 --worst 5 --out eval");
    let losses = column(&read(&dir, "eval/losses.csv"), "loss");
    let worst = read(&dir, "eval/worst.csv");
    let steps = column(&worst, "step");
    let last = steps.iter().copied().fold(0.0, f64::max);
    let ends: Vec<usize> = (0..steps.len()).filter(|&row| steps[row] == last).collect();
    assert_eq!(ends.len(), 5);
    for row in ends {
        let (sample, end) = (column(&worst, "sample")[row], column(&worst, "box")[row]);
        let loss = losses[sample as usize];
        assert!(
            (end * end - loss).abs() < 1e-6 * loss,
            "sample {sample}: {} and {loss}",
            end * end
        );
    }
}

#[test]
fn two_policies_are_evaluated_in_another_scene_and_errors_name_the_scene() {
    let dir = TempDir::new().expect("a folder");
    for seed in [1, 2] {
        succeed(
            &dir,
            &format!("train cart_pole_1 {SMALL} --seed {seed} --epochs 1 --quiet --out seed{seed}"),
        );
    }
    succeed(
        &dir,
        "eval seed1 seed2 --scene cart_pole_1 --set system.cart_mass=3 --samples 8 --out heavy",
    );
    succeed(&dir, "eval seed1 seed2 --samples 8 --out nominal");
    let losses = |folder: &str| column(&read(&dir, &format!("{folder}/losses.csv")), "loss");
    assert_eq!(losses("heavy").len(), 16);
    assert!(
        losses("heavy").iter().zip(losses("nominal")).all(|(heavy, nominal)| *heavy != nominal)
    );
    assert!(dir.path().join("heavy/2-seed2/worst_1.svg").exists());
    let message = error(&dir, "eval seed1 --scene cart_pole_2");
    assert!(message.contains("use a scene with as many observations and controls"), "{message}");
    // The policies of both scenes have 48 parameters.
    let herd = "--set system.drivers=1 --set system.evaders=5 --set policy.widths=[] --set policy.bias=false";
    succeed(&dir, &format!("train guidance {SMALL} {herd} --epochs 1 --quiet --out herd"));
    for (set, message) in [
        (
            "seed=3",
            "--set seed=3 has no effect on an evaluation; give the seed of the initial states by --seed",
        ),
        (
            "training.batch=4",
            "--set training.batch=4 has no effect on an evaluation, which trains nothing",
        ),
    ] {
        let found = error(&dir, &format!("eval herd --set {set}"));
        assert!(found.contains(message), "{found}");
    }
    let message = error(&dir, "eval herd --set system.drivers=2 --set system.evaders=1");
    assert!(
        message.contains("24 observations and 2 controls, but this scene has 12 and 4"),
        "{message}"
    );
    let message = error(&dir, "eval seed1 --scene guidance");
    assert!(message.contains("name a scene of cart_pole"), "{message}");
}

/// The best policy of a run equals the last policy of a shorter run that ends with the best epoch.
#[test]
fn the_best_policy_is_that_of_the_epoch_with_the_lowest_test_loss() {
    let dir = TempDir::new().expect("a folder");
    let train = format!("train cart_pole_1 {SMALL} --set training.learning_rate=0.3 --quiet");
    succeed(&dir, &format!("{train} --epochs 6 --out whole"));
    let losses = column(&read(&dir, "whole/metrics.csv"), "test_loss");
    let best =
        (0..losses.len()).min_by(|&a, &b| losses[a].total_cmp(&losses[b])).expect("an epoch") + 1;
    assert!(best < 6, "the test needs a run whose last epoch is not the best: {losses:?}");
    succeed(&dir, &format!("{train} --epochs {best} --out short"));
    assert_eq!(
        bytes(&dir, "whole/best_policy.safetensors"),
        bytes(&dir, "short/policy.safetensors")
    );
    assert_ne!(
        bytes(&dir, "whole/best_policy.safetensors"),
        bytes(&dir, "whole/policy.safetensors")
    );
    succeed(&dir, "train --resume --epochs 6 --quiet --out short");
    assert_eq!(
        bytes(&dir, "whole/best_policy.safetensors"),
        bytes(&dir, "short/best_policy.safetensors")
    );

    succeed(&dir, "eval whole --epoch best --samples 8 --out best");
    succeed(&dir, "eval whole --samples 8 --out last");
    assert_ne!(bytes(&dir, "best/losses.csv"), bytes(&dir, "last/losses.csv"));
}

#[test]
fn a_training_starts_from_a_policy_and_resumes_without_its_file() {
    let dir = TempDir::new().expect("a folder");
    succeed(&dir, &format!("train cart_pole_1 {SMALL} --epochs 2 --quiet --out first"));
    let continued = format!("train cart_pole_1 {SMALL} --policy first --quiet");
    succeed(&dir, &format!("{continued} --epochs 0 --out none"));
    assert_eq!(bytes(&dir, "none/policy.safetensors"), bytes(&dir, "first/policy.safetensors"));
    succeed(&dir, &format!("{continued} --epochs 2 --out whole"));
    succeed(&dir, &format!("{continued} --epochs 1 --out parts"));
    fs::write(
        dir.path().join("moved.toml"),
        "scene = 1\ntask = \"cart_pole\"\ninitial_policy = \"none/policy.safetensors\"\n",
    )
    .expect("a file");
    fs::remove_dir_all(dir.path().join("first")).expect("a folder");
    succeed(&dir, "train --resume --epochs 2 --quiet --out parts");
    assert_eq!(bytes(&dir, "parts/policy.safetensors"), bytes(&dir, "whole/policy.safetensors"));

    // A path in a scene is relative to the folder of the scene file.
    fs::create_dir(dir.path().join("elsewhere")).expect("a folder");
    physgrad(
        &format!("train ../moved.toml {SMALL} --set system.poles=1 --epochs 0 --quiet --out here"),
        &dir.path().join("elsewhere"),
    )
    .assert()
    .success();
    assert_eq!(
        bytes(&dir, "elsewhere/here/policy.safetensors"),
        bytes(&dir, "none/policy.safetensors")
    );

    for (scene, message) in [
        (
            "cart_pole_2",
            "its tensor layer1.kernel has the shape [4, 8], but the policy of the scene has [6, 100]",
        ),
        (
            "cart_pole_1 --set policy.bias=false --set policy.widths=[8]",
            "it has the tensor layer1.bias, but the policy of the scene has layer1.kernel, layer2.kernel",
        ),
        ("cart_pole_1 --set policy.widths=[8,8]", "its tensor layer2.kernel has the shape [8, 1]"),
        (
            "cart_pole_1 --set policy.widths=[8] --set policy.activation=relu",
            "the activation of its layer 1 is \"tanh\", but \"relu\" in the scene; use the `policy` section",
        ),
    ] {
        let found = error(&dir, &format!("train {scene} --policy none"));
        assert!(found.contains(message), "{scene}: {found}");
    }
    // Tensors of equal shapes, of another task or other observations.
    let policy = bytes(&dir, "none/policy.safetensors");
    for (own, other, message) in [
        (
            "cart_pole",
            "cart_bole",
            "it is a policy of the task `cart_bole`, but the task of the scene is `cart_pole`; choose a policy",
        ),
        (
            "x_dot",
            "y_dot",
            "its observations are x, y_dot, theta_1, omega_1, but those of the scene are x, x_dot, theta_1, omega_1; use",
        ),
    ] {
        let at = policy.windows(own.len()).position(|part| part == own.as_bytes()).expect(own);
        let mut changed = policy.clone();
        changed[at..at + other.len()].copy_from_slice(other.as_bytes());
        fs::write(dir.path().join("other.safetensors"), changed).expect("a file");
        let command = "train cart_pole_1 --set policy.widths=[8] --policy other.safetensors";
        let found = error(&dir, command);
        assert!(found.contains(message), "{found}");
    }
    fs::write(dir.path().join("text"), "no policy").expect("a file");
    let message = error(&dir, "train cart_pole_1 --policy text");
    assert!(message.contains("it is not a file in the safetensors format"), "{message}");
    assert!(error(&dir, "train cart_pole_1 --policy absent").contains("--policy absent"));
}

#[test]
fn an_evaluation_reports_the_lengths_of_episodes_that_can_end() {
    let dir = TempDir::new().expect("a folder");
    let scene = "scene = 1\ntask = \"equations\"\nhorizon = 40\n[system]\nstates = [\"q\"]\n\
        controls = [\"v\"]\ndt = 0.1\nrate.q = \"1 + 0 * v\"\nstart.q = { uniform = [0, 1] }\n\
        [loss]\nrunning = \"1\"\nend = \"q > 1.25\"\n[policy]\nwidths = []\n";
    fs::write(dir.path().join("scene.toml"), scene).expect("a scene");
    succeed(&dir, "train scene.toml --epochs 1 --quiet --out a");
    succeed(&dir, "eval a --samples 20 --worst 0 --out found");
    let rows = read(&dir, "found/losses.csv");
    let [losses, lengths] = ["loss", "length"].map(|name| column(&rows, name));
    // Each step of an episode costs 1.
    assert_eq!(losses, lengths);
    assert!(lengths.iter().all(|length| (2.0..=13.0).contains(length)), "{lengths:?}");
    let mean = lengths.iter().sum::<f64>() / 20.0;
    assert_eq!(column(&read(&dir, "found/summary.csv"), "mean_length"), [mean]);
    assert_eq!(column(&read(&dir, "found/summary.csv"), "ended_early"), [20.0]);
    succeed(&dir, "robust a --grid system.dt=0.1:0.2:2 --samples 20 --out grid");
    let steps = column(&read(&dir, "grid/robust.csv"), "mean_length");
    assert!(6.0 < steps[0] && steps[0] < 9.0 && 1.5 * steps[1] < steps[0], "{steps:?}");
    // A trajectory ends with the state in which the episode ended.
    let rows = read(&dir, "a/trajectory.csv");
    let [steps, ended] = ["step", "ended"].map(|name| column(&rows, name));
    for (i, (step, ended)) in std::iter::zip(&steps, &ended).enumerate() {
        let is_last = steps.get(i + 1).is_none_or(|&next| next == 0.0);
        assert_eq!(*ended, if is_last { *step } else { 0.0 }, "row {i}");
    }
    let output = physgrad("eval a --samples 20 --worst 0 --out again", dir.path()).assert();
    let text = String::from_utf8(output.get_output().stdout.clone()).expect("text");
    assert!(text.contains("mean steps"), "{text}");
    succeed(&dir, "report a --quiet");
    let report = fs::read_to_string(dir.path().join("a/report.html")).expect("a report");
    assert!(report.contains("Length of episodes"));
    assert!(!report.contains("Explained variance"), "the run has no value function");
}

#[test]
fn a_training_warns_of_ends_at_once_and_of_a_policy_that_learns_to_end() {
    let dir = TempDir::new().expect("a folder");
    // A faster motion costs less, and ends earlier.
    let scene = "scene = 1\ntask = \"equations\"\nhorizon = 100\nepochs = 6\nfield = \"regular\"\n\
        [system]\nstates = [\"q\"]\ncontrols = [\"v\"]\ndt = 0.1\nrate.q = \"0.2 + v\"\n\
        start.q = { uniform = [0, 1] }\n[loss]\nrunning = \"1 - 0.5 * v\"\nend = \"q > 1.25\"\n\
        [policy]\nwidths = []\n[training]\nlearning_rate = 0.02\n";
    fs::write(dir.path().join("scene.toml"), scene).expect("a scene");
    let warnings = |change: &str| {
        let arguments = format!("train scene.toml --quiet --out a{change}");
        let output = physgrad(&arguments, dir.path()).assert().success();
        String::from_utf8(output.get_output().stderr.clone()).expect("text")
    };
    let learned = "the policy learns to end them";
    let text = warnings("");
    assert!(text.contains("before the training: ") && text.contains(learned), "{text}");
    let text = warnings(" --set loss.end=q>-1");
    assert!(text.contains("all test episodes end in their first step"), "{text}");
    let text = warnings(" --set loss.running=1+v^2");
    assert!(!text.contains("episodes"), "{text}");
}

#[test]
fn noise_keeps_bounds_and_controls_that_stay_at_them_are_told() {
    let dir = TempDir::new().expect("a folder");
    // Beyond the bounds of the control, the cost is no number.
    let scene = "scene = 1\ntask = \"equations\"\nhorizon = 40\nepochs = 4\nfield = \"regular\"\n\
        [system]\nstates = [\"q\"]\ncontrols = [\"v\"]\ndt = 0.1\nrate.q = \"v\"\nbounds.v = [-1.0, 1.0]\n\
        start.q = { uniform = [0, 1] }\n[loss]\nrunning = \"(next.q - goal)^2 - sqrt(1.01 - v^2)\"\n\
        [policy]\nwidths = [8]\nbounds = true\n[training]\nbatch = 16\ntrain_samples = 16\nlearning_rate = 0.1\n\
        discount = 0.9\n[window]\nsteps = 5\nnoise = 0.5\n[window.value]\n";
    for (goal, is_told) in [("0.5", false), ("100", true)] {
        let scene = scene.replace("goal", goal);
        fs::write(dir.path().join("scene.toml"), scene).expect("a scene");
        let arguments = format!("train scene.toml --quiet --out to_{goal}");
        let output = physgrad(&arguments, dir.path()).assert().success();
        let text = String::from_utf8(output.get_output().stderr.clone()).expect("text");
        assert!(!text.contains("skipped"), "{text}");
        let loud = physgrad("check scene.toml --set window.noise=3", dir.path()).assert().success();
        let loud = String::from_utf8(loud.get_output().stdout.clone()).expect("text");
        assert!(loud.contains("is 3, more than half of its range of 2"), "{loud}");
        let told = "of the controls of the test set are at their bounds";
        assert_eq!(text.contains(told), is_told, "goal {goal}: {text}");
    }
}

/// A plant that is heated by `q` in a unit that is a part `k` of the natural one.
fn heated(k: f64) -> String {
    format!(
        "scene = 1\ntask = \"equations\"\nprecision = \"f64\"\nhorizon = 60\nepochs = 3\nfield = \"regular\"\n\
         [system]\nstates = [\"T\"]\ncontrols = [\"q\", \"vent\"]\ndt = 0.1\n\
         rate.T = \"q / k - (0.1 + vent) * (T - 300)\"\nstart.T = {{ uniform = [290, 330] }}\n\
         parameters.k = {k}\nbounds = {{ q = [0.0, {}], vent = [0.0, 0.5] }}\n\
         [loss]\nrunning = \"((next.T - 310) / 10)^2\"\nend = \"abs(T - 310) < 0.02\"\n\
         [policy]\nwidths = [8]\nbounds = true\n\
         [training]\nbatch = 16\ntrain_samples = 16\ntest_samples = 8\ndiscount = 0.9\n\
         [window]\nsteps = 5\nnormalize = true\nnoise = [{}, 0.01]\n[window.value]\n",
        30.0 * k,
        2.0 * k
    )
}

#[test]
fn the_unit_of_a_bounded_control_does_not_change_a_training() {
    let dir = TempDir::new().expect("a folder");
    let metrics = |k: f64, more: &str| {
        fs::write(dir.path().join("scene.toml"), heated(k)).expect("a scene");
        succeed(&dir, &format!("train scene.toml --quiet --out run{more}"));
        let rows = read(&dir, "run/metrics.csv");
        // Rounding differs only if the factor is no power of two.
        ["train_loss", "test_loss", "explained"].map(|name| column(&rows, name))
    };
    let natural = metrics(1.0, "");
    assert_eq!(natural, metrics(1024.0, ""));
    assert!(natural[1][2] < 0.8 * natural[1][0], "{natural:?}");
    let [_, fixed, _] = metrics(1.0, " --set window.normalize=false");
    let [_, other, _] = metrics(1024.0, " --set window.normalize=false");
    assert_ne!(fixed, other);
    // Every episode ends at once, so all targets of a window are one number.
    let [_, _, explained] = metrics(1.0, " --set loss.end=T>0");
    assert!(explained.iter().all(|share| *share <= 1.0), "{explained:?}");
    let message = error(&dir, "train scene.toml --set window.noise=[1.0] --out a");
    assert!(message.contains("`window.noise` is [1.0]; allowed: 2 numbers"), "{message}");
}

#[test]
fn an_identification_ignores_the_end_of_episodes() {
    let dir = TempDir::new().expect("a folder");
    let scene = "scene = 1\ntask = \"equations\"\nhorizon = 20\n[system]\nstates = [\"x\"]\n\
        controls = [\"u\"]\ndt = 0.1\nrate.x = \"u - g * x\"\n\
        parameters.g = { start = 1.0 }\n[loss]\nrunning = \"next.x^2\"\n";
    fs::write(dir.path().join("plain.toml"), scene).expect("a scene");
    fs::write(dir.path().join("ends.toml"), format!("{scene}end = \"x < 0.5\"\n"))
        .expect("a scene");
    let row = |i: i32| format!("{},{},0\n", 0.1 * f64::from(i), (-0.2 * f64::from(i)).exp());
    let data: String = (0..=20).map(row).collect();
    fs::write(dir.path().join("data.csv"), format!("t,x,u\n{data}")).expect("data");
    let fit = |scene: &str| {
        succeed(&dir, &format!("identify {scene}.toml --data data.csv --out {scene}"));
        read(&dir, &format!("{scene}/identified.csv"))
    };
    assert_eq!(fit("plain"), fit("ends"));
}

#[test]
fn windows_refuse_policies_and_sensors_that_they_do_not_carry_on() {
    let dir = TempDir::new().expect("a folder");
    let scene = "scene = 1\ntask = \"cart_pole\"\n[training]\ndiscount = 0.9\n\
        [window]\nsteps = 10\n[window.value]\n";
    fs::write(dir.path().join("scene.toml"), scene).expect("a scene");
    for (change, message) in [
        ("policy.kind=gru", "`policy.kind` with `window`: the policy has a memory"),
        ("policy.kind=open_loop", "depends on the number of the step"),
        ("training.truncation=11", "has no effect: `window.steps` is 10"),
        ("sensor.delay={steps=2}", "`sensor.delay` is not supported with a value function"),
        ("window.normalize=true --set policy.kind=linear", "`window.normalize` needs a policy"),
    ] {
        let text = error(&dir, &format!("train scene.toml --set {change} --out a"));
        assert!(text.contains(message), "{change}: {text}");
    }
}
