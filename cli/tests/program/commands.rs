//! Interface of the program: output files, CSV headers, messages, exit codes.

use crate::numbers as of_numbers;
use crate::running::{SMALL, error_of, physgrad, train};
use physgrad::train::Session;
use physgrad::{policy::Mlp, tasks::CartPole};
use std::collections::BTreeMap;
use std::fs;
use std::path::Path;
use tempfile::TempDir;

/// Returns the columns of a CSV file by name.
fn columns(path: &Path) -> BTreeMap<String, Vec<String>> {
    let text = fs::read_to_string(path).unwrap_or_else(|e| panic!("{}: {e}", path.display()));
    let mut rows = text.lines().map(|line| line.split(',').map(String::from).collect::<Vec<_>>());
    let header = rows.next().expect("a header");
    let rows: Vec<_> = rows.collect();
    header
        .into_iter()
        .enumerate()
        .map(|(i, name)| (name, rows.iter().map(|row| row[i].clone()).collect()))
        .collect()
}

/// Returns the metrics without the time column.
fn numbers(out: &Path) -> BTreeMap<String, Vec<String>> {
    let mut columns = columns(&out.join("metrics.csv"));
    columns.remove("seconds").expect("a column");
    columns
}

fn policy(out: &Path) -> Vec<u8> {
    fs::read(out.join("policy.safetensors")).expect("a policy")
}

#[test]
fn a_training_run_writes_every_output_file() {
    let dir = TempDir::new().expect("a folder");
    let out = dir.path().join("deep/run");
    train(&out, &["--epochs", "3", "--set", "system.poles=3"]).assert().success();
    let metrics = fs::read_to_string(out.join("metrics.csv")).expect("metrics");
    assert!(
        metrics.starts_with("epoch,loss,train_loss,test_loss,grad_norm,cosine,seconds"),
        "{metrics}"
    );
    assert_eq!(metrics.lines().count(), 4);
    let metrics = columns(&out.join("metrics.csv"));
    assert_eq!(metrics["epoch"], ["1", "2", "3"]);
    assert!(metrics["seconds"].iter().all(|s| s.parse::<f64>().expect("a number") > 0.0));
    assert!(
        metrics["cosine"]
            .iter()
            .all(|c| (-1.0..=1.0).contains(&c.parse::<f64>().expect("a number")))
    );

    let settings: toml::Table =
        fs::read_to_string(out.join("run.toml")).expect("settings").parse().expect("TOML");
    assert_eq!(settings["task"].as_str(), Some("cart_pole"));
    assert_eq!(settings["physgrad"].as_str(), Some(env!("CARGO_PKG_VERSION")));
    assert_eq!(settings["system"]["poles"].as_integer(), Some(3));
    assert!(settings.contains_key("seed"));

    let tensors = policy(&out);
    let tensors = safetensors::SafeTensors::deserialize(&tensors).expect("safetensors");
    assert_eq!(tensors.tensor("layer1.kernel").expect("a kernel").shape(), [8, 12]);
    assert_eq!(tensors.tensor("layer3.bias").expect("a bias").shape(), [1]);

    let trajectory = columns(&out.join("trajectory.csv"));
    assert_eq!(trajectory["step"].len(), 4 * 26);
    assert!(trajectory.contains_key("theta_3") && trajectory.contains_key("force"));
    for picture in ["learning_curve.svg", "animation.svg"] {
        let text = fs::read_to_string(out.join(picture)).expect(picture);
        roxmltree::Document::parse(&text).expect("an SVG is XML");
    }
    assert!(
        fs::read_to_string(out.join("animation.svg")).expect("an animation").contains("<animate")
    );
    assert!(out.join("checkpoint.bin").exists());
}

