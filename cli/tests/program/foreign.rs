//! Folders, files and names of others: results stay in their folder, text of others does not control
//! the terminal, and one bad folder does not hide the rest.

use crate::running::{SMALL, error_of, physgrad, train};
use assert_cmd::Command;
use std::fs::{self, File};
use std::path::Path;
use std::time::Duration;
use tempfile::TempDir;

/// Time limit of a command, which includes a margin for a loaded machine.
const TIME_LIMIT: Duration = Duration::from_secs(20);

/// Sequences that set the title of a terminal and clear its screen.
const ESCAPES: &str = "\u{1b}]0;title\u{7}\u{9b}2J\u{202e}";

fn compare(out: &Path, args: &[&str]) -> Command {
    let mut command = physgrad(&[
        "compare",
        "cart_pole",
        "--fields",
        "R",
        "--seeds",
        "1",
        "--epochs",
        "1",
        "-q",
        "--out",
    ]);
    command.arg(out).args(SMALL).args(args);
    command
}

fn run(args: &[&str], folder: &Path) -> [String; 2] {
    let output =
        physgrad(args).current_dir(folder).timeout(TIME_LIMIT).output().expect("the command runs");
    [output.stdout, output.stderr].map(|bytes| String::from_utf8(bytes).expect("text"))
}

#[test]
fn names_in_a_plan_do_not_lead_out_of_its_folder() {
    let dir = TempDir::new().expect("a folder");
    let [two, other] = ["two", "other"].map(|name| dir.path().join(name));
    let scenes = ["cart_pole_1", "--set", "training.batch=4,8"];
    compare(&two, &scenes).assert().success();
    fs::rename(two.join("cart_pole+batch=4"), &other).expect("a moved folder");
    let picture = other.join("runs/R-0/animation.svg");
    fs::write(&picture, "mine").expect("a file");
    let plan = fs::read_to_string(two.join("comparison.toml")).expect("a plan");
    let absolute = other.display().to_string();
    let refusal = |from: &str, to: &str| {
        assert!(plan.contains(from), "{from}: {plan}");
        fs::write(two.join("comparison.toml"), plan.replacen(from, to, 1)).expect("a plan");
        let error = error_of(physgrad(&["merge"]).arg(&two).timeout(TIME_LIMIT));
        assert_eq!(fs::read_to_string(&picture).expect("a file"), "mine", "{to}");
        error
    };
    for name in ["../other", &*absolute, "..", "a\\\\b", ""] {
        let error = refusal("name = \"cart_pole\"", &format!("name = \"{name}\""));
        assert!(error.contains("`task[0].name` is"), "{name}: {error}");
    }
    // Values in the names of folders do not lead out of the folder either, nor do names of policies.
    for value in ["..", "../other", &*absolute, "a\\u0000b"] {
        let error = refusal("[4, 8]", &format!("[\"{value}\"]"));
        assert!(error.contains("`training.batch` is string"), "{value}: {error}");
    }
    let beside = "`initial_policy` is \"../other/runs/R-0/policy.safetensors\"; allowed: a file beside the plan";
    let path = "initial_policy = \"../other/runs/R-0/policy.safetensors\"";
    for (from, to) in [
        ("[task.scene]", format!("[task.scene]\n{path}")),
        ("[task.scene]", format!("[task.set]\n{path}\n[task.scene]")),
        ("[grid]", format!("[grid]\n{}]", path.replace("= ", "= ["))),
    ] {
        let error = refusal(from, &to);
        assert!(error.contains(beside), "{to}: {error}");
    }
}

#[cfg(unix)]
#[test]
fn linked_folders_inside_a_folder_are_neither_written_nor_searched() {
    use std::os::unix::fs::symlink;
    let dir = TempDir::new().expect("a folder");
    let [folder, other] = ["received", "other"].map(|name| dir.path().join(name));
    compare(&folder, &[]).assert().success();
    let inner = folder.join("runs/R-0");
    fs::rename(&inner, &other).expect("a moved folder");
    symlink(&other, &inner).expect("a link");
    let picture = other.join("animation.svg");
    fs::write(&picture, "mine").expect("a file");
    for (command, message) in [
        (physgrad(&["animate"]).arg(&folder), "omitted 1 link to folders"),
        (physgrad(&["merge"]).arg(&folder), "R-0 is a link"),
        (&mut compare(&folder, &[]), "R-0 is a link"),
    ] {
        let error = error_of(command.timeout(TIME_LIMIT));
        assert!(error.contains(message), "{message}: {error}");
        assert_eq!(fs::read_to_string(&picture).expect("a file"), "mine", "{message}");
    }
    // Links that lead back to a folder: without the rule, the search would visit 20^5 folders.
    for i in 0..20 {
        symlink(dir.path(), dir.path().join(format!("link{i}"))).expect("a link");
    }
    let [said, error] = run(&["runs", "."], dir.path());
    assert!(said.contains("│ ./other ") && said.ends_with("1 run\n"), "{said}{error}");
    assert!(error.contains("omitted 20 links to folders, for example ./link0"), "{error}");
}

