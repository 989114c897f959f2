//! Studies: plans, their errors, and results.

use crate::json::check;
use crate::markdown::root;
use crate::numbers::{physgrad, read};
use serde_json::Value;
use std::fs;
use tempfile::TempDir;

/// Plan with small runs. The policy of each task has one hidden layer of four units.
const PLAN: &str = "\
seeds = 2
epochs = 2
learning_rates = [0.001, 0.1]

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

fn error(dir: &TempDir, args: &str) -> String {
    String::from_utf8(physgrad(args, dir.path()).assert().failure().get_output().stderr.clone())
        .expect("text")
}

#[test]
fn errors_of_a_plan_name_the_line_and_the_allowed_values() {
    for (old, new, message) in [
        (
            "seeds = 2",
            "sedes = 2",
            "plan.toml:1: `sedes` is unknown; allowed: `seeds`, `epochs`, `learning_rates`, `task`, `method`",
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
            "plan.toml:3: `learning_rates` is []; allowed: one learning rate or more",
        ),
        (
            "[0.001, 0.1]",
            "[0.1, 0.1]",
            "plan.toml:3: `learning_rates[1]` is 0.1; allowed: distinct learning rates",
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
            "plan.toml:19: `seed` cannot be set: a study trains several seeds",
        ),
        ("field = \"C\"", "task = \"push\"", "plan.toml:19: `task` cannot be set"),
        (
            "field = \"C\"",
            "initial_policy = \"p\"",
            "plan.toml:19: `initial_policy` cannot be set: a study trains from random",
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
            "`learning_rates` replaces it; remove one of them",
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
    assert!(found.contains("`method` is missing; add an entry [[method]]"), "{found}");
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
    let picture = String::from_utf8(bytes("out/study.svg")).expect("text");
    for label in [">cart_pole_1<", ">mine<", ">1: R, clipped<", ">2: C<", ">untrained policy<"] {
        assert_eq!(picture.matches(label).count(), 1, "{label}");
    }

    // The program refuses a method with other settings, and the folder keeps its plan.
    let plan = bytes("out/study.toml");
    fs::write(
        dir.path().join("plans/plan.toml"),
        PLAN.replace("clip_limit = 0.5", "clip_limit = 0.7"),
    )
    .expect("a file");
    assert!(error(&dir, study).contains("keeps its settings"));
    assert_eq!(plan, bytes("out/study.toml"));
    let changed = String::from_utf8(plan.clone())
        .expect("text")
        .replace("clip_limit = 0.5", "clip_limit = 0.7");
    fs::write(dir.path().join("out/study.toml"), changed).expect("a file");
    assert!(error(&dir, "merge out").contains("keeps its settings"));
    fs::write(dir.path().join("out/study.toml"), plan).expect("a file");
    assert!(error(&dir, "train push --quiet -o out").contains("out holds a study"));

    // The scene is in the plan of the folder: `merge` needs no other file.
    let table = bytes("out/study.csv");
    fs::remove_dir_all(dir.path().join("plans/scenes")).expect("a folder");
    fs::remove_file(dir.path().join("out/study.csv")).expect("a file");
    physgrad("merge out --quiet", dir.path()).assert().success();
    assert_eq!(table, bytes("out/study.csv"));
    // The plan in the folder is valid, and the runs are complete.
    physgrad("study out/study.toml --quiet -o out", dir.path()).assert().success();
    assert_eq!(table, bytes("out/study.csv"));
    physgrad("report out", dir.path()).assert().success();

    // The program refuses folders with other contents.
    assert!(
        error(&dir, "study out/study.toml -o one").contains("one holds a run and is not a study")
    );
    assert!(
        error(&dir, "compare push -o out").contains("out holds a study and is not a comparison")
    );
    let missing = fs::remove_dir_all(dir.path().join("out/mine+C+learning_rate=0.1"));
    missing.expect("a folder");
    assert!(error(&dir, "merge out --quiet").contains("2 of 16 runs are missing or not complete"));
}

#[test]
fn a_plan_without_learning_rates_uses_those_of_the_scenes_and_methods() {
    let plan = PLAN
        .replace("learning_rates = [0.001, 0.1]\n", "")
        .replace("field = \"C\"", "training.learning_rate = 0.02");
    let dir = folder(&plan);
    physgrad("study plans/plan.toml --quiet -o out", dir.path()).assert().success();
    let rows = read(&dir, "out/times.csv");
    assert_eq!(rows.len(), 1 + 4);
    let csv = fs::read_to_string(dir.path().join("out/study.csv")).expect("a table");
    assert!(csv.contains("mine,C,0.02,2,"), "{csv}");
    assert!(
        dir.path().join("out/mine+C/runs/R-0").exists(),
        "the method does not keep the field of the scene"
    );
}

#[test]
fn the_plans_of_the_repository_are_valid() {
    let dir = TempDir::new().expect("a folder");
    let plans = fs::read_dir(root().join("examples/plans")).expect("a folder");
    for plan in plans {
        let path = plan.expect("an entry").path();
        // The program reads the plan, then refuses a folder that holds a comparison.
        fs::write(dir.path().join("comparison.toml"), "").expect("a file");
        let path = path.to_str().expect("a path in UTF-8");
        for quick in ["", " --quick"] {
            let found = error(&dir, &format!("study {path}{quick} -o ."));
            assert!(found.contains("holds a comparison and is not a study"), "{path}: {found}");
        }
    }
}
