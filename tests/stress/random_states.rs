//! Stress case: gradients at many random states.

use super::steps::{error, finite, larger, vjp_by_duals};
use super::{AnySystem, vjp};
use super::{Case, Finding};
use physgrad::Inputs;
use physgrad::Real;
use physgrad::rng::{Purpose, Rng, stream};
use physgrad::scalar::Single;
use physgrad::tasks::{
    BouncingBall, CartPoleSystem, Contact, CoupledCartPole, FrictionScheme, GuidanceSystem,
    QuantumSystem, Renormalized, SliderSystem, TwoBodies,
};
use rand::RngExt;
use rand_distr::{Distribution, StandardNormal};

pub(super) const CASES: &[Case] = &[Case {
    name: "random_states",
    about: "one step and its VJP at 10,000 random states of each of 12 systems, in f64 and f32",
    criterion: "all values are finite. Dual numbers and VJP agree to 1e-12 in f64, and to 64 ε (1 + κ) in f32. ε is \
                the machine epsilon of f32. κ is the relative change of the VJP per relative change of state and \
                control. The case measures κ in f64 at every state",
    explanation: "Derivatives are usually tested at a few selected states. Limits: for systems whose VJP uses dual \
                numbers, this case compares the VJP with itself. The test module `hard_contacts` compares these \
                derivatives with closed forms and differences",
    run: random_states,
}];

const STATES: u64 = 10_000;

fn random_states() -> Vec<Finding> {
    let poles = |poles: usize| CartPoleSystem { poles, ..CartPoleSystem::default() };
    let coupled = CoupledCartPole(poles(4));
    let herding = GuidanceSystem::default().herding();
    let quantum = QuantumSystem { grid: 16, ..QuantumSystem::default() };
    let explicit = SliderSystem { scheme: FrictionScheme::Explicit, ..SliderSystem::default() };
    let spring = Contact::Penalty { stiffness: 1e4, damping: 0.5 };
    let ball = BouncingBall::default();
    [
        of("cart-pole, 1 pole", &poles(1), wide),
        of("cart-pole, 4 poles", &poles(4), wide),
        of("coupled cart-pole, 4 poles", &coupled, wide),
        of("guidance, 2 drivers and 4 evaders", &herding, wide),
        of("quantum, 16 points", &quantum, wave),
        of("quantum, 16 points, renormalized", &Renormalized { system: quantum }, wave),
        of("slider, explicit", &explicit, sliding),
        of("slider, implicit", &SliderSystem::default(), sliding),
        of("ball, time of impact", &ball, falling),
        of("ball, spring", &BouncingBall { contact: spring, ..ball }, falling),
        of("pusher, time of impact", &TwoBodies::pusher(), meeting),
        of("balls, spring", &TwoBodies { contact: spring, ..TwoBodies::balls() }, meeting),
    ]
    .concat()
}

fn normal(rng: &mut Rng) -> f64 {
    StandardNormal.sample(rng)
}

/// Log-uniform magnitude between two powers of ten, with random sign.
fn any_size(rng: &mut Rng, from: f64, to: f64) -> f64 {
    10f64.powf(rng.random_range(from..to)) * if rng.random() { 1.0 } else { -1.0 }
}

/// Draws normal states and controls with a standard deviation of 3.
fn wide(rng: &mut Rng, x: &mut [f64], u: &mut [f64]) {
    x.iter_mut().chain(u).for_each(|x| *x = 3.0 * normal(rng));
}

/// Draws a wave of norm 1, and a control within ±30.
fn wave(rng: &mut Rng, x: &mut [f64], u: &mut [f64]) {
    x.iter_mut().for_each(|x| *x = normal(rng));
    let norm = x.iter().map(|x| x * x).sum::<f64>().sqrt();
    x.iter_mut().for_each(|x| *x /= norm);
    u[0] = rng.random_range(-30.0..30.0);
}

/// Draws a speed from 1e-9 to 10 m/s, in either direction, and a normal position and control.
fn sliding(rng: &mut Rng, x: &mut [f64], u: &mut [f64]) {
    (x[0], x[1], u[0]) = (normal(rng), any_size(rng, -9.0, 1.0), 10.0 * normal(rng));
}

/// Draws a ball above the floor, or on the floor and possibly at rest.
fn falling(rng: &mut Rng, x: &mut [f64], u: &mut [f64]) {
    let on_floor = rng.random_bool(0.1);
    x[0] = if on_floor { 0.0 } else { any_size(rng, -6.0, 0.5).abs() };
    x[1] = if on_floor && rng.random() { 0.0 } else { any_size(rng, -6.0, 1.0) };
    u[0] = 10.0 * normal(rng);
}

