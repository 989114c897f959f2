//! `physgrad report`: contents of the page, which needs no other files, for all kinds of runs.

use crate::running::{SMALL, error_of, physgrad, train};
use assert_cmd::Command;
use serde_json::Value;
use std::fs;
use std::path::{Path, PathBuf};
use tempfile::TempDir;

/// Physics in which no rollout stays finite.
const DIVERGES: [&str; 4] = ["--set", "system.gravity=1e38", "--set", "system.dt=1e5"];

fn compare(out: &Path, args: &[&str]) -> Command {
    let mut command = physgrad(&["compare", "cart_pole", "--out"]);
    command.arg(out).args(SMALL).args(args);
    command
}

fn report(folder: &Path) -> String {
    let output = physgrad(&["report"]).arg(folder).output().expect("the command runs");
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    assert!(String::from_utf8_lossy(&output.stdout).contains("report.html"));
    let page = fs::read_to_string(folder.join("report.html")).expect("a page");
    assert_stands_alone(&page);
    assert_nested(&page);
    page
}

fn refusal(folder: &Path) -> String {
    error_of(physgrad(&["report"]).arg(folder))
}

/// Checks that the page loads nothing. The only addresses on the page are names of XML namespaces.
fn assert_stands_alone(page: &str) {
    for (at, _) in page.match_indices("://") {
        let (before, after) = page.split_at(at);
        let end = after.find(['"', ' ', '<']).unwrap_or(after.len());
        assert!(
            before.ends_with("http") && after.starts_with("://www.w3.org/"),
            "{}",
            &after[..end]
        );
    }
    for (attribute, allowed) in
        [(" src=\"", "data:"), (" href=\"", "#"), ("url(", "#"), ("<link", "no"), ("@import", "no")]
    {
        for (at, _) in page.match_indices(attribute) {
            assert!(page[at + attribute.len()..].starts_with(allowed), "{}", &page[at..at + 40]);
        }
    }
    assert!(page.contains("default-src 'none'"), "the page has no policy that blocks loading");
}

/// Checks that elements are properly nested and closed.
fn assert_nested(page: &str) {
    let mut open: Vec<&str> = Vec::new();
    let mut rest = page;
    while let Some(start) = rest.find('<') {
        rest = &rest[start + 1..];
        let tag = &rest[..rest.find('>').expect("a tag ends")];
        let name =
            tag.split([' ', '/', '\n']).find(|part| !part.is_empty()).expect("a tag has a name");
        if tag.starts_with('/') {
            assert_eq!(open.pop(), Some(name), "before {}", &rest[..40.min(rest.len())]);
        } else if !tag.starts_with('!') && !tag.ends_with('/') && !["meta", "wbr"].contains(&name) {
            open.push(name);
        }
        if ["script", "style"].contains(&name) && !tag.starts_with('/') {
            rest = &rest[rest.find(&format!("</{name}>")).expect("its end")..];
        }
    }
    assert!(open.is_empty(), "{open:?}");
}

/// Returns all texts between two delimiters.
fn between<'a>(page: &'a str, start: &str, end: &str) -> Vec<&'a str> {
    page.split(start).skip(1).map(|rest| &rest[..rest.find(end).expect("an end")]).collect()
}

/// Returns the data of a diagram by its title, as (label, points), without thin lines.
fn diagram(page: &str, title: &str) -> Vec<(String, Vec<Vec<f64>>)> {
    let figure =
        page.split("<figure>").find(|figure| figure.contains(&format!("<h3>{title}</h3>")));
    let figure = figure.unwrap_or_else(|| panic!("there is no diagram {title}"));
    let data = between(figure, "<script type=\"application/json\">", "</script>");
    let data: Value =
        serde_json::from_str(data.first().unwrap_or_else(|| panic!("{title} is empty")))
            .expect("JSON");
    let picture = between(figure, "<svg ", "</svg>");
    roxmltree::Document::parse(&format!("<svg {}</svg>", picture[0])).expect("an SVG is XML");
    let numbers = |point: &Value| serde_json::from_value(point.clone()).expect("numbers");
    let points =
        |line: &Value| line["points"].as_array().expect("points").iter().map(numbers).collect();
    let label = |line: &Value| line["label"].as_str().expect("a label").to_owned();
    let bold = |line: &&Value| line["thin"] == false;
    data["series"]
        .as_array()
        .expect("series")
        .iter()
        .filter(bold)
        .map(|line| (label(line), points(line)))
        .collect()
}

