//! Compares results with those of the authors' code (TensorFlow in float64), for each reference
//! file.
//!
//! `tests/reference/README.md` describes the files. `PHYSGRAD_REFERENCE` selects another folder.
//! Errors of cosines are absolute. Other errors are relative to the largest expected component.
//! `cargo test -p physgrad-tests reference -- --nocapture` prints all errors.

use physgrad::engine::{Batch, Evaluation};
use physgrad::policy::{Conv, Mlp};
use physgrad::tasks::{
    CartPole, CartPoleSystem, Guidance, GuidanceSystem, LossMode, Quantum, QuantumSystem,
};
use physgrad::train::OptimizerKind;
use physgrad::{
    Clip, Cotangents, Field, Flow, Gradient, Inputs, Optimizer, Policy, Rollout, System, Task,
    Trainer, Training, Weights,
};
use serde_json::Value;
use std::path::PathBuf;

/// Returns names and contents of the files `{task}*_{kind}.json`. Panics if there are none.
fn files(task: &str, kind: &str) -> Vec<(String, Value)> {
    let own = PathBuf::from(env!("CARGO_MANIFEST_DIR")).join("reference");
    let folder = std::env::var_os("PHYSGRAD_REFERENCE").map_or(own, PathBuf::from);
    let mut found = Vec::new();
    for entry in std::fs::read_dir(&folder).unwrap_or_else(|e| panic!("{}: {e}", folder.display()))
    {
        let path = entry.expect("a folder entry").path();
        let name = path.file_name().expect("a file name").to_string_lossy().into_owned();
        if name.starts_with(task) && name.ends_with(&format!("_{kind}.json")) {
            let text = std::fs::read_to_string(&path).expect("a readable file");
            found.push((name, serde_json::from_str(&text).expect("JSON")));
        }
    }
    assert!(!found.is_empty(), "{} has no {task}*_{kind}.json", folder.display());
    found.sort_by(|a, b| a.0.cmp(&b.0));
    found
}

/// Returns the entries of an array, row-major.
fn data(array: &Value) -> Vec<f64> {
    array["data"].as_array().expect("an array").iter().map(number).collect()
}

fn number(value: &Value) -> f64 {
    value.as_f64().expect("a number")
}

fn text(value: &Value) -> &str {
    value.as_str().expect("a text")
}

fn list(value: &Value) -> &[Value] {
    value.as_array().expect("a list")
}

fn count(value: &Value) -> usize {
    value.as_u64().expect("a count") as usize
}

/// Returns the entries of all kernels and biases in a list, in the order of θ.
fn variables(list: &Value) -> Vec<f64> {
    self::list(list).iter().flat_map(data).collect()
}

/// Returns the largest difference, relative to the largest magnitude of the expected components.
/// The difference is absolute if all expected components are 0.
fn error(got: &[f64], expected: &[f64]) -> f64 {
    assert_eq!(got.len(), expected.len());
    let scale = expected.iter().fold(0.0, |m: f64, e| m.max(e.abs()));
    let worst = got.iter().zip(expected).map(|(g, e)| (g - e).abs()).fold(0.0, f64::max);
    // `max` would ignore NaN.
    assert!(
        got.iter().chain(expected).all(|x| x.is_finite()),
        "not finite: {got:?}, expected {expected:?}"
    );
    if scale > 0.0 { worst / scale } else { worst }
}

/// Largest error of a quantity in a file. Dropping prints it and compares it with `tolerance`.
struct Worst {
    file: String,
    what: &'static str,
    tolerance: f64,
    worst: f64,
    count: usize,
}

impl Worst {
    fn new(file: &str, what: &'static str, tolerance: f64) -> Self {
        Self { file: file.into(), what, tolerance, worst: 0.0, count: 0 }
    }

    fn add(&mut self, error: f64) {
        assert!(!error.is_nan(), "{}, {}: an error is NaN", self.file, self.what);
        self.worst = self.worst.max(error);
        self.count += 1;
    }
}

impl Drop for Worst {
    fn drop(&mut self) {
        println!(
            "{:<28} {:<24} {:>4} compared, worst {:.1e}, allowed {:.0e}",
            self.file, self.what, self.count, self.worst, self.tolerance
        );
        if !std::thread::panicking() {
            assert!(self.count > 0, "{}: {}: nothing was compared", self.file, self.what);
            assert!(
                self.worst <= self.tolerance,
                "{}: {}: {:e} > {:e}",
                self.file,
                self.what,
                self.worst,
                self.tolerance
            );
        }
    }
}

/// Task and policy of the authors, as described by their files.
trait Authors {
    /// Prefix of the file names.
    const FILES: &'static str;
    type Task: Task + Clone;
    type Policy: Policy + Clone;

