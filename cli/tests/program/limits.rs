//! The program refuses inputs that are too large or too deeply nested. It ends within 10 s, with a
//! message.

use crate::running::physgrad;
use assert_cmd::Command;
use std::fs::{self, File};
use std::path::PathBuf;
use std::time::Duration;
use tempfile::TempDir;

/// Time limit for a refusal.
const TIME_LIMIT: Duration = Duration::from_secs(10);

/// Returns the error message of a command that refuses its input.
fn refusal(command: &mut Command) -> String {
    let output = command.timeout(TIME_LIMIT).output().expect("the command runs");
    let said = String::from_utf8_lossy(&output.stderr).into_owned();
    assert_eq!(output.status.code(), Some(1), "{said}");
    said
}

fn explain(scene: &str) -> String {
    let dir = TempDir::new().expect("a folder");
    let file = dir.path().join("large.toml");
    fs::write(&file, scene).expect("a file");
    refusal(physgrad(&["explain"]).arg(file))
}

#[track_caller]
fn assert_says(said: &str, message: &str) {
    assert!(said.contains(message) && said.len() < 1000, "{message}\n{said:.2000}");
}

#[test]
fn a_scene_with_80000_unknown_sections_is_refused_within_10_s() {
    let headers: String = (0..80_000).map(|i| format!("[a{i}]\n")).collect();
    assert_says(
        &explain(&format!("scene = 1\ntask = \"cart_pole\"\n{headers}")),
        "large.toml:3: `a0` is unknown",
    );
}

#[test]
fn lists_of_100000_obstacles_and_400000_layers_are_refused() {
    let obstacles = "[0,0],\n".repeat(100_000);
    let scene =
        format!("scene = 1\ntask = \"guidance\"\n[effects.obstacles]\ncenters = [\n{obstacles}]\n");
    assert_says(
        &explain(&scene),
        "large.toml:4: `effects.obstacles.centers` is a list of 100000; allowed: up to 1000 centers",
    );
    let scene =
        format!("scene = 1\ntask = \"cart_pole\"\n[policy]\nwidths = [{}]\n", "1,".repeat(400_000));
    assert_says(
        &explain(&scene),
        "large.toml:4: `policy.widths` is a list of 400000; allowed: up to 1000 layers",
    );
}

#[test]
fn a_scene_of_100_mb_is_refused() {
    let dir = TempDir::new().expect("a folder");
    let file: PathBuf = dir.path().join("large.toml");
    File::create(&file).and_then(|file| file.set_len(100_000_000)).expect("a file");
    assert_says(
        &refusal(physgrad(&["explain"]).arg(&file)),
        "large.toml has more than 1000000 bytes",
    );
}

#[test]
fn values_nested_100000_deep_and_keys_of_50001_parts_are_refused() {
    for (open, close) in [("[", "]"), ("{a=", "}")] {
        let scene = format!(
            "scene = 1\ntask = \"cart_pole\"\na = {}1{}\n",
            open.repeat(100_000),
            close.repeat(100_000)
        );
        assert_says(
            &explain(&scene),
            "large.toml:3: cannot recurse further; max recursion depth met",
        );
    }
    assert_says(
        &explain(&format!("scene = 1\n{}a = 1\n", "a.".repeat(50_000))),
        "large.toml cannot be read: recursion limit",
    );
    let said = refusal(&mut physgrad(&[
        "explain",
        "cart_pole",
        "--set",
        &format!("{}a=1", "a.".repeat(50_000)),
    ]));
    assert_says(&said, "the key has 50001 parts; allowed: up to 8");
}

#[test]
fn an_assignment_of_two_lines_is_one_invalid_value() {
    let said = refusal(&mut physgrad(&["explain", "cart_pole", "--set", "horizon=3\nseed=1"]));
    assert_says(&said, "`horizon` is string \"3\\nseed=1\"; allowed: a whole number");
}

#[test]
fn two_thousand_threads_are_refused() {
    let dir = TempDir::new().expect("a folder");
    let out = dir.path().join("run");
    let said = refusal(physgrad(&["train", "cart_pole", "--threads", "2000", "--out"]).arg(&out));
    assert_says(&said, "--threads is 2000; allowed: 1 to ");
    let said = refusal(
        physgrad(&["train", "cart_pole", "--out"]).arg(&out).env("RAYON_NUM_THREADS", "2000"),
    );
    assert_says(&said, "RAYON_NUM_THREADS is 2000; allowed: 1 to ");
    assert!(!out.exists(), "a refused command creates a folder");
}

