//! A planar arm with two links reaches for a goal that differs between samples.
//!
//! Run: `cargo run --release --example arm -- [epochs] [picture.svg]`

use physgrad::prelude::*;
use physgrad::rng::Purpose;
use physgrad::{Clip, Rollout, Training, initial_states};
use physgrad_plot::{Posture, Stage, mechanics};

/// Two uniform links of equal mass and length, in the horizontal plane. State [θ₁ rad, θ₂ rad,
/// ω₁ rad/s, ω₂ rad/s], with θ₂ and ω₂ relative to the first link. Control: torques at [shoulder,
/// elbow], N m. Parameters: the goal [x, y], m.
#[derive(Clone)]
#[rustfmt::skip]
pub struct Arm { pub mass: f64, pub length: f64, pub damping: f64, pub dt: f64 }

const STEPS: usize = 60;

impl Arm {
    /// Position of the hand, m.
    fn hand<T: Scalar>(&self, x: &[T]) -> [T; 2] {
        let ((s1, c1), (s2, c2)) = (x[0].sin_cos(), (x[0] + x[1]).sin_cos());
        [(c1 + c2) * self.length, (s1 + s2) * self.length]
    }
}

#[rustfmt::skip]
impl System for Arm {
    fn state_dim(&self) -> usize { 4 }
    fn control_dim(&self) -> usize { 2 }
    fn param_dim(&self) -> usize { 2 }
    fn step<T: Scalar>(&self, Inputs { x, u, .. }: Inputs<'_, T>, next: &mut [T]) {
        // M α = τ, with M = m l² [[5/3 + c, 1/3 + c/2], [1/3 + c/2, 1/3]] and c = cos θ₂. α is the
        // angular acceleration. τ contains the controls, the damping, and the Coriolis and
        // centrifugal torques.
        let inertia = self.mass * self.length * self.length;
        let (sin, cos) = x[1].sin_cos();
        let (a, b, c) = (cos + 5.0 / 3.0, cos * 0.5 + 1.0 / 3.0, 1.0 / 3.0);
        let coriolis = sin * (0.5 * inertia);
        let first = u[0] - x[2] * self.damping + coriolis * (x[2] * 2.0 + x[3]) * x[3];
        let second = u[1] - x[3] * self.damping - coriolis * x[2] * x[2];
        let scale = (a * c - b * b).recip() * (self.dt / inertia);
        next[2] = x[2] + (first * c - second * b) * scale;
        next[3] = x[3] + (second * a - first * b) * scale;
        for i in 0..2 { next[i] = x[i] + next[i + 2] * self.dt; }
    }
}

#[rustfmt::skip]
impl Task for Arm {
    type System = Self;
    fn system(&self) -> &Self { self }
    fn horizon(&self) -> usize { STEPS }
    fn start(&self, rng: &mut Rng, Start { x, p }: Start<'_>) {
        (x[0], x[1]) = (rng.random_range(-0.5..0.5), rng.random_range(0.5..1.5));
        let (bearing, distance) = (rng.random_range(-2.0..2.0f64), rng.random_range(0.4..0.9));
        (p[0], p[1]) = (distance * bearing.cos(), distance * bearing.sin());
    }
    fn observation_dim(&self) -> Option<usize> { Some(8) }
    fn observe<T: Scalar>(&self, Inputs { x, p, .. }: Inputs<'_, T>, y: &mut [T]) {
        ((y[0], y[1]), (y[2], y[3])) = (x[0].sin_cos(), x[1].sin_cos());
        let hand = self.hand(x);
        (y[4], y[5], y[6], y[7]) = (x[2], x[3], p[0] - hand[0], p[1] - hand[1]);
    }
    fn running_cost<T: Scalar>(&self, Inputs { u, p, .. }: Inputs<'_, T>, next: &[T]) -> T {
        let hand = self.hand(next);
        let (dx, dy) = (hand[0] - p[0], hand[1] - p[1]);
        (dx * dx + dy * dy) * (1.0 / STEPS as f64) + (u[0] * u[0] + u[1] * u[1]) * 1e-4
    }
}

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let mut args = std::env::args().skip(1);
    let epochs = args.next().map_or(Ok(400), |text| text.parse())?;
    let (task, policy) =
        (Arm { mass: 1.0, length: 0.5, damping: 0.2, dt: 0.05 }, Mlp::new([8, 32, 32, 2]));
    check::system(&task).unwrap();
    check::task(&task, &policy).unwrap();
    let training = Training { epochs, clip: Clip::Norm(1.0), ..Training::default() };
    let report = Trainer::new(task.clone(), policy.clone())
        .field(Field::regular())
        .training(training)
        .run()?;

    const SAMPLES: usize = 64;
    let starts = initial_states(&task, 0, Purpose::Test, SAMPLES);
    let mut rollout = Rollout::new(&task, &policy, SAMPLES);
    rollout.start(&starts);
    rollout.run(&task, &policy, &report.weights)?;
    let state =
        |sample: usize, t: usize| [0, 1, 2, 3].map(|i| f64::from(rollout.state(t, sample, i)));
    let goal = |sample: usize| [4, 5].map(|i| f64::from(starts[6 * sample + i]));
    let miss = |sample: usize| {
        let (hand, goal) = (task.hand(&state(sample, STEPS)), goal(sample));
        (hand[0] - goal[0]).hypot(hand[1] - goal[1])
    };
    let mut misses: Vec<f64> = (0..SAMPLES).map(miss).collect();
    misses.sort_by(f64::total_cmp);
    println!(
        "distance from the goal after 3 s: median {:.3} m, largest {:.3} m",
        misses[SAMPLES / 2],
        misses[SAMPLES - 1]
    );
    if let Some(path) = args.next() {
        let posture = |t: usize| {
            let x = state(0, t);
            let elbow = [task.length * x[0].cos(), task.length * x[0].sin()];
            Posture { chain: vec![[0.0; 2], elbow, task.hand(&x)], boxes: Vec::new() }
        };
        let stage = Stage {
            title: "Arm that reaches for a goal".into(),
            size: 0.15,
            floor: None,
            mark: Some(goal(0)),
        };
        let postures: Vec<Posture> = (0..=STEPS).map(posture).collect();
        std::fs::write(path, mechanics(&stage, &postures, task.dt).to_svg())?;
    }
    Ok(())
}
