//! `physgrad paper`: output files, and resumption of stopped runs.

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
fn assert_figure(dir: &Path, name: &str) {
    let file = |extension: &str| dir.join(format!("{name}.{extension}"));
    let svg = read(&file("svg"));
    roxmltree::Document::parse(&svg).expect("an SVG is XML");
    assert!(!svg.contains("no data"), "a panel has no data");
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
    for (figure, cases, panel) in [("fig3", 4, "regularization 0.001"), ("fig4", 4, "poles: 4")] {
        paper(figure, dir.path(), &args).assert().success();
        assert_figure(dir.path(), figure);
        let (clips, fields, seeds) = (2, 2, 2);
        assert_eq!(
            read(&dir.path().join(format!("{figure}.csv"))).lines().count(),
            1 + cases * clips * fields * seeds
        );
        let table = read(&dir.path().join(format!("{figure}.md")));
        assert_eq!(
            table.lines().filter(|line| line.starts_with('|')).count(),
            2 + cases * clips * fields
        );
        assert!(
            table.contains("medians over the seeds"),
            "the note below the table does not explain the lines"
        );
        assert!(
            table.contains(panel)
                && read(&dir.path().join(format!("{figure}.svg"))).contains(panel)
        );
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
    assert!(read(&dir.path().join("fig5.svg")).contains("eigenstate 5: update size"));
}

#[test]
fn a_figure_extended_from_2_to_3_epochs_equals_a_figure_of_3_epochs() {
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

    // A resumed run cannot reduce the number of epochs.
    let args = ["--seeds", "1", "--fields", "C", "--clip", "none", "--epochs", "1"];
    let output = paper("fig3", &dir.path().join("once"), &args).output().expect("the command runs");
    assert!(!output.status.success());
    let text = String::from_utf8_lossy(&output.stderr).into_owned();
    assert!(text.contains("already has 3 epochs, but `epochs` is 1"), "{text}");
    let kept = dir.path().join("once");
    assert_eq!(
        (read(&kept.join("fig3.svg")), read(&kept.join("fig3.md"))),
        once,
        "a refused command changes earlier results"
    );
}

#[test]
fn an_interrupted_figure_writes_only_the_started_run_and_resumes() {
    let dir = TempDir::new().expect("a folder");
    let args = ["--seeds", "2", "--fields", "R,C", "--clip", "none", "--threads", "1"];
    let mut command = std::process::Command::new(assert_cmd::cargo::cargo_bin!("physgrad"));
    command
        .args(["paper", "fig3", "--quick", "--epochs", "1000000", "--out"])
        .arg(dir.path())
        .args(args);
    command.stdout(std::process::Stdio::piped()).stderr(std::process::Stdio::null());
    let child = command.spawn().expect("the command runs");
    let runs = || -> Vec<_> {
        let cases = fs::read_dir(dir.path().join("fig3")).into_iter().flatten().flatten();
        let runs = cases.flat_map(|case| {
            fs::read_dir(case.path().join("runs")).into_iter().flatten().flatten()
        });
        runs.filter(|run| run.path().join("metrics.csv").exists()).map(|run| run.path()).collect()
    };
    let begin = std::time::Instant::now();
    while runs().is_empty() {
        assert!(begin.elapsed() < std::time::Duration::from_secs(120), "no run began within 120 s");
        std::thread::sleep(std::time::Duration::from_millis(5));
    }
    std::thread::sleep(std::time::Duration::from_millis(100));
    let killed =
        std::process::Command::new("kill").args(["-INT", &child.id().to_string()]).status();
    assert!(killed.expect("kill runs").success());
    let output = child.wait_with_output().expect("the process ends");
    assert_eq!(output.status.code(), Some(130));
    assert!(String::from_utf8_lossy(&output.stdout).contains("repeat the same command"));
    assert!(!dir.path().join("fig3.svg").exists());
    let [run] = &runs()[..] else { panic!("one thread begins one run, not {:?}", runs()) };
    let done = read(&run.join("metrics.csv")).lines().count() - 1;
    assert!(done > 0);

    paper("fig3", dir.path(), &args).args(["--epochs", &(done + 1).to_string()]).assert().success();
    assert_figure(dir.path(), "fig3");
    assert_eq!(read(&run.join("metrics.csv")).lines().count() - 1, done + 1);
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
