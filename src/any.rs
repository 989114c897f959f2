//! [`AnyTask`] and [`AnyPolicy`]: what rollouts and reverse passes see of a task and a policy.
//!
//! They are behind pointers: a step of all samples is work enough for a call through a pointer to cost nothing, and what goes
//! through steps, mini-batches and epochs is compiled once for a precision, not for every task.

use crate::backward::StepBack;
use crate::divergence::Cause;
use crate::field::{Compose, Field};
use crate::gradient::Gradient;
use crate::policy::{Policy, PolicyPass, PolicyRecord, Sizes, Tensor};
use crate::rng::Rng;
use crate::rollout::{Lane, StepForward};
use crate::scalar::Float;
use crate::system::System;
use crate::task::Task;

/// A [`Task`] in one precision. Every task is one, so that `&task` can be given where `&dyn AnyTask<F>` is asked for. Its
/// methods are the task's, and need no import.
#[allow(missing_docs)]
pub trait AnyTask<F: Float>: StepForward<F> + StepBack<F, 1> + StepBack<F, 2> + Send + Sync {
    fn state_dim(&self) -> usize;
    fn control_dim(&self) -> usize;
    fn horizon(&self) -> usize;
    fn start(&self, rng: &mut Rng, x: &mut [f64]);
    fn terminal_cost(&self, x: &[Lane<F>]) -> Lane<F>;
    fn terminal_cost_gradient(&self, x: &[Lane<F>], x_bar: &mut [Lane<F>]);
    fn stage_cost_gradient(&self, x: &[Lane<F>], u: &[Lane<F>], x_bar: &mut [Lane<F>], u_bar: &mut [Lane<F>]);
    fn cause(&self, x: &[F], u: &[F]) -> Option<Cause>;
}

impl<T: Task, F: Float> AnyTask<F> for T {
    fn state_dim(&self) -> usize {
        self.system().state_dim()
    }

    fn control_dim(&self) -> usize {
        self.system().control_dim()
    }

    fn horizon(&self) -> usize {
        Task::horizon(self)
    }

    fn start(&self, rng: &mut Rng, x: &mut [f64]) {
        Task::start(self, rng, x);
    }

    fn terminal_cost(&self, x: &[Lane<F>]) -> Lane<F> {
        Task::terminal_cost(self, x)
    }

    fn terminal_cost_gradient(&self, x: &[Lane<F>], x_bar: &mut [Lane<F>]) {
        Task::terminal_cost_gradient(self, x, x_bar);
    }

    fn stage_cost_gradient(&self, x: &[Lane<F>], u: &[Lane<F>], x_bar: &mut [Lane<F>], u_bar: &mut [Lane<F>]) {
        Task::stage_cost_gradient(self, x, u, x_bar, u_bar);
    }

    fn cause(&self, x: &[F], u: &[F]) -> Option<Cause> {
        self.system().cause(x, u)
    }
}

/// A [`Policy`] in one precision. Every policy is one, so that `&policy` can be given where `&dyn AnyPolicy<F>` is asked
/// for. Its methods are the policy's, and need no import.
#[allow(missing_docs)]
pub trait AnyPolicy<F: Float>: Send + Sync {
    fn state_dim(&self) -> usize;
    fn control_dim(&self) -> usize;
    fn param_count(&self) -> usize;
    fn init(&self, rng: &mut Rng, theta: &mut [f64]);
    fn tensors(&self) -> Vec<Tensor>;
    fn sizes(&self, columns: usize) -> Sizes;
    fn pack(&self, theta: &[F], packed: &mut [F]);
    fn forward(&self, pass: PolicyPass<F>, tape: &mut [F], u: &mut [F]);
    fn backward(&self, pass: PolicyPass<F>, tape: &[F], u_bar: &[F], tape_bar: &mut [F], x_bar: Option<&mut [F]>);
    fn param_gradient(&self, pass: PolicyPass<F>, record: PolicyRecord<F>, scratch: &mut [F], theta_bar: &mut [F]);
}

impl<P: Policy, F: Float> AnyPolicy<F> for P {
    fn state_dim(&self) -> usize {
        Policy::state_dim(self)
    }

    fn control_dim(&self) -> usize {
        Policy::control_dim(self)
    }

    fn param_count(&self) -> usize {
        Policy::param_count(self)
    }

    fn init(&self, rng: &mut Rng, theta: &mut [f64]) {
        Policy::init(self, rng, theta);
    }

    fn tensors(&self) -> Vec<Tensor> {
        Policy::tensors(self)
    }

    fn sizes(&self, columns: usize) -> Sizes {
        Policy::sizes::<F>(self, columns)
    }

    fn pack(&self, theta: &[F], packed: &mut [F]) {
        Policy::pack(self, theta, packed);
    }

    fn forward(&self, pass: PolicyPass<F>, tape: &mut [F], u: &mut [F]) {
        Policy::forward(self, pass, tape, u);
    }

    fn backward(&self, pass: PolicyPass<F>, tape: &[F], u_bar: &[F], tape_bar: &mut [F], x_bar: Option<&mut [F]>) {
        Policy::backward(self, pass, tape, u_bar, tape_bar, x_bar);
    }

    fn param_gradient(&self, pass: PolicyPass<F>, record: PolicyRecord<F>, scratch: &mut [F], theta_bar: &mut [F]) {
        Policy::param_gradient(self, pass, record, scratch, theta_bar);
    }
}

/// A [`Field`] in one precision.
pub(crate) trait AnyField<F: Float>: Sync {
    fn compose(&self, gradients: &[Gradient<F>], composed: &mut Gradient<F>);
}

impl<C: Compose, F: Float> AnyField<F> for Field<C> {
    fn compose(&self, gradients: &[Gradient<F>], composed: &mut Gradient<F>) {
        Field::compose(self, gradients, composed);
    }
}