fn labels(lines: &[(String, Vec<Vec<f64>>)]) -> Vec<&str> {
    lines.iter().map(|(label, _)| label.as_str()).collect()
}

/// Returns the cells of the first table, row by row.
fn cells(page: &str) -> Vec<Vec<&str>> {
    let table = between(page, "<tbody>", "</tbody>")[0];
    between(table, "<tr>", "</tr>").iter().map(|row| between(row, "\">", "</td>")).collect()
}

/// Returns the animations on the page.
fn animations(page: &str) -> Vec<&str> {
    let films = between(page, "<div class=\"film\" ", "</div>");
    films.into_iter().map(|film| film.split_once('>').expect("a tag ends").1).collect()
}

/// Checks that two animations have the same position and size of the view, and the same labels
/// below the view.
fn assert_same_scale(a: &str, b: &str) {
    let view = |svg: &str| between(svg, "<svg x=", ">")[0].to_owned();
    assert_eq!(view(a), view(b));
    let labels = |svg: &str| -> Vec<String> {
        let around = svg.split("</svg>").nth(1).expect("channels below the view");
        between(around, "<text ", "</text>").iter().map(|text| text.to_string()).collect()
    };
    assert!(labels(a).iter().any(|label| label.ends_with(">time (s)")), "{:?}", labels(a));
    assert_eq!(labels(a), labels(b));
}

#[test]
fn the_page_of_a_run_has_its_settings_metrics_adjoint_norms_and_animation() {
    let dir = TempDir::new().expect("a folder");
    let out = dir.path().join("run");
    train(&out, &["--epochs", "4", "--set", "system.poles=3"]).assert().success();
    let page = report(&out);
    assert!(page.contains("<title>cart_pole: field C (combined), seed 0 (run)</title>"));
    assert!(page.contains("<th scope=\"row\">poles</th><td>3</td>"));
    assert!(page.contains("<th scope=\"row\">widths</th><td>[12, 8]</td>"));
    assert!(page.contains(concat!("made by physgrad ", env!("CARGO_PKG_VERSION"))));

    let metrics = fs::read_to_string(out.join("metrics.csv")).expect("metrics");
    // Empty cells, such as those of `first_order`, become NaN.
    let rows: Vec<Vec<f64>> = metrics
        .lines()
        .skip(1)
        .map(|row| row.split(',').map(|cell| cell.parse().unwrap_or(f64::NAN)).collect())
        .collect();
    for (title, line, column) in [
        ("Loss by epoch", 0, 2),
        ("Loss by epoch", 1, 3),
        ("Norm of the field", 0, 4),
        ("Agreement of M and R", 0, 5),
        ("Share of components kept", 0, 7),
    ] {
        let (_, points) = &diagram(&page, title)[line];
        assert_eq!(points.len(), 4, "{title}");
        for (point, row) in points.iter().zip(&rows) {
            assert_eq!(point[0], row[0], "{title}");
            assert!(
                (point[1] / row[column] - 1.0).abs() < 1e-4,
                "{title}: {} in place of {}",
                point[1],
                row[column]
            );
        }
    }
    let times = &diagram(&page, "Loss by time")[0].1;
    assert!((times[3][0] / rows.iter().map(|row| row[6]).sum::<f64>() - 1.0).abs() < 1e-4);
    let growth = diagram(&page, "Growth of the adjoint");
    assert_eq!(
        labels(&growth),
        ["R before training", "M before training", "R as trained", "M as trained"]
    );
    assert!(
        growth.iter().all(|(_, points)| points.len() == 26 && points[25][0] == 25.0),
        "not one norm at each of the 26 states"
    );
    assert_eq!(growth[0].1, growth[1].1, "R and M differ while the output layer is zero");
    assert_ne!(growth[2].1, growth[3].1);
    let row = &cells(&page)[0];
    assert!(
        (1.0..10.0).contains(&rows[3][3]),
        "the test loss is {}; the test needs 1 to 10, with three decimal places",
        rows[3][3]
    );
    assert_eq!((row[0], row[3], row[5]), ("4", &*format!("{:.3}", rows[3][3]), "0"));
    assert_eq!(
        animations(&page),
        [fs::read_to_string(out.join("animation.svg")).expect("an animation")]
    );
    assert_eq!(
        between(&page, "<script>", "</script>").len(),
        1,
        "the page does not have exactly one script"
    );

    assert!(report(&out) == page, "a second report has other bytes");
    train(&out, &["--epochs", "1"]).assert().success();
    assert!(
        dir.path().join("run.previous-1/report.html").exists() && !out.join("report.html").exists(),
        "the page does not move with the folder of its run"
    );
}

