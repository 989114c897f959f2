//! Programs of the user: `cli/examples/own_program.rs` with a task, `cli/examples/scene_effect.rs` with
//! effects and a task, and crates that `physgrad new` creates.

use assert_cmd::Command;
use std::path::{Path, PathBuf};
use std::sync::LazyLock;
use tempfile::TempDir;

pub static PROGRAM: LazyLock<PathBuf> = LazyLock::new(|| example("own_program"));
static WITH_EFFECTS: LazyLock<PathBuf> = LazyLock::new(|| example("scene_effect"));

/// Builds an example in the profile of this test, from the packages and features of `cargo test` in
/// the root of the repository, so that no package is compiled again. `PHYSGRAD_WORKSPACE` stands for
/// its option `--workspace`. Returns the path of the program.
fn example(name: &str) -> PathBuf {
    let mut build = std::process::Command::new(env!("CARGO"));
    build.args(["build", "--quiet", "--example", name]);
    if cfg!(feature = "mpi") {
        build.args(["--features", "physgrad-cli/mpi"]);
    }
    if std::env::var_os("PHYSGRAD_WORKSPACE").is_some() {
        build.arg("--workspace");
    }
    if !cfg!(debug_assertions) {
        build.arg("--release");
    }
    let root = Path::new(env!("CARGO_MANIFEST_DIR")).parent().expect("the root");
    assert!(build.current_dir(root).status().expect("cargo runs").success());
    let tests = std::env::current_exe().expect("the path of this test");
    tests.ancestors().nth(2).expect("a target folder").join("examples").join(name)
}

/// Runs [`PROGRAM`]. Returns the standard output.
fn output(args: &[&str], folder: &Path) -> String {
    output_of(&PROGRAM, args, folder)
}

fn output_of(program: &Path, args: &[&str], folder: &Path) -> String {
    let output =
        Command::new(program).args(args).current_dir(folder).output().expect("the command runs");
    assert!(output.status.success(), "{args:?}: {}", String::from_utf8_lossy(&output.stderr));
    String::from_utf8(output.stdout).expect("text")
}

/// Runs [`PROGRAM`] and asserts that it fails. Returns the standard error.
fn error(args: &[&str], folder: &Path) -> String {
    error_of(&PROGRAM, args, folder)
}

fn error_of(program: &Path, args: &[&str], folder: &Path) -> String {
    let output =
        Command::new(program).args(args).current_dir(folder).output().expect("the command runs");
    assert!(!output.status.success(), "{args:?} succeeds; expected an error");
    String::from_utf8(output.stderr).expect("text")
}

