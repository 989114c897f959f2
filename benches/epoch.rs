//! Benchmark of cart-pole training: the gradient of each field of the paper, the parts of the
//! gradient of R, and whole epochs. The parts are matrix products, tanh and physics.
//!
//! Usage: `cargo bench --bench epoch`, or with `-- --quick` for few rounds. Jobs alternate within
//! each round; times are medians. A ratio is the median of the ratios per round, which cancels
//! drifts of the machine's speed.

mod measure;

use measure::{Nothing, median, ratio, rounds};
use physgrad::engine::Batch;
use physgrad::engine::kernels::elementwise::{self, Strided};
use physgrad::engine::kernels::gemm::Product;
use physgrad::engine::kernels::{SimdLevel, gemm};
use physgrad::policy::{Mlp, Policy};
use physgrad::rng::{Purpose, stream};
use physgrad::tasks::CartPole;
use physgrad::{
    Adjoint, Field, Float, Flow, Gradient, Rollout, System, Trainer, Training, Weights,
    initial_states,
};
use std::hint::black_box;

const ROUNDS: usize = 60;
const BATCH: usize = 8;
const WIDTH: usize = 100;

fn main() {
    let rounds = if std::env::args().any(|a| a == "--quick") { 3 } else { ROUNDS };
    println!(
        "cart-pole, 4 poles, widths {WIDTH}, {WIDTH}, mini-batches of {BATCH}; instructions: {:?}",
        SimdLevel::best()
    );
    fields::<f32>(rounds);
    fields::<f64>(rounds);
    shares(rounds);
    epochs(rounds.min(15));
}

fn task_and_policy() -> (CartPole, Mlp) {
    let task = CartPole::new(4);
    let n = task.system.state_dim();
    (task, Mlp::new([n, WIDTH, WIDTH, 1]))
}

/// Initial states of one mini-batch.
fn starts<F: Float>(task: &CartPole) -> Vec<F> {
    initial_states(task, 0, Purpose::Train, BATCH)
}

/// Times the forward pass and the gradients of the five fields of the paper.
fn fields<F: Float>(count: usize) {
    let (task, policy) = task_and_policy();
    let weights = Weights::<F>::init(&policy, &mut stream(0, Purpose::Policy, 0));
    let starts = starts::<F>(&task);
    let mut forward_only = Rollout::new(&task, &policy, BATCH);
    let mut forward = || {
        forward_only.start(&starts);
        forward_only.run(&task, &policy, &weights).expect("finite");
    };
    let gradient = |flows: Vec<Flow>| {
        let mut batch = Batch::new(&task, &policy, BATCH, &flows, 1);
        let (task, policy, weights, starts) = (&task, &policy, &weights, &starts);
        move || {
            batch.run(task, policy, weights, starts).expect("finite");
            black_box(batch.gradients());
        }
    };
    let fields = [
        Field::regular(),
        Field::modified(),
        Field::stopped(),
        Field::network(),
        Field::combined(),
    ];
    let [mut r, mut m, mut s, mut n, mut c] = fields.map(|field| gradient(field.flows()));
    let times = rounds(count * 5, &mut [&mut forward, &mut r, &mut m, &mut s, &mut n, &mut c]);
    println!("\n{} gradient of one mini-batch, forward pass included, one thread", F::NAME);
    for (name, time) in ["forward", "R", "M", "S", "N", "C"].iter().zip(&times) {
        let (to_forward, to_r) = (ratio(time, &times[0]), ratio(time, &times[1]));
        println!(
            "  {name:<8} {:>7.0} µs   {to_forward:.2} x forward   {to_r:.2} x R",
            median(time)
        );
    }
}