#[test]
fn the_page_of_field_m_states_why_the_cosine_is_absent() {
    let dir = TempDir::new().expect("a folder");
    train(dir.path(), &["--epochs", "2", "--field", "M"]).assert().success();
    let page = report(dir.path());
    assert!(
        !page.contains("Agreement of M and R")
            && page.contains("recorded only for fields that combine two gradients")
    );
}

#[test]
fn the_page_of_a_comparison_has_the_printed_table_and_curves_of_all_seeds() {
    let dir = TempDir::new().expect("a folder");
    let args = ["--fields", "C,R", "--seeds", "2", "--seed", "9", "--epochs", "3"];
    let printed = compare(dir.path(), &args).output().expect("the command runs").stdout;
    let printed = String::from_utf8(printed).expect("text");
    let page = report(dir.path());
    assert!(page.contains("<th scope=\"row\">field</th><td>regular, combined</td>"));
    assert!(
        page.contains("<th scope=\"row\">seed</th><td>9, 10</td>"),
        "the seeds are not in increasing order"
    );
    assert!(page.contains("<th scope=\"row\">horizon</th><td>25</td>"));
    let rows = cells(&page);
    assert_eq!((rows[0][0], rows[1][0]), ("regular", "combined"));
    let cells_of = |line: &str| {
        line.trim_matches(['│', '|'])
            .split(['┆', '|'])
            .map(|cell| cell.trim().to_owned())
            .collect::<Vec<_>>()
    };
    for row in &rows {
        let line = printed.lines().find(|line| cells_of(line)[0] == row[0]).expect("the same row");
        assert_eq!(cells_of(line), *row);
    }
    let medians = diagram(&page, "Test loss by epoch");
    assert_eq!(labels(&medians), ["R (regular)", "C (combined)"]);
    for (_, points) in &medians {
        assert!(
            points.iter().all(|p| p.len() == 4 && p[2] <= p[1] && p[1] <= p[3]),
            "a median is outside of its band: {points:?}"
        );
    }
    diagram(&page, "Test loss by time");
    assert_eq!(
        labels(&diagram(&page, "Every run")),
        ["R seed 9", "R seed 10", "C seed 9", "C seed 10"]
    );
    assert_eq!(labels(&diagram(&page, "Share of components kept")), ["C seed 9", "C seed 10"]);
    assert_eq!(labels(&diagram(&page, "Growth of the adjoint before training")), ["R", "M"]);
    assert_eq!(labels(&diagram(&page, "Growth of M as trained")), ["R seed 9", "C seed 9"]);

    let file = |run: &str| -> PathBuf { dir.path().join("runs").join(run).join("animation.svg") };
    let [regular, combined] = animations(&page)[..] else {
        panic!("the page does not have one animation per field")
    };
    assert_same_scale(regular, combined);
    physgrad(&["animate"]).arg(dir.path()).assert().success();
    let animated = ["R-9", "R-10", "C-9", "C-10"]
        .map(|run| fs::read_to_string(file(run)).expect("an animation"));
    animated.iter().for_each(|animation| assert_same_scale(&animated[0], animation));
    fs::remove_file(file("C-9")).expect("the file exists");
    assert!(report(dir.path()) == page, "the page depends on the file of an animation");
}

