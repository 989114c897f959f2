//! Shared parts of the benchmarks: alternating jobs, medians, and a policy with zero control.

use physgrad::policy::{Action, Observed, Policy, PolicyPass};
use physgrad::rng::Rng;
use physgrad::{Float, Scalar};
use std::time::Instant;

/// Runs every job once per round, in turn, after one round of warm-up. Returns microseconds,
/// indexed by job and round.
pub fn rounds(rounds: usize, jobs: &mut [&mut dyn FnMut()]) -> Vec<Vec<f64>> {
    let mut times = vec![Vec::new(); jobs.len()];
    for round in 0..=rounds {
        for (job, times) in jobs.iter_mut().zip(&mut times) {
            let begin = Instant::now();
            job();
            // Discards the first round as warm-up.
            if round > 0 {
                times.push(begin.elapsed().as_secs_f64() * 1e6);
            }
        }
    }
    times
}

pub fn median(values: &[f64]) -> f64 {
    let mut sorted = values.to_vec();
    sorted.sort_by(f64::total_cmp);
    sorted[sorted.len() / 2]
}

/// Median of the ratios per round, which cancels drifts of the machine's speed.
pub fn ratio(a: &[f64], b: &[f64]) -> f64 {
    median(&a.iter().zip(b).map(|(a, b)| a / b).collect::<Vec<_>>())
}

/// Policy with zero control and without arithmetic. It takes almost no time.
#[allow(dead_code, reason = "not all benchmarks use it")]
pub struct Nothing {
    pub state_dim: usize,
    pub control_dim: usize,
}

impl Policy for Nothing {
    fn observation_dim(&self) -> usize {
        self.state_dim
    }
    fn control_dim(&self) -> usize {
        self.control_dim
    }
    fn param_count(&self) -> usize {
        1
    }
    fn init(&self, _: &mut Rng, theta: &mut [f64]) {
        theta.fill(0.0);
    }
    fn act<T: Scalar>(&self, _: &[T], _: Observed<'_, T>, Action { u, .. }: Action<'_, T>) {
        u.fill(T::zero());
    }
    fn forward<F: Float>(&self, _: PolicyPass<F>, _: &mut [F], _: &mut [F]) {}
    fn backward<F: Float>(
        &self,
        _: PolicyPass<F>,
        _: &[F],
        _: &[F],
        _: &mut [F],
        _: Option<&mut [F]>,
    ) {
    }
}
