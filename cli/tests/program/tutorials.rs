//! The commands of the tutorials run in their order, and print the quoted lines.
//!
//! Trainings have two epochs and few samples. Resumed trainings have three epochs. The comparison
//! of quoted lines ignores the contents of words with digits.

use crate::markdown::Page;
use crate::own::PROGRAM;
use crate::shown_commands::{arguments, commands};
use assert_cmd::Command;
use std::fs;
use std::path::Path;
use tempfile::TempDir;

/// Returns a quick form of a call of the program. A call without arguments becomes a training of
/// `cart_pole`.
fn quick(call: &[String]) -> Vec<String> {
    let mut words = if call.is_empty() {
        vec!["train".to_owned(), "cart_pole".to_owned()]
    } else {
        call.to_vec()
    };
    let mut replace = |option: &str, value: &str| {
        if let Some(i) = words.iter().position(|word| word == option) {
            words.drain(i..i + 2);
        }
        words.extend([option.to_owned(), value.to_owned()]);
    };
    let command = call.first().map_or("train", |command| &**command);
    let resumed = call.iter().any(|word| word == "--resume");
    match command {
        "train" if resumed => replace("--epochs", "3"),
        "train" | "compare" => {
            replace("--epochs", "2");
            let small =
                ["training.train_samples=16", "training.test_samples=16", "policy.widths=[8]"];
            words.extend(
                small.iter().flat_map(|setting| ["--set".to_owned(), (*setting).to_owned()]),
            );
        }
        "robust" => replace("--samples", "8"),
        "accuracy" => {
            words.extend(
                ["--rounds", "1", "--set", "horizon=5", "--set", "policy.widths=[4]"]
                    .map(String::from),
            );
            if call.iter().any(|word| word == "--gradients") {
                words.extend(["--horizons", "5"].map(String::from));
            }
        }
        _ => {}
    }
    words
}

/// Replaces every word with a digit by `#`, and every gap by one space.
fn shape(line: &str) -> String {
    let word = |word: &str| {
        if word.contains(|c: char| c.is_ascii_digit()) { "#".to_owned() } else { word.to_owned() }
    };
    line.split_whitespace().map(word).collect::<Vec<_>>().join(" ")
}

/// Returns whether the output contains a quoted line. `...` at the end of the quoted line omits the
/// rest.
fn contains(output: &str, line: &str) -> bool {
    let line = shape(line);
    output.lines().map(shape).any(|said| {
        line.strip_suffix("...").map_or(said == line, |begin| said.starts_with(begin.trim_end()))
    })
}

/// Runs a page in an empty folder. Returns the number of commands that ran.
///
/// Each block of TOML starts with a line `# NAME` and becomes the file NAME. A block `text` quotes
/// the output of the commands in the block `sh` above it. A block `text,ignore` quotes an output
/// that quick forms do not print.
fn run(page: &str) -> usize {
    let (page, dir) = (Page::read(page), TempDir::new().expect("a folder"));
    let (mut folder, mut said, mut runs) = (dir.path().to_owned(), String::new(), 0);
    for (language, text) in &page.blocks {
        match &**language {
            "toml" => {
                let name = text
                    .lines()
                    .next()
                    .and_then(|line| line.strip_prefix("# "))
                    .expect("the name of the file");
                fs::write(folder.join(name), text).expect("a file");
            }
            "sh" => {
                said.clear();
                for command in commands(text) {
                    if command[0] == "cd" {
                        folder.push(&command[1]);
                        continue;
                    }
                    // Studies take too long. The tests of studies check the plans of the
                    // repository.
                    let Some(call) = arguments(&command)
                        .filter(|call| call.first().is_none_or(|first| first != "study"))
                    else {
                        continue;
                    };
                    let program = if command[0] == "physgrad" {
                        assert_cmd::cargo::cargo_bin("physgrad")
                    } else {
                        PROGRAM.clone()
                    };
                    measure(&folder, &command);
                    let output = Command::new(program)
                        .args(quick(call))
                        .current_dir(&folder)
                        .output()
                        .expect("the command runs");
                    let [out, err] = [output.stdout, output.stderr]
                        .map(|text| String::from_utf8(text).expect("text"));
                    // A page shows a mistake with its message.
                    let quoted = !err.trim().is_empty() && page.text.contains(&err);
                    assert!(output.status.success() || quoted, "{command:?}: {err}");
                    if let Some(file) = redirection(text, &command) {
                        fs::write(folder.join(file), &out).expect("a file");
                    }
                    said += &(out + &err);
                    runs += 1;
                }
            }
            "text" => {
                for line in text
                    .lines()
                    .filter(|line| line.trim() != "..." && !line.starts_with(['┌', '╞', '└']))
                {
                    assert!(
                        contains(&said, line),
                        "{}: not in the output: {line}\n{said}",
                        page.path.display()
                    );
                }
            }
            _ => {}
        }
    }
    runs
}

/// Returns the file to which a line of the block redirects the output of a command.
fn redirection<'a>(block: &'a str, command: &[String]) -> Option<&'a str> {
    let line = block.lines().find(|line| line.starts_with(&format!("{} >", command.join(" "))))?;
    line.split(" > ").nth(1)?.split_whitespace().next()
}

/// Writes a simulation to `measured.csv`, in place of the user's measurements, if the command names
/// this file.
fn measure(folder: &Path, command: &[String]) {
    if command.iter().any(|word| word == "measured.csv") {
        fs::copy(folder.join("runs/first/trajectory.csv"), folder.join("measured.csv"))
            .expect("a simulation");
    }
}

#[test]
fn the_first_hour_runs_and_prints_the_quoted_lines() {
    assert!(run("docs/first_hour.md") >= 12);
}

#[test]
fn the_commands_that_choose_a_field_run() {
    assert!(run("docs/method.md") >= 5);
}

#[test]
fn the_guide_to_your_own_system_runs_and_prints_the_quoted_lines() {
    assert!(run("docs/own_system.md") >= 12);
}

#[test]
fn quick_forms_and_quoted_lines_have_the_expected_form() {
    let call: Vec<_> = ["train", "x", "--epochs", "900", "--out", "o"].map(String::from).into();
    assert_eq!(quick(&call)[..6], ["train", "x", "--out", "o", "--epochs", "2"]);
    let output = "epoch 1/2: train 3.5e-1  test 0.4\n│ system.ball ┆ 0.1 ┆ ok │";
    assert!(contains(output, "epoch 100/1000: train 1.0   test 2.0e0"));
    assert!(contains(output, "│ system.ball ┆ ..."));
    assert!(!contains(output, "epoch 100/1000: training 1.0  test 2.0e0"));
    assert!(!contains(output, "│ system.bal ┆ ..."));
}