#[test]
fn a_comparison_of_several_scenes_has_one_page_and_all_animations() {
    let dir = TempDir::new().expect("a folder");
    let mut command = physgrad(&[
        "compare",
        "cart_pole_1",
        "cart_pole_2",
        "--fields",
        "R,M",
        "--seeds",
        "2",
        "--epochs",
        "2",
    ]);
    command.args(&SMALL[..]).arg("--out").arg(dir.path()).assert().success();
    let page = report(dir.path());
    assert!(page.contains("<title>cart_pole_1, cart_pole_2: fields R, M, 2 seeds ("));
    let rows = cells(&page);
    let names: Vec<[&str; 2]> = rows.iter().map(|row| [row[0], row[1]]).collect();
    let expected = ["cart_pole_1", "cart_pole_2"]
        .map(|scene| ["regular", "modified"].map(|field| [scene, field]));
    assert_eq!(names, expected.concat());
    let medians = diagram(&page, "Test loss by epoch");
    let expected = [
        "cart_pole_1: R (regular)",
        "cart_pole_1: M (modified)",
        "cart_pole_2: R (regular)",
        "cart_pole_2: M (modified)",
    ];
    assert_eq!(labels(&medians), expected);
    for section in ["Animation", "Gradients", "Settings"] {
        for scene in ["cart_pole_1", "cart_pole_2"] {
            assert!(page.contains(&format!("<h2>{scene}: {section}</h2>")), "{scene}: {section}");
        }
    }
    assert_eq!(
        animations(&page).len(),
        4,
        "the page does not have one animation per field and scene"
    );
    // The field of a curve determines its colour, the scene its dashes.
    let curves = fs::read_to_string(dir.path().join("curves.svg")).expect("a picture");
    let line = |label: &str| {
        let (_, after) = curves
            .split_once(&format!(">{label}</text><line "))
            .unwrap_or_else(|| panic!("no entry {label}"));
        after[..after.find("/>").expect("an end")].to_owned()
    };
    for (field, color) in [("R (regular)", "#0072b2"), ("M (modified)", "#d55e00")] {
        let [one, two] =
            ["cart_pole_1", "cart_pole_2"].map(|scene| line(&format!("{scene}: {field}")));
        assert!(one.contains(color) && two.contains(color), "{one} {two}");
        assert!(
            !one.contains("stroke-dasharray") && two.contains("stroke-dasharray"),
            "{one} {two}"
        );
    }

    let output = physgrad(&["animate"]).arg(dir.path()).output().expect("the command runs");
    assert_eq!(
        String::from_utf8_lossy(&output.stdout).lines().count(),
        8,
        "`animate` does not print one animation per run"
    );
}

#[test]
fn more_than_three_scenes_have_one_panel_each() {
    let dir = TempDir::new().expect("a folder");
    let scenes = ["slider", "push", "bounce", "lqr", "pendulum"];
    let sizes = ["--set", "training.train_samples=8", "--set", "training.test_samples=4"];
    let mut command = physgrad(&["compare", "--fields", "R,M", "--seeds", "1", "--epochs", "1"]);
    command.args(scenes).args(sizes).arg("--out").arg(dir.path()).assert().success();
    let curves = fs::read_to_string(dir.path().join("curves.svg")).expect("a picture");
    for (text, count) in
        [("R (regular)", 1), ("M (modified)", 1), ("epoch", 5), ("wall time (s)", 5)]
    {
        assert_eq!(curves.matches(&format!(">{text}</text>")).count(), count, "{text}");
    }
    assert!(
        scenes.iter().all(|scene| curves.contains(&format!(">{scene}</text>")))
            && !curves.contains("stroke-dasharray")
    );
    let page = report(dir.path());
    for scene in scenes {
        diagram(&page, &format!("{scene}: Test loss by epoch"));
    }
}

