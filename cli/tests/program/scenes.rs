//! Scene files: presets, files in place of presets, errors in files, and the schema.

use crate::running::{SMALL, error_of, physgrad, train};
use serde_json::Value;
use std::fs;
use std::path::{Path, PathBuf};
use tempfile::TempDir;
use toml::Table;

/// Returns the command that trains a preset or file and writes to `out`.
fn train_scene(scene: &Path, out: &Path, args: &[&str]) -> assert_cmd::Command {
    let mut command = physgrad(&["train"]);
    command.arg(scene).args(args).arg("--out").arg(out);
    command
}

fn stdout(args: &[&str]) -> String {
    let output = physgrad(args).output().expect("the command runs");
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    String::from_utf8(output.stdout).expect("text")
}

fn presets() -> Vec<String> {
    stdout(&["scene"])
        .lines()
        .map(|line| line.split(' ').next().expect("a name").to_owned())
        .collect()
}

fn settings(run: &Path) -> Table {
    fs::read_to_string(run.join("run.toml")).expect("settings").parse().expect("TOML")
}

fn policy(run: &Path) -> Vec<u8> {
    fs::read(run.join("policy.safetensors")).expect("a policy")
}

fn write(dir: &TempDir, text: &str) -> PathBuf {
    let path = dir.path().join("my_scene.toml");
    fs::write(&path, text).expect("a file");
    path
}

#[test]
fn every_preset_has_the_task_and_the_number_in_its_name() {
    let dir = TempDir::new().expect("a folder");
    let names = presets();
    assert!(names.len() >= 14, "{names:?}");
    for name in &names {
        let out = dir.path().join(name);
        assert!(
            stdout(&["scene", name]).starts_with("# "),
            "the first line of {name} is no description"
        );
        let options = [
            "--epochs",
            "0",
            "--set",
            "training.train_samples=4",
            "--set",
            "training.test_samples=4",
        ];
        train_scene(Path::new(name), &out, &options).assert().success();
        let settings = settings(&out);
        let task = settings["task"].as_str().expect("a task");
        // Names of presets of bodies begin with those of their models, and those of equations are free.
        let model = settings["system"].get("model").and_then(toml::Value::as_str);
        let is_of_model = model.is_some_and(|model| name.starts_with(model));
        let is_named =
            name.starts_with(task) || task == "equations" || task == "bodies" && is_of_model;
        assert!(is_named, "{name}");
        let number = name.rsplit('_').next().and_then(|number| number.parse::<f64>().ok());
        let value = match settings["task"].as_str() {
            Some("cart_pole") => settings["system"]["poles"].as_integer().map(|poles| poles as f64),
            Some("guidance") => settings["loss"]["regularization"].as_float(),
            Some("quantum") => {
                settings["system"]["target"].as_integer().map(|target| target as f64)
            }
            _ => None,
        };
        assert!(number.is_none() || number == value, "{name}: {value:?}");
    }
}

#[test]
fn the_presets_of_the_tasks_of_the_paper_list_all_defaults() {
    let tasks = stdout(&["tasks"]);
    for task in ["cart_pole", "guidance", "quantum"] {
        let listed = tasks.split(&format!("{task}: ")).nth(1).expect("the task").lines().skip(2);
        let listed: String = listed
            .take_while(|line| line.is_empty() || line.starts_with("    "))
            .fold(String::new(), |all, line| all + line + "\n");
        let mut defaults: Table = listed.parse().expect("TOML");
        defaults.remove("physgrad");
        let preset: Table = stdout(&["scene", task]).parse().expect("TOML");
        assert_eq!(preset, defaults, "{task}");
    }
    assert!(stdout(&["scene", "cart_pole"]).contains("# kg"), "the preset has no comments");
}