#[test]
fn thirteen_commands_take_the_task_of_the_user() {
    let dir = TempDir::new().expect("a folder");
    let run = |args: &[&str]| output(args, dir.path());
    run(&["train", "ball_beam", "--epochs", "4", "--quiet", "--out", "run"]);
    let state = "r,r_dot,alpha,alpha_dot,torque";
    let trajectory =
        std::fs::read_to_string(dir.path().join("run/trajectory.csv")).expect("a trajectory");
    assert!(trajectory.starts_with(&format!("sample,step,time,{state}")), "{}", &trajectory[..200]);
    let animation =
        std::fs::read_to_string(dir.path().join("run/animation.svg")).expect("an animation");
    assert!(
        animation.contains("roll a ball to the middle"),
        "the animation lacks the title of the task"
    );

    run(&["train", "run/run.toml", "--resume", "--epochs", "6", "--quiet", "--out", "run"]);
    assert_eq!(
        std::fs::read_to_string(dir.path().join("run/metrics.csv"))
            .expect("metrics")
            .lines()
            .count(),
        7
    );
    run(&["report", "run"]);
    run(&["animate", "run"]);
    run(&[
        "compare",
        "ball_beam",
        "--fields",
        "R,C",
        "--seeds",
        "2",
        "--epochs",
        "2",
        "--quiet",
        "--out",
        "compared",
    ]);
    assert!(run(&["check", "ball_beam"]).contains("rollout, R"));
    assert!(run(&["explain", "ball_beam"]).contains("running cost"));
    assert!(
        run(&["accuracy", "ball_beam", "--quiet", "--set", "horizon=5", "--rounds", "1"])
            .contains("native x16")
    );
    assert!(run(&["schema"]).contains("Moment of inertia of the beam J, kg m²"));
    assert!(run(&["tasks"]).contains("roll a ball to the middle"));
    let scene = run(&["scene", "ball_beam"]);
    std::fs::write(
        dir.path().join("own.toml"),
        format!("{scene}[system]\nball = 0.2\n[actuator.lag]\ntime = 0.1\n"),
    )
    .expect("a scene");
    run(&["train", "own.toml", "--epochs", "2", "--quiet", "--out", "lag"]);
    let settings = std::fs::read_to_string(dir.path().join("lag/run.toml")).expect("settings");
    assert!(settings.contains("ball = 0.2"), "{settings}");
    let fitted = "[fit]\n\"system.beam\" = { start = 1 }\n";
    std::fs::write(dir.path().join("fitted.toml"), format!("{scene}{fitted}")).expect("a scene");
    let said = error(&["explain", "fitted.toml"], dir.path());
    let expected = "`system.beam` cannot vary and cannot be fitted; settings that can: `system.ball`, `system.friction` (fields of the \
                    type `Number` that `System::numbers` lists)";
    assert!(said.contains(expected), "{said}");
    // Draws a number of the task for each sample.
    run(&[
        "train",
        "ball_beam",
        "--set",
        "system.ball={uniform=[0.05, 0.2]}",
        "--epochs",
        "2",
        "--quiet",
        "--out",
        "varied",
    ]);
    let trajectory =
        std::fs::read_to_string(dir.path().join("varied/trajectory.csv")).expect("a trajectory");
    assert!(
        trajectory.lines().next().expect("a header").contains("system.ball"),
        "{}",
        &trajectory[..200]
    );
    // Identification from simulated trajectories finds the setting 0.1 of the simulation.
    let unknown =
        "scene = 1\ntask = \"ball_beam\"\n[fit]\n\"system.ball\" = { start = 0.15, min = 0.01 }\n";
    std::fs::write(dir.path().join("unknown.toml"), unknown).expect("a scene");
    run(&["identify", "unknown.toml", "--data", "run/trajectory.csv", "--out", "identified"]);
    let identified =
        std::fs::read_to_string(dir.path().join("identified/identified.csv")).expect("numbers");
    let ball: f64 = identified
        .lines()
        .nth(1)
        .and_then(|row| row.split(',').nth(2))
        .expect("a row")
        .parse()
        .expect("a number");
    assert!((ball - 0.1).abs() < 1e-6, "{ball}");
    assert!(run(&["optimize", "ball_beam", "--out", "plan"]).contains("within its tolerance"));
    run(&[
        "robust",
        "run",
        "varied",
        "--grid",
        "system.ball=0.05:0.2:3",
        "--samples",
        "8",
        "--out",
        "grid",
    ]);
    assert_eq!(
        std::fs::read_to_string(dir.path().join("grid/robust.csv"))
            .expect("a table")
            .lines()
            .count(),
        7
    );
}

#[test]
fn policies_depend_on_the_mass_of_the_ball_and_not_on_the_number_of_threads() {
    let dir = TempDir::new().expect("a folder");
    let trained = |name: &str, more: &[&str]| {
        let args = ["train", "ball_beam", "--epochs", "3", "--quiet", "--out", name];
        output(&[&args, more].concat(), dir.path());
        std::fs::read(dir.path().join(name).join("policy.safetensors")).expect("a policy")
    };
    let one = trained("one", &["--threads", "1"]);
    assert_eq!(one, trained("two", &["--threads", "2"]), "results depend on the number of threads");
    assert_ne!(
        one,
        trained("heavy", &["--set", "system.ball=0.2"]),
        "a setting of the task does not change the policy"
    );
}

