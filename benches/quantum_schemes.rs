//! Benchmark of schemes for Schrödinger's equation at equal phase accuracy.
//!
//! Usage: `cargo bench --bench quantum_schemes`, or with `-- --quick` for few rounds. Measures
//! rollouts with the adjoint of R: eight samples, one thread, zero control. Each scheme takes the
//! fewest substeps for which the phase of the fifth eigenstate is correct to 1 %. [`QuantumScheme`]
//! selects the schemes named "chosen" at run time.
//!
//! Jobs alternate within each round. Ratios are medians over rounds, relative to Crank-Nicolson.
//! The benchmark constructs all jobs five times (once with `--quick`), in varying order and layout.
//! It prints the median, the lowest and the highest of these ratios.

mod measure;

use measure::{Nothing, median, ratio, rounds};
use physgrad::effect::{ForcedSystem, HasModel};
use physgrad::rng::{Purpose, stream};
use physgrad::tasks::{Cubic, Harmonic, Pade, Quantum, QuantumScheme, QuantumSystem, Strang};
use physgrad::{
    Adjoint, Effect, Float, Flow, Forced, Inputs, Rollout, Substeps, System, Task, Weights,
    initial_states,
};
use std::f64::consts::PI;
use std::hint::black_box;

const BATCH: usize = 8;

type Job = Box<dyn FnMut()>;

/// One scheme: name, number of substeps, and a factory of jobs.
struct Form {
    name: String,
    count: usize,
    job: Box<dyn Fn() -> Job>,
}

fn main() {
    let quick = std::env::args().any(|a| a == "--quick");
    println!(
        "microseconds of a rollout with adjoint, {BATCH} samples, one thread; ratio to Crank and Nicolson (lowest, highest)"
    );
    for grid in [32, 64, 128, 512] {
        // A disturbance of the machine affects few rounds if jobs are short.
        let horizon = if grid < 128 { 16 } else { 4 };
        let (places, count) = if quick { (1, 3) } else { (5, (6400 / grid).max(25)) };
        table("f32", grid, horizon, places, count, forms::<f32>(grid, horizon));
        table("f64", grid, horizon, places, count, forms::<f64>(grid, horizon));
    }
}

fn forms<F: Float>(grid: usize, horizon: usize) -> [Vec<Form>; 2] {
    let model = QuantumSystem { grid, ..QuantumSystem::default() };
    let mut all = [Vec::new(), Vec::new()];
    let effects = (Harmonic::default(), Cubic::default());
    for (forms, trapped) in all.iter_mut().zip([false, true]) {
        let mut push = |name: &str, count: usize, form: Form| {
            forms.push(Form { name: name.into(), count, ..form })
        };
        macro_rules! scheme {
            ($name:literal, $make:expr) => {
                let count = least_substeps(model, $make);
                let system = $make(QuantumSystem { dt: model.dt / count as f64, ..model });
                let form = if trapped {
                    form::<F, _, _>(system, effects, count, horizon)
                } else {
                    form::<F, _, _>(system, (), count, horizon)
                };
                push($name, count, form);
            };
        }
        scheme!("Crank and Nicolson", |model| model);
        scheme!("Padé", Pade);
        scheme!("Strang", Strang::new);
        scheme!("Crank and Nicolson, chosen", QuantumScheme::CrankNicolson);
        scheme!("Padé, chosen", |model| QuantumScheme::Pade(Pade(model)));
        scheme!("Strang, chosen", |model| QuantumScheme::Strang(Strang::new(model)));
    }
    all
}