#[test]
fn a_page_animates_sample_0_whatever_the_animation_in_the_folder() {
    let dir = TempDir::new().expect("a folder");
    train(dir.path(), &["--epochs", "1"]).assert().success();
    let animation = fs::read_to_string(dir.path().join("animation.svg")).expect("an animation");
    let page = report(dir.path());
    // Animates sample 3 in the folder. The page still animates sample 0.
    physgrad(&["animate", "--sample", "3"]).arg(dir.path()).assert().success();
    assert_ne!(
        fs::read_to_string(dir.path().join("animation.svg")).expect("an animation"),
        animation
    );
    assert!(report(dir.path()) == page && animations(&page) == [animation]);
}

#[test]
fn runs_with_different_poles_or_tasks_are_not_a_comparison() {
    let dir = TempDir::new().expect("a folder");
    let out = |name: &str| dir.path().join("runs").join(name);
    train(&out("a"), &["--epochs", "1", "--set", "system.poles=2"]).assert().success();
    train(&out("b"), &["--epochs", "1", "--set", "system.poles=3"]).assert().success();
    let text = refusal(dir.path());
    assert!(text.contains("not runs of one comparison") && text.contains("poles = 3"), "{text}");
    fs::remove_dir_all(out("b")).expect("the folder exists");
    physgrad(&["train", "guidance", "--epochs", "1", "--set", "training.train_samples=8", "--out"])
        .arg(out("b"))
        .assert()
        .success();
    let text = refusal(dir.path());
    assert!(
        text.contains("(cart_pole)") && text.contains("(guidance) are not runs of one comparison"),
        "{text}"
    );
    fs::rename(dir.path().join("runs"), dir.path().join("others")).expect("the folder exists");
    let text = refusal(&dir.path().join("others"));
    assert!(text.contains("holds 2 runs or comparisons; choose one"), "{text}");
}

#[test]
fn folder_names_are_escaped_in_html() {
    let dir = TempDir::new().expect("a folder");
    let out = dir.path().join("<i>&\"x");
    train(&out, &["--epochs", "1"]).assert().success();
    let page = report(&out);
    assert!(page.contains("&lt;i&gt;&amp;") && !page.contains("<i>"));
}

