//! Benchmark of the effect system against the same physics in a single handwritten function.
//!
//! Usage: `cargo bench --bench effects`, or with `-- guidance` for one task, and with `-- --quick`
//! for few rounds. Measures steps of eight samples on one thread: forward alone, with the adjoint
//! of R, and with the adjoints of C. One part measures the physics alone, with zero control. The
//! other part measures whole scenes, with the policy of the paper and the gradients with respect to
//! the policy parameters.
//!
//! Jobs alternate within each round; a ratio is the median of the ratios per round. Timings depend
//! on the memory layout. The benchmark therefore constructs all jobs nine times (once with
//! `--quick`), in varying order and layout. It reports the median, the lowest and the highest of
//! these ratios.

mod by_hand;
mod measure;

use by_hand::{cart_pole, guidance, quantum};
use measure::{Nothing, median, ratio, rounds};
use physgrad::engine::any::AnyTask;
use physgrad::policy::AnyPolicy;
use physgrad::policy::{Conv, Mlp, Policy};
use physgrad::rng::{Purpose, stream};
use physgrad::tasks::{
    CartDamping, CartPole, CartPoleEffect, CartPoleSystem, Cubic, Guidance, GuidanceEffect,
    GuidanceSystem, Harmonic, PoleDamping, Quantum, QuantumEffect, QuantumSystem, SteadyWind,
};
use physgrad::{Adjoint, Float, Flow, Forced, Gradient, Rollout, Task, Weights, initial_states};
use std::hint::black_box;

const BATCH: usize = 8;
const PASSES: [(&str, &[Flow]); 3] =
    [("forward", &[]), ("R", &[Flow::REGULAR]), ("C", &[Flow::MODIFIED, Flow::REGULAR])];

type Job = Box<dyn FnMut()>;

/// Scope of a measurement.
#[derive(Clone, Copy, PartialEq)]
enum Of {
    /// Physics with zero control.
    Physics,
    /// Complete scene with its policy.
    Scene,
}

/// One implementation of a scene: its name, and a factory of one job per pass.
struct Form {
    name: &'static str,
    jobs: Box<dyn Fn(Of) -> [Job; 3]>,
}

fn main() {
    let args: Vec<String> = std::env::args().skip(1).collect();
    let (places, count) = if args.iter().any(|a| a == "--quick") { (1, 5) } else { (9, 150_usize) };
    println!(
        "microseconds of a step, {BATCH} samples, one thread; columns: time with effects, time by hand: ratio (lowest, highest)"
    );
    let wanted =
        |task: &str| args.iter().all(|a| a.starts_with('-')) || args.iter().any(|a| a == task);
    let tables =
        |of: Of, name: &str, single: Vec<Vec<Form>>, double: Vec<Vec<Form>>, horizon: usize| {
            // Scenes need fewer rounds: with a network, a step takes longer and its time varies less.
            let (what, count) = if of == Of::Physics {
                ("physics alone", count)
            } else {
                ("the scene", count.div_ceil(4))
            };
            println!("\n{name}: {what}");
            table(of, single, "f32", horizon, places, count);
            table(of, double, "f64", horizon, places, count);
        };
    for of in [Of::Physics, Of::Scene] {
        if wanted("cart_pole") {
            tables(
                of,
                "cart-pole, 4 poles",
                cart_pole_scenes::<f32>(),
                cart_pole_scenes::<f64>(),
                CartPole::new(4).horizon,
            );
        }
        if wanted("guidance") {
            let horizon = Guidance::new(2, 4).horizon;
            tables(
                of,
                "guidance, 2 drivers, 4 evaders",
                guidance_scenes::<f32>(),
                guidance_scenes::<f64>(),
                horizon,
            );
        }
        if wanted("quantum") {
            tables(
                of,
                "quantum, 32 grid points",
                quantum_scenes::<f32>(),
                quantum_scenes::<f64>(),
                Quantum::new(3).horizon,
            );
        }
    }
}

