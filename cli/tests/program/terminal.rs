//! Text in the terminal: widths, numbers, repeated warnings, notes, resumption, settings and
//! completion scripts.

use crate::running::{SMALL, error_of, physgrad};
use std::path::Path;
use tempfile::TempDir;

/// Runs a command in a folder, with `columns` as the width of the terminal. `None` sets no width.
/// Returns standard output and standard error.
fn said(folder: &Path, columns: Option<usize>, args: &[&str]) -> [String; 2] {
    let mut command = physgrad(args);
    command.current_dir(folder);
    match columns {
        Some(columns) => command.env("COLUMNS", columns.to_string()),
        None => command.env_remove("COLUMNS"),
    };
    let output = command.output().expect("the command runs");
    [output.stdout, output.stderr].map(|bytes| String::from_utf8(bytes).expect("text"))
}

/// Arguments of a small training or comparison.
fn small<'a>(args: &[&'a str]) -> Vec<&'a str> {
    args.iter().chain(&SMALL).copied().collect()
}

#[test]
fn no_line_is_longer_than_a_terminal_of_80_or_60_columns() {
    let dir = TempDir::new().expect("a folder");
    let train = small(&["train", "cart_pole", "--epochs", "2", "-o", "one"]);
    let compare = small(&[
        "compare",
        "cart_pole",
        "--fields",
        "R,M,C",
        "--seeds",
        "2",
        "--epochs",
        "1",
        "-o",
        "fields",
    ]);
    let sweep = ["--set", "training.batch=4,8", "--set", "training.learning_rate=0.001,0.003"];
    let sweep = [
        &small(&[
            "compare",
            "cart_pole",
            "--fields",
            "R",
            "--seeds",
            "1",
            "--epochs",
            "1",
            "-o",
            "sweep",
        ])[..],
        &sweep,
    ]
    .concat();
    let robust = [
        "robust",
        "one",
        "--grid",
        "system.cart_mass=0.5:2:2",
        "--grid",
        "system.gravity=9:10:2",
        "--samples",
        "4",
        "-o",
        "robust",
    ];
    let commands: [&[&str]; 12] = [
        &train,
        &compare,
        &sweep,
        &["eval", "one", "--samples", "8", "-o", "eval"],
        &robust,
        &["runs", "."],
        &["optimize", "cart_pole_1", "--set", "horizon=5", "--iterations", "2", "-o", "optimized"],
        &["explain", "cart_pole_windy"],
        &["tasks"],
        &["tasks", "cart_pole"],
        &["scene"],
        &["check", "lqr"],
    ];
    for columns in [80, 60] {
        // Runs `train` and `check` with 80 columns only, because most of these commands
        // are slow. The settings of a task need 64 columns, because their keys and the names of
        // integrators are not broken.
        let is_excluded = |args: &[&str]| {
            ["train", "check"].contains(&args[0]) || *args == ["tasks", "cart_pole"]
        };
        for args in commands.into_iter().filter(|args| columns == 80 || !is_excluded(args)) {
            let [out, err] = said(dir.path(), Some(columns), args);
            assert!(!out.is_empty(), "{args:?}: {err}");
            for line in out.lines().chain(err.lines()) {
                assert!(line.chars().count() <= columns, "{args:?} at {columns}: {line}\n{out}");
            }
        }
    }
}

#[test]
fn a_wide_table_has_the_columns_that_a_narrow_table_omits_and_names() {
    let dir = TempDir::new().expect("a folder");
    let explain = |columns| said(dir.path(), columns, &["explain", "cart_pole_windy"])[0].clone();
    let (narrow, wide, unlimited) = (explain(Some(60)), explain(Some(140)), explain(None));
    let header =
        |text: &str| text.lines().find(|line| line.contains("┆ pass")).expect("a table").to_owned();
    assert!(
        narrow.contains("omitted at this width: ") && !wide.contains("omitted"),
        "{narrow}\n{wide}"
    );
    let omitted = narrow
        .rsplit("omitted at this width: ")
        .next()
        .and_then(|rest| rest.lines().next())
        .expect("a note");
    for column in omitted.split(", ") {
        assert!(
            !header(&narrow).contains(&format!(" {column} "))
                && header(&wide).contains(&format!(" {column} ")),
            "{column}"
        );
    }
    assert_eq!(header(&wide), header(&unlimited));
}

#[test]
fn losses_between_a_thousandth_and_1e5_have_no_exponent() {
    let dir = TempDir::new().expect("a folder");
    let [out, err] =
        said(dir.path(), None, &small(&["train", "cart_pole", "--epochs", "2", "-o", "one"]));
    let after = |text: &str, word: &str| -> f64 {
        let number = text
            .split(word)
            .nth(1)
            .and_then(|rest| rest.split([' ', ',', '\n']).next())
            .expect("a number");
        assert!(!number.contains('e'), "{number}");
        number.parse().expect("a number")
    };
    let metrics = std::fs::read_to_string(dir.path().join("one/metrics.csv")).expect("metrics");
    let row: Vec<&str> = metrics.lines().last().expect("a row").split(',').collect();
    let [train, test] = [2, 3].map(|column| row[column].parse::<f64>().expect("a number"));
    let epoch = err.split("epoch 2/2: ").nth(1).expect("a line of the last epoch");
    for (shown, loss) in [
        (after(&out, "test loss "), test),
        (after(epoch, "train "), train),
        (after(epoch, "test "), test),
    ] {
        assert!(
            (shown / loss - 1.0).abs() < 5e-4,
            "{shown} has not the first four digits of {loss}: {out}{err}"
        );
    }
}