#[test]
fn pages_state_that_a_run_failed_was_interrupted_or_has_no_epoch() {
    let dir = TempDir::new().expect("a folder");
    let (broken, all, none, one) = (
        dir.path().join("broken"),
        dir.path().join("all"),
        dir.path().join("none"),
        dir.path().join("one"),
    );
    train(&broken, &["--epochs", "40"]).args(DIVERGES).assert().failure();
    let page = report(&broken);
    assert!(
        page.contains(
            "This run failed after 3 epochs of 40: training stopped: 11 updates in a row"
        )
    );
    assert!(
        page.contains("losses of 3 epochs, because a rollout diverged.")
            && page.contains("There are no finite values to draw.")
    );
    assert!(
        page.contains("Before training, a rollout diverged")
            && page.contains("state component 0 of sample 0")
    );

    compare(&all, &["--fields", "R,C", "--seeds", "2", "--epochs", "40"])
        .args(DIVERGES)
        .assert()
        .failure();
    let page = report(&all);
    assert!(page.contains("4 warnings") && page.contains("C seed 1 failed after 3 epochs of 40"));
    assert_eq!(cells(&page)[0][..4], ["regular", "2", "2", "NaN"]);

    train(&none, &["--epochs", "0"]).assert().success();
    let page = report(&none);
    assert!(page.contains("No epoch is complete") && !page.contains("class=\"trouble\""));
    diagram(&page, "Growth of the adjoint");

    train(&one, &["--epochs", "1"]).assert().success();
    assert_eq!(diagram(&report(&one), "Loss by epoch")[0].1.len(), 1);
    // Imitates an interrupted run.
    let settings = fs::read_to_string(one.join("run.toml")).expect("settings");
    fs::write(one.join("run.toml"), settings.replace("epochs = 1", "epochs = 5"))
        .expect("settings");
    let before = fs::read(one.join("checkpoint.bin")).expect("a checkpoint");
    let page = report(&one);
    assert!(page.contains(
        "This run has 1 epoch of 5: it is still training, or was interrupted and can be resumed."
    ));
    assert_eq!(cells(&page)[0][0], "1 of 5");
    assert!(
        fs::read(one.join("checkpoint.bin")).expect("a checkpoint") == before,
        "`report` changed the checkpoint"
    );
}

#[test]
fn adjoint_norms_above_the_largest_f32_are_drawn_to_step_0() {
    let dir = TempDir::new().expect("a folder");
    // The cart is so light that the controls of the untrained policy move it strongly: states stay
    // finite, and their derivatives grow. For lighter carts, finiteness depends on rounding.
    let light = [
        "--set",
        "system.cart_mass=2e-4",
        "--set",
        "system.pole_mass=2e-4",
        "--set",
        "policy.zero_init_output=false",
    ];
    train(dir.path(), &["--epochs", "0"])
        .args(light)
        .args(["--set", "horizon=1500"])
        .assert()
        .success();
    let page = report(dir.path());
    assert!(!page.contains("the adjoint of R diverged"));
    let growth = diagram(&page, "Growth of the adjoint");
    let first = |line: usize| growth[line].1[0][0];
    assert!(first(2) == 0.0 && first(3) == 0.0, "R from {} on, M from {} on", first(2), first(3));
    let largest = growth[2].1.iter().fold(0.0_f64, |largest, point| largest.max(point[1]));
    assert!(largest > f64::from(f32::MAX), "{largest:e}");
}

#[test]
fn folders_without_a_run_or_with_half_a_checkpoint_are_refused() {
    let dir = TempDir::new().expect("a folder");
    assert!(refusal(&dir.path().join("nowhere")).contains("there is no folder"));
    assert!(refusal(dir.path()).contains("there is no run in"));
    let out = dir.path().join("run");
    train(&out, &["--epochs", "1"]).assert().success();
    let checkpoint = fs::read(out.join("checkpoint.bin")).expect("a checkpoint");
    fs::write(out.join("checkpoint.bin"), &checkpoint[..checkpoint.len() / 2])
        .expect("half a checkpoint");
    let text = refusal(&out);
    assert!(text.contains("checkpoint.bin") && text.contains("damaged"), "{text}");
    assert!(!out.join("report.html").exists());
}

/// Evaluates an expression in Node.js, with the functions of the page's script. Returns the printed
/// value, or `None` without Node.js.
fn evaluated(page: &str, expression: &str) -> Option<String> {
    let script = between(page, "<script>", "</script>")[0];
    let functions = script.split("const activate").next().expect("functions before the charts");
    let program = format!("{functions}\nconsole.log({expression});");
    let output = std::process::Command::new("node").args(["-e", &program]).output().ok()?;
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    Some(String::from_utf8(output.stdout).expect("text"))
}