fn cart_pole_scenes<F: Float>() -> Vec<Vec<Form>> {
    let system = CartPoleSystem { poles: 4, ..CartPoleSystem::default() };
    let network = Mlp::new([10, 100, 100, 1]);
    let (pole, cart, wind) =
        (PoleDamping::default(), CartDamping::default(), SteadyWind::default());
    let list: Vec<CartPoleEffect> = vec![pole.into(), cart.into(), wind.into()];
    vec![
        vec![
            form::<F>(
                &network,
                "",
                CartPole::with_system(cart_pole::ByHand::<false, false> {
                    system,
                    pole,
                    cart,
                    wind,
                }),
            ),
            form::<F>(&network, "no effect", CartPole::with_system(system)),
            form::<F>(
                &network,
                "no effect, list",
                CartPole::with_system(Forced { system, effects: list[..0].to_vec() }),
            ),
        ],
        vec![
            form::<F>(
                &network,
                "",
                CartPole::with_system(cart_pole::ByHand::<true, false> {
                    system,
                    pole,
                    cart,
                    wind,
                }),
            ),
            form::<F>(
                &network,
                "friction",
                CartPole::with_system(Forced { system, effects: (pole, cart) }),
            ),
            form::<F>(
                &network,
                "friction, list",
                CartPole::with_system(Forced { system, effects: list[..2].to_vec() }),
            ),
        ],
        vec![
            form::<F>(
                &network,
                "",
                CartPole::with_system(cart_pole::ByHand::<true, true> { system, pole, cart, wind }),
            ),
            form::<F>(
                &network,
                "friction and wind",
                CartPole::with_system(Forced { system, effects: (pole, cart, wind) }),
            ),
            form::<F>(
                &network,
                "friction and wind, list",
                CartPole::with_system(Forced { system, effects: list }),
            ),
        ],
    ]
}

fn guidance_scenes<F: Float>() -> Vec<Vec<Form>> {
    let typed = GuidanceSystem::default().herding();
    let network = Mlp::new([24, 100, 100, 4]);
    let (system, (friction, spread, evade, flock)) = (typed.system, typed.effects);
    let list: Vec<GuidanceEffect> =
        vec![friction.into(), spread.into(), evade.into(), flock.into()];
    vec![vec![
        form::<F>(
            &network,
            "",
            Guidance::with_system(guidance::ByHand { system, friction, spread, evade, flock }),
        ),
        form::<F>(&network, "herding", Guidance::with_system(typed)),
        form::<F>(
            &network,
            "herding, list",
            Guidance::with_system(Forced { system, effects: list }),
        ),
    ]]
}

fn quantum_scenes<F: Float>() -> Vec<Vec<Form>> {
    let network = Conv::new(32, 60);
    let (system, trap, cubic) = (QuantumSystem::default(), Harmonic::default(), Cubic::default());
    let list: Vec<QuantumEffect> = vec![trap.into(), cubic.into()];
    vec![
        vec![
            form::<F>(
                &network,
                "",
                Quantum::with_system(quantum::ByHand::<false, false> { system, trap, cubic }, 3),
            ),
            form::<F>(&network, "no effect", Quantum::with_system(system, 3)),
            form::<F>(
                &network,
                "no effect, list",
                Quantum::with_system(Forced { system, effects: list[..0].to_vec() }, 3),
            ),
        ],
        vec![
            form::<F>(
                &network,
                "",
                Quantum::with_system(quantum::ByHand::<true, true> { system, trap, cubic }, 3),
            ),
            form::<F>(
                &network,
                "trap and cubic",
                Quantum::with_system(Forced { system, effects: (trap, cubic) }, 3),
            ),
            form::<F>(
                &network,
                "trap and cubic, list",
                Quantum::with_system(Forced { system, effects: list }, 3),
            ),
        ],
    ]
}

