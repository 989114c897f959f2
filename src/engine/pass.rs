//! [`Closed`]: a closed loop of task and policy. [`Pass`]: its reverse pass.

use crate::engine::any::AnyTask;
use crate::engine::rollout::Rollout;
use crate::numbers::scalar::Float;
use crate::policy::{AnyPolicy, Weights};

/// Task, policy and the weights of the policy.
#[derive(Clone, Copy)]
pub(crate) struct Closed<'a, F: Float> {
    pub(crate) task: &'a dyn AnyTask<F>,
    pub(crate) policy: &'a dyn AnyPolicy<F>,
    pub(crate) weights: &'a Weights<F>,
}

/// Constant arguments of one reverse pass.
pub(crate) struct Pass<'a, F: Float> {
    pub(crate) closed: Closed<'a, F>,
    pub(crate) rollout: &'a Rollout<F>,
    /// Factor of all cotangents.
    pub(crate) scale: F,
    /// True if the pass measures the growth of the adjoints.
    pub(crate) measured: bool,
}
