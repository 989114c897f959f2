//! Trajectory optimization of a scene.

use crate::optimize::{Initial, OptimizeError, Options, Plan, optimize};
use crate::program::operations::Visit;
use crate::{Policy, Task};

/// Visitor that optimizes the controls from one initial state.
pub struct Optimizing<'a> {
    pub x0: &'a [f64],
    /// Parameters of the rollout.
    pub p: &'a [f64],
    pub initial: Initial<'a>,
    pub options: &'a Options,
}

impl Visit for Optimizing<'_> {
    type Out = Result<Plan, OptimizeError>;

    fn visit<T: Task + Clone + 'static, P: Policy + Clone + 'static>(self, task: T, _policy: P) -> Self::Out {
        optimize(&task, self.x0, self.p, self.initial, self.options)
    }
}