#[test]
fn a_repeated_warning_is_printed_once_with_a_count_at_the_end() {
    let dir = TempDir::new().expect("a folder");
    let diverging = [
        "--set",
        "system.gravity=1e38",
        "--set",
        "system.dt=1e5",
        "--set",
        "training.max_skipped=1000",
    ];
    let train =
        [&small(&["train", "cart_pole", "--epochs", "5", "-q", "-o", "one"])[..], &diverging]
            .concat();
    let [_, err] = said(dir.path(), None, &train);
    for cause in [
        "skipped, so the parameters did not change",
        "the training loss is not finite",
        "the test loss is not finite",
    ] {
        let lines: Vec<&str> = err.lines().filter(|line| line.contains(cause)).collect();
        assert_eq!(lines.len(), 2, "{cause}: {err}");
        assert!(lines[0].starts_with("warning: epoch 1: ") && !lines[0].contains("times"), "{err}");
        assert!(
            lines[1].starts_with(lines[0]) && lines[1].ends_with(" (5 times, last in epoch 5)"),
            "{err}"
        );
    }
    let compare = small(&[
        "compare",
        "cart_pole",
        "--fields",
        "R",
        "--seeds",
        "2",
        "--epochs",
        "5",
        "-q",
        "-o",
        "two",
    ]);
    let [_, err] = said(dir.path(), None, &[&compare[..], &diverging].concat());
    let count = |text: &str| err.matches(text).count();
    assert_eq!(
        (count("the test loss is not finite"), count("(10 times, last in R seed ")),
        (2, 3),
        "{err}"
    );
}

#[test]
fn settings_that_another_setting_limits_are_noted() {
    let dir = TempDir::new().expect("a folder");
    for (setting, note) in [
        ("training.batch=100", "`training.batch` is 100, but `training.train_samples` is 16"),
        ("training.warm_up=1000", "`training.warm_up` is 1000 updates, but the run has "),
    ] {
        for command in ["train", "compare"] {
            let out = format!("{command}_{setting}");
            let args = small(&[command, "cart_pole", "--epochs", "1", "-o", &out]);
            let set = ["--set", "training.train_samples=16", "--set", setting];
            let [_, err] = said(dir.path(), None, &[&args[..], &set].concat());
            assert_eq!(err.matches(note).count(), 1, "{command}: {err}");
        }
    }
    let [_, err] = said(
        dir.path(),
        None,
        &[
            &small(&["train", "cart_pole", "--epochs", "1", "-o", "equal"])[..],
            &["--set", "training.train_samples=16", "--set", "training.batch=16"],
        ]
        .concat(),
    );
    assert!(!err.contains("note: "), "{err}");
}

#[test]
fn compare_resumes_with_a_message_and_requires_runs_with_resume() {
    let dir = TempDir::new().expect("a folder");
    let compare = |args: &[&str]| {
        let all = small(&["compare", "cart_pole", "--fields", "R", "--seeds", "2", "-o", "two"]);
        [&all[..], args].concat().into_iter().map(String::from).collect::<Vec<_>>()
    };
    let run = |args: &[&str]| {
        let args = compare(args);
        said(dir.path(), None, &args.iter().map(String::as_str).collect::<Vec<_>>())
    };
    let args = compare(&["--resume"]);
    let refused = error_of(
        physgrad(&args.iter().map(String::as_str).collect::<Vec<_>>()).current_dir(dir.path()),
    );
    assert!(refused.contains("there is no run to resume in two; omit --resume"), "{refused}");
    assert!(!run(&["--epochs", "1"])[1].contains("resuming"));
    assert!(
        run(&["--epochs", "2", "--resume"])[1]
            .contains("resuming 2 of these runs from their folders")
    );
    let moved = &small(&["train", "cart_pole", "--epochs", "1", "-o", "one"]);
    said(dir.path(), None, moved);
    let [_, err] = said(dir.path(), None, moved);
    let command = err
        .lines()
        .find_map(|line| line.split("to resume it: physgrad ").nth(1))
        .expect("a command");
    let resumed: Vec<&str> = command.split(' ').chain(["--epochs", "2"]).collect();
    assert!(said(dir.path(), None, &resumed)[0].contains("2 epochs"), "{command}");
}

#[test]
fn the_settings_of_a_task_have_units_defaults_and_choices() {
    let dir = TempDir::new().expect("a folder");
    let [out, _] = said(dir.path(), None, &["tasks", "cart_pole"]);
    let row = |name: &str| {
        out.lines()
            .find(|line| line.contains(&format!("│ {name} ")))
            .unwrap_or_else(|| panic!("{name}: {out}"))
    };
    assert!(
        row("system.cart_mass").contains("Mass of the cart, kg")
            && row("system.dt").contains("Time step, s")
    );
    assert!(row("training.batch").contains("┆ 8 "), "{out}");
    for choice in ["uncoupled", "coupled", "momentum", "terminal"] {
        assert!(out.contains(choice), "{choice}: {out}");
    }
}

#[test]
fn completion_scripts_contain_the_commands() {
    for shell in ["bash", "zsh", "fish", "elvish", "powershell"] {
        let [out, _] = said(Path::new("."), None, &["completions", shell]);
        assert!(
            ["accuracy", "fields", "quiet"].iter().all(|word| out.contains(word)),
            "{shell}: {out}"
        );
    }
}
