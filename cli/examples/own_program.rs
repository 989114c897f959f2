//! The whole program for a task of your own: a ball on a beam. `docs/own_system.md` explains it.
//!
//! Run: `cargo run --release --example own_program -- train ball_beam`

use physgrad::prelude::*;
use physgrad_cli::ProgramTask;
use physgrad_plot::{Animation, Posture, Stage, mechanics};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use std::process::ExitCode;

/// A ball rolls on a beam that a torque turns (Hauser, Sastry and Kokotović 1992,
/// doi:10.1109/9.119645):
///
/// ```text
/// 7/5 m r̈ = m r α̇² - m g sin α - c ṙ
/// (J + m r²) α̈ = τ - 2 m r ṙ α̇ - m g r cos α
/// ```
///
/// State [r m, ṙ m/s, α rad, α̇ rad/s], control [τ N m]. Semi-implicit Euler.
#[derive(Clone, Debug, Serialize, Deserialize, JsonSchema)]
#[serde(default)]
struct BallBeam {
    /// Mass of the ball m, kg.
    ball: Number,
    /// Friction of the ball c, N s/m.
    friction: Number,
    /// Moment of inertia of the beam J, kg m².
    beam: f64,
    /// Time step, s.
    dt: f64,
}

impl Default for BallBeam {
    fn default() -> Self {
        Self { ball: 0.1.into(), friction: 0.02.into(), beam: 0.02, dt: 0.02 }
    }
}

const GRAVITY: f64 = 9.81;

#[rustfmt::skip]
impl System for BallBeam {
    fn state_dim(&self) -> usize { 4 }
    fn control_dim(&self) -> usize { 1 }
    fn numbers(&self) -> Numbers<'_> { Numbers::new([("ball", &self.ball), ("friction", &self.friction)]) }
    fn step<T: Scalar>(&self, Inputs { x, u, p, .. }: Inputs<'_, T>, next: &mut [T]) {
        let [mass, friction] = self.numbers().last_of(p);
        let (r, speed, angle, rate) = (x[0], x[1], x[2], x[3]);
        let (sin, cos) = angle.sin_cos();
        let force = mass * (r * rate * rate - sin * GRAVITY) - friction * speed;
        let torque = u[0] - mass * r * (speed * rate * 2.0 + cos * GRAVITY);
        next[1] = speed + force / (mass * 1.4) * self.dt;
        next[3] = rate + torque / (mass * r * r + self.beam) * self.dt;
        next[0] = r + next[1] * self.dt;
        next[2] = angle + next[3] * self.dt;
    }
}

/// The ball rolls to the middle of the beam and rests there.
#[rustfmt::skip]
impl Task for BallBeam {
    type System = Self;
    fn system(&self) -> &Self { self }
    fn horizon(&self) -> usize { 150 }
    fn start(&self, rng: &mut Rng, Start { x, .. }: Start<'_>) {
        x[0] = rng.random_range(-0.4..0.4);
        x[2] = rng.random_range(-0.2..0.2);
    }
    fn running_cost<T: Scalar>(&self, Inputs { u, .. }: Inputs<'_, T>, next: &[T]) -> T {
        (next[0] * next[0] * 10.0 + next[1] * next[1] + next[2] * next[2] + u[0] * u[0]) * self.dt
    }
}

#[rustfmt::skip]
impl ProgramTask for BallBeam {
    const NAME: &'static str = "ball_beam";
    const ABOUT: &'static str = "roll a ball to the middle of a beam";
    const EPOCHS: usize = 100;
    fn dt(&self) -> f64 { self.dt }
    fn refined(&self, substeps: usize) -> Option<Self> { Some(Self { dt: self.dt / substeps as f64, ..*self }) }
    fn validate(&self) -> Result<(), (&'static str, &'static str)> {
        let positive = |name, value: f64| if value > 0.0 { Ok(()) } else { Err((name, "a positive number")) };
        self.ball.extremes().into_iter().try_for_each(|mass| positive("ball", mass))?;
        positive("beam", self.beam)?;
        positive("dt", self.dt)
    }
    fn state_names(&self) -> Vec<String> { ["r", "r_dot", "alpha", "alpha_dot"].map(String::from).into() }
    fn control_names(&self) -> Vec<String> { vec!["torque".into()] }
    fn animation(&self, states: &[Vec<f64>], _controls: &[Vec<f64>], _params: &[f64]) -> Animation {
        let posture = |x: &Vec<f64>| {
            let (sin, cos) = x[2].sin_cos();
            let point = |r: f64, height: f64| [r * cos - height * sin, r * sin + height * cos];
            Posture { chain: vec![point(-0.6, 0.0), point(0.6, 0.0)], boxes: vec![point(x[0], 0.04)] }
        };
        let stage = Stage { title: Self::ABOUT.into(), size: 0.06, floor: None, mark: Some([0.0, 0.0]) };
        mechanics(&stage, &states.iter().map(posture).collect::<Vec<_>>(), self.dt)
    }
}

fn main() -> ExitCode {
    physgrad_cli::program().task::<BallBeam>().main()
}