#[test]
fn a_preset_its_text_and_its_saved_run_train_equally() {
    let dir = TempDir::new().expect("a folder");
    let file = write(&dir, &stdout(&["scene", "cart_pole"]));
    let [of_preset, of_file, again] = ["preset", "file", "again"].map(|name| dir.path().join(name));
    let options = [&SMALL[..], &["--epochs", "2", "--set", "training.clip=norm"]].concat();
    train_scene(Path::new("cart_pole"), &of_preset, &options).assert().success();
    train_scene(&file, &of_file, &options).assert().success();
    assert!(policy(&of_preset) == policy(&of_file));
    train_scene(&of_file.join("run.toml"), &again, &[]).assert().success();
    assert!(policy(&again) == policy(&of_file));
    assert_eq!(settings(&again), settings(&of_preset));
    assert_eq!(settings(&again)["training"]["clip_limit"].as_float(), Some(1.0));
}

#[test]
fn absent_settings_have_the_defaults_of_the_task() {
    let dir = TempDir::new().expect("a folder");
    let file = write(
        &dir,
        "scene = 1\ntask = \"cart_pole\"\nepochs = 0\n[system]\ncart_mass = 2\n[training]\ntrain_samples = 8\n",
    );
    let out = dir.path().join("run");
    train_scene(&file, &out, &["--quiet"]).assert().success();
    let settings = settings(&out);
    assert_eq!(settings["system"]["cart_mass"].as_float(), Some(2.0));
    assert_eq!(settings["system"]["poles"].as_integer(), Some(2), "the default of the task");
    assert!(
        !settings.contains_key("effects") && !settings.contains_key("actuator"),
        "absent sections are written"
    );
    assert!(settings["training"].get("clip_limit").is_none(), "an unused setting is written");

    // `compare` and `check` also accept a scene file.
    let compare = dir.path().join("compare");
    physgrad(&["compare"])
        .arg(&file)
        .args(["--epochs", "1", "--fields", "R", "--seeds", "1", "--out"])
        .arg(&compare)
        .assert()
        .success();
    assert!(compare.join("runs/R-0/run.toml").exists());
    let mut check = physgrad(&["check", "my_scene.toml"]);
    let checks = check.current_dir(dir.path()).output().expect("the command runs");
    assert!(String::from_utf8_lossy(&checks.stdout).contains("my_scene.toml: system"));
}

#[test]
fn a_resampled_run_resumes_with_equal_bits_and_a_decay_fixes_the_number_of_epochs() {
    let dir = TempDir::new().expect("a folder");
    let file = write(
        &dir,
        "scene = 1\ntask = \"cart_pole\"\nepochs = 3\n[training]\nresample = true\ndecay = \"cosine\"\nwarm_up = 2\n",
    );
    let [whole, part] = ["whole", "part"].map(|name| dir.path().join(name));
    train_scene(&file, &whole, &SMALL).assert().success();
    assert_eq!(settings(&whole)["training"]["decay_end"].as_float(), Some(0.01));
    // A decay over two epochs has other learning rates than a decay over three.
    train_scene(&file, &part, &[&SMALL[..], &["--epochs", "2"]].concat()).assert().success();
    let error = error_of(&mut train_scene(&file, &part, &["--resume", "--epochs", "3"]));
    assert!(
        error.contains("only while `training.decay` is constant") && error.contains("epochs = 3"),
        "{error}"
    );
    // With a constant rate after the warm-up, a run can resume with more epochs.
    let constant = |out: &Path, args: &[&str]| {
        train_scene(
            &file,
            out,
            &[&SMALL[..], &["--set", "training.decay=constant"], args].concat(),
        )
        .assert()
        .success();
    };
    let [whole, part, other] =
        ["constant", "constant_part", "fixed"].map(|name| dir.path().join(name));
    constant(&whole, &[]);
    constant(&part, &["--epochs", "2"]);
    constant(&part, &["--epochs", "3", "--resume"]);
    assert!(policy(&part) == policy(&whole));
    constant(&other, &["--set", "training.resample=false"]);
    assert!(policy(&other) != policy(&whole));
}

