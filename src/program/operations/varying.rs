//! Numbers of a system that are not fixed.

use crate::program::operations::Visit;
use crate::{Policy, System, Task, Varied};

/// Visitor that lists the numbers that are not fixed.
#[derive(Default)]
pub struct Varying {
    /// The numbers, with their indices in the parameters of a rollout.
    pub varied: Vec<Varied>,
    /// Number of parameters of a rollout.
    pub params: usize,
}

impl Visit for Varying {
    type Out = Self;

    fn visit<T: Task + Clone + 'static, P: Policy + Clone + 'static>(self, task: T, _policy: P) -> Self {
        Self { varied: task.system().varied(task.param_dim()), params: task.param_dim() }
    }
}