#[test]
fn a_saved_run_is_animated_from_any_test_state() {
    let dir = TempDir::new().expect("a folder");
    let (run, animation) = (dir.path().join("run"), |path: &Path| {
        fs::read(path.join("animation.svg")).expect("an animation")
    });
    train(&run, &["--epochs", "1"]).assert().success();
    let first = animation(&run);
    let animate = |args: &[&str]| {
        let mut command = physgrad(&["animate"]);
        command.arg(dir.path().join("run")).args(args);
        command
    };
    animate(&["--sample", "3"]).assert().success();
    assert_ne!(animation(&run), first, "sample 3 has the animation of sample 0");
    animate(&[]).assert().success();
    assert_eq!(animation(&run), first, "`train` does not animate sample 0");
    let text = error_of(&mut animate(&["--sample", "100000"]));
    assert!(text.contains("--sample is 100000; allowed: 0 to "), "{text}");

    let compare = dir.path().join("compare");
    physgrad(&[
        "compare",
        "cart_pole",
        "--fields",
        "R,C",
        "--seeds",
        "1",
        "--epochs",
        "1",
        "--quiet",
        "--out",
    ])
    .arg(&compare)
    .assert()
    .success();
    let output = physgrad(&["animate"]).arg(&compare).output().expect("the command runs");
    assert_eq!(String::from_utf8_lossy(&output.stdout).lines().count(), 2, "one animation per run");
    let text = error_of(physgrad(&["animate"]).arg(dir.path()));
    assert!(text.contains("holds 2 runs or comparisons; choose one"), "{text}");
    let nothing = dir.path().join("nothing");
    fs::create_dir(&nothing).expect("a folder");
    assert!(error_of(physgrad(&["animate"]).arg(&nothing)).contains("there is no run in"));
}

#[test]
fn the_cosine_column_is_empty_for_a_single_gradient() {
    let dir = TempDir::new().expect("a folder");
    for field in ["R", "modified", "S", "network"] {
        let out = dir.path().join(field);
        train(&out, &["--epochs", "1", "--field", field]).assert().success();
        assert_eq!(columns(&out.join("metrics.csv"))["cosine"], [""]);
    }
}

#[test]
fn results_are_equal_with_1_2_and_5_threads_and_depend_on_the_seed() {
    let dir = TempDir::new().expect("a folder");
    let run = |name: &str, args: &[&str]| {
        let out = dir.path().join(name);
        train(&out, &["--epochs", "2"]).args(args).assert().success();
        (numbers(&out), policy(&out), fs::read(out.join("trajectory.csv")).expect("a trajectory"))
    };
    let one = run("one", &["--threads", "1"]);
    assert!(run("two", &["--threads", "2"]) == one);
    assert!(run("five", &["--threads", "5"]) == one);
    assert!(run("seed", &["--threads", "1", "--seed", "1"]).1 != one.1);
}

#[test]
fn a_run_resumed_after_2_of_5_epochs_equals_an_uninterrupted_run() {
    let dir = TempDir::new().expect("a folder");
    let (whole, parts) = (dir.path().join("whole"), dir.path().join("parts"));
    train(&whole, &["--epochs", "5"]).assert().success();
    train(&parts, &["--epochs", "2"]).assert().success();
    let mut resume = physgrad(&["train", "cart_pole", "--resume", "--epochs", "5", "--out"]);
    resume.arg(&parts).assert().success();
    let mut fewer = physgrad(&["train", "cart_pole", "--resume", "--epochs", "3", "--out"]);
    assert!(error_of(fewer.arg(&parts)).contains("already has 5 epochs"));
    assert_eq!(numbers(&parts), numbers(&whole));
    assert!(policy(&parts) == policy(&whole));
}

#[test]
fn errors_name_the_key_and_the_allowed_values() {
    let dir = TempDir::new().expect("a folder");
    let out = dir.path().join("run");
    for (set, parts) in [
        ("training.lerning_rate=1", &["training.lerning_rate", "learning_rate", "batch"][..]),
        ("training.learning_rate=fast", &["training.learning_rate", "fast"]),
        ("training.learning_rate=-1", &["training.learning_rate", "-1", "positive"]),
        ("training.clip=big", &["training.clip", "big", "none", "value", "norm"]),
        ("system.poles=0", &["system.poles", "0", "1 to"]),
        ("system.poles=abc", &["system.poles", "\"abc\"; allowed: a whole number, 1 to "]),
        ("system.poles=2.5", &["system.poles", "a whole number, 1 to "]),
        ("training.batch=-1", &["training.batch", "-1", "a whole number, 1 to 1000000"]),
        ("seed=abc", &["seed", "a whole number, 0 or more"]),
        ("system.dt=nan", &["system.dt", "NaN", "positive"]),
        ("policy.widths=[8, 0]", &["policy.widths", "0"]),
        ("policy.widths=wide", &["policy.widths", "wide"]),
        ("system=4", &["system", "system.poles"]),
        ("horizon=0", &["horizon", "0", "1 to"]),
        ("horizon=99999999999", &["horizon", "1 to"]),
        ("training.batch=1000000000000", &["training.batch", "1 to"]),
        ("horizon=50000000", &["GB", "training.batch", "horizon"]),
        ("physgrad=9.9", &["physgrad", "cannot be set"]),
        ("nonsense", &["nonsense", "KEY=VALUE"]),
        ("task=other", &["task", "other", "cannot be set"]),
    ] {
        let text = error_of(&mut train(&out, &["--set", set]));
        for part in parts {
            assert!(text.contains(part), "{set}: {text}");
        }
        assert!(!out.exists(), "{set}: a refused setting creates a folder");
    }
    let text = error_of(&mut train(&out, &["--field", "sideways"]));
    assert!(text.contains("sideways") && text.contains("combined"), "{text}");
    let text = error_of(&mut physgrad(&["train", "cart_pool"]));
    assert!(text.contains("cart_pool") && text.contains("cart_pole"), "{text}");
}

