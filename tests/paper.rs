//! `physgrad paper`: what it leaves, and that it goes on where it was stopped.

use assert_cmd::Command;
use std::fs;
use std::path::Path;
use tempfile::TempDir;

fn paper(figure: &str, out: &Path, args: &[&str]) -> Command {
    let mut command = Command::cargo_bin("physgrad").expect("the program is built");
    command.args(["paper", figure, "--quick", "--out"]).arg(out).args(args);
    command
}

fn read(path: &Path) -> String {
    fs::read_to_string(path).unwrap_or_else(|e| panic!("{}: {e}", path.display()))
}

/// Picture, picture, numbers and table of a figure are there and are what they say.
fn assert_figure(dir: &Path, name: &str) {
    let file = |extension: &str| dir.join(format!("{name}.{extension}"));
    let svg = read(&file("svg"));
    roxmltree::Document::parse(&svg).expect("an SVG is XML");
    assert!(!svg.contains("no data"), "every panel has lines");
    assert!(fs::read(file("png")).expect("a PNG").starts_with(b"\x89PNG"));
    assert!(read(&file("csv")).lines().count() > 1);
    assert!(read(&file("md")).starts_with('|'), "a Markdown table");
}

#[test]
fn toy_figures_are_drawn_and_told() {
    let dir = TempDir::new().expect("a folder");
    for figure in ["fig1", "fig2"] {
        let said = paper(figure, dir.path(), &[]).assert().success();
        assert_figure(dir.path(), figure);
        assert!(String::from_utf8_lossy(&said.get_output().stdout).contains(&format!("{figure}.svg")));
    }
}

#[test]
fn a_trained_figure_has_a_row_for_every_run_and_every_case() {
    let dir = TempDir::new().expect("a folder");
    let args = ["--seeds", "2", "--epochs", "1", "--fields", "R,C", "--clip", "none,norm", "--quiet"];
    for (figure, cases, panel) in [("fig3", 4, "regularization 0.001"), ("fig4", 4, "poles: 4")] {
        paper(figure, dir.path(), &args).assert().success();
        assert_figure(dir.path(), figure);
        let (clips, fields, seeds) = (2, 2, 2);
        assert_eq!(read(&dir.path().join(format!("{figure}.csv"))).lines().count(), 1 + cases * clips * fields * seeds);
        let table = read(&dir.path().join(format!("{figure}.md")));
        assert_eq!(table.lines().count(), 2 + cases * clips * fields);
        assert!(table.contains(panel) && read(&dir.path().join(format!("{figure}.svg"))).contains(panel));
    }
}

#[test]
fn the_quantum_figure_also_shows_the_size_of_the_updates() {
    let dir = TempDir::new().expect("a folder");
    paper("fig5", dir.path(), &["--seeds", "1", "--epochs", "1", "--fields", "C", "--clip", "none"]).assert().success();
    assert_figure(dir.path(), "fig5");
    assert!(read(&dir.path().join("fig5.svg")).contains("eigenstate 5: update size"));
}

#[test]
fn a_figure_goes_on_where_it_was_and_is_the_same_as_made_at_once() {
    let dir = TempDir::new().expect("a folder");
    let figure = |out: &str, epochs: &str| {
        let args = ["--seeds", "1", "--fields", "C", "--clip", "none", "--epochs", epochs];
        paper("fig3", &dir.path().join(out), &args).assert().success();
        let table = read(&dir.path().join(out).join("fig3.md"));
        (read(&dir.path().join(out).join("fig3.svg")), table)
    };
    let once = figure("once", "3");
    assert_ne!(figure("twice", "2"), once);
    assert_eq!(figure("twice", "3"), once);

    // Fewer epochs than there are cannot be had by going on.
    let args = ["--seeds", "1", "--fields", "C", "--clip", "none", "--epochs", "1"];
    let output = paper("fig3", &dir.path().join("once"), &args).output().expect("it runs");
    assert!(!output.status.success());
    let text = String::from_utf8_lossy(&output.stderr).into_owned();
    assert!(text.contains("has 3 epochs already, and asked for are 1"), "{text}");
}

#[test]
fn a_figure_that_is_none_is_refused_with_those_there_are() {
    let dir = TempDir::new().expect("a folder");
    let output = paper("fig9", dir.path(), &[]).output().expect("it runs");
    assert!(!output.status.success());
    let text = String::from_utf8_lossy(&output.stderr).into_owned();
    assert!(text.contains("fig9") && text.contains("fig1, fig2, fig3, fig4, fig5, all"), "{text}");
}
