//! Rollouts of a policy from new initial states.

use crate::operations::trajectory::{self, Trajectory};
use crate::settings::Precision;
use anyhow::{Result, bail};
use physgrad::engine::any::AnyTask;
use physgrad::policy::AnyPolicy;
use physgrad::rng::{Purpose, stream};
use physgrad::{DynTask, Float, Policy, Rollout, Weights, initial_states};

/// A policy with its parameters, and a seed of initial states.
pub trait AnyEvaluation {
    /// Results from the initial states `0 .. samples`.
    fn results(&self, samples: usize) -> Vec<Evaluated>;
    /// Rollout from the initial state `sample`.
    fn rollout(&self, sample: usize) -> Trajectory;
}

/// Result of one rollout.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Evaluated {
    /// Infinite if the rollout diverges.
    pub loss: f64,
    /// Steps of the episode. None if episodes of the task cannot end, or the rollout diverges.
    pub length: Option<usize>,
}

struct Evaluation<P, F> {
    task: DynTask,
    policy: P,
    weights: Weights<F>,
    seed: u64,
}

/// Prepares rollouts of the policy. `theta` has the parameters of the policy, without the trained
/// numbers of the system. Trained numbers have their initial values.
///
/// # Errors
/// The length of `theta` is not the number of these parameters.
pub fn new<P: Policy + 'static>(
    task: DynTask,
    policy: P,
    precision: Precision,
    theta: &[f64],
    seed: u64,
) -> Result<Box<dyn AnyEvaluation>> {
    let mut all = vec![0.0; policy.param_count()];
    policy.init(&mut stream(seed, Purpose::Policy, 0), &mut all);
    let own = policy.param_count() - policy.trained_params().len();
    if theta.len() != own {
        bail!(
            "the policy has {} parameters, but the policy of this scene has {own}; use the `policy` section of the run",
            theta.len()
        );
    }
    all[..own].copy_from_slice(theta);
    Ok(match precision {
        Precision::F32 => {
            Box::new(Evaluation { weights: weights::<f32>(&policy, &all), task, policy, seed })
        }
        Precision::F64 => {
            Box::new(Evaluation { weights: weights::<f64>(&policy, &all), task, policy, seed })
        }
    })
}

fn weights<F: Float>(policy: &dyn AnyPolicy<F>, theta: &[f64]) -> Weights<F> {
    Weights::new(policy, theta.iter().map(|&theta| F::from_f64(theta)).collect())
}

impl<P: Policy, F: Float> AnyEvaluation for Evaluation<P, F> {
    fn results(&self, samples: usize) -> Vec<Evaluated> {
        results(
            &self.task,
            &self.policy,
            &self.weights,
            &initial_states(&self.task, self.seed, Purpose::Evaluate, samples),
        )
    }

    fn rollout(&self, sample: usize) -> Trajectory {
        let starts = initial_states(&self.task, self.seed, Purpose::Evaluate, sample + 1);
        trajectory::rollouts(&self.task, &self.policy, &self.weights, &starts, sample..sample + 1)
            .remove(0)
    }
}

fn results<F: Float>(
    task: &dyn AnyTask<F>,
    policy: &dyn AnyPolicy<F>,
    weights: &Weights<F>,
    starts: &[F],
) -> Vec<Evaluated> {
    /// Largest number of samples in a rollout.
    const BLOCK: usize = 32;
    const DIVERGED: Evaluated = Evaluated { loss: f64::INFINITY, length: None };
    let samples = starts.len() / task.start_dim();
    let mut rollout = Rollout::for_evaluation(task, policy, BLOCK.min(samples));
    let mut run = |starts: &[F]| {
        rollout.start(starts);
        rollout.run(task, policy, weights).ok()?;
        let result = |sample| Evaluated {
            loss: rollout.cost(sample).as_(),
            length: rollout.length(task, sample),
        };
        Some((0..rollout.samples()).map(result).collect::<Vec<_>>())
    };
    let mut results = Vec::with_capacity(samples);
    for starts in starts.chunks(BLOCK * task.start_dim()) {
        match run(starts) {
            Some(block) => results.extend(block),
            // Repeats the rollout sample by sample, because a divergence ends the rollout of a
            // block.
            None => {
                let alone = |start| run(start).map_or(DIVERGED, |block| block[0]);
                results.extend(starts.chunks(task.start_dim()).map(alone));
            }
        }
    }
    results
}
