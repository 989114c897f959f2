//! What a scene costs through the machinery of effects, against the same physics written by hand in one function.
//!
//! `cargo bench --bench effects`; with `-- guidance` for one task. Steps of a batch of eight samples on one thread, with a
//! policy that does nothing: forward, and forward with the adjoints of R and of C. Everything is measured in turn, round
//! after round; a ratio is the median of the rounds' ratios. How fast code is depends a little on where its data
//! happen to be: the jobs are made anew, elsewhere and in another order, several times, and the ratio is the median of these.

mod by_hand;
mod measure;

use by_hand::{cart_pole, guidance, quantum};
use measure::{Nothing, median, ratio, rounds};
use physgrad::rng::{Purpose, stream};
use physgrad::tasks::{
    CartDamping, CartPole, CartPoleEffect, CartPoleSystem, Cubic, Guidance, GuidanceEffect, GuidanceSystem, Harmonic,
    PoleDamping, Quantum, QuantumEffect, QuantumSystem, SteadyWind,
};
use physgrad::{Adjoint, Float, Flow, Rollout, System, Task, Weights, With};
use std::hint::black_box;

const BATCH: usize = 8;
const PASSES: [(&str, &[Flow]); 3] = [("forward", &[]), ("R", &[Flow::REGULAR]), ("C", &[Flow::MODIFIED, Flow::REGULAR])];

type Job = Box<dyn FnMut()>;

/// A scene, in one form: its name, and a job for each pass.
struct Form {
    name: &'static str,
    jobs: Box<dyn Fn() -> [Job; 3]>,
}

fn main() {
    let args: Vec<String> = std::env::args().skip(1).collect();
    let (places, count) = if args.iter().any(|a| a == "--quick") { (1, 5) } else { (9, 150) };
    println!("microseconds of a step, {BATCH} samples, one thread; through effects, by hand: ratio (lowest, highest)");
    let wanted = |task: &str| args.iter().all(|a| a.starts_with('-')) || args.iter().any(|a| a == task);
    if wanted("cart_pole") {
        println!("\ncart-pole, 4 poles");
        table(cart_pole_scenes::<f32>(), "f32", CartPole::new(4).horizon, places, count);
        table(cart_pole_scenes::<f64>(), "f64", CartPole::new(4).horizon, places, count);
    }
    if wanted("guidance") {
        println!("\nguidance, 2 drivers, 4 evaders");
        table(guidance_scenes::<f32>(), "f32", Guidance::new(2, 4).horizon, places, count);
        table(guidance_scenes::<f64>(), "f64", Guidance::new(2, 4).horizon, places, count);
    }
    if wanted("quantum") {
        println!("\nquantum, 32 grid points");
        table(quantum_scenes::<f32>(), "f32", Quantum::new(3).horizon, places, count);
        table(quantum_scenes::<f64>(), "f64", Quantum::new(3).horizon, places, count);
    }
}

fn cart_pole_scenes<F: Float>() -> Vec<Vec<Form>> {
    let system = CartPoleSystem { poles: 4, ..CartPoleSystem::default() };
    let (pole, cart, wind) = (PoleDamping::default(), CartDamping::default(), SteadyWind::default());
    let list: Vec<CartPoleEffect> = vec![pole.into(), cart.into(), wind.into()];
    vec![
        vec![
            form::<F, _>("", CartPole::around(cart_pole::ByHand::<false, false> { system, pole, cart, wind })),
            form::<F, _>("no effect", CartPole::around(system)),
            form::<F, _>("no effect, list", CartPole::around(With { system, effects: list[..0].to_vec() })),
        ],
        vec![
            form::<F, _>("", CartPole::around(cart_pole::ByHand::<true, false> { system, pole, cart, wind })),
            form::<F, _>("friction", CartPole::around(With { system, effects: (pole, cart) })),
            form::<F, _>("friction, list", CartPole::around(With { system, effects: list[..2].to_vec() })),
        ],
        vec![
            form::<F, _>("", CartPole::around(cart_pole::ByHand::<true, true> { system, pole, cart, wind })),
            form::<F, _>("friction and wind", CartPole::around(With { system, effects: (pole, cart, wind) })),
            form::<F, _>("friction and wind, list", CartPole::around(With { system, effects: list })),
        ],
    ]
}

fn guidance_scenes<F: Float>() -> Vec<Vec<Form>> {
    let typed = GuidanceSystem::default().herding();
    let (system, (friction, spread, evade, flock)) = (typed.system, typed.effects);
    let list: Vec<GuidanceEffect> = vec![friction.into(), spread.into(), evade.into(), flock.into()];
    vec![vec![
        form::<F, _>("", Guidance::around(guidance::ByHand { system, friction, spread, evade, flock })),
        form::<F, _>("herding", Guidance::around(typed)),
        form::<F, _>("herding, list", Guidance::around(With { system, effects: list })),
    ]]
}