#[test]
fn the_csv_of_a_chart_has_the_values_of_its_curves() {
    let dir = TempDir::new().expect("a folder");
    compare(dir.path(), &["--fields", "R,M", "--seeds", "2", "--epochs", "2"]).assert().success();
    let page = report(dir.path());
    let data = between(&page, "<script type=\"application/json\">", "</script>")[0];
    let Some(csv) = evaluated(&page, &format!("csv({data})")) else {
        println!("skipped: there is no Node.js");
        return;
    };
    let rows: Vec<Vec<&str>> =
        csv.lines().filter(|row| !row.is_empty()).map(|row| row.split(',').collect()).collect();
    assert_eq!(rows[0], ["series", "epoch", "test loss", "low", "high"]);
    // Labels of single runs contain a comma and are quoted.
    let medians: Vec<&Vec<&str>> =
        rows[1..].iter().filter(|row| !row[0].starts_with('"')).collect();
    let mut expected = Vec::new();
    for (label, points) in diagram(&page, "Test loss by epoch") {
        let cells = |point: Vec<f64>| {
            [vec![label.clone()], point.iter().map(f64::to_string).collect()].concat()
        };
        expected.extend(points.into_iter().map(cells));
    }
    assert_eq!(medians.len(), 4);
    assert!(
        medians.iter().zip(&expected).all(|(found, expected)| *found == expected),
        "{medians:?} {expected:?}"
    );
    assert_eq!(rows.len(), 1 + 4 + 8, "medians and single runs");
}

#[test]
fn ticks_of_a_zoomed_axis_are_round_numbers_within_its_range() {
    let dir = TempDir::new().expect("a folder");
    train(dir.path(), &["--epochs", "1"]).assert().success();
    let page = report(dir.path());
    for (range, log, expected) in [
        ("[-0.03, 8.03]", false, r#"[[0,"0"],[2,"2"],[4,"4"],[6,"6"],[8,"8"]]"#),
        ("[-2.5, 0.5]", true, r#"["0.005","0.01","0.02","0.05","0.1","0.2","0.5","1","2"]"#),
        ("[-0.1, 0]", true, r#"["0.8","0.85","0.9","0.95","1"]"#),
    ] {
        let names = if log { ".map((tick) => tick[1])" } else { "" };
        let Some(found) =
            evaluated(&page, &format!("JSON.stringify(ticks({range}, {log}){names})"))
        else {
            println!("skipped: there is no Node.js");
            return;
        };
        assert_eq!(found.trim(), expected, "{range}");
    }
}

#[test]
fn a_damaged_file_of_an_identification_is_named() {
    let dir = TempDir::new().expect("a folder");
    let write = |file: &str, text: &str| fs::write(dir.path().join(file), text).expect("a file");
    for (file, text) in [
        ("fit.csv", "name\nx"),
        ("fit.csv", "a,b\nx"),
        ("trajectories.csv", "x"),
        ("identified.csv", "x"),
        ("identified.csv", ""),
    ] {
        write(
            "identified.csv",
            "name,start,value,standard_error,robust_error,status,correlation with a\na,1,2,0.1,0.1,estimated,1\n",
        );
        write("fit.csv", "name,value\nsegments,1\n");
        write("trajectories.csv", "segment,t,x_measured,x_simulated\n0,0,1,1\n");
        write(file, text);
        let said = refusal(dir.path());
        assert!(said.contains(&format!("{file} is damaged; restore the file")), "{file}: {said}");
    }
}

#[test]
fn infinite_samples_of_an_identification_are_not_drawn() {
    let dir = TempDir::new().expect("a folder");
    let write = |file: &str, text: &str| fs::write(dir.path().join(file), text).expect("a file");
    write(
        "identified.csv",
        "name,start,value,standard_error,robust_error,correlation with a\na,1,2,0.1,0.1,1\n",
    );
    write("fit.csv", "name,value\nsegments,1\n");
    write(
        "trajectories.csv",
        "segment,t,x_measured,x_simulated\n0,0,1,1\n0,1,inf,1\n0,2,1,-inf\n0,inf,1,1\n0,3,1,1.5\n",
    );
    assert!(!report(dir.path()).contains("NaN"));
}