/// Times the parts of R's gradient in f32, each alone.
///
/// Products of the reverse pass cover all columns at once here. The library splits these products
/// into blocks of 32 columns.
fn shares(count: usize) {
    let (task, policy) = task_and_policy();
    let n = task.system.state_dim();
    let steps = task.horizon;
    let columns = BATCH * steps;
    let weights = Weights::<f32>::init(&policy, &mut stream(0, Purpose::Policy, 0));
    let starts = starts::<f32>(&task);
    let level = SimdLevel::best();

    let mut rollout = Rollout::new(&task, &policy, BATCH);
    let mut adjoint = Adjoint::new(&task, &policy, &rollout, &[Flow::REGULAR]);
    let mut theta_bar = Gradient::zeros(policy.param_count());
    let mut whole = || {
        rollout.start(&starts);
        rollout.run(&task, &policy, &weights).expect("finite");
        adjoint.run(&task, &policy, &weights, &rollout, 0.125).expect("finite");
        adjoint.param_gradient(0, &policy, &weights, &rollout, 0..BATCH, &mut theta_bar);
    };

    // (rows, depth, columns, calls) of the matrix products in one gradient, with rows padded to odd
    // multiples of 16 as in the library. Two products belong to the forward pass, three to the
    // reverse pass, and three to the weight gradients. The last three sum over 64 columns per call.
    let (pad_n, pad_w) = (16, 112);
    let products = [
        (pad_w, n + 1, BATCH, steps),
        (pad_w, WIDTH + 1, BATCH, steps),
        (pad_w, 1, columns, 1),
        (pad_w, WIDTH, columns, 1),
        (pad_n, WIDTH, columns, 1),
        (pad_w, 64, n + 1, columns / 64),
        (pad_w, 64, WIDTH + 1, columns / 64),
        (pad_w, 64, 1, columns / 64),
    ];
    let a = vec![0.5f32; 112 * 1024];
    let b = vec![0.25f32; 112 * 1024];
    let mut c = vec![0.0f32; 112 * 1024];
    let mut by_physgrad = || {
        for (rows, depth, cols, times) in products {
            for _ in 0..times {
                let (a, b, c) = (black_box(&a), black_box(&b), &mut c);
                let p = Product {
                    rows,
                    depth,
                    cols,
                    a,
                    lda: rows,
                    b,
                    b_row: 1,
                    b_col: depth,
                    c,
                    ldc: rows,
                    accumulate: false,
                };
                gemm::single::product(level, p);
            }
        }
    };
    let mut c_matrixmultiply = vec![0.0f32; 112 * 1024];
    let mut by_matrixmultiply = || {
        for (rows, depth, cols, times) in products {
            let (a, b, c) = (
                &black_box(&a)[..rows * depth],
                &black_box(&b)[..depth * cols],
                &mut c_matrixmultiply[..rows * cols],
            );
            // Column-major layout for all three matrices.
            let (row_stride, [a_stride, b_stride, c_stride]) =
                (1, [rows, depth, rows].map(|rows| rows as isize));
            for _ in 0..times {
                let (a, b, c) = (a.as_ptr(), b.as_ptr(), c.as_mut_ptr());
                // SAFETY: the three slices are complete matrices of these shapes.
                unsafe {
                    matrixmultiply::sgemm(
                        rows, depth, cols, 1.0, a, row_stride, a_stride, b, row_stride, b_stride,
                        0.0, c, row_stride, c_stride,
                    )
                };
            }
        }
    };
    let mut layer: Vec<f32> = (0..pad_w * BATCH).map(|i| (i % 64) as f32 / 16.0 - 2.0).collect();
    let mut tanh = || {
        let all = Strided { first: 0, step: pad_w, count: BATCH, len: pad_w };
        for _ in 0..2 * steps {
            elementwise::tanh(level, black_box(&mut layer), all);
        }
    };
    let zero_control = Nothing { state_dim: n, control_dim: 1 };
    let zero_weights = Weights::<f32>::init(&zero_control, &mut stream(0, Purpose::Policy, 0));
    let mut physics_rollout = Rollout::new(&task, &zero_control, BATCH);
    let mut physics_adjoint =
        Adjoint::new(&task, &zero_control, &physics_rollout, &[Flow::REGULAR]);
    let mut physics = || {
        physics_rollout.start(&starts);
        physics_rollout.run(&task, &zero_control, &zero_weights).expect("finite");
        physics_adjoint
            .run(&task, &zero_control, &zero_weights, &physics_rollout, 0.125)
            .expect("finite");
    };

    let times = rounds(
        count * 5,
        &mut [&mut whole, &mut by_physgrad, &mut tanh, &mut physics, &mut by_matrixmultiply],
    );
    let part = |i: usize| ratio(&times[i], &times[0]);
    let (products, tanh, physics) = (part(1), part(2), part(3));
    println!("\nf32 gradient of R: {:.0} µs, of which (each part alone)", median(&times[0]));
    println!("  matrix products        {:>4.0} %", 100.0 * products);
    println!("  tanh of the layers     {:>4.0} %", 100.0 * tanh);
    println!(
        "  physics and its VJP    {:>4.0} %   with costs, and moving numbers between lanes and columns",
        100.0 * physics
    );
    println!("  the rest               {:>4.0} %", 100.0 * (1.0 - products - tanh - physics));
    let slower = 1.0 + part(4) - products;
    println!(
        "  the same products by matrixmultiply take {:.2} x as long: the gradient would take {slower:.2} x",
        part(4) / products
    );
}

/// Times whole epochs: 32 updates of 8 samples, then evaluations of 256 training and 256 test
/// samples.
fn epochs(count: usize) {
    let cores = std::thread::available_parallelism().map_or(1, usize::from);
    println!("\nf32 epoch: {} updates, evaluation of 256 + 256 states", 256 / BATCH);
    let session = |field: Field, workers: usize| {
        let (task, policy) = task_and_policy();
        let training = Training { epochs: usize::MAX >> 32, workers, ..Training::default() };
        let mut session = Trainer::new(task, policy)
            .field(field)
            .training(training)
            .session()
            .expect("valid settings");
        move || {
            session.epoch().expect("finite");
        }
    };
    let [mut r1, mut c1] = [Field::regular(), Field::combined()].map(|field| session(field, 1));
    let [mut r2, mut c2] = [Field::regular(), Field::combined()].map(|field| session(field, cores));
    let times = rounds(count * 2, &mut [&mut r1, &mut c1, &mut r2, &mut c2]);
    for (i, name) in
        [(0, "R, 1 thread"), (1, "C, 1 thread"), (2, "R, all cores"), (3, "C, all cores")]
    {
        println!("  {name:<14} {:>6.1} ms", median(&times[i]) * 1e-3);
    }
    println!(
        "  {cores} cores: {:.2} x for R, {:.2} x for C; C / R {:.2}",
        ratio(&times[0], &times[2]),
        ratio(&times[1], &times[3]),
        ratio(&times[1], &times[0])
    );
}