#[test]
fn discount_control_truncation_and_cut_change_r_and_their_neutral_values_do_not() {
    let dir = TempDir::new().expect("a folder");
    let file = write(&dir, "scene = 1\ntask = \"cart_pole\"\nepochs = 1\n");
    // In the 25 steps of `SMALL`, the adjoint of R does not grow. The horizon is therefore 100.
    let trained = |field: &str, setting: &str| {
        let out = dir.path().join(format!("{field}_{setting}"));
        train_scene(
            &file,
            &out,
            &[&SMALL[..], &["--field", field, "--set", setting, "--set", "horizon=100"]].concat(),
        )
        .assert()
        .success();
        policy(&out)
    };
    for (field, setting, message) in [
        ("S", "discount=0.5", "`training.discount` is 0.5, but has no effect: field stopped omits"),
        ("S", "truncation=5", "`training.truncation` is 5, but has no effect: field stopped omits"),
        ("S", "cut=5", "`training.cut` is 5, but has no effect: field stopped omits all paths"),
        ("R", "truncation=99", "`training.truncation` is 99, but has no effect: `horizon` is 25"),
        (
            "S",
            "estimator=zeroth_order",
            "`field` is stopped, but has no effect: `training.estimator` is zeroth_order",
        ),
        (
            "R",
            "average=0.9",
            "`training.average` is 0.9, but has no effect: field regular has no second gradient",
        ),
        (
            "M",
            "control=0.5",
            "`training.control` is 0.5, but has no effect: field modified omits the path",
        ),
    ] {
        let setting = format!("training.{setting}");
        let args = [&SMALL[..], &["--field", field, "--set", &setting]].concat();
        let refused = train_scene(&file, &dir.path().join("refused"), &args).output();
        let stderr = refused.expect("the command runs").stderr;
        let key = if message.starts_with("`field`") {
            "--field".to_owned()
        } else {
            format!("--set {setting}")
        };
        let (stderr, message) = (String::from_utf8_lossy(&stderr), format!("{key}: {message}"));
        assert!(stderr.contains(&message), "{message}\n{stderr}");
    }
    let (regular, stopped) =
        (trained("R", "training.discount=1"), trained("S", "training.discount=1"));
    assert!(trained("R", "training.discount=0") == stopped, "R without any path differs from S");
    assert!(
        trained("R", "training.control=0") == trained("M", "training.control=1"),
        "R without observations differs from M"
    );
    let mut different = vec![regular.clone(), stopped];
    for (key, neutral, value) in [
        ("discount", "1", "0.9"),
        ("control", "1", "0.9"),
        ("truncation", "100", "10"),
        ("cut", "300", "0.001"),
    ] {
        let of = |value: &str| trained("R", &format!("training.{key}={value}"));
        assert!(of(neutral) == regular, "{key} of {neutral} changes R");
        different.push(of(value));
    }
    for (i, policy) in different.iter().enumerate() {
        assert!(!different[..i].contains(policy), "trainings {i} and an earlier one are equal");
    }
}

/// First lines of a cart-pole scene.
const CART_POLE: &str = "scene = 1\ntask = \"cart_pole\"\n";