#[test]
fn errors_of_a_task_of_the_user_name_the_allowed_settings() {
    let dir = TempDir::new().expect("a folder");
    let message = |setting: &str| error(&["train", "ball_beam", "--set", setting], dir.path());
    assert!(
        message("system.bal=1")
            .contains("`system.bal` is unknown; allowed: `ball`, `friction`, `beam`, `dt`")
    );
    assert!(message("system.ball=-1").contains("`system.ball` is -1; allowed: a positive number"));
    assert!(message("integrator.method=\"rk4\"").contains("native"));
    assert!(error(&["train", "ball_bean"], dir.path()).contains("ball_beam"));
}

#[test]
fn scenes_add_effects_of_the_user_to_built_in_and_own_tasks() {
    let dir = TempDir::new().expect("a folder");
    let run = |args: &[&str]| output_of(&WITH_EFFECTS, args, dir.path());
    let failed = |args: &[&str]| error_of(&WITH_EFFECTS, args, dir.path());
    // Adds an effect of the user, with a drawn number, to a built-in task with a built-in effect.
    let scene = "scene = 1\ntask = \"cart_pole\"\n[effects.gusty_wind]\nspeed = 3\n\
                 [vary]\n\"effects.eddy_brake.force\" = { uniform = [1.0, 8.0] }\n";
    std::fs::write(dir.path().join("brake.toml"), scene).expect("a scene");
    run(&["check", "brake.toml"]);
    run(&["train", "brake.toml", "--epochs", "2", "--quiet", "--out", "run"]);
    run(&["train", "run/run.toml", "--resume", "--epochs", "3", "--quiet", "--out", "run"]);
    run(&["report", "run"]);
    let trajectory =
        std::fs::read_to_string(dir.path().join("run/trajectory.csv")).expect("a trajectory");
    assert!(
        trajectory.contains("start_of_gusts,effects.eddy_brake.force,force"),
        "{}",
        &trajectory[..200]
    );
    run(&[
        "train",
        "brake.toml",
        "--epochs",
        "1",
        "--quiet",
        "--without",
        "eddy_brake",
        "--out",
        "without",
    ]);
    assert!(run(&["schema"]).contains("Largest force, N."));
    // Adds an effect of the user to a task of the user. `explain` counts a product and a sum.
    let explained = run(&["explain", "puck", "--set", "effects.spring.stiffness=3"]);
    let row = explained
        .lines()
        .find(|line| line.contains("effects.spring") && line.contains("┆ step"))
        .expect("a row");
    assert_eq!(row.split('┆').nth(2).map(str::trim), Some("2"), "{row}");
    let trained = |name: &str, more: &[&str]| {
        run(&[&["train", "puck", "--epochs", "1", "--quiet", "--out", name], more].concat());
        std::fs::read(dir.path().join(name).join("policy.safetensors")).expect("a policy")
    };
    assert_ne!(
        trained("free", &[]),
        trained("held", &["--set", "effects.spring.stiffness=3"]),
        "the effect does not change the policy"
    );

    let message = |setting: &str| failed(&["train", "cart_pole", "--set", setting]);
    assert!(
        message("effects.eddy_brake.sped=3")
            .contains("`effects.eddy_brake.sped` is unknown; allowed: `force` or `speed`")
    );
    assert!(message("effects.eddy_brake.speed=-3").contains("is -3; allowed: a positive number"));
    assert!(message("effects.eddy_brake.force=nan").contains("is NaN; allowed: a finite number"));
    assert!(message("effects.edy_brake.speed=3").contains("`bumpers`, `eddy_brake`"));
    assert!(
        message("effects.spring.stiffness=3").contains("is an effect of puck, not of cart_pole")
    );
    assert!(
        failed(&["train", "lqr", "--set", "effects.spring.stiffness=3"])
            .contains("allowed here: none")
    );
}

/// Returns the command `physgrad new` with these arguments, to run in `folder`.
fn new(args: &[&str], folder: &Path) -> Command {
    let mut command = Command::cargo_bin("physgrad").expect("the program is built");
    command.arg("new").args(args).current_dir(folder);
    command
}