/// Every command refuses options and settings that it does not read, and does not list the options.
#[test]
fn options_and_settings_without_effect_are_refused_and_not_listed() {
    let dir = TempDir::new().expect("a folder");
    let scene = "scene = 1\ntask = \"pendulum\"\n[fit]\n\"system.gravity\" = { start = 9 }\n";
    fs::write(dir.path().join("scene.toml"), scene).expect("a scene");
    fs::write(dir.path().join("data.csv"), "t,theta_1\n0,0\n0.01,0\n0.02,0\n").expect("data");
    let run = |command: &str| {
        let output = of_numbers::physgrad(command, dir.path()).output().expect("the program runs");
        (output.status.success(), String::from_utf8_lossy(&output.stderr).into_owned())
    };
    let of_trainings = [
        "field=S",
        "epochs=3",
        "tags=[\"a\"]",
        "log=[\"jsonl\"]",
        "training.batch=4",
        "training.learning_rate=0.5",
        "training.discount=0.5",
        "training.control=0.5",
        "training.truncation=5",
        "training.cut=1",
        "training.clip=value",
    ];
    let identify = "identify scene.toml --data data.csv";
    for (command, others) in [
        ("check pendulum", &["precision=f64"][..]),
        ("accuracy pendulum", &["integrator.substeps=2", "precision=f64"]),
        ("accuracy pendulum --gradients", &["policy.zero_init_output=true", "precision=f32"]),
        ("explain pendulum", &["training.memory=1MB", "seed=3"]),
        ("optimize pendulum", &["policy.widths=[4]"]),
        (identify, &["training.memory=1MB", "horizon=5", "precision=f32"]),
    ] {
        for setting in of_trainings.iter().chain(others) {
            let (succeeds, said) = run(&format!("{command} --set {setting}"));
            let expected = format!("error: --set {setting} has no effect on ");
            assert!(!succeeds && said.contains(&expected), "{command}: {said}");
        }
    }
    for (command, refused, read) in [
        ("accuracy", &["field", "epochs", "tag", "log", "precision"][..], &["seed", "policy"][..]),
        ("explain", &["field", "epochs", "seed", "tag", "log", "policy"], &["precision", "set"]),
        ("optimize", &["field", "epochs", "tag", "log", "policy"], &["seed", "precision"]),
        ("identify", &["field", "epochs", "seed", "precision", "policy"], &["set", "without"]),
    ] {
        let output =
            of_numbers::physgrad(&format!("{command} --help"), dir.path()).output().expect("help");
        let help = String::from_utf8_lossy(&output.stdout).into_owned();
        let lists = |option: &&str| help.contains(&format!(" --{option} "));
        assert!(!refused.iter().any(lists) && read.iter().all(lists), "{command}: {help}");
    }
    let (succeeds, said) = run(&format!("{identify} --noise theta_1=1,omega_1=0.1"));
    let expected = "--noise omega_1=0.1 has no effect: the file has no measurement of omega_1; measured states: theta_1";
    assert!(!succeeds && said.contains(expected), "{said}");
    for (command, expected) in [
        ("train pendulum --epochs -1", "'--epochs <N>': allowed: a whole number, 0 or more"),
        ("compare pendulum --seeds -1", "'--seeds <K>': allowed: a whole number, 0 or more"),
        ("animate run --sample -1", "'--sample <N>': allowed: a whole number, 0 or more"),
        ("accuracy pendulum --target -1", "--target -1; allowed: a positive error"),
    ] {
        let (succeeds, said) = run(command);
        assert!(!succeeds && said.contains(expected), "{command}: {said}");
    }
}

