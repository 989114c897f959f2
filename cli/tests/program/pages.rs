//! Scenes in the documentation are valid. The program prints the quoted lines of outputs.

use crate::markdown::Page;
use assert_cmd::Command;
use std::fs;
use tempfile::TempDir;

fn physgrad(args: &[&str]) -> Command {
    let mut command = Command::cargo_bin("physgrad").expect("the program is built");
    command.args(args);
    command
}

fn stdout(args: &[&str]) -> String {
    let output = physgrad(args).output().expect("the command runs");
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    String::from_utf8(output.stdout).expect("text")
}

#[test]
fn every_scene_of_three_pages_is_valid() {
    let dir = TempDir::new().expect("a folder");
    for (name, least) in [("docs/scenes.md", 3), ("docs/equations.md", 2), ("README.md", 0)] {
        let page = Page::read(name);
        let scenes: Vec<_> = page.blocks("toml").collect();
        assert!(scenes.len() >= least, "{name} has fewer than {least} scenes");
        for scene in scenes {
            let file = dir.path().join("a_scene.toml");
            fs::write(&file, scene).expect("a file");
            physgrad(&["explain"]).arg(&file).assert().success();
        }
    }
}

#[test]
fn scenes_md_quotes_an_output_of_explain_and_four_errors() {
    let dir = TempDir::new().expect("a folder");
    let page = Page::read("docs/scenes.md");
    let first = page.blocks("toml").next().expect("a scene");
    let file = dir.path().join("windy.toml");
    fs::write(&file, first).expect("a file");
    let mut explain = physgrad(&["explain", "windy.toml"]);
    let output = explain.current_dir(dir.path()).output().expect("the command runs");
    let output = String::from_utf8(output.stdout).expect("text");
    let shown = page
        .blocks("text")
        .find(|block| block.starts_with("windy.toml: "))
        .expect("an explanation");
    // The page omits some rows of the output.
    for line in shown.lines() {
        assert!(output.lines().any(|said| said == line), "{line}\n{output}");
    }
    for mistaken in [
        first.replace("speed = 4.0", "sped = 4.0"),
        first.replace("speed = 4.0", "cart_drag = -1"),
        first.replace("bumpers", "gusty_wind"),
        first.replace("steady_wind", "walls").replace("speed = 4.0\n", ""),
    ] {
        fs::write(&file, mistaken).expect("a file");
        let output = physgrad(&["train", "windy.toml"])
            .current_dir(dir.path())
            .output()
            .expect("the command runs");
        let said = String::from_utf8(output.stderr).expect("text");
        assert!(!output.status.success() && page.text.contains(&said), "{said}");
    }
}

#[test]
fn effects_md_equals_the_output_of_physgrad_effects() {
    assert!(
        Page::read("docs/effects.md").text == stdout(&["effects"]),
        "docs/effects.md is out of date; run: physgrad effects > docs/effects.md"
    );
}
