//! Benchmark of graphs against systems in Rust: step and VJP of eight samples, and whole epochs.
//!
//! Usage: `cargo bench --bench graph`. Both sides alternate within each round; numbers are minima,
//! for one thread.

use physgrad::graph::GraphTask;
use physgrad::policy::Mlp;
use physgrad::scalar::{CotangentPack, Lanes};
use physgrad::tasks::{CartPole, Guidance, Upright};
use physgrad::{
    Cotangent as _, Cotangents, DynTask, Field, Inputs, System, Task, Trainer, Training,
};
use std::hint::black_box;
use std::time::Instant;

type R = Lanes<f32, 8>;
const ROUNDS: usize = 200;
const CALLS: usize = 200;

/// Least ns per sample of `work`, for each of the tasks.
fn least(works: &mut [Box<dyn FnMut() + '_>]) -> Vec<f64> {
    let mut least = vec![f64::INFINITY; works.len()];
    for _ in 0..ROUNDS {
        for (least, work) in least.iter_mut().zip(&mut *works) {
            let start = Instant::now();
            (0..CALLS).for_each(|_| work());
            *least = least.min(start.elapsed().as_secs_f64() * 1e9 / (CALLS * 8) as f64);
        }
    }
    least
}

fn step<'a>(task: &'a DynTask) -> Box<dyn FnMut() + 'a> {
    let system = task.system();
    let x: Vec<R> = (0..system.state_dim()).map(|i| R::from(0.1 * (i + 1) as f64)).collect();
    let u = vec![R::from(0.3); system.control_dim()];
    let p = vec![R::from(1.0); task.param_dim()];
    let mut next = x.clone();
    Box::new(move || {
        system.step(Inputs { x: black_box(&x), u: &u, p: &p, t: 0 }, &mut next);
        black_box(&next);
    })
}

fn vjp<'a, const K: usize>(task: &'a DynTask) -> Box<dyn FnMut() + 'a> {
    let system = task.system();
    let x: Vec<R> = (0..system.state_dim()).map(|i| R::from(0.1 * (i + 1) as f64)).collect();
    let u = vec![R::from(0.3); system.control_dim()];
    let p = vec![R::from(1.0); task.param_dim()];
    let next_bar = vec![CotangentPack([R::from(0.7); K]); x.len()];
    let (mut x_bar, mut u_bar) = (next_bar.clone(), vec![CotangentPack::null(); u.len()]);
    Box::new(move || {
        let inputs = Inputs { x: black_box(&x), u: &u, p: &p, t: 0 };
        system.vjp(inputs, &next_bar, Cotangents::of(&mut x_bar, &mut u_bar));
        black_box(&x_bar);
        x_bar.fill(CotangentPack::null());
        u_bar.fill(CotangentPack::null());
    })
}

fn compare<T: Task + Clone + 'static>(name: &str, task: T) {
    let start = Instant::now();
    let graph = DynTask::new(GraphTask::of(&task).expect("a task of straight lines"));
    let recorded = start.elapsed().as_secs_f64() * 1e3;
    let task = DynTask::new(task);
    let both = [&task, &graph];
    println!("{name}, recorded in {recorded:.1} ms: ns per sample by hand, by graph, ratio");
    for (what, mut works) in [
        ("step", both.map(step)),
        ("vjp of one cotangent", both.map(vjp::<1>)),
        ("vjp of two cotangents", both.map(vjp::<2>)),
    ] {
        let least = least(&mut works);
        println!("  {what:24} {:8.1} {:8.1} {:6.2}", least[0], least[1], least[1] / least[0]);
    }
    for field in [Field::regular(), Field::combined()] {
        let mut best = [f64::INFINITY; 2];
        for _ in 0..5 {
            for (best, task) in best.iter_mut().zip(both) {
                let widths = [task.system().state_dim(), 64, 64, task.system().control_dim()];
                let training = Training { epochs: 2, workers: 1, ..Training::default() };
                let trainer = Trainer::new(task.clone(), Mlp::new(widths)).training(training);
                let start = Instant::now();
                trainer.field(field).run().expect("a training");
                *best = best.min(start.elapsed().as_secs_f64() * 1e3);
            }
        }
        let [hand, graph] = best;
        println!("  training, {:14} {hand:8.1} {graph:8.1} {:6.2}", field.name(), graph / hand);
    }
}

fn main() {
    if std::env::args().any(|argument| argument == "cart_pole") {
        return compare("cart-pole of four poles", CartPole::new(4));
    }
    compare("cart-pole of four poles", CartPole::new(4));
    compare("guidance", Guidance::new(2, 4));
    compare("double pendulum, RK4", Upright::double_pendulum());
    compare("chain of three poles, RK4", Upright::pole_chain(3));
}