#[test]
fn an_unwritable_folder_is_an_error_before_training() {
    let dir = TempDir::new().expect("a folder");
    let file = dir.path().join("file");
    fs::write(&file, "").expect("a file");
    let text = error_of(&mut train(&file.join("run"), &["--epochs", "100000"]));
    assert!(text.contains("cannot be written to") && text.contains("--out"), "{text}");
}

#[test]
fn runs_that_cannot_resume_are_refused_with_the_reason() {
    let dir = TempDir::new().expect("a folder");
    let resume = |args: &[&str]| {
        let mut command = physgrad(&["train", "cart_pole", "--resume", "--epochs", "3", "--out"]);
        command.arg(dir.path()).args(args);
        command
    };
    assert!(error_of(&mut resume(&[])).contains("no run to resume"));
    train(dir.path(), &["--epochs", "1"]).assert().success();
    let before = policy(dir.path());

    let text = error_of(&mut resume(&["--set", "system.poles=4"]));
    assert!(text.contains("keeps its settings") && text.contains("poles = 4"), "{text}");

    // Replaces the checkpoint by one of another network.
    let other = dir.path().join("other");
    train(&other, &["--epochs", "1", "--set", "policy.widths=[3]"]).assert().success();
    let own = fs::read(dir.path().join("checkpoint.bin")).expect("a checkpoint");
    fs::copy(other.join("checkpoint.bin"), dir.path().join("checkpoint.bin")).expect("a copy");
    let text = error_of(&mut resume(&[]));
    assert!(
        text.contains("another run")
            && text.contains("checkpoint.bin")
            && text.contains("widths = [3]"),
        "{text}"
    );
    fs::write(dir.path().join("checkpoint.bin"), &own[..own.len() / 2]).expect("half a checkpoint");
    assert!(error_of(&mut resume(&[])).contains("damaged"));
    fs::write(dir.path().join("checkpoint.bin"), own).expect("a checkpoint");

    let settings = fs::read_to_string(dir.path().join("run.toml")).expect("settings");
    let of = |version: &str| {
        settings.replace(
            &format!("physgrad = \"{}\"", env!("CARGO_PKG_VERSION")),
            &format!("physgrad = \"{version}\""),
        )
    };
    fs::write(dir.path().join("run.toml"), of("99.0.0")).expect("settings");
    assert!(error_of(&mut resume(&[])).contains("99.0.0"));
    fs::write(dir.path().join("run.toml"), &settings).expect("settings");
    assert!(policy(dir.path()) == before);
    resume(&[]).assert().success();
}

#[test]
fn a_policy_without_its_recorded_test_loss_causes_a_warning() {
    let dir = TempDir::new().expect("a folder");
    let trained =
        train(dir.path(), &["--epochs", "2", "--json"]).assert().success().get_output().clone();
    assert!(!String::from_utf8(trained.stderr).expect("text").contains("warning"));
    let result: serde_json::Value = serde_json::from_slice(&trained.stdout).expect("an object");
    let loss = result["best_test_loss"].as_f64().expect("a loss");
    let warnings = |epochs: &str| {
        let resumed = train(dir.path(), &["--resume", "--quiet", "--epochs", epochs])
            .assert()
            .success()
            .get_output()
            .clone();
        String::from_utf8(resumed.stderr).expect("text")
    };
    assert_eq!(warnings("3"), "");

    // Simulates other equations: records another loss of the same policy.
    train(dir.path(), &["--epochs", "2", "--quiet"]).assert().success();
    let path = dir.path().join("checkpoint.bin");
    let mut bytes = fs::read(&path).expect("a checkpoint");
    let places: Vec<usize> =
        (0..bytes.len() - 8).filter(|&at| bytes[at..at + 8] == loss.to_le_bytes()).collect();
    assert!(
        places.len() >= 2,
        "the checkpoint has the loss in the record of the epoch and beside the best parameters"
    );
    for at in places {
        bytes[at..at + 8].copy_from_slice(&(1.001 * loss).to_le_bytes());
    }
    Session::<CartPole, Mlp, f32>::seal(&mut bytes);
    fs::write(&path, bytes).expect("a checkpoint");
    let warning = warnings("3");
    assert!(
        warning.contains("warning: the best policy in") && warning.contains("train again"),
        "{warning}"
    );
}

