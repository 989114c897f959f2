//! Losses of a policy on new initial states.

use crate::any::AnyTask;
use crate::policy::AnyPolicy;
use crate::program::settings::Precision;
use crate::rng::Purpose;
use crate::{DynTask, Float, Policy, Rollout, Weights, initial_states};

/// Losses of the policy with the parameters `theta` from new initial states; infinite for rollouts
/// that diverge.
pub fn losses(task: &DynTask, policy: &impl Policy, precision: Precision, theta: &[f64], seed: u64, samples: usize) -> Vec<f64> {
    match precision {
        Precision::F32 => evaluate::<f32>(task, policy, theta, seed, samples),
        Precision::F64 => evaluate::<f64>(task, policy, theta, seed, samples),
    }
}

fn evaluate<F: Float>(task: &dyn AnyTask<F>, policy: &dyn AnyPolicy<F>, theta: &[f64], seed: u64, samples: usize) -> Vec<f64> {
    /// Largest number of samples in a rollout.
    const BLOCK: usize = 32;
    let weights = Weights::new(policy, theta.iter().map(|&theta| F::from_f64(theta)).collect());
    let starts: Vec<F> = initial_states(task, seed, Purpose::Test, samples);
    let mut rollout = Rollout::for_evaluation(task, policy, BLOCK.min(samples));
    let mut run = |starts: &[F]| {
        rollout.start(starts);
        let outcome = rollout.run(task, policy, &weights);
        outcome.map(|()| (0..rollout.samples()).map(|sample| rollout.cost(sample).as_()).collect::<Vec<f64>>())
    };
    let each = |start: &[F], run: &mut dyn FnMut(&[F]) -> Option<Vec<f64>>| run(start).map_or(f64::INFINITY, |cost| cost[0]);
    let mut losses = Vec::with_capacity(samples);
    for starts in starts.chunks(BLOCK * task.start_dim()) {
        match run(starts) {
            Ok(costs) => losses.extend(costs),
            // A divergence ends the whole rollout: repeat it sample by sample.
            Err(_) => {
                losses.extend(starts.chunks(task.start_dim()).map(|start| each(start, &mut |start| run(start).ok())));
            }
        }
    }
    losses
}