#[test]
fn a_new_crate_has_the_name_of_the_task_and_overwrites_nothing() {
    let dir = TempDir::new().expect("a folder");
    new(&["swing_boat"], dir.path()).assert().success();
    let read =
        |file: &str| std::fs::read_to_string(dir.path().join("swing_boat").join(file)).expect(file);
    let source = read("src/main.rs");
    assert!(
        source.contains("impl System for SwingBoat") && source.contains("= \"swing_boat\";"),
        "{source}"
    );
    assert!(!source.contains("BallBeam") && !source.contains("own_program"), "{source}");
    assert!(
        read("Cargo.toml").contains("name = \"swing_boat\"")
            && read("scene.toml").contains("task = \"swing_boat\"")
    );
    let refused = |name: &str| {
        String::from_utf8(new(&[name], dir.path()).assert().failure().get_output().stderr.clone())
            .expect("text")
    };
    assert!(refused("swing_boat").contains("cannot create the folder swing_boat"));
    assert!(refused("slider").contains("built-in task"));
    assert!(refused("Swing-Boat").contains("lower case letters"));
    for (name, reason) in [
        ("self", "is a keyword of Rust"),
        ("crate", "is a keyword of Rust"),
        ("super", "is a keyword of Rust"),
        ("try", "is a keyword of Rust"),
        ("test", "is a crate of Rust or a folder of Cargo"),
        ("std", "is a crate of Rust or a folder of Cargo"),
        ("core", "is a crate of Rust or a folder of Cargo"),
        ("serde", "is a dependency of the new crate"),
        ("physgrad", "is a dependency of the new crate"),
        // The source of the new crate already uses these types.
        ("system", "its type would be `System`"),
        ("mlp", "its type would be `Mlp`"),
        ("exit_code", "its type would be `ExitCode`"),
    ] {
        let error = refused(name);
        assert!(
            error.contains(&format!("`{name}` cannot be the name of a task"))
                && error.contains(reason),
            "{error}"
        );
        assert!(
            error.contains(&format!("for instance `{name}_task`"))
                && !dir.path().join(name).exists(),
            "{error}"
        );
    }
    assert!(refused("Self").contains("allowed: lower case letters"));
    // `Moment` is only a word of a comment in the source of the new crate, so `moment` is allowed.
    new(&["moment"], dir.path()).assert().success();
}

#[cfg(unix)]
#[test]
fn a_new_crate_is_complete_or_absent_and_its_manifest_has_any_path() {
    let dir = TempDir::new().expect("a folder");
    let crates = dir.path().join("crates");
    std::fs::create_dir(&crates).expect("a folder");
    // A limit of one block on the size of files fails as a full disk does.
    let mut limited = std::process::Command::new("sh");
    limited
        .args(["-c", "ulimit -f 1 && exec \"$0\" new swing_boat"])
        .arg(assert_cmd::cargo::cargo_bin!("physgrad"));
    let output = limited.current_dir(&crates).output().expect("the command runs");
    let error = String::from_utf8_lossy(&output.stderr);
    assert!(
        !output.status.success() && error.contains("cannot write the folder swing_boat"),
        "{error}"
    );
    assert_eq!(
        std::fs::read_dir(&crates).expect("a folder").count(),
        0,
        "an incomplete crate is left"
    );
    new(&["swing_boat"], &crates).assert().success();

    let sources = dir.path().join("e\u{301} \"x\"\n\u{7f}");
    std::fs::create_dir(&sources).expect("a folder");
    new(&["paths", "--path"], &crates).arg(&sources).assert().success();
    let manifest = std::fs::read_to_string(crates.join("paths/Cargo.toml")).expect("a manifest");
    let manifest: toml::Table = manifest.parse().expect("TOML");
    let written = manifest["dependencies"]["physgrad"]["path"].as_str().expect("a path");
    assert_eq!(Path::new(written), sources.canonicalize().expect("a folder"));
}