#[test]
fn a_diverged_run_reports_step_sample_and_component_and_writes_its_policy() {
    let dir = TempDir::new().expect("a folder");
    let text = error_of(&mut train(
        dir.path(),
        &["--epochs", "50", "--set", "system.gravity=1e38", "--set", "system.dt=1e5"],
    ));
    for part in ["forward pass", "step", "sample", "component", "in a row"] {
        assert!(text.contains(part), "{text}");
    }
    assert!(dir.path().join("policy.safetensors").exists());
    assert!(dir.path().join("checkpoint.bin").exists());
}

#[test]
fn a_comparison_has_one_row_per_run_and_its_runs_equal_single_runs() {
    let dir = TempDir::new().expect("a folder");
    let mut compare = physgrad(&[
        "compare",
        "cart_pole",
        "--fields",
        "R,combined",
        "--seeds",
        "2",
        "--epochs",
        "2",
        "--out",
    ]);
    compare.arg(dir.path()).args(SMALL).assert().success();
    let text = fs::read_to_string(dir.path().join("summary.csv")).expect("a summary");
    assert!(
        text.starts_with(
            "field,seed,epochs,untrained_test_loss,final_train_loss,final_test_loss,best_test_loss,failed,skipped,seconds\n"
        ),
        "{text}"
    );
    let summary = columns(&dir.path().join("summary.csv"));
    assert_eq!(summary["field"], ["R", "R", "C", "C"]);
    assert_eq!(summary["seed"], ["0", "1", "0", "1"]);
    let curves = fs::read_to_string(dir.path().join("curves.svg")).expect("a picture");
    roxmltree::Document::parse(&curves).expect("an SVG is XML");

    // Repeats one run without a comparison, on two threads.
    let alone = dir.path().join("alone");
    train(&alone, &["--epochs", "2", "--field", "C", "--seed", "1", "--threads", "2"])
        .assert()
        .success();
    assert_eq!(columns(&alone.join("metrics.csv"))["test_loss"][1], summary["final_test_loss"][3]);
}

#[test]
fn a_comparison_without_any_update_has_status_3_and_losses_of_nan() {
    let dir = TempDir::new().expect("a folder");
    let mut compare = physgrad(&[
        "compare",
        "cart_pole",
        "--fields",
        "R,C",
        "--seeds",
        "2",
        "--epochs",
        "40",
        "--out",
    ]);
    compare.arg(dir.path()).args(SMALL).args([
        "--set",
        "system.gravity=1e38",
        "--set",
        "system.dt=1e5",
    ]);
    let output = compare.output().expect("the command runs");
    assert_eq!(output.status.code(), Some(3));
    let text = String::from_utf8(output.stderr).expect("text");
    assert!(
        text.contains("no update was applied in 4 of 4 runs")
            && text.contains("R seed 1")
            && text.contains("forward pass"),
        "{text}"
    );
    let summary = columns(&dir.path().join("summary.csv"));
    assert_eq!(summary["final_test_loss"], ["NaN"; 4]);
}

#[test]
fn a_comparison_resumes_with_more_epochs_and_refuses_other_settings() {
    let dir = TempDir::new().expect("a folder");
    let compare = |args: &[&str]| {
        let mut compare = physgrad(&["compare", "cart_pole", "--seeds", "1", "--out"]);
        compare.arg(dir.path()).args(SMALL).args(args);
        compare
    };
    compare(&["--fields", "R,S", "--epochs", "1"]).assert().success();
    compare(&["--fields", "R,S", "--epochs", "3"]).assert().success();
    assert_eq!(columns(&dir.path().join("runs/R-0/metrics.csv"))["epoch"].len(), 3);
    let before = fs::read_to_string(dir.path().join("summary.csv")).expect("a summary");
    let text =
        error_of(&mut compare(&["--fields", "R,S", "--epochs", "3", "--set", "system.poles=4"]));
    assert!(text.contains("keeps its settings") && text.contains("poles = 4"), "{text}");
    assert!(error_of(&mut compare(&["--fields", "R,regular"])).contains("twice"));
    assert!(error_of(&mut compare(&["--set", "field=S"])).contains("--fields"));
    let alike = ["--fields", "R,S", "--set", "training.estimator=zeroth_order"];
    assert!(error_of(&mut compare(&alike)).contains("`fields` names 2 fields, but has no effect"));
    let blind = ["--fields", "M,S", "--set", "training.control=0.5"];
    assert!(error_of(&mut compare(&blind)).contains("fields modified, stopped omit the path"));
    assert!(error_of(&mut compare(&["--set", "fieldx=1"])).contains("`fieldx` is unknown"));
    assert!(
        error_of(&mut compare(&["--seed", "9223372036854775807", "--seeds", "2"]))
            .contains("seeds")
    );
    assert_eq!(
        fs::read_to_string(dir.path().join("summary.csv")).expect("a summary"),
        before,
        "a refused command changes the summary"
    );
}