#[test]
fn errors_in_a_file_name_the_line_and_the_allowed_values() {
    let dir = TempDir::new().expect("a folder");
    let out = dir.path().join("run");
    for (text, message) in [
        (
            "[training]\nlerning_rate = 1\n",
            "my_scene.toml:4: `training.lerning_rate` is unknown; allowed: `batch`, `train_samples`",
        ),
        ("\n[sytem]\npoles = 1\n", "my_scene.toml:4: `sytem` is unknown; allowed: "),
        ("[effects.wind]\nspeed = 1\n", "my_scene.toml:3: `effects.wind` is unknown; allowed: "),
        ("[actuator]\nlog = 1\n", "my_scene.toml:4: `actuator.log` is unknown; allowed: "),
        (
            "[system]\nenabled = false\n",
            "my_scene.toml:4: `system.enabled` is unknown; allowed: `model`, `poles`",
        ),
        (
            "[training]\nclip_limit = 2\n",
            "my_scene.toml:4: `training.clip_limit` is 2, but has no effect: `training.clip` is none",
        ),
        (
            "[system]\npoles = \"two\"\n",
            "my_scene.toml:4: `system.poles` is string \"two\"; allowed: a whole number",
        ),
        (
            "[policy]\nwidths = [\n  8,\n  true,\n]\n",
            "my_scene.toml:6: `policy.widths[1]` is boolean `true`; allowed: a whole number",
        ),
        (
            "policy = { widths = [0] }\n",
            "my_scene.toml:3: `policy.widths` has 0; allowed: 1 to 10000",
        ),
        ("system = 4\n", "my_scene.toml:3: `system` is integer `4`; allowed: a section"),
        ("system = [4]\n", "my_scene.toml:3: `system` is a list; allowed: a section"),
        (
            "policy = { widths = 4 }\n",
            "my_scene.toml:3: `policy.widths` is integer `4`; allowed: a list",
        ),
        (
            "[training]\noptimizer = 3\n",
            "my_scene.toml:4: `training.optimizer` is integer `3`; allowed: `adam`, ",
        ),
        ("system.dt = -1\n", "my_scene.toml:3: `system.dt` is -1; allowed: a positive number"),
        ("epochs = -1\n", "my_scene.toml:3: `epochs` is integer `-1`; allowed: a whole number"),
        (
            "field = \"sideways\"\n",
            "my_scene.toml:3: `field` is invalid: unknown field `sideways`; expected combined, ",
        ),
        ("precision = \"f16\"\n", "my_scene.toml:3: `precision` is `f16`; allowed: `f32` or `f64`"),
        ("horizon = \n", "my_scene.toml:3: "),
        (
            "[effects.bumpers]\nenabled = false\n",
            "my_scene.toml:4: `effects.bumpers.enabled` is unknown; allowed: `half_travel`",
        ),
        (
            "[effects.bumpers]\nhalf_travel = \"far\"\n",
            "my_scene.toml:4: `effects.bumpers.half_travel` is string \"far\"; allowed: a number",
        ),
        (
            "[training]\nmemory = 10\n",
            "my_scene.toml:4: `training.memory` is integer `10`; allowed: a number of bytes such as \"64MB\"",
        ),
        (
            "[vary]\n\"system.dt\" = { uniform = [0.01, 0.02] }\n",
            "my_scene.toml:4: `system.dt` cannot vary and cannot be fitted; settings that can: `system.cart_mass`, `system.pole_mass`, \
             `system.half_length`, `system.gravity`",
        ),
        (
            "[vary]\n\"system.pole_mass\" = { normal = [1.0, 0.5] }\n",
            "my_scene.toml:4: `system.pole_mass` is -0.5 in { normal = [1.0, 0.5] }, which reaches 3 standard deviations; \
             allowed: a positive number",
        ),
        (
            "[training]\nresample = 1\n",
            "my_scene.toml:4: `training.resample` is integer `1`; allowed: a boolean",
        ),
        (
            "[training]\ndecay = \"linear\"\n",
            "my_scene.toml:4: `training.decay` is `linear`; allowed: `constant`, `cosine`, `exponential`",
        ),
        (
            "[training]\ndecay_end = 0.1\n",
            "my_scene.toml:4: `training.decay_end` is 0.1, but has no effect: `training.decay` is constant",
        ),
        (
            "[training]\ndecay = \"exponential\"\ndecay_end = 0\n",
            "my_scene.toml:5: `training.decay_end` is 0; allowed: a positive number up to 1",
        ),
        (
            "[training]\ndecay = \"cosine\"\ndecay_end = 2\n",
            "my_scene.toml:5: `training.decay_end` is 2; allowed: 0 to 1",
        ),
        (
            "[training]\nwarm_up = -1\n",
            "my_scene.toml:4: `training.warm_up` is integer `-1`; allowed: a whole number",
        ),
        (
            "[training]\ndiscount = 1.5\n",
            "my_scene.toml:4: `training.discount` is 1.5; allowed: 0 to 1",
        ),
        (
            "[training]\naverage = 1\n",
            "my_scene.toml:4: `training.average` is 1; allowed: 0 to below 1",
        ),
        (
            "[training]\ntruncation = 0\n",
            "my_scene.toml:4: `training.truncation` is 0; allowed: 1 to 1000000000",
        ),
        (
            "[training]\ncut = 0\n",
            "my_scene.toml:4: `training.cut` is 0; allowed: a positive number",
        ),
        (
            "[training]\nestimator = \"best\"\n",
            "my_scene.toml:4: `training.estimator` is `best`; allowed: `exact`, `first_order`, ",
        ),
        (
            "[training]\npairs = 4\n",
            "my_scene.toml:4: `training.pairs` is 4, but has no effect: `training.estimator` is exact",
        ),
        (
            "[training]\nestimator = \"zeroth_order\"\ntolerance = 1\n",
            "my_scene.toml:5: `training.tolerance` is 1, but has no effect: `training.estimator` is not alpha_order",
        ),
        (
            "[training]\nestimator = \"zeroth_order\"\ncut = 1\n",
            "`training.cut` is 1, but has no effect: `training.estimator` is zeroth_order",
        ),
        (
            "[policy]\nwidths = []\nactivation = \"relu\"\n",
            "my_scene.toml:5: `policy.activation` is relu, but has no effect: `policy.widths` is []",
        ),
        (
            "[training]\nestimator = \"inverse_variance\"\npairs = 1\n",
            "my_scene.toml:5: `training.pairs` is 1; allowed: 2 to 100000",
        ),
        (
            "[loss]\nmode = \"final\"\n",
            "my_scene.toml:4: `loss.mode` is `final`; allowed: `terminal` or `running`",
        ),
        (
            "[effects.dry_friction]\n\nsmoothing = 0\n",
            "my_scene.toml:5: `effects.dry_friction.smoothing` is 0; allowed: a positive number",
        ),
        (
            "[effects.steady_wind]\ngust = 1\n",
            "my_scene.toml:4: `effects.steady_wind.gust` is unknown; allowed: `speed`",
        ),
        (
            "[effects.steady_wind]\n[effects.gusty_wind]\n",
            "my_scene.toml:4: `effects.gusty_wind` cannot be combined with `effects.steady_wind`: both set the wind speed; allowed: one of them",
        ),
        (
            "[effects.cubic]\nstrength = 1\n",
            "my_scene.toml:3: `effects.cubic` is an effect of quantum, not of cart_pole; allowed here: pole_damping, ",
        ),
        (
            "[actuator.limit]\nkind = \"hard\"\n",
            "my_scene.toml:3: `actuator.limit.bound` is missing",
        ),
        (
            "[actuator.lag]\ntime = 0\n",
            "my_scene.toml:4: `actuator.lag.time` is 0; allowed: a positive number",
        ),
        (
            "[actuator.delay]\nsteps = 0\n",
            "my_scene.toml:4: `actuator.delay.steps` is 0; allowed: 1 to 1000",
        ),
        ("epochs = 1\nepochs = 2\n", "my_scene.toml:4: "),
    ] {
        let file = write(&dir, &format!("{CART_POLE}{text}"));
        let error = error_of(&mut train_scene(&file, &out, &[]));
        assert!(error.contains(message), "{message}\n{error}");
        assert!(!out.exists(), "a refused scene creates a folder");
    }
    for (text, message) in [
        (
            "task = \"cart_pole\"\n",
            "my_scene.toml: `scene` is missing; a scene begins with `scene = 1`",
        ),
        ("scene = 1\n", "my_scene.toml: `task` is missing; allowed: cart_pole, guidance, quantum"),
        (
            "scene = 2\ntask = \"cart_pole\"\n",
            "my_scene.toml:1: `scene` is 2; this version of physgrad reads scenes of version 1",
        ),
        (
            "scene = 1\ntask = \"quantum\"\n[effects]\nharmonic = {}\nbarrier = {}\n",
            "my_scene.toml:5: `effects.barrier` cannot be combined with `effects.harmonic`: there is one static potential",
        ),
        (
            "scene = 1\ntask = \"quantum\"\n[actuator.lag]\ntime = 1\n",
            "my_scene.toml:3: `actuator.lag` adds to the state, and the network of this task observes only the wave function",
        ),
        (
            "scene = 1\ntask = \"guidance\"\n[effects.obstacles]\ncenters = [[0, 0], [1, nan]]\n",
            "my_scene.toml:4: `effects.obstacles.centers[1][1]` is NaN; allowed: a finite number",
        ),
        (
            "scene = 1\ntask = \"guidance\"\n[effects.obstacles]\ncenters = [[0, 0, 1]]\n",
            "my_scene.toml:4: `effects.obstacles.centers[0]` has 3 entries; allowed: a list of 2",
        ),
        (
            "scene = 1\ntask = \"guidance\"\n[effects.obstacles]\ncenters = []\n",
            "my_scene.toml:4: `effects.obstacles.centers` is []; allowed: one center or more, each [x, y]",
        ),
        (
            "scene = 1\ntask = \"quantum\"\n[effects.absorbing_edges]\nwidth = 1.5\n",
            "my_scene.toml:4: `effects.absorbing_edges.width` is 1.5; allowed: more than 0, up to 1, half the length of the box",
        ),
        (
            "scene = 1\ntask = \"cart_pool\"\n",
            "my_scene.toml:2: `task` is \"cart_pool\"; allowed: cart_pole, guidance, quantum",
        ),
    ] {
        let error = error_of(&mut train_scene(&write(&dir, text), &out, &[]));
        assert!(error.contains(message), "{message}\n{error}");
    }
    let error = error_of(&mut train_scene(&dir.path().join("nowhere.toml"), &out, &[]));
    assert!(error.contains("cannot read") && error.contains("nowhere.toml"), "{error}");
    let error = error_of(&mut physgrad(&["train", "cart_pool"]));
    assert!(
        error.contains("there is no preset `cart_pool`; presets: cart_pole, ")
            && error.contains("ends in .toml"),
        "{error}"
    );
}