#[test]
fn a_new_crate_for_python_has_one_task_in_program_and_module() {
    let dir = TempDir::new().expect("a folder");
    let output =
        new(&["swing_boat", "--python"], dir.path()).assert().success().get_output().clone();
    let text = String::from_utf8(output.stdout).expect("text");
    assert!(text.contains("src/task.rs") && text.contains("pip install ."), "{text}");
    let read =
        |file: &str| std::fs::read_to_string(dir.path().join("swing_boat").join(file)).expect(file);
    let (task, main, module) = (read("src/task.rs"), read("src/main.rs"), read("src/lib.rs"));
    assert!(task.contains("pub struct SwingBoat {") && task.contains("fn gradients_are_exact"));
    assert!(!task.contains("fn main") && !task.contains("ExitCode"), "{task}");
    for source in [&main, &module] {
        assert!(source.contains("physgrad_cli::program().task::<task::SwingBoat>()"), "{source}");
    }
    let manifest: toml::Table = read("Cargo.toml").parse().expect("TOML");
    let bindings = &manifest["dependencies"]["physgrad-python"];
    assert!(Path::new(bindings["path"].as_str().expect("a path")).join("Cargo.toml").exists());
    assert_eq!(bindings["optional"].as_bool(), Some(true));
    let project: toml::Table = read("pyproject.toml").parse().expect("TOML");
    assert_eq!(project["tool"]["maturin"]["python-source"].as_str(), Some("python"));
    for file in ["__init__.py", "_core.pyi", "py.typed"] {
        let own = Path::new("../python/physgrad").join(file);
        assert_eq!(
            read(&format!("python/physgrad/{file}")),
            std::fs::read_to_string(own).expect(file)
        );
    }
    new(&["other", "--python", "--scene"], dir.path()).assert().failure();
}

/// Builds all dependencies, which takes minutes. To run the test:
/// `cargo test --release -p physgrad-cli --test program -- --ignored`.
#[test]
#[ignore = "builds a crate with all its dependencies"]
fn a_new_crate_passes_its_test_and_trains() {
    let dir = TempDir::new().expect("a folder");
    new(&["swing_boat"], dir.path()).assert().success();
    let cargo = |args: &[&str]| {
        let mut command = std::process::Command::new(env!("CARGO"));
        command
            .args(args)
            .current_dir(dir.path().join("swing_boat"))
            .env_remove("CARGO_TARGET_DIR");
        assert!(command.status().expect("cargo runs").success(), "{args:?}");
    };
    cargo(&["test", "--release"]);
    for command in
        ["check swing_boat", "train scene.toml --epochs 3 --quiet --out run", "report run"]
    {
        cargo(&[&["run", "--release", "--"], &command.split(' ').collect::<Vec<_>>()[..]].concat());
    }
    cargo(&[
        "run",
        "--release",
        "--",
        "compare",
        "scene.toml",
        "--fields",
        "R,C",
        "--seeds",
        "2",
        "--epochs",
        "2",
        "--quiet",
    ]);
}

#[test]
fn a_policy_of_the_user_is_chosen_checked_trained_and_evaluated_in_any_task() {
    let program = example("own_policy");
    let dir = TempDir::new().expect("a folder");
    let chosen = ["--set", "policy.kind=fourier", "--set", "policy.frequencies=2"];
    let run = |args: &[&str]| output_of(&program, &[args, &chosen].concat(), dir.path());
    for task in ["pendulum", "cart_pole_1"] {
        let checked = run(&["check", task]);
        assert!(!checked.contains("FAILED"), "{checked}");
        let small = ["--set", "training.train_samples=8", "--set", "training.test_samples=8"];
        run(&[&["train", task, "--epochs", "1", "--quiet", "--out", task][..], &small].concat());
        output_of(&program, &["eval", task, "--samples", "8"], dir.path());
    }
    let listed = output_of(&program, &["tasks", "pendulum"], dir.path());
    assert!(listed.contains("fourier") && listed.contains("policy.frequencies"), "{listed}");
    let wrong = ["explain", "pendulum", "--set", "policy.kind=fourier"];
    let many = ["--set", "policy.frequencies=1001"];
    let error = error_of(&program, &[&wrong[..], &many].concat(), dir.path());
    assert!(error.contains("`policy.frequencies` is 1001; allowed: 0 to 1000"), "{error}");
}
