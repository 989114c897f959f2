//! Benchmark of default derivatives against analytic derivatives, and of a policy that implements
//! `act` alone against one with batched passes.
//!
//! Usage: `cargo bench --bench defaults`, or with `-- products`, `-- trainings`, `-- policies` for
//! one part, and with `-- --quick` for few rounds. Jobs alternate within each round; ratios are
//! medians of the ratios per round.

mod measure;

use measure::{median, ratio, rounds};
use physgrad::engine::Batch;
use physgrad::policy::{Action, Linear, Mlp, Observed};
use physgrad::rng::{Purpose, Rng, stream};
use physgrad::scalar::{CotangentPack, Dual, Lanes};
use physgrad::{
    Cotangent, Cotangents, Field, Float, Flow, Inputs, Policy, Real, Scalar, Start, System, Task,
    Trainer, Training, Weights, initial_states,
};
use rand::RngExt;
use std::hint::black_box;

/// Stiffness k of the springs of a [`Rod`], N/m.
const STIFFNESS: f64 = 8000.0;
/// Cubic stiffness k₃ of the springs, N/m³.
const HARDENING: f64 = 2e5;
/// Viscous damping, N s/m.
const DAMPING: f64 = 0.1;
/// Time step, s.
const DT: f64 = 0.01;

/// Implementation of the derivatives of a [`Rod`].
#[derive(Clone, Copy, PartialEq)]
enum By {
    Hand,
    Default,
}

/// Masses of 1 kg in a row between two walls, with viscous damping. The springs have the force
/// k d + k₃ d³ at the extension d. Controls are forces on every 25th mass, beginning with the
/// first, N.
struct Rod {
    masses: usize,
    by: By,
    /// Number of unused parameters, which count as inputs. Default derivatives use reverse mode for
    /// more than 16 inputs.
    unused: usize,
}

impl Rod {
    fn controls(&self) -> usize {
        self.masses.div_ceil(25)
    }
}

/// Spring force at the extension d, N.
#[inline(always)]
fn spring<T: Scalar>(d: T) -> T {
    d * (d * d * HARDENING + STIFFNESS)
}

/// Derivative of the spring force, N/m.
#[inline(always)]
fn slope<T: Scalar>(d: T) -> T {
    d * d * (3.0 * HARDENING) + STIFFNESS
}

impl System for Rod {
    fn state_dim(&self) -> usize {
        2 * self.masses
    }
    fn control_dim(&self) -> usize {
        self.controls()
    }
    fn param_dim(&self) -> usize {
        self.unused
    }
    #[inline(always)]
    fn step<T: Scalar>(&self, Inputs { x, u, .. }: Inputs<'_, T>, next: &mut [T]) {
        let n = self.masses;
        let (q, v) = x.split_at(n);
        let (q_next, v_next) = next.split_at_mut(n);
        let mut left = spring(q[0]);
        for i in 0..n {
            let right = spring(if i + 1 < n { q[i + 1] - q[i] } else { -q[i] });
            let mut force = right - left - v[i] * DAMPING;
            if i % 25 == 0 {
                force += u[i / 25];
            }
            v_next[i] = v[i] + force * DT;
            q_next[i] = q[i] + v_next[i] * DT;
            left = right;
        }
    }
    #[inline(always)]
    fn vjp<R: Real, C: Cotangent<R>>(
        &self,
        inputs: Inputs<'_, R>,
        next_bar: &[C],
        cotangents: Cotangents<'_, C>,
    ) {
        if self.by == By::Default {
            return DefaultOf(self).vjp(inputs, next_bar, cotangents);
        }
        let (Cotangents { x: Some(x_bar), u: Some(u_bar), p: None }, n) = (cotangents, self.masses)
        else {
            unreachable!()
        };
        let (dt, kept) = (R::from(DT), R::from(1.0 - DAMPING * DT));
        let (q, (q_next_bar, v_next_bar)) = (&inputs.x[..n], next_bar.split_at(n));
        let (q_bar, v_bar) = x_bar.split_at_mut(n);
        let of = |i: usize| v_next_bar[i] + q_next_bar[i] * dt;
        let mut before = of(0) * dt;
        q_bar[0] += -(before * slope(q[0]));
        for i in 0..n {
            let speed_bar = of(i);
            let force_bar = speed_bar * dt;
            v_bar[i] += speed_bar * kept;
            q_bar[i] += q_next_bar[i];
            if i % 25 == 0 {
                u_bar[i / 25] += force_bar;
            }
            if i > 0 {
                let pull = (before - force_bar) * slope(q[i] - q[i - 1]);
                q_bar[i] += pull;
                q_bar[i - 1] -= pull;
            }
            before = force_bar;
        }
        q_bar[n - 1] -= before * slope(q[n - 1]);
    }
}

