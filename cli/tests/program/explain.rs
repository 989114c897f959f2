//! Compares the counts and bytes of `physgrad explain` with those of the library. Checks presets by
//! `physgrad check`.

use assert_cmd::Command;
use physgrad::count::{OpCount, TaskOpCount};
use physgrad::policy::Mlp;
use physgrad::tasks::{
    CartPole, CartPoleEffect, CartPoleSystem, CoupledCartPole, DryFriction, PoleDamping,
};
use physgrad::{Adjoint, Field, Forced, Rollout, System};
use std::fs;
use tempfile::TempDir;

fn physgrad(args: &[&str]) -> Command {
    let mut command = Command::cargo_bin("physgrad").expect("the program is built");
    command.args(args);
    command
}

/// Returns the rows of all tables in the output, as cells.
fn explained(scene: &str, args: &[&str]) -> Vec<Vec<String>> {
    let dir = TempDir::new().expect("a folder");
    let file = dir.path().join("scene.toml");
    fs::write(&file, scene).expect("a file");
    let output = physgrad(&["explain"]).arg(&file).args(args).output().expect("the command runs");
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    let text = String::from_utf8(output.stdout).expect("text");
    let cells =
        |line: &str| line.split(['│', '┆']).map(|cell| cell.trim().to_owned()).collect::<Vec<_>>();
    text.lines()
        .map(cells)
        .map(|cells| cells.into_iter().filter(|cell| !cell.is_empty()).collect())
        .collect()
}

fn row<'a>(rows: &'a [Vec<String>], name: &str) -> &'a [String] {
    rows.iter()
        .find(|row| row.first().is_some_and(|first| first == name))
        .unwrap_or_else(|| panic!("{name}: {rows:?}"))
}

/// Returns the rows of the three passes of the part with this name, without the name.
fn passes(rows: &[Vec<String>], name: &str) -> Vec<Vec<String>> {
    let first = rows
        .iter()
        .position(|row| row.len() == 10 && row[0] == name)
        .unwrap_or_else(|| panic!("{name}: {rows:?}"));
    vec![rows[first][1..].to_vec(), rows[first + 1].clone(), rows[first + 2].clone()]
}

const SCENE: &str = "
scene = 1
task = \"cart_pole\"
horizon = 40
[system]
model = \"coupled\"
poles = 3
[effects]
pole_damping = {}
dry_friction = {}
[policy]
widths = [20]
";

fn model() -> CartPoleSystem {
    CartPoleSystem { poles: 3, ..CartPoleSystem::default() }
}

#[test]
fn operation_counts_of_each_effect_equal_those_of_the_library() {
    let rows = explained(SCENE, &[]);
    let cost = |system: &Forced<CoupledCartPole, Vec<CartPoleEffect>>| OpCount::of(system);
    let count =
        |effects: Vec<CartPoleEffect>| cost(&Forced { system: CoupledCartPole(model()), effects });
    let (alone, damped, all) = (
        count(vec![]),
        count(vec![PoleDamping::default().into()]),
        count(vec![PoleDamping::default().into(), DryFriction::default().into()]),
    );
    let of = |pass: &str, counts: physgrad::count::Ops| {
        let physgrad::count::Ops { add, negate, multiply, divide, sqrt, transcendental, compare } =
            counts;
        let numbers =
            [counts.total(), add, negate, multiply, divide, sqrt, transcendental, compare];
        [pass.to_owned()]
            .into_iter()
            .chain(numbers.map(|count| count.to_string()))
            .collect::<Vec<_>>()
    };
    let cells = |cost: &OpCount| {
        vec![of("step", cost.step), of("VJP", cost.vjp), of("VJP to control", cost.vjp_control)]
    };
    let printed = |name: &str| passes(&rows, name);
    assert_eq!(printed("system alone"), cells(&alone));
    assert_eq!(printed("together"), cells(&all));
    let own = OpCount {
        step: damped.step - alone.step,
        vjp: damped.vjp - alone.vjp,
        vjp_control: damped.vjp_control - alone.vjp_control,
    };
    assert_eq!(printed("effects.pole_damping"), cells(&own));
    let task = CartPole::with_system(Forced {
        system: CoupledCartPole(model()),
        effects: Vec::<CartPoleEffect>::new(),
    });
    let counts = TaskOpCount::of(&task);
    let pair = |name: &str| {
        let first = rows
            .iter()
            .position(|row| row.first().is_some_and(|first| first == name))
            .unwrap_or_else(|| panic!("{name}: {rows:?}"));
        [rows[first][1..].to_vec(), rows[first + 1].clone()]
    };
    let of_pair = |value, gradient| [of("value", value), of("gradient", gradient)];
    assert_eq!(pair("running cost"), of_pair(counts.running_cost, counts.running_cost_gradient));
    assert_eq!(pair("terminal cost"), of_pair(counts.terminal_cost, counts.terminal_cost_gradient));
    assert!(
        rows.iter().any(|row| row.first().is_some_and(|cell| cell == "present")
            && row[1] == "effects.dry_friction")
    );
    assert!(
        rows.iter()
            .any(|row| row.first().is_some_and(|cell| cell == "absent")
                && row[1] == "effects.bumpers")
    );
    let without = explained(SCENE, &["--without", "dry_friction"]);
    assert_eq!(passes(&without, "together"), cells(&damped));
}