#[test]
fn guidance_and_quantum_train_and_refuse_settings_out_of_range() {
    let dir = TempDir::new().expect("a folder");
    for (task, settings, column) in [
        (
            "guidance",
            [
                "system.drivers=3",
                "system.evaders=2",
                "loss.regularization=0.01",
                "loss.mode=terminal",
            ],
            "evader_2_vy",
        ),
        (
            "quantum",
            ["system.grid=16", "system.target=4", "system.weighting=[3, 1]", "policy.width=8"],
            "im_16",
        ),
    ] {
        let out = dir.path().join(task);
        let mut train = physgrad(&[
            "train",
            task,
            "--epochs",
            "2",
            "--set",
            "training.train_samples=16",
            "--out",
        ]);
        train.arg(&out).args(settings.iter().flat_map(|set| ["--set", set])).assert().success();
        assert!(columns(&out.join("trajectory.csv")).contains_key(column));
        assert!(
            numbers(&out)["test_loss"]
                .iter()
                .all(|loss| loss.parse::<f64>().expect("a number").is_finite())
        );
        let animation = fs::read_to_string(out.join("animation.svg")).expect("an animation");
        roxmltree::Document::parse(&animation).expect("an SVG is XML");
        assert!(animation.contains("<animate"));
    }
    for (task, set, allowed) in [
        ("guidance", "system.drivers=0", "1 to"),
        ("guidance", "system.evaders=0", "1 to"),
        ("guidance", "loss.regularization=-1", "0 or more"),
        ("quantum", "system.grid=2", "7 to"),
        ("quantum", "system.target=33", "1 to 32"),
        ("quantum", "system.dt=-1", "positive"),
        ("quantum", "system.weighting=[0, 0]", "1e-6 to 1e6"),
    ] {
        let text = error_of(&mut physgrad(&["train", task, "--set", set]));
        let (key, value) = set.split_once('=').expect("an assignment");
        assert!(
            text.contains(key)
                && text.contains(value.trim_matches(['[', ']']))
                && text.contains(allowed),
            "{text}"
        );
    }
}

#[test]
#[ignore = "long: all variants of the task"]
fn the_gradient_checks_of_cart_pole_pass() {
    let output = physgrad(&["check", "cart_pole"]).assert().success();
    let text = String::from_utf8(output.get_output().stdout.clone()).expect("text");
    assert!(text.contains("rollout") && text.contains("ok") && !text.contains("FAILED"), "{text}");
}

/// In raw units, temperatures saturate a drawn network, and its parameters differ in scale.
#[test]
fn a_check_measures_in_the_units_of_the_training() {
    let dir = TempDir::new().expect("a folder");
    let scene = "scene = 1\ntask = \"equations\"\nhorizon = 100\nfield = \"regular\"\n\
        [system]\nstates = [\"T\"]\ncontrols = [\"q\"]\ndt = 0.1\nrate.T = \"q - 0.1 * (T - 300)\"\n\
        start.T = { uniform = [250, 350] }\n[loss]\nrunning = \"((next.T - 310) / 50)^2\"\n\
        [policy]\nwidths = [16]\n[window]\nsteps = 10\n";
    let file = dir.path().join("scene.toml");
    fs::write(&file, scene).expect("a scene");
    let file = file.to_str().expect("a path of letters");
    // Error of R in percent.
    let error = |normalize: bool| -> f64 {
        let set = format!("window.normalize={normalize}");
        let output = physgrad(&["check", file, "--set", &set]).assert().success();
        let text = String::from_utf8(output.get_output().stdout.clone()).expect("text");
        let percent = text.split("mean loss by ").nth(1).and_then(|rest| rest.split(' ').next());
        percent.and_then(|number| number.parse().ok()).unwrap_or_else(|| panic!("{text}"))
    };
    let args = ["check", file, "--set", "loss.end=T > 0"];
    let output = physgrad(&args).assert().success();
    let text = String::from_utf8(output.get_output().stdout.clone()).expect("text");
    assert!(text.contains("episodes: all test episodes end in their first step"), "{text}");
    assert!(error(false) > 0.1, "{}", error(false));
    assert!(error(true) < 1e-4, "{}", error(true));
}