    /// Returns the task of a file. `case` is the part of the file with the loss mode, or the file
    /// itself.
    fn task(file: &Value, case: &Value, horizon: usize) -> Self::Task;
    fn policy(file: &Value, task: &Self::Task) -> Self::Policy;
}

fn loss_mode(case: &Value) -> LossMode {
    match case["loss_mode"].as_str() {
        Some("CONTINUOUS") => LossMode::Running,
        _ => LossMode::Terminal,
    }
}

/// Returns an MLP whose hidden layers have equal widths.
fn mlp(file: &Value, system: &impl System) -> Mlp {
    let hidden = vec![count(&file["width"]); count(&file["depth"])];
    Mlp::new([&[system.state_dim()], &hidden[..], &[system.control_dim()]].concat())
}

struct AuthorsGuidance;

impl Authors for AuthorsGuidance {
    const FILES: &'static str = "gbr";
    type Task = Guidance;
    type Policy = Mlp;

    fn task(file: &Value, case: &Value, horizon: usize) -> Guidance {
        let (drivers, evaders) = (count(&file["n_drivers"]), count(&file["n_evaders"]));
        let system = GuidanceSystem {
            drivers,
            evaders,
            dt: number(&file["dt"]),
            ..GuidanceSystem::default()
        };
        // Steps and trajectories do not depend on the regularization. Their settings omit it.
        let regularization = case["regularization"].as_f64().unwrap_or(0.0);
        Guidance { system: system.herding(), loss: loss_mode(case), regularization, horizon }
    }

    fn policy(file: &Value, task: &Guidance) -> Mlp {
        mlp(file, &task.system)
    }
}

struct AuthorsQuantum;

impl Authors for AuthorsQuantum {
    const FILES: &'static str = "quantum";
    type Task = Quantum;
    type Policy = Conv;

    fn task(file: &Value, case: &Value, horizon: usize) -> Quantum {
        let system = QuantumSystem {
            grid: count(&file["Nx"]),
            dt: number(&file["dt"]),
            ..QuantumSystem::default()
        };
        // Steps and trajectories do not depend on the target. Their settings omit it.
        let target = case["target_state"].as_u64().unwrap_or(1) as usize;
        Quantum { system, loss: loss_mode(case), horizon, ..Quantum::new(target) }
    }

    fn policy(file: &Value, task: &Quantum) -> Conv {
        Conv::new(task.system.grid, count(&file["width"]))
    }
}

struct AuthorsCartPole;

impl Authors for AuthorsCartPole {
    const FILES: &'static str = "cartpole";
    type Task = CartPole;
    type Policy = Mlp;

    fn task(file: &Value, case: &Value, horizon: usize) -> CartPole {
        let system = CartPoleSystem {
            poles: count(&file["n_poles"]),
            dt: number(&file["dt"]),
            ..CartPoleSystem::default()
        };
        CartPole { system, loss: loss_mode(case), horizon }
    }

    fn policy(file: &Value, task: &CartPole) -> Mlp {
        mlp(file, &task.system)
    }
}

fn flow(mode: &str) -> Flow {
    match mode {
        "F" => Flow::REGULAR,
        "P" => Flow::MODIFIED,
        "S" => Flow::STOPPED,
        _ => panic!("unknown flow {mode}"),
    }
}

fn steps_and_vjps<A: Authors>() {
    for (name, file) in files(A::FILES, "step") {
        let task = A::task(&file, &file, 1);
        let system = task.system();
        let (n, m) = (system.state_dim(), system.control_dim());
        let mut steps = Worst::new(&name, "next state", 1e-12);
        let mut by_state = Worst::new(&name, "vjp by state", 1e-12);
        let mut by_control = Worst::new(&name, "vjp by control", 1e-12);
        let field = |key: &str| data(&file[key]);
        let (state, control, cotangent) = (field("state"), field("control"), field("cotangent"));
        let (next, vjp_state, vjp_control) =
            (field("next_state"), field("vjp_state"), field("vjp_control"));
        for case in 0..control.len() / m {
            let (states, controls) = (case * n..(case + 1) * n, case * m..(case + 1) * m);
            let (x, u) = (&state[states.clone()], &control[controls.clone()]);
            let (mut got, mut x_bar, mut u_bar) = (vec![0.0; n], vec![0.0; n], vec![0.0; m]);
            system.step(Inputs::new(x, u), &mut got);
            system.vjp(
                Inputs::new(x, u),
                &cotangent[states.clone()],
                Cotangents::of(&mut x_bar, &mut u_bar),
            );
            steps.add(error(&got, &next[states.clone()]));
            by_state.add(error(&x_bar, &vjp_state[states]));
            by_control.add(error(&u_bar, &vjp_control[controls]));
        }
    }
}

