//! What a scene costs through the machinery of effects, against the same physics written by hand in one function.
//!
//! `cargo bench --bench effects`. A step and its adjoint (R) of a batch of eight samples on one thread, with a policy that
//! does nothing. Everything is measured in turn, round after round; a ratio is the median of the rounds' ratios.

mod by_hand;
mod measure;

use by_hand::ByHand;
use measure::{Nothing, median, ratio, rounds};
use physgrad::rng::{Purpose, stream};
use physgrad::tasks::{CartDamping, CartPole, CartPoleEffect, CartPoleSystem, PoleDamping, SteadyWind};
use physgrad::{Adjoint, Around, Float, Flow, Rollout, Task, Weights, With};

const BATCH: usize = 8;
const POLES: usize = 4;

fn main() {
    let count = if std::env::args().any(|a| a == "--quick") { 20 } else { 2000 };
    println!("microseconds of a step and its adjoint, {BATCH} samples, {POLES} poles, one thread; against physics by hand");
    table::<f32>(count);
    table::<f64>(count);
}

fn table<F: Float>(count: usize) {
    let system = CartPoleSystem { poles: POLES, ..CartPoleSystem::default() };
    let (pole, cart, wind) = (PoleDamping::default(), CartDamping::default(), SteadyWind::default());
    let list: Vec<CartPoleEffect> = vec![pole.into(), cart.into(), wind.into()];
    let mut jobs: [Box<dyn FnMut()>; 8] = [
        Box::new(job::<F, _>(ByHand::<false, false> { system, pole, cart, wind })),
        Box::new(job::<F, _>(system)),
        Box::new(job::<F, _>(ByHand::<true, false> { system, pole, cart, wind })),
        Box::new(job::<F, _>(With { system, effects: (pole, cart) })),
        Box::new(job::<F, _>(With { system, effects: list[..2].to_vec() })),
        Box::new(job::<F, _>(ByHand::<true, true> { system, pole, cart, wind })),
        Box::new(job::<F, _>(With { system, effects: (pole, cart, wind) })),
        Box::new(job::<F, _>(With { system, effects: list })),
    ];
    let mut jobs: Vec<&mut dyn FnMut()> = jobs.iter_mut().map(|job| &mut **job as &mut dyn FnMut()).collect();
    let times = rounds(count, &mut jobs);
    println!("\n{}", F::NAME);
    for (name, job, hand) in [
        ("no effect", 1, 0),
        ("friction, typed", 3, 2),
        ("friction, list", 4, 2),
        ("friction and wind, typed", 6, 5),
        ("friction and wind, list", 7, 5),
    ] {
        let (time, by_hand) = (median(&times[job]) / 100.0, median(&times[hand]) / 100.0);
        println!("  {name:<25} {time:>6.3} us, by hand {by_hand:>6.3} us: {:.3}", ratio(&times[job], &times[hand]));
    }
}

/// A rollout of 100 steps and its adjoint.
fn job<F: Float, S: Around<CartPoleSystem>>(system: S) -> impl FnMut() {
    let task = CartPole::around(system);
    let (state_dim, control_dim) = (task.system.state_dim(), task.system.control_dim());
    let policy = Nothing { state_dim, control_dim };
    let weights = Weights::<F>::init(&policy, &mut stream(0, Purpose::Policy, 0));
    let mut x = vec![0.0; BATCH * state_dim];
    for (sample, x) in x.chunks_exact_mut(state_dim).enumerate() {
        task.start(&mut stream(0, Purpose::Train, sample as u64), x);
    }
    let starts: Vec<F> = x.into_iter().map(F::lift).collect();
    let mut rollout = Rollout::new(&task, &policy, BATCH);
    let mut adjoint = Adjoint::new(&policy, &rollout, &[Flow::REGULAR]);
    move || {
        rollout.start(&starts);
        rollout.run(&task, &policy, &weights).expect("finite");
        adjoint.run(&task, &policy, &weights, &rollout, F::lift(0.125)).expect("finite");
    }
}
