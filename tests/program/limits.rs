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
    assert_says(&explain(&format!("scene = 1\ntask = \"cart_pole\"\n{headers}")), "large.toml:3: `a0` is unknown");
}

#[test]
fn lists_of_100000_obstacles_and_400000_layers_are_refused() {
    let obstacles = "[0,0],\n".repeat(100_000);
    let scene = format!("scene = 1\ntask = \"guidance\"\n[effects.obstacles]\ncenters = [\n{obstacles}]\n");
    assert_says(&explain(&scene), "large.toml:4: `effects.obstacles.centers` is a list of 100000; allowed: up to 1000 centers");
    let scene = format!("scene = 1\ntask = \"cart_pole\"\n[policy]\nwidths = [{}]\n", "1,".repeat(400_000));
    assert_says(&explain(&scene), "large.toml:4: `policy.widths` is a list of 400000; allowed: up to 1000 layers");
}

#[test]
fn a_scene_of_100_mb_is_refused() {
    let dir = TempDir::new().expect("a folder");
    let file: PathBuf = dir.path().join("large.toml");
    File::create(&file).and_then(|file| file.set_len(100_000_000)).expect("a file");
    assert_says(&refusal(physgrad(&["explain"]).arg(&file)), "large.toml has more than 1000000 bytes");
}

#[test]
fn values_nested_100000_deep_and_keys_of_50001_parts_are_refused() {
    for (open, close) in [("[", "]"), ("{a=", "}")] {
        let scene = format!("scene = 1\ntask = \"cart_pole\"\na = {}1{}\n", open.repeat(100_000), close.repeat(100_000));
        assert_says(&explain(&scene), "large.toml:3: cannot recurse further; max recursion depth met");
    }
    assert_says(&explain(&format!("scene = 1\n{}a = 1\n", "a.".repeat(50_000))), "large.toml cannot be read: recursion limit");
    let said = refusal(&mut physgrad(&["explain", "cart_pole", "--set", &format!("{}a=1", "a.".repeat(50_000))]));
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
    let said = refusal(physgrad(&["train", "cart_pole", "--out"]).arg(&out).env("RAYON_NUM_THREADS", "2000"));
    assert_says(&said, "RAYON_NUM_THREADS is 2000; allowed: 1 to ");
    assert!(!out.exists(), "a refused command creates a folder");
}

#[test]
fn a_horizon_of_1e8_and_500_wide_layers_exceed_the_memory_and_are_refused() {
    let long = ["explain", "cart_pole", "--set", "horizon=100000000"];
    for budget in ["1GB", "900000GB"] {
        let said = refusal(physgrad(&long).args(["--set", &format!("training.memory={budget:?}")]));
        assert_says(&said, "this machine has ");
    }
    // The parameters of 500 layers of width 10,000 need 200 GB in f32.
    let widths = format!("policy.widths=[{}]", ["10000"; 500].join(","));
    assert_says(
        &refusal(&mut physgrad(&["explain", "cart_pole", "--set", &widths, "--set", "training.memory=\"1GB\""])),
        "this machine has ",
    );
}
