//! Systems, effects and states that the tests of quantum control share.
#![allow(dead_code)]

use physgrad::rng::Rng;
use physgrad::tasks::{
    Barrier, ControlShape, Cubic, DoubleWell, Harmonic, QuantumEffect, QuantumSystem,
};
use physgrad::{Effect, Inputs, OdeInputs, Scalar, System, check};
use rand::RngExt;

pub fn box_of(grid: usize) -> QuantumSystem {
    QuantumSystem { grid, ..QuantumSystem::default() }
}

pub fn dipole(grid: usize) -> QuantumSystem {
    QuantumSystem { control: ControlShape::Dipole, ..box_of(grid) }
}

/// Returns one effect of each built-in type except tables. Centers off the middle break a symmetry
/// that could hide errors.
pub fn every_effect() -> Vec<QuantumEffect> {
    vec![
        Harmonic { center: 0.3, ..Harmonic::default() }.into(),
        Barrier { center: -0.2, ..Barrier::default() }.into(),
        DoubleWell::default().into(),
        Cubic::default().into(),
    ]
}

/// Returns the effects of [`every_effect`] as a tuple.
pub fn every_effect_typed() -> (Harmonic, Barrier, DoubleWell, Cubic) {
    (
        Harmonic { center: 0.3, ..Harmonic::default() },
        Barrier { center: -0.2, ..Barrier::default() },
        DoubleWell::default(),
        Cubic::default(),
    )
}

pub fn step<S: System>(system: &S, x: &[f64], u: f64) -> Vec<f64> {
    let mut next = vec![f64::NAN; x.len()];
    system.step(Inputs::new(x, &[u]), &mut next);
    next
}

/// Returns the state after `steps` steps without control.
pub fn run<S: System>(system: &S, mut x: Vec<f64>, steps: usize) -> Vec<f64> {
    for _ in 0..steps {
        x = step(system, &x, 0.0);
    }
    x
}

/// Returns the normalized state of a wave function of position.
pub fn wave(model: &QuantumSystem, psi: impl Fn(f64) -> (f64, f64)) -> Vec<f64> {
    let x: Vec<f64> = model.points().flat_map(|x| <[f64; 2]>::from(psi(x))).collect();
    let norm = norm(&x);
    x.into_iter().map(|x| x / norm).collect()
}

/// Returns a Gaussian wave packet with the wave number k. The standard deviation of the density is
/// `sigma`.
pub fn packet(model: &QuantumSystem, center: f64, sigma: f64, k: f64) -> Vec<f64> {
    wave(model, |x| {
        let size = (-((x - center) / (2.0 * sigma)).powi(2)).exp();
        (size * (k * x).cos(), size * (k * x).sin())
    })
}

pub fn norm(x: &[f64]) -> f64 {
    x.iter().map(|x| x * x).sum::<f64>().sqrt()
}

pub fn densities(x: &[f64]) -> Vec<f64> {
    x.chunks_exact(2).map(|psi| psi[0] * psi[0] + psi[1] * psi[1]).collect()
}

pub fn largest_difference(a: &[f64], b: &[f64]) -> f64 {
    assert!(a.len() == b.len() && a.iter().chain(b).all(|x| x.is_finite()));
    a.iter().zip(b).map(|(a, b)| (a - b).abs()).fold(0.0, f64::max)
}

/// Returns modulus and phase of `⟨a, b⟩`.
pub fn overlap(a: &[f64], b: &[f64]) -> (f64, f64) {
    let (mut re, mut im) = (0.0, 0.0);
    for (a, b) in a.chunks_exact(2).zip(b.chunks_exact(2)) {
        re += a[0] * b[0] + a[1] * b[1];
        im += a[0] * b[1] - a[1] * b[0];
    }
    (re.hypot(im), im.atan2(re))
}

/// Draws states of norm about 1, controls within ±30, and parameters within ±3.
pub fn lively(rng: &mut Rng, x: &mut [f64], u: &mut [f64], p: &mut [f64]) {
    let size = (3.0 / x.len() as f64).sqrt();
    x.iter_mut().for_each(|x| *x = rng.random_range(-size..size));
    u.iter_mut().for_each(|u| *u = rng.random_range(-30.0..30.0));
    p.iter_mut().for_each(|p| *p = rng.random_range(-3.0..3.0));
}

/// Custom effect: the potential `sin(t + p) Re ψ₀ x` at the position x, with ψ₀ at the first point.
///
/// Depends on time, on a parameter, and on more than the density of the wave.
#[derive(Clone, Debug)]
pub struct Swinging;

impl Effect<QuantumSystem> for Swinging {
    fn param_dim(&self) -> usize {
        1
    }
    fn draw_params(&self, rng: &mut Rng, p: &mut [f64]) {
        p[0] = rng.random_range(0.0..=1.0);
    }
    fn add_forces<T: Scalar>(
        &self,
        model: &QuantumSystem,
        OdeInputs { x, p, t, .. }: OdeInputs<'_, T>,
        forces: &mut [T],
    ) {
        let push = (t + p[0]).sin() * x[0];
        for (v, point) in forces.iter_mut().zip(model.points()) {
            *v += push * point;
        }
    }
}

/// Checks the derivatives of a system at the states and controls of [`lively`].
#[track_caller]
pub fn check_lively<S: System>(system: &S) {
    check::system_at(system, lively)
        .unwrap_or_else(|mismatch| panic!("{} state components: {mismatch}", system.state_dim()));
}