#[cfg(unix)]
#[test]
fn a_schema_replaces_a_file_and_not_the_target_of_a_link() {
    let dir = TempDir::new().expect("a folder");
    fs::write(dir.path().join("target"), "mine").expect("a file");
    std::os::unix::fs::symlink("target", dir.path().join("link")).expect("a link");
    assert!(
        run(&["schema", "--out", "link"], dir.path())[1]
            .contains("--out: link: it exists and is not a regular file")
    );
    assert_eq!(fs::read_to_string(dir.path().join("target")).expect("a file"), "mine");
    assert_eq!(run(&["schema", "--out", "target"], dir.path()), ["", ""]);
    assert!(fs::read_to_string(dir.path().join("target")).expect("a file").contains("\"$schema\""));
}

#[test]
fn oversized_files_and_long_tags_do_not_hide_the_other_runs() {
    let dir = TempDir::new().expect("a folder");
    let settings = |tag: &str| {
        format!("task = \"lqr\"\nfield = \"regular\"\nseed = 1\nepochs = 1\ntags = [\"{tag}\"]\n")
    };
    for (name, tag) in [
        ("a", "short"),
        ("b", &*"x".repeat(900_000)),
        ("c", &*"x ".repeat(450_000)),
        ("d", ""),
        ("e", ""),
    ] {
        fs::create_dir(dir.path().join(name)).expect("a folder");
        fs::write(dir.path().join(name).join("run.toml"), settings(tag)).expect("a file");
    }
    let sparse = |path: &str| {
        let file =
            File::options().write(true).create(true).truncate(false).open(dir.path().join(path));
        file.and_then(|file| file.set_len(1 << 40)).expect("a sparse file");
    };
    ["d/metrics.csv", "e/run.toml", "a/checkpoint.bin", "large.safetensors"]
        .into_iter()
        .for_each(sparse);
    let [said, error] = run(&["runs", "."], dir.path());
    assert!(said.ends_with("3 runs\n") && said.len() < 20_000, "{error}{said:.2000}");
    for file in ["d/metrics.csv", "e/run.toml"] {
        assert!(error.contains(&format!("omitted a run: ./{file} has more than ")), "{error}");
    }
    assert!(run(&["scene"], dir.path())[1].is_empty());
    let policy = ["train", "lqr", "--policy", "large.safetensors", "-o", "run"];
    assert!(
        run(&policy, dir.path())[1].contains("large.safetensors has more than "),
        "{:?}",
        run(&policy, dir.path())
    );
}

#[test]
fn control_characters_of_others_do_not_reach_the_terminal() {
    let dir = TempDir::new().expect("a folder");
    let tagged = dir.path().join(format!("run{ESCAPES}"));
    fs::create_dir(&tagged).expect("a folder");
    let tag: String = ESCAPES.chars().map(|c| format!("\\u{:04x}", c as u32)).collect();
    let settings =
        format!("task = \"{tag}\"\nfield = \"{tag}\"\nseed = 1\nepochs = 1\ntags = [\"{tag}\"]\n");
    fs::write(tagged.join("run.toml"), &settings).expect("a file");
    fs::create_dir(dir.path().join("held")).expect("a folder");
    fs::write(dir.path().join("held/.physgrad.lock"), ESCAPES).expect("a file");
    fs::write(
        dir.path().join("bad.toml"),
        format!("scene = 1\ntask = \"lqr\"\n[system]\n\"a{tag}\" = 1\n"),
    )
    .expect("a file");
    fs::write(dir.path().join("worse.toml"), format!("scene = 1\ntask = {ESCAPES}\n"))
        .expect("a file");
    fs::write(dir.path().join("data.csv"), format!("t,x{ESCAPES}\n0,{ESCAPES}\n")).expect("a file");
    let held = File::open(dir.path().join("held/.physgrad.lock")).expect("a file");
    held.lock().expect("a lock");
    let [name, assignment] = [format!("no{ESCAPES}.toml"), format!("system.x{ESCAPES}={ESCAPES}")];
    let [option, run_name] = [format!("--{ESCAPES}"), format!("run{ESCAPES}")];
    let cases: [&[&str]; 17] = [
        &["runs", "."],
        &["runs", ".", "--json"],
        &["runs", ".", "-o", "listed"],
        &["explain", &name],
        &["explain", "bad.toml"],
        &["explain", "worse.toml"],
        &["explain", "lqr", "--set", &assignment],
        &["explain", &option],
        &["scene", &name],
        &["tasks", &name],
        &["report", &run_name],
        &["animate", &run_name],
        &["merge", &run_name],
        &["eval", &run_name],
        &["train", "--resume", "-o", &run_name],
        &["train", "lqr", "--epochs", "0", "-o", "held"],
        &["identify", "cart_pole", "--data", "data.csv", "--fit", "system.cart_mass"],
    ];
    for args in cases {
        let said = run(args, dir.path()).concat();
        assert!(!said.is_empty(), "{args:?}");
        let bad = said
            .chars()
            .find(|&c| (c.is_control() && !matches!(c, '\n' | '\t')) || c == '\u{202e}');
        assert_eq!(bad, None, "{args:?}: {said:?}");
    }
    // The escaped JSON has the original text, and a label of a picture is XML.
    let list: serde_json::Value =
        serde_json::from_str(&run(&["runs", ".", "--json"], dir.path())[0]).expect("JSON");
    assert_eq!(
        (&list["runs"][0]["tags"], &list["runs"][0]["run"]),
        (&ESCAPES.into(), &format!("./run{ESCAPES}").into())
    );
    let picture = fs::read_to_string(dir.path().join("listed/curves.svg")).expect("a picture");
    roxmltree::Document::parse(&picture).expect("an SVG is XML");
    let [_, error] = run(&["train", "lqr", "--epochs", "0", "-o", "held"], dir.path());
    assert!(error.contains("in use by \\u{1b}]0;title\\u{7}\\u{9b}2J"), "{error}");
}

