//! Stress case: norms of waves and adjoints over very many steps.

use super::step;
use super::steps::larger;
use super::{Case, Finding};
use physgrad::Substeps;
use physgrad::System;
use physgrad::Task;
use physgrad::rng::{Purpose, stream};
use physgrad::scalar::Single;
use physgrad::tasks::{Quantum, QuantumSystem, Renormalized};
use physgrad::{Cotangents, Inputs, Start};
use physgrad::{Float, Real};
use rand::RngExt;
use rand_distr::{Distribution, StandardNormal};

pub(super) const CASES: &[Case] = &[Case {
    name: "quantum_long",
    about: "a wave over 1e5 steps, its adjoint over 1e4, and 1e4 steps forward and backward in time; 32 points, \
                random controls within 30",
    criterion: "in f64, the norm drifts by at most 1e-10, with and without control. In f32, it drifts by at most \
                1e-2 under random controls, and by 1e-6 if renormalized in each step or in each 16th. The f32 drift \
                without control, where each step rounds alike, is reported without a bound. The norm of the adjoint \
                drifts by at most 1e-10. Integration forward and backward in time ends within 1e-9 of the initial \
                state. A wave with losses fails (a planted fault)",
    explanation: "The Crank-Nicolson step and its adjoint are unitary except for rounding, so neither explodes. In f64 \
                the norm drifts within its bound. In f32, each step of a wave without control rounds alike. The norm \
                can then drift beyond the declared bound of 1e-2. `Renormalized` restores the norm and differentiates \
                the restoration. A correction of the plain step would change the bits of the paper's runs",
    run: quantum_long,
}];

fn quantum_long() -> Vec<Finding> {
    let model = QuantumSystem::default();
    let each = Renormalized { system: model };
    let sometimes = Renormalized { system: Substeps { system: model, count: 16 } };
    let [forward, backward] = [model.dt, -model.dt].map(|dt| QuantumSystem { dt, ..model });
    let lossy = Scaled { system: model, factor: 1.0 - 1e-14 };
    vec![
        Finding::at_most(
            "drift of the norm in 1e5 steps, f64, control 0",
            drift::<_, f64>(&model, 100_000, 0.0),
            1e-10,
        ),
        Finding::at_most(
            "drift of the norm in 1e5 steps, f64",
            drift::<_, f64>(&model, 100_000, 30.0),
            1e-10,
        ),
        Finding::info(
            "drift of the norm in 1e5 steps, f32, control 0 (declared bound: 1e-2)",
            unbounded(drift::<_, Single<f32>>(&model, 100_000, 0.0)),
        ),
        Finding::at_most(
            "drift of the norm in 1e5 steps, f32, control 0, renormalized in each step",
            drift::<_, Single<f32>>(&each, 100_000, 0.0),
            1e-6,
        ),
        Finding::at_most(
            "drift of the norm in 1e5 steps, f32",
            drift::<_, Single<f32>>(&model, 100_000, 30.0),
            1e-2,
        ),
        Finding::at_most(
            "drift of the norm in 1e5 steps, f32, renormalized in each step",
            drift::<_, Single<f32>>(&each, 100_000, 30.0),
            1e-6,
        ),
        Finding::at_most(
            "drift of the norm in 1e5 steps, f32, renormalized in each 16th step",
            drift::<_, Single<f32>>(&sometimes, 100_000 / 16, 30.0),
            1e-6,
        ),
        Finding::at_most(
            "drift of the adjoint's norm in 1e4 steps, f64",
            adjoint_drift(&model, 10_000),
            1e-10,
        ),
        Finding::at_most(
            "1e4 steps forward and backward in time, f64",
            return_error(&forward, &backward, 10_000),
            1e-9,
        ),
        Finding::at_least(
            "drift with a loss of 1e-14 in each step, f64",
            drift::<_, f64>(&lossy, 100_000, 30.0),
            1e-10,
        ),
    ]
}

/// Planted fault: a system that scales its state in every step.
struct Scaled<S> {
    system: S,
    factor: f64,
}

impl<S: System> System for Scaled<S> {
    fn state_dim(&self) -> usize {
        self.system.state_dim()
    }

    fn control_dim(&self) -> usize {
        self.system.control_dim()
    }

    fn step<T: physgrad::Scalar>(&self, inputs: Inputs<'_, T>, next: &mut [T]) {
        self.system.step(inputs, next);
        for next in next {
            *next *= self.factor;
        }
    }
}

/// Formats a drift that has no bound. Rounding determines whether the drift exceeds 1e-2.
fn unbounded(drift: f64) -> String {
    format!("{drift:.1e}{}", if drift > 1e-2 { ", above the declared bound" } else { "" })
}

fn norm<R: Real>(x: &[R]) -> f64 {
    x.iter().map(|x| x.lane(0).to_f64() * x.lane(0).to_f64()).sum::<f64>().sqrt()
}

fn start<R: Real>() -> Vec<R> {
    let mut x = vec![0.0; 64];
    Quantum::new(3).start(&mut stream(0, Purpose::Test, 0), Start { x: &mut x, p: &mut [] });
    x.into_iter().map(R::from).collect()
}

/// Random controls in `[-size, size)`.
fn controls(count: usize, size: f64) -> Vec<f64> {
    let mut rng = stream(1, Purpose::Test, 0);
    (0..count).map(|_| size * rng.random_range(-1.0..1.0)).collect()
}

/// Largest deviation of the norm from 1 along a rollout in the precision of `R`. Evaluates the norm
/// in double precision.
fn drift<S: System, R: Real>(system: &S, steps: usize, size: f64) -> f64 {
    let mut x = start::<R>();
    let mut next = x.clone();
    let mut worst = 0.0f64;
    for u in controls(steps, size) {
        step(system, Inputs::new(&x, &[R::from(u)]), &mut next);
        x.copy_from_slice(&next);
        worst = larger(worst, (norm(&x) - 1.0).abs());
    }
    worst
}

/// Largest relative change of the norm of a random cotangent in a reverse pass.
fn adjoint_drift<S: System>(system: &S, steps: usize) -> f64 {
    let mut rng = stream(2, Purpose::Test, 0);
    let mut bar: Vec<f64> = (0..64).map(|_| StandardNormal.sample(&mut rng)).collect();
    let (x, mut x_bar, first) = (start::<f64>(), vec![0.0; 64], norm(&bar));
    let mut worst = 0.0f64;
    for u in controls(steps, 30.0) {
        // The step is linear in the state, so its Jacobian does not depend on the state.
        x_bar.fill(0.0);
        system.vjp(
            Inputs::new(&x, &[u]),
            &bar,
            Cotangents { x: Some(&mut x_bar), ..Cotangents::default() },
        );
        bar.copy_from_slice(&x_bar);
        worst = larger(worst, (norm(&bar) / first - 1.0).abs());
    }
    worst
}

/// Distance from the initial state after integrating forward and then backward in time.
fn return_error<S: System>(forward: &S, backward: &S, steps: usize) -> f64 {
    let first = start::<f64>();
    let (mut x, mut next) = (first.clone(), first.clone());
    let controls = controls(steps, 30.0);
    let both =
        controls.iter().map(|u| (forward, u)).chain(controls.iter().rev().map(|u| (backward, u)));
    for (system, &u) in both {
        step(system, Inputs::new(&x, &[u]), &mut next);
        x.copy_from_slice(&next);
    }
    let off: Vec<f64> = x.iter().zip(&first).map(|(x, first)| x - first).collect();
    norm(&off)
}
