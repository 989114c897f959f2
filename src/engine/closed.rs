//! [`Closed`]: a closed loop of task and policy.

use crate::engine::any::AnyTask;
use crate::numbers::scalar::Float;
use crate::policy::{AnyPolicy, Weights};

/// Task, policy and the weights of the policy.
#[derive(Clone, Copy)]
pub(crate) struct Closed<'a, F: Float> {
    pub(crate) task: &'a dyn AnyTask<F>,
    pub(crate) policy: &'a dyn AnyPolicy<F>,
    pub(crate) weights: &'a Weights<F>,
}