#[test]
fn errors_distinguish_command_line_and_file() {
    let dir = TempDir::new().expect("a folder");
    let out = dir.path().join("run");
    let file = write(&dir, &format!("{CART_POLE}[system]\ndt = -1\n"));
    let error = error_of(&mut train_scene(&file, &out, &["--set", "system.dt=-2"]));
    assert!(error.contains("error: --set system.dt=-2: `system.dt` is -2"), "{error}");
    let error = error_of(&mut train_scene(&file, &out, &["--set", "system.poles=1"]));
    assert!(error.contains("my_scene.toml:4: `system.dt` is -1"), "{error}");
    for (set, message) in [
        ("effects.wind.speed=1", "--set effects.wind.speed=1: `effects.wind` is unknown"),
        ("task=quantum", "`task` defines the meaning of the other settings"),
        ("scene=2", "`scene` defines the meaning of the other settings"),
        ("system.dt.unit=s", "`system.dt` is not a section"),
        (
            "integrator.method=rk5",
            "`integrator.method` is `rk5`; allowed: euler, semi_implicit, verlet, heun, implicit_midpoint, sdirk2, rk4, tsit5, \
             adaptive; or omit it for the native scheme\n",
        ),
    ] {
        let error = error_of(&mut train_scene(&file, &out, &["--set", set]));
        assert!(error.contains(message), "{message}\n{error}");
    }
    for (task, set, message) in [
        ("push", "system.masses=[1]", "`system.masses` has 1 entry; allowed: a list of 2"),
        ("push", "system.masses=[1, 2, 3]", "`system.masses` has 3 entries; allowed: a list of 2"),
        ("quantum", "integrator.method=rk5", "is `rk5`; allowed: pade, strang; or omit it"),
        ("lqr", "system.spread={start = 1}", "cannot be fitted, nor can another setting"),
    ] {
        let error = error_of(&mut physgrad(&["explain", task, "--set", set]));
        assert!(error.contains(message), "{message}\n{error}");
    }
}