#[test]
fn a_check_of_windows_passes_with_their_value_function() {
    let checked = |steps: &str| {
        let args = ["check", "half_cheetah_run", "--set", "horizon=40", "--set", steps];
        let output = physgrad(&args).assert().success();
        let text = String::from_utf8(output.get_output().stdout.clone()).expect("text");
        assert!(text.contains("rollout") && !text.contains("FAILED"), "{text}");
        text
    };
    // Stiff contacts make R vary strongly between rollouts of 8 steps, and hardly over 2.
    let long = checked("window.steps=8");
    assert!(long.contains("over a window of 8 steps: undecided"), "{long}");
    assert!(long.contains("window: with `window.steps = 2`, R differs"), "{long}");
    let short = checked("window.steps=2");
    assert!(short.contains("over a window of 2 steps: no jumps"), "{short}");
    assert!(!short.contains("window: with"), "{short}");
}

#[test]
fn a_check_distinguishes_long_steps_from_unstable_physics() {
    let dir = TempDir::new().expect("a folder");
    let checked = |scene: &str| {
        let file = dir.path().join("scene.toml");
        fs::write(&file, format!("scene = 1\n{scene}")).expect("a scene");
        let small = ["--set", "policy.widths=[8]"];
        let output = physgrad(&["check"]).arg(&file).args(small).assert().success();
        String::from_utf8(output.get_output().stdout.clone()).expect("text")
    };
    // Friction damps the angular velocity at 300/s. Each step of RK4 over 0.01 s multiplies the
    // angular velocity by 1 - 3 + 9/2 - 27/6 + 81/24 = 1.375.
    let rubbed = "task = \"pendulum\"\nhorizon = 10\n[[system.arms]]\nviscous = 0.4\n";
    let text = checked(rubbed);
    assert!(
        text.contains("omega_1 grows by 1.3")
            && text.contains("Shorten the step: `integrator.substeps = 2`"),
        "{text}"
    );
    let text = checked(&format!("{rubbed}[integrator]\nsubsteps = 2\n"));
    assert!(text.contains("stable: no perturbation"), "{text}");
    // Steps of RK4 multiply the angular velocity by 83, two half steps by 14, four quarters by less
    // than 1.
    let text = checked("task = \"pendulum\"\nhorizon = 2\n[[system.arms]]\nviscous = 1.0\n");
    assert!(
        text.contains("4 times as many substeps. Shorten the step: `integrator.substeps = 4`"),
        "{text}"
    );
    // Upright rods are unstable, and steps of 10 ms resolve their fall.
    let text =
        checked("task = \"double_pendulum\"\nhorizon = 200\n[system]\nstart = \"upright\"\n");
    assert!(text.contains("the physics is unstable, not the step"), "{text}");
    // Poles that swing on a cart for 128 steps grow by a few percent.
    let text = checked("task = \"cart_pole\"\n");
    assert!(!text.contains("unstable") && text.contains("time step, worst of"), "{text}");
    // In 20 steps, the pusher does not reach the box.
    let text = checked("task = \"push\"\nhorizon = 20\n");
    assert!(text.contains("loss at the initial parameters: flat"), "{text}");
}

/// With 32 substeps, no perturbation grows over a whole step, but the substeps chatter.
#[test]
#[ignore = "long: more than a hundred substeps of six poles"]
fn substeps_that_chatter_are_not_advised() {
    let dir = TempDir::new().expect("a folder");
    let file = dir.path().join("scene.toml");
    let scene = "scene = 1\ntask = \"cart_pole\"\nhorizon = 100\n[system]\npoles = 6\n\
                 [effects.dry_friction]\nforce = 50.0\nsmoothing = 1e-3\n";
    fs::write(&file, scene).expect("a scene");
    let output = physgrad(&["check"]).arg(&file).output().expect("the command runs");
    let text = String::from_utf8(output.stdout).expect("text");
    assert!(text.contains("chatters") && text.contains("Use an implicit integrator"), "{text}");
}

