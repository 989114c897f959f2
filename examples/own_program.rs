//! The whole program for a task of your own: a planar quadrotor flies to the origin and hovers.
//!
//! Run:
//! `cargo run --release --example own_program -- train quadrotor --field R --set system.mass=0.8`
//! Other commands: `compare`, `report`, `animate`, `accuracy`, `explain`, `check`, `scene`,
//! `schema`.

use physgrad::prelude::*;
use physgrad::program::ProgramTask;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use std::process::ExitCode;

/// State [x m, z m, tilt rad, and their rates]. Control: thrusts [left, right] beyond half the
/// weight, N. Semi-implicit Euler; moment of inertia mass arm² / 2. The fields are settings of a
/// scene.
#[derive(Clone, Debug, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
struct Quadrotor {
    /// Mass, kg. A `Number` may also be drawn for each sample, or trained.
    mass: Number,
    /// Distance of a rotor from the center, m.
    arm: f64,
    /// Time step, s.
    dt: f64,
}

impl Default for Quadrotor {
    fn default() -> Self {
        Self { mass: 0.8.into(), arm: 0.2, dt: 0.05 }
    }
}

const GRAVITY: f64 = 9.81;

#[rustfmt::skip]
impl System for Quadrotor {
    fn state_dim(&self) -> usize { 6 }
    fn control_dim(&self) -> usize { 2 }
    fn numbers(&self) -> Numbers<'_> { Numbers::new([("mass", &self.mass)]) }
    fn step<T: Scalar>(&self, Inputs { x, u, p, .. }: Inputs<'_, T>, next: &mut [T]) {
        let [mass] = self.numbers().last_of(p);
        let (sin, cos) = x[2].sin_cos();
        let thrust = (u[0] + u[1]) / mass + GRAVITY;
        next[3] = x[3] - thrust * sin * self.dt;
        next[4] = x[4] + (thrust * cos - GRAVITY) * self.dt;
        next[5] = x[5] + (u[1] - u[0]) * 2.0 / (mass * self.arm) * self.dt;
        for i in 0..3 { next[i] = x[i] + next[i + 3] * self.dt; }
    }
}

#[rustfmt::skip]
impl Task for Quadrotor {
    type System = Self;
    fn system(&self) -> &Self { self }
    fn horizon(&self) -> usize { 60 }
    fn start(&self, rng: &mut Rng, Start { x, .. }: Start<'_>) { x[..3].fill_with(|| rng.random_range(-0.5..0.5)); }
    fn observation_dim(&self) -> Option<usize> { Some(7) }
    fn observe<T: Scalar>(&self, Inputs { x, .. }: Inputs<'_, T>, y: &mut [T]) {
        (y[0], y[1], y[4], y[5], y[6]) = (x[0], x[1], x[3], x[4], x[5]);
        (y[2], y[3]) = x[2].sin_cos();
    }
    fn running_cost<T: Scalar>(&self, Inputs { u, .. }: Inputs<'_, T>, next: &[T]) -> T {
        let state: T = next.iter().map(|&x| x * x).sum();
        state * 0.05 + (u[0] * u[0] + u[1] * u[1]) * 1e-4
    }
}

#[rustfmt::skip]
impl ProgramTask for Quadrotor {
    const NAME: &'static str = "quadrotor";
    const ABOUT: &'static str = "fly a planar quadrotor to the origin and hover";
    const EPOCHS: usize = 100;
    fn dt(&self) -> f64 { self.dt }
    fn refined(&self, substeps: usize) -> Option<Self> { Some(Self { dt: self.dt / substeps as f64, ..*self }) }
    fn validate(&self) -> Result<(), (&'static str, &'static str)> {
        let positive = |name, value: f64| if value > 0.0 { Ok(()) } else { Err((name, "a positive number")) };
        self.mass.extremes().into_iter().try_for_each(|mass| positive("mass", mass))?;
        positive("arm", self.arm)?;
        positive("dt", self.dt)
    }
    fn state_names(&self) -> Vec<String> { ["x", "z", "tilt", "x_dot", "z_dot", "tilt_dot"].map(String::from).into() }
    fn control_names(&self) -> Vec<String> { ["left", "right"].map(String::from).into() }
}

fn main() -> ExitCode {
    physgrad::program().task::<Quadrotor>().main()
}