#[test]
fn set_adds_steady_wind_and_without_removes_gusty_wind_and_lag() {
    let dir = TempDir::new().expect("a folder");
    let out = dir.path().join("run");
    let options = [&SMALL[..], &["--epochs", "1"]].concat();
    let change =
        ["--without", "gusty_wind", "--without", "lag", "--set", "effects.steady_wind.speed=1"];
    train_scene(Path::new("cart_pole_windy"), &out, &[&options[..], &change[..]].concat())
        .assert()
        .success();
    let settings = settings(&out);
    let parts = |section: &str| {
        settings[section].as_table().expect("a section").keys().cloned().collect::<Vec<_>>()
    };
    assert_eq!(parts("effects"), ["pole_damping", "dry_friction", "steady_wind", "bumpers"]);
    assert_eq!(parts("actuator"), ["limit"]);
    assert_eq!(
        settings["effects"]["steady_wind"]["cart_drag"].as_float(),
        Some(0.06),
        "the default of the effect"
    );
}

#[test]
fn the_same_command_resumes_a_run_and_another_scene_prints_its_differences() {
    let dir = TempDir::new().expect("a folder");
    let out = dir.path().join("run");
    let start = [&SMALL[..], &["--epochs", "1", "--without", "actuator.lag"]].concat();
    train_scene(Path::new("cart_pole_windy"), &out, &start).assert().success();
    let resume = [&SMALL[..], &["--epochs", "2", "--without", "actuator.lag", "--resume"]].concat();
    train_scene(Path::new("cart_pole_windy"), &out, &resume).assert().success();

    let file = write(&dir, &format!("{CART_POLE}[system]\ndt = 0.5\n"));
    let output = train_scene(&file, &out, &["--epochs", "3", "--resume"])
        .assert()
        .success()
        .get_output()
        .clone();
    let stderr = String::from_utf8(output.stderr).expect("UTF-8");
    assert!(
        stderr.contains("resumes with its saved settings") && stderr.contains("system.dt = 0.5"),
        "{stderr}"
    );

    let error = error_of(&mut train_scene(&out, &dir.path().join("again"), &[]));
    assert!(error.contains("is a folder, not a scene") && error.contains("run.toml"), "{error}");
}