#[test]
fn runs_that_exceed_the_memory_are_refused_although_their_scenes_are_valid() {
    let dir = TempDir::new().expect("a folder");
    let large = |command: &str| {
        let mut command = physgrad(&[command, "cart_pole", "--set", "horizon=100000000"]);
        command.current_dir(dir.path());
        command
    };
    large("explain").assert().success();
    for budget in ["1GB", "900000GB"] {
        for command in ["train", "check", "optimize", "accuracy"] {
            let budget = format!("training.memory={budget:?}");
            let said = refusal(large(command).args(["--set", &budget]));
            assert_says(&said, "this machine has ");
        }
    }
    // The parameters of 500 layers of width 10,000 need 200 GB in f32.
    let widths = format!("policy.widths=[{}]", ["10000"; 500].join(","));
    assert_says(
        &refusal(
            physgrad(&["train", "cart_pole", "--set", &widths])
                .args(["--set", "training.memory=\"1GB\""])
                .current_dir(dir.path()),
        ),
        "this machine has ",
    );
    assert_eq!(fs::read_dir(dir.path()).expect("a folder").count(), 0, "a refusal creates files");
}

#[test]
fn threads_that_cannot_be_created_are_an_error_and_no_panic() {
    let dir = TempDir::new().expect("a folder");
    let physgrad = |args: &[&str]| {
        let mut command = physgrad(args);
        // A stack of 1 PB exceeds the address space, so the system refuses every thread.
        command
            .current_dir(dir.path())
            .env("RUST_MIN_STACK", (1_u64 << 50).to_string())
            .env("RAYON_NUM_THREADS", "2");
        command
    };
    let parallel: [&[&str]; 13] = [
        &["train", "lqr"],
        &["compare", "lqr"],
        &["study", "absent.toml"],
        &["merge", "absent"],
        &["animate", "absent"],
        &["report", "absent"],
        &["eval", "absent"],
        &["export", "absent", "--onnx", "a.onnx"],
        &["robust", "absent", "--grid", "system.dt=1:2:2"],
        &["optimize", "lqr"],
        &["check", "lqr"],
        &["paper", "fig1"],
        &["accuracy", "lqr"],
    ];
    for args in parallel {
        let said = refusal(&mut physgrad(args));
        assert_says(&said, "error: cannot start 2 threads (");
        assert_says(&said, "choose fewer with --threads or RAYON_NUM_THREADS");
    }
    assert_eq!(
        fs::read_dir(dir.path()).expect("a folder").count(),
        0,
        "a refused command creates files"
    );
    for args in
        [&["runs", "."][..], &["explain", "lqr"], &["scene"], &["schema"], &["tasks"], &["effects"]]
    {
        physgrad(args).assert().success();
    }
}

#[test]
fn the_variable_of_the_number_of_threads_is_checked_by_every_command() {
    for (value, message) in [
        ("100000", "is 100000; allowed: 1 to "),
        ("1e30", "is 1e30; allowed"),
        ("-1", "is -1; allowed"),
    ] {
        for args in [&["check", "lqr"][..], &["report", "absent"], &["explain", "lqr"], &["scene"]]
        {
            let said = refusal(physgrad(args).env("RAYON_NUM_THREADS", value));
            assert_says(&said, &format!("RAYON_NUM_THREADS {message}"));
        }
    }
    physgrad(&["explain", "lqr"]).env("RAYON_NUM_THREADS", "0").assert().success();
}

#[test]
fn products_of_two_limits_have_a_limit_of_their_own() {
    let dir = TempDir::new().expect("a folder");
    let rates = format!(
        "training.learning_rate={}",
        (1..=11).map(|i| format!("{i}e-4")).collect::<Vec<_>>().join(",")
    );
    let compare = ["compare", "lqr", "--fields", "R", "--seeds", "10000", "--set", &rates];
    let said = refusal(physgrad(&compare).current_dir(dir.path()));
    assert_says(
        &said,
        "11 combinations of settings, 1 field and 10000 seeds give 110000 runs; allowed: up to 100000",
    );
    let said = refusal(physgrad(&["paper", "fig4", "--seeds", "10000"]).current_dir(dir.path()));
    assert_says(&said, "12 combinations of settings, 4 fields and 10000 seeds give 480000 runs");
    let plan = "seeds = 10000\nbest = { \"training.learning_rate\" = [1e-1, 1e-2, 1e-3] }\n[[task]]\nscene = \"lqr\"\n";
    let methods = ["R", "M", "S", "C"]
        .map(|field| format!("[[method]]\nname = \"{field}\"\nset = {{ field = \"{field}\" }}\n"));
    fs::write(dir.path().join("plan.toml"), plan.to_owned() + &methods.concat()).expect("a plan");
    let said = refusal(physgrad(&["study", "plan.toml"]).current_dir(dir.path()));
    assert_says(&said, "12 combinations of settings, 1 field and 10000 seeds give 120000 runs");
    let said = refusal(physgrad(&["eval", "absent", "--worst", "1000000"]).current_dir(dir.path()));
    assert_says(&said, "--worst is 1000000; allowed: 0 to 100");
}

#[test]
fn the_largest_number_of_epochs_is_a_thousand_million() {
    for epochs in ["9223372036854775807", "1000000001"] {
        let said =
            refusal(&mut physgrad(&["explain", "lqr", "--set", &format!("epochs={epochs}")]));
        assert_says(&said, &format!("`epochs` is {epochs}; allowed: 0 to 1000000000"));
    }
}