fn trajectories<A: Authors>() {
    for (name, file) in files(A::FILES, "rollout") {
        let theta = variables(&file["controller"]);
        let starts = data(&file["initial_states"]);
        let mut states = Worst::new(&name, "states", 1e-9);
        let mut controls = Worst::new(&name, "controls", 1e-9);
        for trajectory in list(&file["trajectories"]) {
            let task = A::task(&file, &file, count(&trajectory["Nt"]));
            let policy = A::policy(&file, &task);
            let (n, m) = (task.system().state_dim(), task.system().control_dim());
            let samples = starts.len() / n;
            let mut rollout = Rollout::new(&task, &policy, samples);
            rollout.start(&starts);
            rollout.run(&task, &policy, &Weights::new(&policy, theta.clone())).expect("finite");
            // Order: samples, steps, components.
            let each = |steps: usize, size: usize| {
                (0..samples).flat_map(move |s| {
                    (0..steps).flat_map(move |t| (0..size).map(move |i| (t, s, i)))
                })
            };
            let got: Vec<f64> =
                each(task.horizon() + 1, n).map(|(t, s, i)| rollout.state(t, s, i)).collect();
            states.add(error(&got, &data(&trajectory["states"])));
            let got: Vec<f64> =
                each(task.horizon(), m).map(|(t, s, i)| rollout.control(t, s, i)).collect();
            controls.add(error(&got, &data(&trajectory["controls"])));
        }
    }
}

/// Returns the mean loss from the given initial states.
fn loss<T: Task>(task: &T, policy: &impl Policy, weights: &Weights<f64>, starts: &[f64]) -> f64 {
    Evaluation::new(task, policy, 1).run(task, policy, weights, starts).expect("finite")
}

/// Returns the task without the regularization of the controls.
fn physics<A: Authors>(file: &Value, case: &Value, horizon: usize) -> A::Task {
    let mut case = case.clone();
    case["regularization"] = 0.0.into();
    A::task(file, &case, horizon)
}

fn losses_and_gradients<A: Authors>() {
    for (name, file) in files(A::FILES, "rollout") {
        let theta = variables(&file["controller"]);
        let starts = data(&file["initial_states"]);
        let mut losses = Worst::new(&name, "loss", 1e-9);
        let mut gradients = Worst::new(&name, "gradient of F, P, S", 1e-9);
        let mut combined = Worst::new(&name, "C, by component", 1e-9);
        for case in list(&file["cases"]) {
            let mode = text(&case["mode"]);
            let task = A::task(&file, case, count(&case["Nt"]));
            let policy = A::policy(&file, &task);
            let weights = Weights::new(&policy, theta.clone());
            let samples = starts.len() / task.system().state_dim();
            let flows = if mode == "C" { Field::combined().flows() } else { vec![flow(mode)] };
            let mut batch = Batch::new(&task, &policy, samples, &flows, 1);
            let loss = batch.run(&task, &policy, &weights, &starts).expect("finite");
            losses.add(error(&[loss], &[number(&case["loss"])]));
            if let Some(expected) = case["physics_loss"].as_f64() {
                let task = physics::<A>(&file, case, task.horizon());
                losses.add(error(&[self::loss(&task, &policy, &weights, &starts)], &[expected]));
            }
            let expected = variables(&case["grads"]);
            if mode != "C" {
                gradients.add(error(batch.gradients()[0].values(), &expected));
                continue;
            }
            let mut got = Gradient::zeros(policy.param_count());
            Field::combined().combine(batch.gradients(), &mut got);
            let got = got.to_vec();
            let [m, r] = [0, 1].map(|k| batch.gradients()[k].values());
            let kept = |g: &[f64]| g.iter().map(|&g| g != 0.0).collect::<Vec<_>>();
            assert_eq!(
                kept(&got),
                kept(&expected),
                "{name}: C keeps other components than the authors'"
            );
            // Kept components equal those of M, and the others are exactly 0.
            for ((&c, &m), &r) in got.iter().zip(m).zip(r) {
                assert!(
                    if m * r > 0.0 { c == m } else { c == 0.0 },
                    "{name}: C = {c} of M = {m}, R = {r}"
                );
            }
            combined.add(error(&got, &expected));
        }
    }
}

fn mean(numbers: &[f64]) -> f64 {
    numbers.iter().sum::<f64>() / numbers.len() as f64
}

