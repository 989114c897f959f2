//! Plans of many trainings, as files and as short forms of `compare`: errors and results.

use crate::json::check;
use crate::markdown::root;
use crate::numbers::{physgrad, read};
use crate::runs::{SMALL, error, succeed};
use serde_json::Value;
use std::fs;
use tempfile::TempDir;

/// Plan with small runs. The policy of each task has one hidden layer of four units.
const PLAN: &str = "\
seeds = 2
epochs = 2
best = { \"training.learning_rate\" = [0.001, 0.1] }

[[task]]
scene = \"cart_pole_1\"
set = { horizon = 5, policy.widths = [4], \"training.train_samples\" = 8, \"training.test_samples\" = 4 }

[[task]]
name = \"mine\"
scene = \"scenes/mine.toml\"

[[method]]
name = \"R, clipped\"
set = { field = \"R\", training = { clip = \"norm\", clip_limit = 0.5 } }

[[method]]
name = \"C\"
set = { field = \"C\" }
";

const SCENE: &str = "scene = 1\ntask = \"cart_pole\"\nhorizon = 5\nfield = \"regular\"\n[system]\npoles = 1\n[policy]\nwidths = [4]\n\
                     [training]\ntrain_samples = 8\ntest_samples = 4\n";

/// Returns a folder with the plan in `plans/plan.toml` and [`SCENE`] in `plans/scenes/mine.toml`.
fn folder(plan: &str) -> TempDir {
    let dir = TempDir::new().expect("a folder");
    fs::create_dir_all(dir.path().join("plans/scenes")).expect("a folder");
    fs::write(dir.path().join("plans/plan.toml"), plan).expect("a file");
    fs::write(dir.path().join("plans/scenes/mine.toml"), SCENE).expect("a file");
    dir
}

#[test]
fn errors_of_a_plan_name_the_line_and_the_allowed_values() {
    for (old, new, message) in [
        (
            "seeds = 2",
            "sedes = 2",
            "plan.toml:1: `sedes` is unknown; allowed: `title`, `seeds`, `epochs`, `fields`, `grid`, `best`, `figure`, `list`, `task`, `method`",
        ),
        ("seeds = 2", "seeds = 0", "plan.toml:1: `seeds` is 0; allowed: 1 to 10000"),
        (
            "seeds = 2",
            "seeds = \"two\"",
            "plan.toml:1: `seeds` is string \"two\"; allowed: a whole number, 0 or more",
        ),
        ("epochs = 2", "epochs = 0", "plan.toml:2: `epochs` is 0; allowed: 1 or more"),
        (
            "[0.001, 0.1]",
            "[]",
            "plan.toml:3: `best.training.learning_rate` is []; allowed: a list of values",
        ),
        (
            "[0.001, 0.1]",
            "[0.1, 0.1]",
            "plan.toml:3: `best.training.learning_rate[1]` is 0.1; allowed: distinct values",
        ),
        (
            "[0.001, 0.1]",
            "[-0.1, 0.1]",
            "plan.toml:3: `training.learning_rate` is -0.1; allowed: a positive number up to 1e6",
        ),
        (
            "scene = \"cart_pole_1\"",
            "scen = \"cart_pole_1\"",
            "plan.toml:6: `task[0].scen` is unknown; allowed: `name`, `scene`, `set`",
        ),
        ("\"cart_pole_1\"", "\"cart_pole_l\"", "plan.toml:6: there is no preset `cart_pole_l`"),
        (
            "\"cart_pole_1\"",
            "7",
            "plan.toml:6: `task[0].scene` is 7; allowed: a preset, or the path of a scene",
        ),
        (
            "\"scenes/mine.toml\"",
            "\"scenes/yours.toml\"",
            "plan.toml:11: cannot read plans/scenes/yours.toml",
        ),
        ("policy.widths = [4]", "policy.width = [4]", "plan.toml:7: `policy.width` is unknown"),
        ("name = \"C\"\n", "", "plan.toml:17: `method[1].name` is missing"),
        (
            "name = \"C\"",
            "name = \"R, clipped\"",
            "plan.toml:18: two entries [[method]] have the name \"R, clipped\"",
        ),
        (
            "name = \"mine\"",
            "name = \"../mine\"",
            "plan.toml:10: `task[1].name` is \"../mine\"; allowed: a name of up to 100 bytes without `/`",
        ),
        ("field = \"C\"", "training.field = \"C\"", "plan.toml:19: `training.field` is unknown"),
        ("field = \"C\"", "field = \"X\"", "plan.toml:19: `field`"),
        (
            "field = \"C\"",
            "seed = 3",
            "plan.toml:19: `method[1].set.seed` cannot be set: every combination trains several seeds",
        ),
        ("field = \"C\"", "task = \"push\"", "plan.toml:19: `method[1].set.task` cannot be set"),
        (
            "field = \"C\"",
            "initial_policy = \"p\"",
            "plan.toml:19: `initial_policy`: cannot read plans/p",
        ),
        (
            "name = \"C\"",
            "name = \"C.previous-1\"",
            "plan.toml:18: `method[1].name` is \"C.previous-1\"; allowed: a name of up",
        ),
        (
            "name = \"C\"",
            "name = \"r, Clipped\"",
            "plan.toml:18: two entries [[method]] have the name",
        ),
        (
            "field = \"C\"",
            "\"training.learning_rate\" = 1",
            "is set, but `best` replaces it; remove one of them",
        ),
        ("field = \"C\"", "\"system.masses\" = 1", "(task cart_pole_1, method C)"),
        ("seeds = 2", "seeds = ", "plan.toml:1: "),
    ] {
        assert!(PLAN.contains(old), "{old}");
        let dir = folder(&PLAN.replacen(old, new, 1));
        let found = error(&dir, "study plans/plan.toml --quiet -o out");
        assert!(found.contains(message), "{new}: {found}, expected {message}");
        assert!(!dir.path().join("out").exists(), "{new}: an invalid plan creates a folder");
    }
    let found = error(&folder("[[task]]\nscene = \"push\"\n"), "study plans/plan.toml");
    assert!(
        found.contains("`method` is missing; add an entry [[method]], or a list `fields`"),
        "{found}"
    );
    assert!(
        error(&folder(PLAN), "study plans/other.toml").contains("cannot read plans/other.toml")
    );
}

#[test]
fn a_study_trains_every_combination_and_equals_single_runs() {
    let dir = folder(PLAN);
    let study = "study plans/plan.toml -o out";
    let output = physgrad(&format!("{study} --json"), dir.path())
        .assert()
        .success()
        .get_output()
        .stdout
        .clone();
    let object: Value = serde_json::from_slice(&output).expect("JSON");
    check("study", &object);
    let methods = object["methods"].as_array().expect("rows");
    let names = methods
        .iter()
        .map(|row| [&row["task"], &row["method"]].map(|name| name.as_str().expect("a name")));
    let expected =
        ["cart_pole_1", "mine"].map(|task| ["R, clipped", "C"].map(|method| [task, method]));
    assert_eq!(names.collect::<Vec<_>>(), expected.concat());
    assert!(
        methods.iter().all(|row| row["seeds"] == 2 && row["median_test_loss"].is_number()),
        "{object}"
    );

    // Both tasks have equal settings, so C has equal results.
    assert_eq!(methods[1]["median_test_loss"], methods[3]["median_test_loss"]);
    let bytes = |path: &str| fs::read(dir.path().join(path)).expect(path);
    let train = "train plans/scenes/mine.toml --quiet --seed 1 --epochs 2 --set training.learning_rate=0.1 --set training.clip=norm \
                 --set training.clip_limit=0.5 --out one";
    physgrad(train, dir.path()).assert().success();
    for task in ["mine", "cart_pole_1"] {
        let run = format!("out/{task}+R, clipped+learning_rate=0.1/runs/R-1");
        assert_eq!(bytes("one/policy.safetensors"), bytes(&format!("{run}/policy.safetensors")));
    }
    let summary = String::from_utf8(bytes("out/summary.csv")).expect("text");
    assert_eq!(summary.lines().count(), 1 + 2 * 2 * 2 * 2);
    let picture = String::from_utf8(bytes("out/losses.svg")).expect("text");
    for label in [">cart_pole_1<", ">mine<", ">1: R, clipped<", ">2: C<", ">untrained policy<"] {
        assert_eq!(picture.matches(label).count(), 1, "{label}");
    }

    // The program refuses a method with other settings, and the folder keeps its plan.
    let plan = bytes("out/comparison.toml");
    fs::write(
        dir.path().join("plans/plan.toml"),
        PLAN.replace("clip_limit = 0.5", "clip_limit = 0.7"),
    )
    .expect("a file");
    assert!(error(&dir, study).contains("keeps its settings"));
    assert_eq!(plan, bytes("out/comparison.toml"));
    let changed = String::from_utf8(plan.clone())
        .expect("text")
        .replace("clip_limit = 0.5", "clip_limit = 0.7");
    fs::write(dir.path().join("out/comparison.toml"), changed).expect("a file");
    assert!(error(&dir, "merge out").contains("keeps its settings"));
    fs::write(dir.path().join("out/comparison.toml"), plan).expect("a file");
    assert!(error(&dir, "train push --quiet -o out").contains("out holds a comparison"));

    // The scene is in the plan of the folder: `merge` needs no other file.
    let table = bytes("out/table.csv");
    fs::remove_dir_all(dir.path().join("plans/scenes")).expect("a folder");
    fs::remove_file(dir.path().join("out/table.csv")).expect("a file");
    physgrad("merge out --quiet", dir.path()).assert().success();
    assert_eq!(table, bytes("out/table.csv"));
    // The plan in the folder is valid, and the runs are complete.
    physgrad("study out/comparison.toml --quiet -o out", dir.path()).assert().success();
    assert_eq!(table, bytes("out/table.csv"));
    physgrad("report out", dir.path()).assert().success();

    // The program refuses folders with other contents.
    let refused = error(&dir, "study out/comparison.toml -o one");
    assert!(refused.contains("one holds a run and is not a comparison"), "{refused}");
    let refused = error(&dir, "compare push -o out");
    assert!(refused.contains("out holds a comparison of several scenes"), "{refused}");
    let missing = fs::remove_dir_all(dir.path().join("out/mine+C+learning_rate=0.1"));
    missing.expect("a folder");
    let missing = "2 of 16 runs are missing or not complete";
    assert!(error(&dir, "merge out --quiet").contains(missing));
    for folder in fs::read_dir(dir.path().join("out")).expect("a folder") {
        let folder = folder.expect("an entry").path();
        if folder.is_dir() && folder.to_string_lossy().contains("mine+") {
            fs::remove_dir_all(folder).expect("a folder");
        }
    }
    let said = error(&dir, "merge out --quiet");
    assert!(said.contains("8 of 16 runs are missing or not complete"), "{said}");
    assert!(said.trim_end().ends_with(" and 4 more") && said.lines().count() == 1, "{said}");
}

#[test]
fn a_plan_without_values_to_choose_has_one_run_per_task_method_and_seed() {
    let plan = PLAN
        .replace("best = { \"training.learning_rate\" = [0.001, 0.1] }\n", "")
        .replace("field = \"C\"", "training.learning_rate = 0.02");
    let dir = folder(&plan);
    physgrad("study plans/plan.toml --quiet -o out", dir.path()).assert().success();
    assert_eq!(read(&dir, "out/times.csv").len(), 1 + 4);
    assert_eq!(read(&dir, "out/table.csv")[0][..3], ["task", "method", "seeds"]);
    let settings = fs::read_to_string(dir.path().join("out/mine+C/runs/R-0/run.toml"));
    let settings = settings.expect("the method keeps the field of the scene");
    assert!(settings.contains("learning_rate = 0.02"), "{settings}");
}

#[test]
fn a_grid_and_a_list_give_every_combination_and_a_figure_lays_them_out() {
    let small = "set = { epochs = 1, horizon = 5, policy.widths = [4], training.train_samples = 8, training.test_samples = 4 }";
    let task = format!("[[task]]\nscene = \"cart_pole_1\"\n{small}\n");
    let tasks = format!("{task}{}", task.replace("pole_1", "pole_2"));
    let list = "[[list]]\ntraining = { clip = \"norm\", clip_limit = 0.5 }\n[[list]]\ntraining.clip = \"value\"\ntraining.clip_limit = 2\n";
    let head = "seeds = 1\nfields = [\"C\", \"R\"]\ngrid = { \"training.batch\" = [4, 8] }\n";
    let figure =
        "[figure]\nrows = \"training.batch\"\ncolumns = \"task\"\nupdate_size = \"cart_pole_2\"\n";

    let dir = folder(&format!("{head}{list}{tasks}"));
    physgrad("study plans/plan.toml --quiet -o out", dir.path()).assert().success();
    let rows = read(&dir, "out/summary.csv");
    let names = ["task", "training.batch", "training.clip", "training.clip_limit", "field", "seed"];
    assert_eq!(rows[0][..6], names);
    assert_eq!(rows.len(), 1 + 2 * 2 * 2 * 2);
    assert_eq!(rows[16][..6], ["cart_pole_2", "8", "value", "2", "R", "0"]);
    let run = "out/cart_pole_2+batch=8+clip=value+clip_limit=2/runs/R-0/run.toml";
    let settings = fs::read_to_string(dir.path().join(run)).expect("settings");
    assert!(settings.contains("batch = 8\n") && settings.contains("clip_limit = 2"), "{settings}");

    let dir = folder(&format!("{head}{figure}{tasks}"));
    physgrad("study plans/plan.toml --quiet -o out", dir.path()).assert().success();
    let picture = fs::read_to_string(dir.path().join("out/figure.svg")).expect("a picture");
    roxmltree::Document::parse(&picture).expect("an SVG is XML");
    for (label, count) in [
        (">cart_pole_1<", 1),
        (">cart_pole_2<", 1),
        (">cart_pole_2: update size<", 1),
        (">test loss (batch: 8)<", 1),
        (">norm of the field<", 2),
    ] {
        assert_eq!(picture.matches(label).count(), count, "{label}");
    }
    assert!(!dir.path().join("out/curves.svg").exists(), "a figure replaces the curves");
}

#[test]
fn runs_of_a_grid_equal_single_runs() {
    let dir = TempDir::new().expect("a folder");
    let compare = format!(
        "compare cart_pole_1 {SMALL} --set training.learning_rate=0.001,0.1 --fields R,C --seeds 2 --out sweep"
    );
    let output = succeed(&dir, &compare);
    assert!(output.contains("lowest median final test loss: learning_rate=0.1, "), "{output}");
    let rows = read(&dir, "sweep/summary.csv");
    assert_eq!(rows[0][..3], ["training.learning_rate", "field", "seed"]);
    assert_eq!(rows.len(), 1 + 2 * 2 * 2);
    succeed(
        &dir,
        &format!(
            "train cart_pole_1 {SMALL} --set training.learning_rate=0.1 --field R --seed 1 --quiet --out one"
        ),
    );
    let bytes = |path: &str| fs::read(dir.path().join(path)).expect(path);
    assert_eq!(
        bytes("one/policy.safetensors"),
        bytes("sweep/learning_rate=0.1/runs/R-1/policy.safetensors")
    );
    let row = rows.iter().find(|row| row[..3] == ["0.1", "R", "1"]).expect("the row of the run");
    let column = rows[0].iter().position(|name| name == "final_test_loss").expect("a column");
    assert_eq!(row[column], read(&dir, "one/metrics.csv")[1][3]);
    let svg = String::from_utf8(bytes("sweep/settings.svg")).expect("text");
    roxmltree::Document::parse(&svg).expect("an SVG is XML");
    assert!(
        ["training.learning_rate", "final test loss", "C (combined)"]
            .iter()
            .all(|label| svg.contains(label))
    );

    // Repeats the command: the runs are complete, and nothing changes.
    let before = bytes("sweep/learning_rate=0.1/runs/R-1/metrics.csv");
    succeed(&dir, &compare);
    assert_eq!(bytes("sweep/learning_rate=0.1/runs/R-1/metrics.csv"), before);
}

#[test]
fn several_values_are_refused_where_they_have_no_meaning() {
    let dir = TempDir::new().expect("a folder");
    for (args, message) in [
        (
            "train cart_pole --set training.batch=4,8",
            "has several values, which only `compare` trains",
        ),
        (
            "compare cart_pole --set training.batch=4 --set training.batch=4,8",
            "`training.batch` has several values and is set twice",
        ),
        ("compare cart_pole --epochs 2 --set epochs=1,2", "`epochs` has several values and is set"),
        ("compare cart_pole --set seed=1,2", "`grid.seed` cannot be set: every combination trains"),
        (
            "compare cart_pole --set training.batch=4,4",
            "`grid.training.batch[1]` is 4; allowed: distinct values",
        ),
        ("compare cart_pole --set training.batch=4,x", "--set: `training.batch` is string"),
    ] {
        let found = error(&dir, args);
        assert!(found.contains(message), "{args}: {found}");
    }
}

/// A comparison of one scene writes to `runs`, one of several scenes or combinations to
/// `NAME/runs`. One folder cannot hold both, nor comparisons of two different single scenes.
#[test]
fn a_comparison_of_one_scene_does_not_mix_with_another_one() {
    let dir = TempDir::new().expect("a folder");
    let small = "--fields R --seeds 1 --epochs 1 --set training.train_samples=8 --set training.test_samples=4 --quiet";
    let one = format!("compare cart_pole_1 {small}");
    let several = format!("{one} --set training.batch=2,4");
    let run = |command: &str, folder: &str| {
        physgrad(&format!("{command} --out {folder}"), dir.path()).assert()
    };
    run(&one, "first").success();
    run(&several, "second").success();
    let other = one.replace("cart_pole_1", "cart_pole_2").replace("--fields R", "--fields M");
    let others = several.replace("batch=2,4", "batch=1,8");
    for (command, folder, found) in [
        (others, "second", "second holds another comparison"),
        (several, "first", "first holds a comparison of one scene"),
        (one, "second", "second holds a comparison of several scenes"),
        (other, "first", "first/runs/R-0 holds a run with other settings"),
    ] {
        let stderr = run(&command, folder).failure().get_output().stderr.clone();
        let stderr = String::from_utf8_lossy(&stderr);
        assert!(stderr.contains(found), "{stderr}");
    }
}

#[test]
fn the_plans_of_the_repository_are_valid() {
    let dir = TempDir::new().expect("a folder");
    let plans = fs::read_dir(root().join("examples/plans")).expect("a folder");
    for plan in plans {
        let path = plan.expect("an entry").path();
        // The program reads the plan, then refuses a folder that holds a run.
        fs::write(dir.path().join("run.toml"), "").expect("a file");
        let path = path.to_str().expect("a path in UTF-8");
        for quick in ["", " --quick"] {
            let found = error(&dir, &format!("study {path}{quick} -o ."));
            assert!(found.contains("holds a run and is not a comparison"), "{path}: {found}");
        }
    }
}