#[test]
fn trajectories_name_actuator_states_the_phase_of_gusts_and_applied_forces() {
    let dir = TempDir::new().expect("a folder");
    let options = [&SMALL[..], &["--epochs", "1", "--set", "actuator.delay.steps=2"]].concat();
    train_scene(Path::new("cart_pole_windy"), dir.path(), &options).assert().success();
    let text = fs::read_to_string(dir.path().join("trajectory.csv")).expect("trajectories");
    let header = text.lines().next().expect("a header");
    assert!(
        header.ends_with(
            "omega_2,force_in_1,force_in_2,force_before,start_of_gusts,force,force_applied"
        ),
        "{header}"
    );
    let widths: Vec<usize> = text.lines().map(|line| line.split(',').count()).collect();
    assert!(
        widths.iter().all(|&width| width == widths[0]),
        "the rows have different numbers of columns"
    );
}

/// Checks, at each step, Newton's second law for a block without friction, and the limit, delay and
/// lag of its motor.
#[test]
fn the_force_of_a_row_accelerates_the_block_to_the_next_row() {
    const SCENE: &str = "
        scene = 1
        task = 'slider'
        precision = 'f64'
        epochs = 1
        horizon = 12
        system = { mass = 2.0, coefficient = 0.0, dt = 0.05 }
        actuator = { limit = { bound = 0.01, kind = 'hard' }, delay = { steps = 2 }, lag = { time = 0.1 } }
        training = { train_samples = 4, test_samples = 2 }
    ";
    let dir = TempDir::new().expect("a folder");
    let out = dir.path().join("run");
    train_scene(&write(&dir, SCENE), &out, &[]).assert().success();
    let mut csv = csv::Reader::from_path(out.join("trajectory.csv")).expect("trajectories");
    let header = csv.headers().expect("a header").clone();
    assert_eq!(
        header.iter().collect::<Vec<_>>()[3..],
        ["x", "x_dot", "push_in_1", "push_in_2", "push_before", "push", "push_applied"]
    );
    let rows: Vec<Vec<Option<f64>>> = csv
        .records()
        .map(|row| row.expect("a row").iter().map(|cell| cell.parse().ok()).collect())
        .collect();
    assert_eq!(rows.len(), 2 * 13);
    let column = |name: &str| header.iter().position(|own| own == name).expect("a column");
    let mut largest = 0.0f64;
    for rollout in rows.chunks(13) {
        let number = |t: usize, name: &str| rollout[t][column(name)].expect("a number");
        let mut motor = 0.0;
        for (t, row) in rollout[..12].iter().enumerate() {
            let delayed = if t < 2 { 0.0 } else { number(t - 2, "push").clamp(-0.01, 0.01) };
            motor = delayed + (motor - delayed) * (-0.05f64 / 0.1).exp();
            let accelerating = 2.0 * (number(t + 1, "x_dot") - number(t, "x_dot")) / 0.05;
            for force in [motor, accelerating] {
                assert!(
                    (number(t, "push_applied") - force).abs() < 1e-12,
                    "step {t}: {force}, {row:?}"
                );
            }
            assert_eq!(number(t + 1, "push_before"), number(t, "push_applied"));
            largest = largest.max(motor.abs());
        }
        assert_eq!([rollout[12][column("push")], rollout[12][column("push_applied")]], [None; 2]);
    }
    assert!(
        largest > 0.005,
        "the largest force of the motor is {largest} N, not more than 0.005 N"
    );
}

