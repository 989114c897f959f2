//! How long the adjoint is on its way back through a rollout.

use physgrad::any::AnyTask;
use physgrad::policy::AnyPolicy;
use physgrad::{Adjoint, Divergence, Float, Flow, Rollout, Weights};

/// Test start states that are rolled out.
pub const SAMPLES: usize = 64;

/// The adjoint of one flow.
pub struct Lengths {
    pub flow: Flow,
    /// Its length at each state of the rollout; NaN before where it diverged.
    pub norms: Vec<f64>,
    /// Where a number was not finite.
    pub diverged: Option<Divergence>,
}

impl Lengths {
    /// The lengths against the steps.
    pub fn points(&self) -> Vec<(f64, f64)> {
        self.norms.iter().enumerate().map(|(step, &norm)| (step as f64, norm)).collect()
    }
}

/// The adjoints of R and M under a policy.
pub fn lengths<F: Float>(task: &dyn AnyTask<F>, policy: &dyn AnyPolicy<F>, weights: &Weights<F>, starts: &[F]) -> [Lengths; 2] {
    let n = task.state_dim();
    let starts = &starts[..starts.len().min(SAMPLES * n)];
    let mut rollout = Rollout::new(task, policy, starts.len() / n);
    rollout.start(starts);
    let forward = rollout.run(task, policy, weights);
    // One after the other: side by side, the one that diverges would stop the other.
    [Flow::REGULAR, Flow::MODIFIED].map(|flow| {
        if let Err(divergence) = forward {
            return Lengths { flow, norms: Vec::new(), diverged: Some(divergence) };
        }
        let mut adjoint = Adjoint::new(policy, &rollout, &[flow]).keep_norms();
        // A gradient of the mean, as in training.
        let diverged = adjoint.run(task, policy, weights, &rollout, F::lift(1.0 / rollout.samples() as f64)).err();
        Lengths { flow, norms: adjoint.norms(0).to_vec(), diverged }
    })
}