#[test]
fn a_check_reports_steps_that_do_not_resolve_the_motion() {
    let dir = TempDir::new().expect("a folder");
    let checked = |scene: &str, args: &[&str]| {
        let file = dir.path().join("scene.toml");
        fs::write(&file, format!("scene = 1\n{scene}")).expect("a scene");
        let output = physgrad(&["check"]).arg(&file).args(args).output().expect("the command runs");
        String::from_utf8(output.stdout).expect("text")
    };
    let small = ["--set", "policy.widths=[8]"];
    // Steps of 3 s, in which a pole falls and turns.
    let text = checked("task = \"cart_pole\"\nhorizon = 20\n[system]\ndt = 3\n", &small);
    assert!(!text.contains("not the step"), "{text}");
    // Rollouts diverge with one step, and with two half steps in place of it.
    let damped = "task = \"cart_pole\"\nhorizon = 50\n[system]\ndt = 0.08\n[effects.pole_damping]\ndamping = 5.0\n";
    let text = checked(damped, &small);
    assert!(text.contains("not with 8 times as many substeps. Shorten the step"), "{text}");
    // Friction damps the angular velocity at λ = 750 / (s viscous) with viscous = 13.33, so λ dt is
    // 100. The implicit midpoint rule multiplies it by (1 - 50) / (1 + 50) = -0.961; the
    // printed bound is -0.92.
    let rubbed = "task = \"pendulum\"\nhorizon = 10\n[[system.arms]]\nviscous = 13.333333333333\n[integrator]\nmethod = \"implicit_midpoint\"\n";
    let text = checked(rubbed, &small);
    assert!(
        text.contains("rings")
            && text.contains("omega_1 changes its sign")
            && text.contains("multiplier about -0.9"),
        "{text}"
    );
    // The ball rebounds with four fifths of its speed, in single steps.
    let output = physgrad(&["check", "bounce"]).output().expect("the command runs");
    let text = String::from_utf8(output.stdout).expect("text");
    assert!(text.contains("time step, worst of") && !text.contains("rings"), "{text}");
    // Control limits: the trained controls of the file exceed them, and the check follows the file.
    let limited = "task = \"pendulum\"\nhorizon = 20\n[actuator]\nlimit = { bound = 0.85, kind = \"hard\" }\n[policy]\nwidths = [4]\n";
    let text = checked(limited, &[]);
    assert!(text.contains("kinks: none"), "{text}");
    physgrad(&[
        "train",
        "scene.toml",
        "--epochs",
        "3",
        "--quiet",
        "-o",
        "run",
        "--set",
        "policy.zero_init_output=false",
    ])
    .args(["--set", "training.train_samples=8", "--set", "training.test_samples=8"])
    .current_dir(dir.path())
    .assert()
    .success();
    let policy = dir.path().join("run");
    let text = checked(limited, &["--policy", policy.to_str().expect("a path")]);
    assert!(text.contains("kink: step: next[1]"), "{text}");
}

#[test]
fn tasks_are_listed_with_their_settings() {
    let output = physgrad(&["tasks"]).assert().success();
    let text = String::from_utf8(output.get_output().stdout.clone()).expect("text");
    assert!(
        text.contains("cart_pole") && text.contains("poles") && text.contains("learning_rate"),
        "{text}"
    );
}

#[test]
fn a_run_killed_25_times_equals_an_uninterrupted_run() {
    let dir = TempDir::new().expect("a folder");
    let [whole, killed] = ["whole", "killed"].map(|name| dir.path().join(name));
    let epochs = ["--epochs", "400", "--save-every", "0", "--threads", "1"];
    train(&whole, &epochs).assert().success();
    let mut random = 12345_u64;
    let mut resume = Vec::new();
    let mut resumed = 0;
    for _ in 0..25 {
        let out = killed.to_str().expect("a path");
        let mut process = std::process::Command::new(assert_cmd::cargo::cargo_bin("physgrad"));
        process
            .args(["train", "cart_pole", "--out", out, "--quiet"])
            .args(SMALL)
            .args(epochs)
            .args(&resume);
        let mut process = process.spawn().expect("the process starts");
        random = random.wrapping_mul(6364136223846793005).wrapping_add(1442695040888963407);
        std::thread::sleep(std::time::Duration::from_millis(20 + (random >> 33) % 120));
        process.kill().expect("the process is killed or has ended");
        let ended = process.wait().expect("the process has ended");
        // A run that is killed before it writes its settings starts again. A run with settings
        // resumes.
        resume = if killed.join("run.toml").exists() { vec!["--resume"] } else { Vec::new() };
        resumed += resume.len();
        assert!(ended.code().is_none_or(|code| code == 0), "a killed run does not resume: {ended}");
    }
    assert!(resumed > 10, "resumed {resumed} of 25 times, not more than 10");
    train(&killed, &["--resume", "--epochs", "400", "--threads", "1"]).assert().success();
    assert_eq!((policy(&killed), numbers(&killed)), (policy(&whole), numbers(&whole)));
}
