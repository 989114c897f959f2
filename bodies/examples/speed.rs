//! Time of a step and of its reverse derivative per sample, on one thread, eight samples at once.
//!
//! Usage: `speed MODEL.xml ...`. Each model is simulated by Euler's method from its reference pose
//! under random controls that change every 10 steps. The states of the steps 200 to 231 are timed.
//! `bodies/tests/references/speed.py` prints times of MuJoCo beside these.

use physgrad::scalar::Lanes;
use physgrad::{Cotangents, Float, Inputs, Real, Scalar, System};
use physgrad_bodies::model::Integrator;
use physgrad_bodies::{Bodies, files};
use rand::{RngExt, SeedableRng, rngs::SmallRng};
use std::hint::black_box;
use std::path::Path;
use std::time::Instant;

/// States and controls of consecutive steps.
type States<T> = Vec<(Vec<T>, Vec<T>)>;

fn main() -> Result<(), Box<dyn std::error::Error>> {
    println!("{:24} us per sample and step: smallest (median)", "");
    for path in std::env::args().skip(1) {
        let mut model = files::read(Path::new(&path))?;
        model.options.integrator = Integrator::Euler;
        let bodies = Bodies::new(model)?;
        let states = typical(&bodies);
        let touching = states.iter().map(|(x, u)| iterations(&bodies, x, u)).sum::<f64>();
        print!("{:24} iterations {:.2}", bodies.model().name, touching / states.len() as f64);
        let times = [time::<f32>(&bodies, &states), time::<f64>(&bodies, &states)];
        for (name, [step, vjp]) in ["f32", "f64"].into_iter().zip(times) {
            print!(" | {name} step {step}, vjp {vjp}");
        }
        println!();
    }
    Ok(())
}

fn typical(bodies: &Bodies) -> States<Lanes<f64, 8>> {
    let mut rng = SmallRng::seed_from_u64(0);
    let mut noise = |scale: f64| {
        let mut all = Lanes::zero();
        (0..8).for_each(|lane| all.set_lane(lane, scale * rng.random_range(-1.0..1.0)));
        all
    };
    let mut x: Vec<Lanes<f64, 8>> = bodies.reference().iter().map(|&q| noise(0.05) + q).collect();
    x.extend((0..bodies.velocities()).map(|_| noise(0.05)));
    let mut u = vec![Lanes::zero(); bodies.control_dim()];
    let mut all = Vec::new();
    for t in 0..232 {
        if t % 10 == 0 {
            u.iter_mut().for_each(|u| *u = noise(1.0));
        }
        if t >= 200 {
            all.push((x.clone(), u.clone()));
        }
        let mut next = x.clone();
        bodies.step(Inputs::new(&x, &u), &mut next);
        x = next;
    }
    all
}

/// Iterations of the solver, mean over lanes.
fn iterations(bodies: &Bodies, x: &[Lanes<f64, 8>], u: &[Lanes<f64, 8>]) -> f64 {
    let one =
        |all: &[Lanes<f64, 8>], lane: usize| all.iter().map(|x| x.lane(lane)).collect::<Vec<_>>();
    let count =
        |lane: usize| bodies.accelerations(Inputs::new(&one(x, lane), &one(u, lane))).1 as f64;
    (0..8).map(count).sum::<f64>() / 8.0
}

/// Times of step and reverse derivative.
fn time<F: Float>(bodies: &Bodies, states: &States<Lanes<f64, 8>>) -> [String; 2]
where
    Lanes<F, 8>: Real<Real = F>,
{
    let cast =
        |all: &[Lanes<f64, 8>]| all.iter().map(|x| Lanes(x.0.map(F::from_f64))).collect::<Vec<_>>();
    let states: States<Lanes<F, 8>> = states.iter().map(|(x, u)| (cast(x), cast(u))).collect();
    let mut next = states[0].0.clone();
    let bar = vec![Lanes::<F, 8>::one(); next.len()];
    let (mut x_bar, mut u_bar) = (bar.clone(), states[0].1.clone());
    let step = rounds(&states, |x, u| bodies.step(Inputs::new(x, u), black_box(&mut next)));
    let vjp = rounds(&states, |x, u| {
        x_bar.fill(Lanes::zero());
        u_bar.fill(Lanes::zero());
        bodies.vjp(Inputs::new(x, u), &bar, Cotangents::of(black_box(&mut x_bar), &mut u_bar));
    });
    [step, vjp]
}

fn rounds<T>(states: &States<T>, mut work: impl FnMut(&[T], &[T])) -> String {
    let mut round = || {
        let begin = Instant::now();
        states.iter().for_each(|(x, u)| work(x, u));
        begin.elapsed().as_secs_f64() * 1e6 / (8 * states.len()) as f64
    };
    round();
    let mut times: Vec<f64> = (0..400).map(|_| round()).collect();
    times.sort_by(f64::total_cmp);
    format!("{:.2} ({:.2})", times[0], times[times.len() / 2])
}