/// Prints times and ratios. The first form of each scene is the handwritten one.
fn table(
    of: Of,
    scenes: Vec<Vec<Form>>,
    precision: &str,
    horizon: usize,
    places: usize,
    count: usize,
) {
    println!("{precision}");
    for forms in scenes {
        // Times and ratios, by pass and form. Each innermost vector has one number per repetition.
        let mut found = [(); 3].map(|()| vec![(Vec::new(), Vec::new()); forms.len()]);
        for place in 0..places {
            // Varies the order of construction and the memory layout between repetitions.
            let order: Vec<usize> = (0..forms.len()).map(|i| (i + place) % forms.len()).collect();
            let mut gaps = Vec::new();
            let mut jobs: Vec<[Job; 3]> = Vec::new();
            for &form in &order {
                gaps.push(black_box(vec![0_u8; 64 + 832 * place]));
                jobs.push((forms[form].jobs)(of));
            }
            for pass in 0..3 {
                let mut jobs: Vec<&mut dyn FnMut()> =
                    jobs.iter_mut().map(|job| &mut *job[pass] as &mut dyn FnMut()).collect();
                let times = deeper(3 * place, &mut || rounds(count, &mut jobs));
                let hand = &times
                    [order.iter().position(|&form| form == 0).expect("the order contains form 0")];
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
                let (low, high) = ratios
                    .iter()
                    .fold((f64::MAX, 0.0_f64), |(low, high), &r| (low.min(r), high.max(r)));
                let (time, hand) = (median(times), median(&found[0].0));
                print!(
                    "  {name} {time:.3}, {hand:.3}: {:.3} ({low:.2}, {high:.2})",
                    median(ratios)
                );
            }
            println!();
        }
    }
}

/// Calls `work` at a greater stack depth, which changes the stack addresses.
#[inline(never)]
fn deeper<T>(calls: usize, work: &mut dyn FnMut() -> T) -> T {
    let space = black_box([0_u8; 208]);
    let result = if calls == 0 { work() } else { deeper(calls - 1, work) };
    black_box(space);
    result
}

fn form<F: Float>(
    network: &(impl Policy + Clone + 'static),
    name: &'static str,
    task: impl Task + Clone + 'static,
) -> Form {
    let network = network.clone();
    let policy = move |of: Of, task: &dyn AnyTask<F>| -> Box<dyn AnyPolicy<F>> {
        match of {
            Of::Physics => {
                Box::new(Nothing { state_dim: task.state_dim(), control_dim: task.control_dim() })
            }
            Of::Scene => Box::new(network.clone()),
        }
    };
    Form {
        name,
        jobs: Box::new(move |of| {
            PASSES.map(|(_, flows)| job::<F>(of, Box::new(task.clone()), policy(of, &task), flows))
        }),
    }
}

/// Returns a job: a rollout and the adjoints of the flows. With [`Of::Scene`], the job also
/// computes the parameter gradients.
fn job<F: Float>(
    of: Of,
    task: Box<dyn AnyTask<F>>,
    policy: Box<dyn AnyPolicy<F>>,
    flows: &[Flow],
) -> Job {
    let weights = Weights::<F>::init(&*policy, &mut stream(0, Purpose::Policy, 0));
    let starts: Vec<F> = initial_states(&*task, 0, Purpose::Train, BATCH);
    let mut rollout = Rollout::new(&*task, &*policy, BATCH);
    let mut adjoint = (!flows.is_empty()).then(|| Adjoint::new(&*task, &*policy, &rollout, flows));
    let mut gradient = Gradient::zeros(weights.theta().len());
    Box::new(move || {
        rollout.start(&starts);
        rollout.run(&*task, &*policy, &weights).expect("finite");
        if let Some(adjoint) = &mut adjoint {
            adjoint.run(&*task, &*policy, &weights, &rollout, F::from_f64(0.125)).expect("finite");
            let asked = if of == Of::Scene { adjoint.flows().len() } else { 0 };
            for k in 0..asked {
                adjoint.param_gradient(k, &*policy, &weights, &rollout, 0..BATCH, &mut gradient);
            }
        }
    })
}
