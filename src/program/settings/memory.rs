//! How much memory a run takes.

use super::Precision;
use crate::program::kind::Visit;
use physgrad::{Float, Policy, System, Task};

/// The workspaces of a run, in bytes, before any of them is asked for.
pub struct Memory {
    pub precision: Precision,
    /// Samples of a mini-batch.
    pub samples: usize,
    /// Samples of both data sets.
    pub start_states: usize,
}

impl Visit for Memory {
    type Out = f64;

    fn visit<T: Task, P: Policy>(self, task: T, policy: P) -> f64 {
        match self.precision {
            Precision::F32 => self.bytes::<f32>(&task, &policy),
            Precision::F64 => self.bytes::<f64>(&task, &policy),
        }
    }
}

impl Memory {
    fn bytes<F: Float>(&self, task: &impl Task, policy: &impl Policy) -> f64 {
        let (n, m) = (task.system().state_dim(), task.system().control_dim());
        let columns = self.samples as f64 * task.horizon() as f64;
        // The policy's needs grow with the columns; a few are enough to see how.
        let few = policy.sizes::<F>(64);
        let per_column = (few.tape + 2 * few.tape_bar) as f64 / 64.0 + 4.0 * (n + m) as f64;
        // θ and its packed form, the optimizer and its copy, gradients of two flows.
        let parameters = policy.param_count() as f64 * 16.0;
        let sets = self.start_states as f64 * n as f64;
        (columns * per_column + parameters + sets) * size_of::<F>() as f64
    }
}