fn quantum_scenes<F: Float>() -> Vec<Vec<Form>> {
    let (system, trap, cubic) = (QuantumSystem::default(), Harmonic::default(), Cubic::default());
    let list: Vec<QuantumEffect> = vec![trap.into(), cubic.into()];
    vec![
        vec![
            form::<F, _>("", Quantum::around(quantum::ByHand::<false, false> { system, trap, cubic }, 3)),
            form::<F, _>("no effect", Quantum::around(system, 3)),
            form::<F, _>("no effect, list", Quantum::around(With { system, effects: list[..0].to_vec() }, 3)),
        ],
        vec![
            form::<F, _>("", Quantum::around(quantum::ByHand::<true, true> { system, trap, cubic }, 3)),
            form::<F, _>("trap and cubic", Quantum::around(With { system, effects: (trap, cubic) }, 3)),
            form::<F, _>("trap and cubic, list", Quantum::around(With { system, effects: list }, 3)),
        ],
    ]
}

/// Of each scene, the first form is the one by hand.
fn table(scenes: Vec<Vec<Form>>, precision: &str, horizon: usize, places: usize, count: usize) {
    println!("{precision}");
    for forms in scenes {
        // [pass][form][place]
        let mut found = [(); 3].map(|()| vec![(Vec::new(), Vec::new()); forms.len()]);
        for place in 0..places {
            // Made in another order, and with gaps of odd sizes between them.
            let order: Vec<usize> = (0..forms.len()).map(|i| (i + place) % forms.len()).collect();
            let mut gaps = Vec::new();
            let mut jobs: Vec<[Job; 3]> = Vec::new();
            for &form in &order {
                gaps.push(black_box(vec![0_u8; 64 + 832 * place]));
                jobs.push((forms[form].jobs)());
            }
            for pass in 0..3 {
                let mut jobs: Vec<&mut dyn FnMut()> = jobs.iter_mut().map(|job| &mut *job[pass] as &mut dyn FnMut()).collect();
                let times = deeper(3 * place, &mut || rounds(count, &mut jobs));
                let hand = &times[order.iter().position(|&form| form == 0).expect("it is there")];
                for (&form, times) in order.iter().zip(&times) {
                    found[pass][form].0.push(median(times) / horizon as f64);
                    found[pass][form].1.push(ratio(times, hand));
                }
            }
        }
        for form in 1..forms.len() {
            print!("  {:<24}", forms[form].name);
            for ((name, _), found) in PASSES.iter().zip(&found) {
                let (times, ratios) = &found[form];
                let (low, high) = ratios.iter().fold((f64::MAX, 0.0_f64), |(low, high), &r| (low.min(r), high.max(r)));
                let (time, hand) = (median(times), median(&found[0].0));
                print!("  {name} {time:.3}, {hand:.3}: {:.3} ({low:.2}, {high:.2})", median(ratios));
            }
            println!();
        }
    }
}

/// Does the work with the stack elsewhere.
#[inline(never)]
fn deeper<T>(calls: usize, work: &mut dyn FnMut() -> T) -> T {
    let space = black_box([0_u8; 208]);
    let result = if calls == 0 { work() } else { deeper(calls - 1, work) };
    black_box(space);
    result
}

fn form<F: Float, T: Task + Clone + 'static>(name: &'static str, task: T) -> Form {
    Form { name, jobs: Box::new(move || PASSES.map(|(_, flows)| job::<F, T>(task.clone(), flows))) }
}

/// A rollout, and its adjoint if there are flows.
fn job<F: Float, T: Task + 'static>(task: T, flows: &[Flow]) -> Job {
    let (state_dim, control_dim) = (task.system().state_dim(), task.system().control_dim());
    let policy = Nothing { state_dim, control_dim };
    let weights = Weights::<F>::init(&policy, &mut stream(0, Purpose::Policy, 0));
    let mut x = vec![0.0; BATCH * state_dim];
    for (sample, x) in x.chunks_exact_mut(state_dim).enumerate() {
        task.start(&mut stream(0, Purpose::Train, sample as u64), x);
    }
    let starts: Vec<F> = x.into_iter().map(F::lift).collect();
    let mut rollout = Rollout::new(&task, &policy, BATCH);
    let mut adjoint = (!flows.is_empty()).then(|| Adjoint::new(&policy, &rollout, flows));
    Box::new(move || {
        rollout.start(&starts);
        rollout.run(&task, &policy, &weights).expect("finite");
        if let Some(adjoint) = &mut adjoint {
            adjoint.run(&task, &policy, &weights, &rollout, F::lift(0.125)).expect("finite");
        }
    })
}
