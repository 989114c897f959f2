//! Stress case: all fields vanish at the optimum of the linear-quadratic regulator.

use super::{Case, Finding};
use physgrad::Field;
use physgrad::Flow;
use physgrad::Gradient;
use physgrad::System;
use physgrad::Task;
use physgrad::engine::Batch;
use physgrad::initial_states;
use physgrad::policy::{Linear, Weights};
use physgrad::rng::Purpose;
use physgrad::tasks::Lqr;

pub(super) const CASES: &[Case] = &[Case {
    name: "lqr_optimum",
    about: "R, M and C at the Riccati gain of a stable and of an unstable plant, over 1, 10, 50 and 100 steps",
    criterion: "at the optimum, no component of the three exceeds 1e-11. With a relative gain error of 1e-6, R and M \
                exceed 1e-11",
    explanation: "An optimizer leaves an optimum at which its field is not 0. R vanishes at any optimum, and C where R \
                does. M need not vanish there. For the regulator it does, because the cotangent of every control is 0. \
                The doubling algorithm solves the Riccati equation. Fixed-point iteration leaves rounding errors in its \
                solution, which M amplifies above the limit. Limits: for other losses M has no such fixed point, \
                which motivates C",
    run: lqr_optimum,
}];

const SAMPLES: u64 = 8;

fn lqr_optimum() -> Vec<Finding> {
    let mut findings = Vec::new();
    for (name, mut lqr) in [("stable", Lqr::spring()), ("unstable", Lqr::upright_cart_pole())] {
        let best = lqr.optimum().gain.clone();
        for horizon in [1, 10, 50, 100] {
            lqr.horizon = horizon;
            for (field, largest) in ["M", "R", "C"].into_iter().zip(largest(&lqr, &best)) {
                findings.push(Finding::at_most(
                    format!("{name} plant, T = {horizon}: {field}"),
                    largest,
                    1e-11,
                ));
            }
        }
        let wrong = largest(&lqr, &best.iter().map(|gain| gain * (1.0 + 1e-6)).collect::<Vec<_>>());
        for (field, largest) in ["M", "R"].into_iter().zip(wrong) {
            findings.push(Finding::at_least(
                format!("{name} plant, gain error of 1e-6: {field}"),
                largest,
                1e-11,
            ));
        }
    }
    findings
}

/// Largest absolute components of M, R and C for a gain; NaN if a rollout diverges.
fn largest(lqr: &Lqr, gain: &[f64]) -> [f64; 3] {
    let n = lqr.system().state_dim();
    let policy = Linear::new(n, lqr.system().control_dim());
    let starts: Vec<f64> = initial_states(lqr, 0, Purpose::Train, SAMPLES as usize);
    let weights = Weights::<f64>::new(&policy, gain.to_vec());
    let mut batch = Batch::new(lqr, &policy, SAMPLES as usize, &[Flow::MODIFIED, Flow::REGULAR], 1);
    let ran = batch.run(lqr, &policy, &weights, &starts);
    let mut combined = Gradient::zeros(gain.len());
    Field::combined().combine(batch.gradients(), &mut combined);
    let size = |field: &[f64]| field.iter().fold(0.0, |largest: f64, g| largest.max(g.abs()));
    let all = [
        size(batch.gradients()[0].values()),
        size(batch.gradients()[1].values()),
        size(combined.values()),
    ];
    if ran.is_ok() { all } else { [f64::NAN; 3] }
}