#[test]
fn counts_of_parts_minus_the_overlap_add_up_to_the_whole() {
    let scene = "scene = 1\ntask = \"cart_pole\"\n[effects.cart_damping]\n[actuator]\nlimit = { bound = 2 }\nlag = { time = 0.1 }\n";
    let rows = explained(scene, &[]);
    let total =
        |name: &str, pass: usize| passes(&rows, name)[pass][1].parse::<i64>().expect("a number");
    let parts = ["effects.cart_damping", "actuator.limit", "actuator.lag"];
    for pass in 0..3 {
        let sum = total("system alone", pass)
            + parts.map(|part| total(part, pass)).into_iter().sum::<i64>();
        assert_eq!(sum - total("counted twice", pass), total("together", pass));
    }
    assert!(total("counted twice", 1) > 0, "limit and lag share no operations in the VJP");
}

#[test]
fn reported_bytes_equal_those_of_the_library() {
    let rows = explained(SCENE, &[]);
    let system = Forced {
        system: CoupledCartPole(model()),
        effects: (PoleDamping::default(), DryFriction::default()),
    };
    let policy = Mlp::new([system.state_dim(), 20, 1]);
    let samples = 8;
    let stored = |horizon: usize, field: Option<Field>| {
        let task = CartPole { horizon, ..CartPole::with_system(system) };
        let Some(field) = field else {
            return Rollout::<f32>::for_evaluation(&task, &policy, samples).stored_bytes();
        };
        let rollout = Rollout::<f32>::new(&task, &policy, samples);
        rollout.stored_bytes()
            + Adjoint::new(&task, &policy, &rollout, &field.flows()).stored_bytes()
    };
    let printed = |name: &str| {
        row(&rows, name)[1..]
            .iter()
            .map(|cell| cell.parse::<usize>().expect("a number"))
            .collect::<Vec<_>>()
    };
    let fields = Field::PAPER.map(|field| (field.to_string(), Some(field)));
    for (name, field) in fields.into_iter().chain([("evaluation".to_owned(), None)]) {
        let (short, long) = (stored(40, field), stored(140, field));
        assert_eq!((long - short) % (100 * samples), 0, "steps store different numbers of bytes");
        let (each, whole) = ((long - short) / (100 * samples), short / samples);
        assert_eq!(
            printed(&name),
            [each, whole - 40 * each, whole],
            "{name}: bytes per step, constant and whole"
        );
    }
    assert_eq!(printed("evaluation")[0], 0, "evaluation stores steps");
    assert!(
        printed("modified")[0] < printed("regular")[0],
        "M stores no fewer bytes per step than R"
    );
}

#[test]
fn the_presets_with_more_effects_than_the_paper_pass_the_gradient_checks() {
    let dir = TempDir::new().expect("a folder");
    for (preset, small) in [
        ("cart_pole_windy", "policy.widths=[8]"),
        ("guidance_walled", "policy.widths=[8]"),
        ("quantum_double_well", "policy.width=4"),
    ] {
        let scene = String::from_utf8(
            physgrad(&["scene", preset]).output().expect("the command runs").stdout,
        )
        .expect("text");
        // A short rollout covers every derivative.
        let short = |line: &str| {
            if line.starts_with("horizon") { "horizon = 20".to_owned() } else { line.to_owned() }
        };
        let file = dir.path().join(format!("{preset}.toml"));
        fs::write(&file, scene.lines().map(short).collect::<Vec<_>>().join("\n")).expect("a file");
        let mut check = physgrad(&["check"]);
        let output = check.arg(&file).args(["--set", small]).output().expect("the command runs");
        let text = String::from_utf8_lossy(&output.stdout);
        assert!(
            output.status.success() && text.contains("rollout, R"),
            "{text}{}",
            String::from_utf8_lossy(&output.stderr)
        );
    }
}

#[test]
fn the_memory_of_a_training_by_windows_is_that_of_a_window() {
    let last = |rows: &[Vec<String>], name: &str| -> [f64; 3] {
        let cells = &row(rows, name)[1..];
        std::array::from_fn(|i| cells[i].parse().expect("a number"))
    };
    let scene = SCENE.replace("horizon = 40", "horizon = 100");
    let plain = explained(&scene, &[]);
    let windows = explained(&format!("{scene}\n[window]\nsteps = 25\n"), &[]);
    assert_eq!(last(&plain, "evaluation"), last(&windows, "evaluation"));
    let [per_step, constant, whole] = last(&windows, "combined");
    assert_eq!(last(&plain, "combined")[..2], [per_step, constant]);
    assert_eq!(whole, constant + 25.0 * per_step);
}
