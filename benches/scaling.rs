//! Benchmark of the time of a step and its adjoint against the size of the system.
//!
//! Usage: `cargo bench --bench scaling`, or with `-- --quick` for few rounds. Eight samples in f32,
//! one thread, zero control: the times cover physics, costs and data movement. Sizes alternate
//! within each round.

mod measure;

use measure::{Nothing, median, ratio, rounds};
use physgrad::rng::{Purpose, stream};
use physgrad::tasks::{Guidance, Quantum, QuantumSystem};
use physgrad::{Adjoint, Flow, Rollout, System, Task, Weights, initial_states};

const BATCH: usize = 8;
/// Number of time steps, small enough that the largest trajectories stay in the cache.
const STEPS: usize = 16;

fn main() {
    let count = if std::env::args().any(|a| a == "--quick") { 3 } else { 60 };
    println!(
        "microseconds of one step and its adjoint, {BATCH} samples, f32, one thread; multiples of the smallest size"
    );

    let grids = [32, 64, 128, 256, 512, 1024];
    let quantum = |grid| {
        let task = Quantum::new(3);
        Quantum { system: QuantumSystem { grid, ..task.system }, horizon: STEPS, ..task }
    };
    println!("\nquantum: a tridiagonal solve each way, O(grid)");
    table("grid points", count, &grids.map(|grid| (grid, quantum(grid))));

    // Numbers of drivers and evaders. n agents form n (n - 1) / 2 pairs.
    let herds = [(1, 2), (2, 4), (4, 8), (8, 16), (16, 32)];
    let guidance =
        |(drivers, evaders)| Guidance { horizon: STEPS, ..Guidance::new(drivers, evaders) };
    let pairs = |(drivers, evaders)| (drivers + evaders) * (drivers + evaders - 1) / 2;
    println!("\nguidance: every pair of agents once each way, O(pairs)");
    table("pairs", count, &herds.map(|herd| (pairs(herd), guidance(herd))));
}

fn table<T: Task>(what: &str, count: usize, sizes: &[(usize, T)]) {
    let mut jobs: Vec<_> = sizes.iter().map(|(_, task)| step_and_adjoint(task)).collect();
    let mut jobs: Vec<&mut dyn FnMut()> =
        jobs.iter_mut().map(|job| job as &mut dyn FnMut()).collect();
    let times = rounds(count, &mut jobs);
    for ((size, _), time) in sizes.iter().zip(&times) {
        let (growth, size_growth) = (ratio(time, &times[0]), *size as f64 / sizes[0].0 as f64);
        println!(
            "  {what} {size:>5}: {:>8.2} µs   {growth:>6.1} x for {size_growth:>6.1} x the size",
            median(time) / STEPS as f64
        );
    }
}

fn step_and_adjoint<T: Task>(task: &T) -> impl FnMut() {
    let (state_dim, control_dim) = (task.system().state_dim(), task.system().control_dim());
    let policy = Nothing { state_dim, control_dim };
    let weights = Weights::<f32>::init(&policy, &mut stream(0, Purpose::Policy, 0));
    let starts: Vec<f32> = initial_states(task, 0, Purpose::Train, BATCH);
    let mut rollout = Rollout::new(task, &policy, BATCH);
    let mut adjoint = Adjoint::new(task, &policy, &rollout, &[Flow::REGULAR]);
    move || {
        rollout.start(&starts);
        rollout.run(task, &policy, &weights).expect("finite");
        adjoint.run(task, &policy, &weights, &rollout, 0.125).expect("finite");
    }
}