/// System that forwards the step of `S` and uses default derivatives.
struct DefaultOf<'a, S>(&'a S);

impl<S: System> System for DefaultOf<'_, S> {
    fn state_dim(&self) -> usize {
        self.0.state_dim()
    }
    fn control_dim(&self) -> usize {
        self.0.control_dim()
    }
    #[inline(always)]
    fn step<T: Scalar>(&self, inputs: Inputs<'_, T>, next: &mut [T]) {
        self.0.step(inputs, next);
    }
}

impl Task for Rod {
    type System = Self;
    fn system(&self) -> &Self {
        self
    }
    fn horizon(&self) -> usize {
        100
    }
    fn start(&self, rng: &mut Rng, Start { x, .. }: Start<'_>) {
        x.fill_with(|| rng.random_range(-1e-3..1e-3));
    }
    #[inline(always)]
    fn running_cost<T: Scalar>(&self, Inputs { u, .. }: Inputs<'_, T>, next: &[T]) -> T {
        next.iter().map(|&x| x * x).sum::<T>() + u.iter().map(|&u| u * u).sum::<T>() * 0.01
    }
    #[inline(always)]
    fn running_cost_gradient<R: Real>(
        &self,
        inputs: Inputs<'_, R>,
        next: &[R],
        cotangents: Cotangents<'_, R>,
        next_bar: &mut [R],
    ) {
        if self.by == By::Default {
            return Costs(self).running_cost_gradient(inputs, next, cotangents, next_bar);
        }
        next_bar.iter_mut().zip(next).for_each(|(bar, &x)| *bar += x + x);
        cotangents.u.into_iter().flatten().zip(inputs.u).for_each(|(bar, &u)| *bar += u * 0.02);
    }
}

/// Task with the running cost of a [`Rod`], and the default gradient of the cost.
struct Costs<'a>(&'a Rod);

impl Task for Costs<'_> {
    type System = Rod;
    fn system(&self) -> &Rod {
        self.0
    }
    fn horizon(&self) -> usize {
        self.0.horizon()
    }
    fn start(&self, rng: &mut Rng, start: Start<'_>) {
        self.0.start(rng, start);
    }
    #[inline(always)]
    fn running_cost<T: Scalar>(&self, inputs: Inputs<'_, T>, next: &[T]) -> T {
        self.0.running_cost(inputs, next)
    }
}

/// Policy that computes the tanh network of an [`Mlp`] by `act` alone, without batched passes.
struct ActOnly {
    sizes: [usize; 4],
    mlp: Mlp,
}

impl Policy for ActOnly {
    fn observation_dim(&self) -> usize {
        self.sizes[0]
    }
    fn control_dim(&self) -> usize {
        self.sizes[3]
    }
    fn param_count(&self) -> usize {
        self.mlp.param_count()
    }
    fn init(&self, rng: &mut Rng, theta: &mut [f64]) {
        self.mlp.init(rng, theta);
    }
    #[inline(always)]
    fn act<T: Scalar>(
        &self,
        theta: &[T],
        Observed { y, .. }: Observed<'_, T>,
        Action { u, .. }: Action<'_, T>,
    ) {
        let (mut h, mut first) = (y.to_vec(), 0);
        for (layer, sizes) in self.sizes.windows(2).enumerate() {
            let bias = first + sizes[0] * sizes[1];
            let mut z = theta[bias..][..sizes[1]].to_vec();
            for i in 0..sizes[0] {
                for j in 0..sizes[1] {
                    z[j] += theta[first + i * sizes[1] + j] * h[i];
                }
            }
            if layer < 2 {
                z.iter_mut().for_each(|z| *z = z.tanh());
            }
            (h, first) = (z, bias + sizes[1]);
        }
        u.copy_from_slice(&h);
    }
}

/// Two chains of leaky integrators, with seven states together. Each of the two controls drives the
/// first state of a chain.
struct Small;