/// Draws two bodies in contact, or with a gap of 1e-6 to 3.2 m.
fn meeting(rng: &mut Rng, x: &mut [f64], u: &mut [f64]) {
    x[0] = normal(rng);
    x[1] = x[0] + 0.1 + if rng.random_bool(0.1) { 0.0 } else { any_size(rng, -6.0, 0.5).abs() };
    (x[2], x[3], u[0]) = (normal(rng), normal(rng), 10.0 * normal(rng));
}

type Draw = fn(&mut Rng, &mut [f64], &mut [f64]);

/// State, control and cotangent.
struct Sample<R> {
    x: Vec<R>,
    u: Vec<R>,
    bar: Vec<R>,
}

/// Result at one state: finiteness, and error of the VJP.
struct Outcome {
    finite: bool,
    error: f64,
}

/// Object-safe system for both precisions.
trait Either: AnySystem<f64> + AnySystem<Single<f32>> {}

impl<S: AnySystem<f64> + AnySystem<Single<f32>>> Either for S {}

fn of(name: &str, system: &dyn Either, draw: Draw) -> Vec<Finding> {
    let (double, single): (&dyn AnySystem<f64>, &dyn AnySystem<Single<f32>>) = (system, system);
    let (mut finite, mut worst) = ([0, 0], [0.0, 0.0]);
    for index in 0..STATES {
        let mut rng = stream(0, Purpose::Check, index);
        let (mut x, mut u) = (vec![0.0; double.state_dim()], vec![0.0; double.control_dim()]);
        draw(&mut rng, &mut x, &mut u);
        let bar = x.iter().map(|_| normal(&mut rng)).collect();
        let sample = Sample { x, u, bar };
        let condition = condition(double, &sample, &mut rng);
        let (of_double, of_single) = (at(double, &sample), at(single, &rounded(&sample)));
        finite[0] += usize::from(of_double.finite);
        finite[1] += usize::from(of_single.finite);
        worst[0] = larger(worst[0], of_double.error);
        worst[1] = larger(
            worst[1],
            of_single.error / (64.0 * f64::from(f32::EPSILON) * (1.0 + condition)),
        );
    }
    let all = STATES as usize;
    vec![
        Finding::all(format!("{name}: states with finite results, f64"), finite[0], all),
        Finding::all(format!("{name}: states with finite results, f32"), finite[1], all),
        Finding::at_most(format!("{name}: VJP against dual numbers, f64"), worst[0], 1e-12),
        Finding::at_most(
            format!("{name}: VJP against dual numbers, f32, in 64 ε (1 + κ)"),
            worst[1],
            1.0,
        ),
    ]
}

fn rounded(sample: &Sample<f64>) -> Sample<Single<f32>> {
    let single = |v: &[f64]| v.iter().map(|&v| Single::from(v)).collect();
    Sample { x: single(&sample.x), u: single(&sample.u), bar: single(&sample.bar) }
}

fn reverse<R: Real>(system: &dyn AnySystem<R>, sample: &Sample<R>) -> [Vec<R>; 2] {
    let [x_bar, u_bar, _] = vjp(system, Inputs::new(&sample.x, &sample.u), &sample.bar);
    [x_bar, u_bar]
}

fn at<R: Real>(system: &dyn AnySystem<R>, sample: &Sample<R>) -> Outcome {
    let Sample { x, u, bar } = sample;
    let mut next = x.clone();
    system.step(Inputs::new(x, u), &mut next);
    let [x_bar, u_bar] = reverse(system, sample);
    let [x_dual, u_dual] = vjp_by_duals(system, x, u, bar);
    let finite = [&next, &x_bar, &u_bar, &x_dual, &u_dual].into_iter().all(|v| finite(v));
    // State and control cotangents share one scale: a single-component cotangent may vanish by
    // chance.
    Outcome { finite, error: error(&[x_bar, u_bar].concat(), &[x_dual, u_dual].concat()) }
}

/// Condition number κ: relative change of the VJP per relative change of state and control, in a
/// random direction.
fn condition(system: &dyn AnySystem<f64>, sample: &Sample<f64>, rng: &mut Rng) -> f64 {
    /// Relative change of each entry.
    const BY: f64 = 1e-7;
    let mut moved = |v: &[f64]| {
        v.iter().map(|v| v * (1.0 + if rng.random() { BY } else { -BY })).collect::<Vec<f64>>()
    };
    let near = Sample { x: moved(&sample.x), u: moved(&sample.u), bar: sample.bar.clone() };
    error(&reverse(system, &near).concat(), &reverse(system, sample).concat()) / BY
}