/// Compares a session with the authors' logs and with an explicit loop of updates.
///
/// The loop provides the columns that records lack: the mean squared norms of gradients, and losses
/// without regularization.
fn training<A: Authors>() {
    for (name, file) in files(A::FILES, "train") {
        let task = A::task(&file, &file, count(&file["Nt"]));
        let physics = physics::<A>(&file, &file, task.horizon());
        let policy = A::policy(&file, &task);
        let (epochs, size, rate) =
            (count(&file["epochs"]), count(&file["batch_size"]), number(&file["lr"]));
        let rule = OptimizerKind::named("adam").expect("a known optimizer");
        let [theta, train, test] = [
            variables(&file["controller"]),
            data(&file["train_states"]),
            data(&file["test_states"]),
        ];
        let mut losses = Worst::new(&name, "losses of all epochs", 1e-8);
        let mut sizes = Worst::new(&name, "squared gradient norms", 1e-8);
        let mut cosines = Worst::new(&name, "cosine of P and F", 1e-8);
        let mut finals = Worst::new(&name, "final variables", 1e-8);
        let mut replays = Worst::new(&name, "session and loop", 1e-12);
        for run in list(&file["runs"]) {
            let (mode, limit) = (text(&run["mode"]), number(&run["clip_num"]));
            let clip = match text(&run["clip_mode"]) {
                "VALUE" => Clip::Value(limit),
                "NORM" => Clip::Norm(limit),
                _ => Clip::None,
            };
            let field = if mode == "C" { Field::combined() } else { Field::Flow(flow(mode)) };
            let training = Training {
                epochs,
                batch: size,
                learning_rate: rate,
                rule,
                clip,
                ..Training::default()
            };
            let trainer = Trainer::new(task.clone(), policy.clone())
                .precision::<f64>()
                .field(field)
                .training(training);
            let mut session = trainer
                .session_from(theta.clone(), train.clone(), test.clone())
                .expect("valid settings");

            let mut weights = Weights::new(&policy, theta.clone());
            let mut optimizer = Optimizer::new(rule, rate, theta.len());
            let mut batch = Batch::new(&task, &policy, size, &field.flows(), 1);
            let mut update = Gradient::zeros(theta.len());

            let columns: Vec<_> = list(&file["log_columns"]).iter().map(text).collect();
            let log = data(&run["log"]);
            for epoch in 0..epochs {
                let logged = |name: &str| {
                    let column = columns.iter().position(|&c| c == name)?;
                    Some(log[epoch * columns.len() + column])
                };
                let column = |name: &str| logged(name).expect("a column");
                let record = session.epoch().expect("finite");
                let got = [record.loss, record.train_loss, record.test_loss];
                losses.add(error(&got, &["loss", "loss_train", "loss_test"].map(column)));
                if let Some(cosine) = record.cosine {
                    cosines.add((cosine - column("cossim")).abs());
                }
                let (mut lengths, mut without) = (Vec::new(), Vec::new());
                for starts in train.chunks(size * task.system().state_dim()) {
                    without.push(loss(&physics, &policy, &weights, starts));
                    batch.run(&task, &policy, &weights, starts).expect("finite");
                    field.combine(batch.gradients(), &mut update);
                    lengths.push(update.norm().get());
                    clip.apply(&mut update);
                    weights.update(&policy, |theta| optimizer.step(theta, &update));
                }
                let squares: Vec<f64> = lengths.iter().map(|length| length * length).collect();
                sizes.add(error(&[mean(&squares)], &[column("grad_size")]));
                replays.add(error(&[record.grad_norm.get()], &[mean(&lengths)]));
                if logged("physics").is_some() {
                    let after =
                        [&train, &test].map(|starts| loss(&physics, &policy, &weights, starts));
                    let got = [mean(&without), after[0], after[1]];
                    losses.add(error(
                        &got,
                        &["physics", "physics_train", "physics_test"].map(column),
                    ));
                }
            }
            finals.add(error(session.weights().theta(), &variables(&run["final_variables"])));
            replays.add(error(session.weights().theta(), weights.theta()));
        }
    }
}

#[test]
fn eigenstates_equal_the_authors() {
    for (name, file) in files("quantum", "step") {
        let system = AuthorsQuantum::task(&file, &file, 1).system;
        let expected = data(&file["eigenstates"]);
        let mut eigenstates = Worst::new(&name, "eigenstates", 1e-12);
        for (index, expected) in expected.chunks(system.grid).enumerate() {
            let got: Vec<f64> = system.eigenstate(index + 1).collect();
            eigenstates.add(error(&got, expected));
        }
    }
}

macro_rules! authors {
    ($module:ident, $authors:ty) => {
        mod $module {
            use super::*;

            #[test]
            fn steps_and_vjps_equal_the_authors() {
                steps_and_vjps::<$authors>();
            }
            #[test]
            fn trajectories_equal_the_authors() {
                trajectories::<$authors>();
            }
            #[test]
            fn losses_and_gradients_equal_the_authors() {
                losses_and_gradients::<$authors>();
            }
            #[test]
            fn training_equals_the_authors_logs() {
                training::<$authors>();
            }
        }
    };
}

authors!(cart_pole, AuthorsCartPole);
authors!(guidance, AuthorsGuidance);
authors!(quantum, AuthorsQuantum);