#[test]
fn without_wind_is_refused_if_the_scene_has_no_effect() {
    let dir = TempDir::new().expect("a folder");
    let error = error_of(&mut train(dir.path(), &["--without", "wind"]));
    assert!(
        error.contains("--without wind: preset cart_pole has no such effect or part of the actuator or the sensor; it has none"),
        "{error}"
    );
}

/// Checks that each key of a table is a property of the schema, with a description. All keys except
/// sections, `scene` and `task` need a default. The schema must refuse other keys. The first kind of
/// a policy is the default.
fn assert_described(schema: &Value, table: &Table, path: &str) {
    let kinds = &schema["oneOf"];
    let schema = if kinds.is_array() { &kinds[0] } else { schema };
    for (key, value) in table {
        let property = &schema["properties"][key];
        assert!(property.is_object(), "{path}.{key} is missing: {schema}");
        assert!(property["description"].is_string(), "{path}.{key} is not described");
        match value {
            toml::Value::Table(section) => assert_described(property, section, key),
            _ => assert!(
                !property["default"].is_null() || ["scene", "task"].contains(&&**key),
                "{path}.{key} has no default"
            ),
        }
    }
    assert_eq!(schema["additionalProperties"], false, "{path}");
}

#[test]
fn the_schema_has_one_branch_per_task_with_every_setting() {
    let dir = TempDir::new().expect("a folder");
    let file = dir.path().join("schema.json");
    physgrad(&["schema", "--out"]).arg(&file).assert().success();
    let text = fs::read_to_string(&file).expect("a schema");
    assert_eq!(text, stdout(&["schema"]));
    let schema: Value = serde_json::from_str(&text).expect("JSON");
    let branches = schema["oneOf"].as_array().expect("branches");
    for task in ["cart_pole", "guidance", "quantum"] {
        let of_task = |branch: &&Value| branch["properties"]["task"]["const"] == task;
        let branch = branches.iter().find(of_task).expect("a branch of the task");
        assert_eq!(branch["required"], serde_json::json!(["scene", "task"]));
        assert_described(branch, &stdout(&["scene", task]).parse().expect("TOML"), task);
        // Scenes may also have these sections. The schema does not restrict their keys.
        assert!(
            ["vary", "fit"].iter().all(|section| branch["properties"][section]["type"] == "object"),
            "{branch}"
        );
        let training = &branch["properties"]["training"]["properties"];
        assert!(training["clip_limit"].is_object() && training["decay_end"].is_object());
        assert_eq!(
            training["decay"]["enum"],
            serde_json::json!(["constant", "cosine", "exponential"])
        );
        // Keys without a default are required within a section. The section itself is optional.
        let actuator = &branch["properties"]["actuator"];
        assert_eq!(actuator["required"], Value::Null);
        assert_eq!(actuator["properties"]["limit"]["required"], serde_json::json!(["bound"]));
    }
}