impl System for Small {
    fn state_dim(&self) -> usize {
        7
    }
    fn control_dim(&self) -> usize {
        2
    }
    #[inline(always)]
    fn step<T: Scalar>(&self, Inputs { x, u, .. }: Inputs<'_, T>, next: &mut [T]) {
        for i in 0..7 {
            next[i] = x[i] * 0.9 + if i < 2 { u[i] } else { x[i - 2] * 0.1 };
        }
    }
}

impl Task for Small {
    type System = Self;
    fn system(&self) -> &Self {
        self
    }
    fn horizon(&self) -> usize {
        50
    }
    fn start(&self, rng: &mut Rng, Start { x, .. }: Start<'_>) {
        x.fill_with(|| rng.random_range(-1.0..1.0));
    }
    fn terminal_cost<T: Scalar>(&self, x: &[T], _: &[T]) -> T {
        x.iter().map(|&x| x * x).sum()
    }
}

fn main() {
    let args = || std::env::args().skip(1);
    let rounds = if args().any(|arg| arg == "--quick") { 5 } else { 30 };
    let wanted =
        |part: &str| args().all(|arg| arg.starts_with('-')) || args().any(|arg| arg == part);
    if wanted("products") {
        products(rounds);
    }
    if wanted("trainings") {
        trainings::<f32>(rounds);
        trainings::<f64>(rounds);
    }
    if wanted("policies") {
        policies::<f32>(rounds);
        policies::<f64>(rounds);
    }
}

/// VJP of a rod by dual numbers with four tangents.
fn by_duals(
    rod: &Rod,
    x: &[Lanes<f32, 8>],
    u: &[Lanes<f32, 8>],
    next_bar: &[Lanes<f32, 8>],
    cotangents: &mut [Lanes<f32, 8>],
) {
    let (n, m) = (x.len(), u.len());
    let mut next = vec![Dual::constant(Lanes([0.0; 8])); n];
    let mut all: Vec<Dual<Lanes<f32, 8>, 4>> = Vec::new();
    for first in (0..n + m).step_by(4) {
        let chunk = first..(n + m).min(first + 4);
        let seed = |(i, &value)| {
            if chunk.contains(&i) {
                Dual::variable(value, i - first)
            } else {
                Dual::constant(value)
            }
        };
        all.clear();
        all.extend(x.iter().chain(u).enumerate().map(seed));
        rod.step(Inputs::new(&all[..n], &all[n..]), &mut next);
        for (k, i) in chunk.clone().enumerate() {
            cotangents[i] = next
                .iter()
                .zip(next_bar)
                .fold(Lanes([0.0; 8]), |sum, (next, &bar)| sum + bar * next.tangents[k]);
        }
    }
}

/// Times three VJPs of eight samples (analytic, by dual numbers, in reverse mode) for several
/// numbers of inputs.
fn products(count: usize) {
    println!("microseconds of one VJP of eight samples in f32, by number of inputs");
    println!("  inputs     hand    duals  reverse   duals / hand  reverse / hand");
    for masses in [2, 4, 6, 7, 8, 10, 16, 32, 100] {
        let rod = |by, unused| Rod { masses, by, unused };
        let (hand, reverse) = (rod(By::Hand, 0), rod(By::Default, 17));
        let numbers = |len: usize| -> Vec<Lanes<f32, 8>> {
            (0..len)
                .map(|i| Lanes(std::array::from_fn(|k| 1e-3 * ((7 * i + k) % 13) as f32)))
                .collect()
        };
        let (n, m) = (2 * masses, hand.controls());
        let (x, u, p) = (numbers(n), numbers(m), numbers(17));
        let next_bar: Vec<_> = numbers(n).into_iter().map(|bar| CotangentPack([bar])).collect();
        let plain_bar = numbers(n);
        let job = |rod: Rod, p: Vec<Lanes<f32, 8>>| {
            let (x, u, next_bar) = (&x, &u, &next_bar);
            let (mut x_bar, mut u_bar) =
                (vec![CotangentPack::null(); n], vec![CotangentPack::null(); m]);
            move || {
                for _ in 0..100 {
                    x_bar.fill(CotangentPack::null());
                    u_bar.fill(CotangentPack::null());
                    let inputs = Inputs { x: black_box(x), u, p: &p, t: 0 };
                    rod.vjp(inputs, next_bar, Cotangents::of(&mut x_bar, &mut u_bar));
                    black_box((&mut x_bar, &mut u_bar));
                }
            }
        };
        let (mut by_hand, mut by_tape) = (job(hand, Vec::new()), job(reverse, p));
        let (duals, mut cotangents) = (rod(By::Default, 0), vec![Lanes([0.0; 8]); n + m]);
        let mut duals = || {
            (0..100).for_each(|_| {
                by_duals(&duals, black_box(&x), &u, &plain_bar, black_box(&mut cotangents))
            })
        };
        let times = rounds(3 * count, &mut [&mut by_hand, &mut duals, &mut by_tape]);
        let [hand, duals, reverse] = [0, 1, 2].map(|i| median(&times[i]) / 100.0);
        let [to_hand, tape_to_hand] = [1, 2].map(|i| ratio(&times[i], &times[0]));
        println!(
            "  {:>6} {hand:>8.2} {duals:>8.2} {reverse:>8.2} {to_hand:>14.1} {tape_to_hand:>15.1}",
            n + m
        );
    }
}

