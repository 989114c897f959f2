//! Norms of the adjoints along a rollout.

use physgrad::engine::any::AnyTask;
use physgrad::policy::AnyPolicy;
use physgrad::{Adjoint, Divergence, Float, Flow, Rollout, Weights};

/// Largest number of test initial states in the rollout.
pub const SAMPLES: usize = 64;

/// Norms of the adjoint of one flow: root mean squares over the samples.
pub struct AdjointNorms {
    pub flow: Flow,
    /// Norm at each state of the rollout. NaN at states that a diverged reverse pass did not reach.
    /// Empty if the rollout diverged.
    pub norms: Vec<f64>,
    /// First non-finite number of the rollout or of the reverse pass. None if all are finite.
    pub diverged: Option<Divergence>,
}

impl AdjointNorms {
    /// Pairs of step and norm.
    pub fn points(&self) -> Vec<(f64, f64)> {
        self.norms.iter().enumerate().map(|(step, &norm)| (step as f64, norm)).collect()
    }
}

/// Adjoint norms of R and M under a policy.
pub fn norms<F: Float>(
    task: &dyn AnyTask<F>,
    policy: &dyn AnyPolicy<F>,
    weights: &Weights<F>,
    starts: &[F],
) -> [AdjointNorms; 2] {
    let n = task.start_dim();
    let starts = &starts[..starts.len().min(SAMPLES * n)];
    let mut rollout = Rollout::new(task, policy, starts.len() / n);
    rollout.start(starts);
    let forward = rollout.run(task, policy, weights);
    // Runs the flows separately: in a joint pass, a divergence of one flow ends both.
    [Flow::REGULAR, Flow::MODIFIED].map(|flow| {
        if let Err(divergence) = forward {
            return AdjointNorms { flow, norms: Vec::new(), diverged: Some(divergence) };
        }
        let mut adjoint = Adjoint::new(task, policy, &rollout, &[flow]).keep_norms();
        // Scales the loss to the mean over samples, as in training.
        let diverged = adjoint
            .run(task, policy, weights, &rollout, F::from_f64(1.0 / rollout.samples() as f64))
            .err();
        AdjointNorms { flow, norms: adjoint.norms(0).to_vec(), diverged }
    })
}
