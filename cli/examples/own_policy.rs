//! A policy of your own for every task of the program: controls as a Fourier series over the
//! rollout. `docs/own_system.md` explains it.
//!
//! Run: `cargo run --release --example own_policy -- train pendulum --set policy.kind=fourier`

use physgrad::policy::{Action, Observed, Policy};
use physgrad::prelude::*;
use physgrad_cli::{Controlled, ProgramPolicy};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use std::f64::consts::TAU;
use std::process::ExitCode;

/// Settings of the section `policy`.
#[derive(Clone, Debug, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
struct FourierSettings {
    /// Number of frequencies besides 0.
    frequencies: usize,
}

impl Default for FourierSettings {
    fn default() -> Self {
        Self { frequencies: 4 }
    }
}

/// `u_i(t) = a_i0 + Σ_k (a_ik cos(2π k t / T) + b_ik sin(2π k t / T))`, with the trained numbers a
/// and b.
struct Fourier {
    observations: usize,
    controls: usize,
    frequencies: usize,
    horizon: usize,
}

#[rustfmt::skip]
impl Policy for Fourier {
    fn observation_dim(&self) -> usize { self.observations }
    fn control_dim(&self) -> usize { self.controls }
    fn param_count(&self) -> usize { self.controls * (1 + 2 * self.frequencies) }
    fn init(&self, rng: &mut Rng, theta: &mut [f64]) { theta.fill_with(|| rng.random_range(-0.1..0.1)); }
    fn act<T: Scalar>(&self, theta: &[T], Observed { t, .. }: Observed<'_, T>, Action { u, .. }: Action<'_, T>) {
        for (u, theta) in u.iter_mut().zip(theta.chunks(1 + 2 * self.frequencies)) {
            *u = theta[0];
            for k in 1..=self.frequencies {
                let (sin, cos) = (TAU * (k * t) as f64 / self.horizon as f64).sin_cos();
                *u += theta[2 * k - 1] * cos + theta[2 * k] * sin;
            }
        }
    }
}

impl ProgramPolicy for FourierSettings {
    type Policy = Fourier;
    const NAME: &'static str = "fourier";
    const ABOUT: &'static str = "Controls as a Fourier series over the rollout.";

    fn validate(&self) -> Result<(), (&'static str, &'static str)> {
        if self.frequencies <= 1000 { Ok(()) } else { Err(("frequencies", "0 to 1000")) }
    }

    fn policy(&self, scene: &Controlled) -> Result<Fourier, String> {
        let (observations, controls) = (scene.observations.len(), scene.controls.len());
        let (frequencies, horizon) = (self.frequencies, scene.horizon);
        Ok(Fourier { observations, controls, frequencies, horizon })
    }
}

fn main() -> ExitCode {
    physgrad_cli::program().policy::<FourierSettings>().main()
}
