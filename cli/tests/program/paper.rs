//! `physgrad paper`: output files, and resumption with more epochs.

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

/// Checks that the SVG is XML with data in every panel, and that PNG, CSV and table are not empty.
/// Figures 3 to 5 have the folder of their plan.
fn assert_figure(dir: &Path, name: &str) {
    let is_plan = dir.join(name).is_dir();
    let file = |extension: &str| match extension {
        _ if !is_plan => dir.join(format!("{name}.{extension}")),
        "csv" => dir.join(name).join("summary.csv"),
        "md" => dir.join(name).join("table.md"),
        extension => dir.join(name).join(format!("figure.{extension}")),
    };
    let svg = read(&file("svg"));
    roxmltree::Document::parse(&svg).expect("an SVG is XML");
    assert!(!svg.contains("no positive data"), "a panel has no data");
    assert!(fs::read(file("png")).expect("a PNG").starts_with(b"\x89PNG"));
    assert!(read(&file("csv")).lines().count() > 1);
    assert!(read(&file("md")).starts_with('|'), "the table is not in Markdown");
}

#[test]
fn figures_1_and_2_are_written_as_svg_png_csv_and_table() {
    let dir = TempDir::new().expect("a folder");
    for figure in ["fig1", "fig2"] {
        let said = paper(figure, dir.path(), &[]).assert().success();
        assert_figure(dir.path(), figure);
        assert!(
            String::from_utf8_lossy(&said.get_output().stdout).contains(&format!("{figure}.svg"))
        );
    }
}

#[test]
fn figures_3_and_4_have_one_csv_row_per_run_and_one_table_row_per_case_and_field() {
    let dir = TempDir::new().expect("a folder");
    let args =
        ["--seeds", "2", "--epochs", "1", "--fields", "R,C", "--clip", "none,norm", "--quiet"];
    for (figure, cases, panel, case) in [
        ("fig3", 4, "regularization 0.001", "clip=norm regularization=0.001"),
        ("fig4", 4, "poles: 4", "clip=norm poles=4"),
    ] {
        let file = |name: &str| read(&dir.path().join(figure).join(name));
        paper(figure, dir.path(), &args).assert().success();
        assert_figure(dir.path(), figure);
        let (clips, fields, seeds) = (2, 2, 2);
        assert_eq!(file("summary.csv").lines().count(), 1 + cases * clips * fields * seeds);
        let table = file("table.md");
        assert_eq!(
            table.lines().filter(|line| line.starts_with('|')).count(),
            2 + cases * clips * fields
        );
        assert!(
            table.contains("ratio of the median to that of R") && table.contains(case),
            "{table}"
        );
        let picture = file("figure.svg");
        for label in [panel, "test loss (clip: norm)", "2 seeds, means of 30 epochs"] {
            assert!(picture.contains(label), "{label}");
        }
    }
}

#[test]
fn figure_5_shows_the_update_size_of_eigenstate_5() {
    let dir = TempDir::new().expect("a folder");
    paper(
        "fig5",
        dir.path(),
        &["--seeds", "1", "--epochs", "1", "--fields", "C", "--clip", "none"],
    )
    .assert()
    .success();
    assert_figure(dir.path(), "fig5");
    assert!(read(&dir.path().join("fig5/figure.svg")).contains("eigenstate 5: update size"));
}

#[test]
fn a_figure_extended_from_2_to_3_epochs_equals_a_figure_of_3_epochs() {
    let dir = TempDir::new().expect("a folder");
    let figure = |out: &str, epochs: &str| {
        let args = ["--seeds", "1", "--fields", "C", "--clip", "none", "--epochs", epochs];
        paper("fig3", &dir.path().join(out), &args).assert().success();
        let file = |name: &str| read(&dir.path().join(out).join("fig3").join(name));
        (file("figure.svg"), file("table.md"))
    };
    let once = figure("once", "3");
    assert_ne!(figure("twice", "2"), once);
    assert_eq!(figure("twice", "3"), once);

    // A resumed run cannot reduce the number of epochs.
    let args = ["--seeds", "1", "--fields", "C", "--clip", "none", "--epochs", "1"];
    let output = paper("fig3", &dir.path().join("once"), &args).output().expect("the command runs");
    assert!(!output.status.success());
    let text = String::from_utf8_lossy(&output.stderr).into_owned();
    assert!(text.contains("already has 3 epochs, but `epochs` is 1"), "{text}");
    let kept = dir.path().join("once");
    assert_eq!(
        (read(&kept.join("fig3/figure.svg")), read(&kept.join("fig3/table.md"))),
        once,
        "a refused command changes earlier results"
    );
}

#[test]
fn figures_with_0_seeds_or_epochs_or_repeated_names_are_refused_before_any_run() {
    let dir = TempDir::new().expect("a folder");
    let out = dir.path().join("paper");
    for (args, word) in [
        (["--seeds", "0"], "--seeds is 0"),
        (["--epochs", "0"], "--epochs is 0"),
        (["--fields", "C,combined"], "--fields names combined twice"),
        (["--clip", "norm,norm"], "--clip names norm twice"),
    ] {
        let output = paper("all", &out, &args).output().expect("the command runs");
        assert!(!output.status.success());
        let text = String::from_utf8_lossy(&output.stderr).into_owned();
        assert!(text.matches(word).count() == 1, "{text}");
        assert!(!out.exists());
    }
}

#[test]
fn an_unknown_figure_is_refused_with_the_known_ones() {
    let dir = TempDir::new().expect("a folder");
    let output = paper("fig9", dir.path(), &[]).output().expect("the command runs");
    assert!(!output.status.success());
    let text = String::from_utf8_lossy(&output.stderr).into_owned();
    assert!(text.contains("fig9") && text.contains("fig1, fig2, fig3, fig4, fig5, all"), "{text}");
}
