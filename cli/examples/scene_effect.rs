//! Effects of your own, named in scenes: a brake for cart-pole, and a spring for a task of your
//! own.
//!
//! Run:
//! `cargo run --release --example scene_effect -- explain cart_pole --set effects.eddy_brake={}`

use physgrad::effect::{DynEffect, Named};
use physgrad::prelude::*;
use physgrad::tasks::CartPoleSystem;
use physgrad::{Effect, OdeInputs};
use physgrad_cli::{ProgramEffect, ProgramTask, SceneEffects};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use std::process::ExitCode;

/// Eddy-current brake on the cart (Wouterse 1991, IEE Proceedings B 138, 153).
#[derive(Clone, Debug, Serialize, Deserialize, JsonSchema)]
struct EddyBrake {
    /// Largest force, N.
    force: Number,
    /// Speed at which the force is largest, m/s.
    speed: f64,
}

impl Default for EddyBrake {
    fn default() -> Self {
        Self { force: 5.0.into(), speed: 1.0 }
    }
}

#[rustfmt::skip]
impl Effect<CartPoleSystem> for EddyBrake {
    fn numbers(&self) -> Numbers<'_> { Numbers::new([("force", &self.force)]) }
    fn add_forces<T: Scalar>(&self, _: &CartPoleSystem, OdeInputs { x, p, .. }: OdeInputs<'_, T>, forces: &mut [T]) {
        let [force] = self.numbers().of(p);
        let s = x[1] * (1.0 / self.speed);
        forces[0] -= s * force * 2.0 / (s * s + 1.0);
    }
}

impl ProgramEffect for EddyBrake {
    type Model = CartPoleSystem;
    const TASK: &'static str = "cart_pole";
    const NAME: &'static str = "eddy_brake";
    const EQUATION: &'static str = "F = -2 force s / (1 + s²), s = ẋ / speed";
    fn validate(&self) -> Result<(), (&'static str, &'static str)> {
        if self.speed > 0.0 { Ok(()) } else { Err(("speed", "a positive number")) }
    }
}

/// A mass that a force moves to the origin: x = [position m, velocity m/s], u = [force N].
#[derive(Clone, Debug, Serialize, Deserialize, JsonSchema)]
struct Puck {
    /// Mass, kg.
    mass: f64,
    #[serde(skip)]
    effects: Vec<Named<DynEffect<Puck>>>,
}

impl Default for Puck {
    fn default() -> Self {
        Self { mass: 1.0, effects: Vec::new() }
    }
}

const DT: f64 = 0.05;

#[rustfmt::skip]
impl System for Puck {
    fn state_dim(&self) -> usize { 2 }
    fn control_dim(&self) -> usize { 1 }
    fn step<T: Scalar>(&self, inputs: Inputs<'_, T>, next: &mut [T]) {
        let mut force = [inputs.u[0]];
        self.effects.add_forces(self, inputs.continuous(DT), &mut force);
        next[1] = inputs.x[1] + force[0] * (DT / self.mass);
        next[0] = inputs.x[0] + next[1] * DT;
    }
}

#[rustfmt::skip]
impl Task for Puck {
    type System = Self;
    fn system(&self) -> &Self { self }
    fn horizon(&self) -> usize { 40 }
    fn start(&self, rng: &mut Rng, Start { x, .. }: Start<'_>) { x[0] = rng.random_range(-1.0..1.0); }
    fn running_cost<T: Scalar>(&self, Inputs { u, .. }: Inputs<'_, T>, next: &[T]) -> T {
        (next[0] * next[0] + u[0] * u[0] * 0.01) * DT
    }
}

#[rustfmt::skip]
impl ProgramTask for Puck {
    const NAME: &'static str = "puck";
    fn dt(&self) -> f64 { DT }
    fn with_effects(&self, effects: &SceneEffects) -> Option<Self> { Some(Self { effects: effects.of(), ..self.clone() }) }
}

/// A spring that pulls the puck to the origin.
#[derive(Clone, Debug, Default, Serialize, Deserialize, JsonSchema)]
struct Spring {
    /// Stiffness, N/m.
    stiffness: f64,
}

#[rustfmt::skip]
impl Effect<Puck> for Spring {
    fn add_forces<T: Scalar>(&self, _: &Puck, OdeInputs { x, .. }: OdeInputs<'_, T>, forces: &mut [T]) {
        forces[0] -= x[0] * self.stiffness;
    }
}

impl ProgramEffect for Spring {
    type Model = Puck;
    const TASK: &'static str = "puck";
    const NAME: &'static str = "spring";
    const EQUATION: &'static str = "F = -stiffness x";
}

fn main() -> ExitCode {
    physgrad_cli::program().task::<Puck>().effect::<EddyBrake>().effect::<Spring>().main()
}