/// Returns the fewest substeps per time step for which one substep advances the phase of the fifth
/// eigenstate with an error of at most 1 %.
fn least_substeps<S: System>(model: QuantumSystem, make: impl Fn(QuantumSystem) -> S) -> usize {
    let phi: Vec<f64> = model.eigenstate(5).flat_map(|phi| [phi, 0.0]).collect();
    let sine = (5.0 * PI / (2.0 * (model.grid + 1) as f64)).sin() / model.spacing();
    let error = |count: &usize| {
        let dt = model.dt / *count as f64;
        let mut next = vec![0.0; phi.len()];
        make(QuantumSystem { dt, ..model }).step(Inputs::new(&phi, &[0.0]), &mut next);
        let part = |i: usize| {
            phi.iter().step_by(2).zip(next[i..].iter().step_by(2)).map(|(a, b)| a * b).sum::<f64>()
        };
        (-part(1).atan2(part(0))).rem_euclid(2.0 * PI) / (4.0 * sine * sine * dt) - 1.0
    };
    (1..100).find(|count| error(count).abs() <= 0.01).expect("fewer than 100 substeps suffice")
}

fn table(
    precision: &str,
    grid: usize,
    horizon: usize,
    places: usize,
    count: usize,
    scenes: [Vec<Form>; 2],
) {
    for (scene, forms) in ["no effect", "trap and cubic"].iter().zip(scenes) {
        println!("\n{precision}, {grid} grid points, {horizon} steps, {scene}");
        let mut found = vec![(Vec::new(), Vec::new()); forms.len()];
        for place in 0..places {
            // Varies the order of construction and the memory layout between repetitions.
            let order: Vec<usize> = (0..forms.len()).map(|i| (i + place) % forms.len()).collect();
            let mut gaps = Vec::new();
            let mut jobs: Vec<Job> = Vec::new();
            for &form in &order {
                gaps.push(black_box(vec![0_u8; 64 + 832 * place]));
                jobs.push((forms[form].job)());
            }
            let mut jobs: Vec<&mut dyn FnMut()> =
                jobs.iter_mut().map(|job| &mut **job as &mut dyn FnMut()).collect();
            let times = rounds(count, &mut jobs);
            let first = &times
                [order.iter().position(|&form| form == 0).expect("the order contains form 0")];
            for (&form, times) in order.iter().zip(&times) {
                found[form].0.push(median(times));
                found[form].1.push(ratio(times, first));
            }
        }
        for (form, (times, ratios)) in forms.iter().zip(&found) {
            let (low, high) = ratios
                .iter()
                .fold((f64::MAX, 0.0_f64), |(low, high), &r| (low.min(r), high.max(r)));
            let (name, substeps) = (&form.name, form.count);
            println!(
                "  {name:<28} {substeps:>3}  {:>9.1}  {:.3} ({low:.2}, {high:.2})",
                median(times),
                median(ratios)
            );
        }
    }
}

fn form<F, H, E>(system: H, effects: E, count: usize, horizon: usize) -> Form
where
    F: Float,
    H: ForcedSystem<Model = QuantumSystem> + Clone + 'static,
    E: Effect<QuantumSystem> + 'static,
{
    let job = move || {
        let system = Forced { system: system.clone(), effects: effects.clone() };
        if count == 1 {
            job::<F, _>(system, horizon)
        } else {
            job::<F, _>(Substeps { system, count }, horizon)
        }
    };
    Form { name: String::new(), count, job: Box::new(job) }
}

/// Returns a job that runs a rollout and its adjoint.
fn job<F: Float, S: HasModel<QuantumSystem> + 'static>(system: S, horizon: usize) -> Job {
    let task = Quantum { horizon, ..Quantum::with_system(system, 3) };
    let (state_dim, control_dim) = (task.system().state_dim(), task.system().control_dim());
    let policy = Nothing { state_dim, control_dim };
    let weights = Weights::<F>::init(&policy, &mut stream(0, Purpose::Policy, 0));
    let starts: Vec<F> = initial_states(&task, 0, Purpose::Train, BATCH);
    let mut rollout = Rollout::new(&task, &policy, BATCH);
    let mut adjoint = Adjoint::new(&task, &policy, &rollout, &[Flow::REGULAR]);
    Box::new(move || {
        rollout.start(&starts);
        rollout.run(&task, &policy, &weights).expect("finite");
        adjoint.run(&task, &policy, &weights, &rollout, F::from_f64(0.125)).expect("finite");
    })
}