/// Times training epochs for a rod with 200 states, with two fields and two policies.
fn trainings<F: Float>(count: usize) {
    println!("\n{}: epoch of a rod with 200 states, 64 samples, 100 steps, one thread", F::NAME);
    for (name, field) in [("R", Field::regular as fn() -> Field), ("C", Field::combined)] {
        compare(
            &format!("{name}, linear policy"),
            count,
            [By::Hand, By::Default].map(|by| epoch::<F, _>(by, Linear::new(200, 4), field())),
        );
        compare(
            &format!("{name}, MLP 200-32-4"),
            count,
            [By::Hand, By::Default].map(|by| epoch::<F, _>(by, Mlp::new([200, 32, 4]), field())),
        );
    }
}

/// Returns a job that trains for one epoch.
fn epoch<F: Float, P: Policy>(by: By, policy: P, field: Field) -> impl FnMut() {
    let rod = Rod { masses: 100, by, unused: 0 };
    let training = Training {
        epochs: usize::MAX >> 32,
        workers: 1,
        train_samples: 64,
        test_samples: 8,
        ..Training::default()
    };
    let trainer = Trainer::new(rod, policy).field(field).precision::<F>().training(training);
    let mut session = trainer.session().expect("valid settings");
    move || {
        session.epoch().expect("finite");
    }
}

/// Prints the times of a job with analytic and with default derivatives, and their ratio.
fn compare(name: &str, count: usize, [mut hand, mut default]: [impl FnMut(); 2]) {
    let times = rounds(count, &mut [&mut hand, &mut default]);
    let [hand, default] = [0, 1].map(|i| median(&times[i]) * 1e-3);
    println!(
        "  {name:<20} analytic {hand:>6.2} ms, default {default:>6.2} ms, ratio {:.2}",
        ratio(&times[1], &times[0])
    );
}

/// Times the gradient of R with a policy of 4802 parameters.
fn policies<F: Float>(count: usize) {
    println!(
        "\n{}: gradient of R over 50 steps of eight samples, policy 7-64-64-2 with 4802 parameters",
        F::NAME
    );
    let sizes = [7, 64, 64, 2];
    let (mlp, act_only) = (Mlp::new(sizes), ActOnly { sizes, mlp: Mlp::new(sizes) });
    let starts = initial_states::<F>(&Small, 0, Purpose::Train, 8);
    let weights = Weights::<F>::init(&mlp, &mut stream(0, Purpose::Policy, 0));
    let plain = Weights::<F>::new(&act_only, weights.theta().to_vec());
    let flows = [Flow::REGULAR];
    let mut built_in = Batch::new(&Small, &mlp, 8, &flows, 1);
    let mut by_act = Batch::new(&Small, &act_only, 8, &flows, 1);
    let mut fast = || {
        built_in.run(&Small, &mlp, &weights, &starts).expect("finite");
    };
    let mut slow = || {
        by_act.run(&Small, &act_only, &plain, &starts).expect("finite");
    };
    let times = rounds(count, &mut [&mut fast, &mut slow]);
    let [fast, slow] = [0, 1].map(|i| median(&times[i]));
    println!(
        "  batched {fast:.0} µs, act only {slow:.0} µs, ratio {:.1}",
        ratio(&times[1], &times[0])
    );
}
