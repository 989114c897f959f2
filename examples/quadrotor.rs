//! A planar quadrotor flies a figure eight that is a function of the step number.
//!
//! Run: `cargo run --release --example quadrotor -- [epochs] [picture.svg]`

use physgrad::prelude::*;
use physgrad::rng::Purpose;
use physgrad::{Clip, Rollout, Training, initial_states};
use physgrad_plot::{Animation, Shape};
use std::f64::consts::TAU;

/// State [x m, z m, tilt rad, and their rates]. Control: thrusts [left, right] beyond half the
/// weight, N. Semi-implicit Euler; moment of inertia mass arm² / 2.
#[derive(Clone)]
#[rustfmt::skip]
pub struct Quadrotor { pub mass: f64, pub arm: f64, pub dt: f64 }

const STEPS: usize = 80;
const GRAVITY: f64 = 9.81;

impl Quadrotor {
    /// Position, m, and velocity, m/s, to reach at the end of step `t`.
    fn reference(&self, t: usize) -> [f64; 4] {
        let (rate, angle) = (TAU / (STEPS as f64 * self.dt), TAU * (t + 1) as f64 / STEPS as f64);
        [angle.sin(), 0.5 * (2.0 * angle).sin(), rate * angle.cos(), rate * (2.0 * angle).cos()]
    }
}

#[rustfmt::skip]
impl System for Quadrotor {
    fn state_dim(&self) -> usize { 6 }
    fn control_dim(&self) -> usize { 2 }
    fn step<T: Scalar>(&self, Inputs { x, u, .. }: Inputs<'_, T>, next: &mut [T]) {
        let (sin, cos) = x[2].sin_cos();
        let thrust = (u[0] + u[1]) / self.mass + GRAVITY;
        next[3] = x[3] - thrust * sin * self.dt;
        next[4] = x[4] + (thrust * cos - GRAVITY) * self.dt;
        next[5] = x[5] + (u[1] - u[0]) * (2.0 / (self.mass * self.arm)) * self.dt;
        for i in 0..3 { next[i] = x[i] + next[i + 3] * self.dt; }
    }
}

#[rustfmt::skip]
impl Task for Quadrotor {
    type System = Self;
    fn system(&self) -> &Self { self }
    fn horizon(&self) -> usize { STEPS }
    fn start(&self, rng: &mut Rng, Start { x, .. }: Start<'_>) { x.fill_with(|| rng.random_range(-0.2..0.2)); }
    fn observation_dim(&self) -> Option<usize> { Some(7) }
    fn observe<T: Scalar>(&self, Inputs { x, t, .. }: Inputs<'_, T>, y: &mut [T]) {
        let [px, pz, vx, vz] = self.reference(t);
        (y[0], y[1], y[2], y[3]) = (x[0] - px, x[1] - pz, x[3] - vx, x[4] - vz);
        ((y[4], y[5]), y[6]) = (x[2].sin_cos(), x[5]);
    }
    fn running_cost<T: Scalar>(&self, Inputs { u, t, .. }: Inputs<'_, T>, next: &[T]) -> T {
        let [px, pz, ..] = self.reference(t);
        let (dx, dz) = (next[0] - px, next[1] - pz);
        (dx * dx + dz * dz) * (1.0 / STEPS as f64) + (u[0] * u[0] + u[1] * u[1]) * 1e-6
    }
}

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let mut args = std::env::args().skip(1);
    let epochs = args.next().map_or(Ok(300), |text| text.parse())?;
    let (task, policy) = (Quadrotor { mass: 0.8, arm: 0.2, dt: 0.05 }, Mlp::new([7, 32, 32, 2]));
    check::system(&task).unwrap();
    check::task(&task, &policy).unwrap();
    let training = Training { epochs, clip: Clip::Norm(1.0), ..Training::default() };
    let report = Trainer::new(task.clone(), policy.clone())
        .field(Field::regular())
        .training(training)
        .run()?;

    const FLIGHTS: usize = 16;
    let mut rollout = Rollout::new(&task, &policy, FLIGHTS);
    rollout.start(&initial_states(&task, 0, Purpose::Test, FLIGHTS));
    rollout.run(&task, &policy, &report.weights)?;
    let at = |sample: usize, t: usize| [0, 1].map(|i| f64::from(rollout.state(t, sample, i)));
    let mut squares = 0.0;
    for sample in 0..FLIGHTS {
        for t in STEPS / 2..STEPS {
            let ([x, z], [px, pz, ..]) = (at(sample, t + 1), task.reference(t));
            squares += (x - px).powi(2) + (z - pz).powi(2);
        }
    }
    let distance = (squares / (FLIGHTS * STEPS / 2) as f64).sqrt();
    println!(
        "root mean square distance from the reference position in the second half: {distance:.3} m"
    );
    if let Some(path) = args.next() {
        let body = |t: usize| {
            let ([x, z], tilt) = (at(0, t), f64::from(rollout.state(t, 0, 2)));
            let end =
                |side: f64| [x + side * task.arm * tilt.cos(), z + side * task.arm * tilt.sin()];
            vec![Shape::Line { from: end(-1.0), to: end(1.0), width: 0.06, color: "#0072B2" }]
        };
        let curve = |points: Vec<[f64; 2]>, color| Shape::Curve { points, width: 0.02, color };
        let reference = (0..STEPS).map(|t| [task.reference(t)[0], task.reference(t)[1]]).collect();
        let picture = Animation {
            title: "Quadrotor on a figure eight (grey), with its path (orange)".into(),
            seconds: STEPS as f64 * task.dt,
            view: ([-1.4, -0.9], [1.4, 0.9]),
            still: vec![
                curve(reference, "#9AA0A8"),
                curve((0..=STEPS).map(|t| at(0, t)).collect(), "#E69F00"),
            ],
            frames: (0..=STEPS).map(body).collect(),
            ..Animation::default()
        };
        std::fs::write(path, picture.to_svg())?;
    }
    Ok(())
}