#[test]
fn an_identification_without_a_header_keeps_its_report() {
    let dir = TempDir::new().expect("a folder");
    fs::write(dir.path().join("report.html"), "mine").expect("a file");
    for text in ["", "name,start\n"] {
        fs::write(dir.path().join("identified.csv"), text).expect("a file");
        assert!(
            run(&["report", "."], dir.path())[1].contains("./identified.csv is damaged"),
            "{text:?}"
        );
        assert_eq!(fs::read_to_string(dir.path().join("report.html")).expect("a file"), "mine");
    }
    let files = [
        (
            "identified.csv",
            "name,start,value,standard_error,robust_error,status\nm,1,2,0.1,0.1,estimated\n",
        ),
        ("fit.csv", "name,value\nchi2,1\n"),
        (
            "trajectories.csv",
            "segment,t,x_measured,x_simulated\na,0,inf,1\na,1,1,2\na,2,NaN,1\na,inf,1,1\n",
        ),
    ];
    files.iter().for_each(|(name, text)| fs::write(dir.path().join(name), text).expect("a file"));
    assert_eq!(run(&["report", "."], dir.path()), ["./report.html\n", ""]);
    let page = fs::read_to_string(dir.path().join("report.html")).expect("a page");
    assert!(
        page.contains("x, segment a") && !page.contains("NaN") && !page.contains("inf\""),
        "{page}"
    );
}

#[test]
fn a_formula_in_a_tag_is_text_in_csv_and_unchanged_in_json() {
    let dir = TempDir::new().expect("a folder");
    let tag = "=HYPERLINK(1)";
    fs::create_dir(dir.path().join("a")).expect("a folder");
    fs::write(dir.path().join("a/run.toml"), format!("task = \"lqr\"\ntags = [\"{tag}\"]\n"))
        .expect("a file");
    let [said, error] = run(&["runs", ".", "--json", "-o", "listed"], dir.path());
    let list: serde_json::Value = serde_json::from_str(&said).expect("JSON");
    assert_eq!(list["runs"][0]["tags"], tag, "{error}");
    let table = fs::read_to_string(dir.path().join("listed/runs.csv")).expect("a table");
    assert!(table.contains(&format!(",'{tag}\n")), "{table}");
}

#[test]
fn reports_and_animations_of_a_folder_are_written_elsewhere() {
    let dir = TempDir::new().expect("a folder");
    let out = dir.path().join("one");
    train(&out, &["--epochs", "1", "-q"]).assert().success();
    compare(&dir.path().join("two"), &[]).assert().success();
    let modified = |file: &str| {
        fs::metadata(dir.path().join(file)).and_then(|file| file.modified()).expect("a time")
    };
    let files = ["one/animation.svg", "two/runs/R-0/animation.svg"];
    let before = files.map(modified);
    assert_eq!(
        run(&["report", "one", "-o", "pages/new"], dir.path()),
        ["pages/new/report.html\n", ""]
    );
    assert_eq!(
        run(&["animate", "two", "-o", "pages"], dir.path()),
        ["pages/runs/R-0/animation.svg\n", ""]
    );
    assert_eq!(run(&["animate", "one", "-o", "pages"], dir.path()), ["pages/animation.svg\n", ""]);
    let read = |file: &str| fs::read(dir.path().join(file)).expect(file);
    assert_eq!(read("pages/animation.svg"), read("one/animation.svg"));
    assert_eq!(files.map(modified), before);
    assert!(
        !read("pages/new/report.html").is_empty() && !dir.path().join("one/report.html").exists()
    );
}
