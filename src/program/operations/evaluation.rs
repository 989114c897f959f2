//! Losses of a policy on new initial states.

use crate::any::AnyTask;
use crate::policy::AnyPolicy;
use crate::program::operations::Visit;
use crate::program::settings::Precision;
use crate::rng::Purpose;
use crate::{Float, Policy, Rollout, Task, Weights, initial_states};

/// Visitor that evaluates a policy.
pub struct Evaluating<'a> {
    pub precision: Precision,
    /// Parameters of the policy.
    pub theta: &'a [f64],
    pub seed: u64,
    pub samples: usize,
}

impl Visit for Evaluating<'_> {
    /// Loss of each sample; infinite if its rollout diverges.
    type Out = Vec<f64>;

    fn visit<T: Task + Clone + 'static, P: Policy + Clone + 'static>(self, task: T, policy: P) -> Vec<f64> {
        match self.precision {
            Precision::F32 => losses::<f32>(&task, &policy, &self),
            Precision::F64 => losses::<f64>(&task, &policy, &self),
        }
    }
}

fn losses<F: Float>(task: &dyn AnyTask<F>, policy: &dyn AnyPolicy<F>, of: &Evaluating) -> Vec<f64> {
    /// Samples in a rollout.
    const BLOCK: usize = 32;
    let weights = Weights::new(policy, of.theta.iter().map(|&theta| F::from_f64(theta)).collect());
    let starts: Vec<F> = initial_states(task, of.seed, Purpose::Test, of.samples);
    let mut rollout = Rollout::for_evaluation(task, policy, BLOCK.min(of.samples));
    let mut run = |starts: &[F]| {
        rollout.start(starts);
        let outcome = rollout.run(task, policy, &weights);
        outcome.map(|()| (0..rollout.samples()).map(|sample| rollout.cost(sample).as_()).collect::<Vec<f64>>())
    };
    let each = |start: &[F], run: &mut dyn FnMut(&[F]) -> Option<Vec<f64>>| run(start).map_or(f64::INFINITY, |cost| cost[0]);
    let mut losses = Vec::with_capacity(of.samples);
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

/// Quantile of sorted numbers, linear between neighbours (Hyndman and Fan 1996, type 7,
/// doi:10.1080/00031305.1996.10473566).
pub fn quantile(sorted: &[f64], share: f64) -> f64 {
    let at = share * (sorted.len() - 1) as f64;
    let (low, rest) = (sorted[at.floor() as usize], at.fract());
    // Avoids 0 · ∞ for diverged rollouts.
    if rest == 0.0 { low } else { low + rest * (sorted[at.ceil() as usize] - low) }
}
