//! [`AnyTask`] and [`AnyPolicy`]: what rollouts and reverse passes see of a task and a policy.
//!
//! They are behind pointers: a step of all samples is work enough for a call through a pointer to cost nothing, and what goes
//! through steps, mini-batches and epochs is compiled once for a precision, not for every task.

use crate::apart::{self, One};
use crate::backward::StepBack;
use crate::divergence::Cause;
use crate::field::{Compose, Field};
use crate::gradient::Gradient;
use crate::policy::{Policy, PolicyPass, PolicyRecord, Sizes, Tensor};
use crate::rng::Rng;
use crate::rollout::{Lane, StepForward};
use crate::scalar::{Columns, Float};
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
        System::state_dim(self.system())
    }

    fn control_dim(&self) -> usize {
        System::control_dim(self.system())
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

/// A [`System`] in one precision, one sample at a time: for what steps through it to compare, and is compiled once. Its methods
/// are the system's.
pub(crate) trait AnySystem<F: Float> {
    fn state_dim(&self) -> usize;
    fn control_dim(&self) -> usize;
    fn step(&self, x: &[F], u: &[F], next: &mut [F]);
    fn vjp(&self, x: &[F], u: &[F], next_bar: &[One<F>], x_bar: &mut [One<F>], u_bar: &mut [One<F>]);
    fn jvp_state(&self, x: &[F], u: &[F], x_tan: &[F], next_tan: &mut [F]);
    fn jvp_control(&self, x: &[F], u: &[F], u_tan: &[F], next_tan: &mut [F]);
}

impl<S: System, F: Float> AnySystem<F> for S {
    fn state_dim(&self) -> usize {
        System::state_dim(self)
    }

    fn control_dim(&self) -> usize {
        System::control_dim(self)
    }

    fn step(&self, x: &[F], u: &[F], next: &mut [F]) {
        apart::step(self, x, u, next);
    }

    fn vjp(&self, x: &[F], u: &[F], next_bar: &[One<F>], x_bar: &mut [One<F>], u_bar: &mut [One<F>]) {
        apart::vjp(self, x, u, next_bar, x_bar, u_bar);
    }

    fn jvp_state(&self, x: &[F], u: &[F], x_tan: &[F], next_tan: &mut [F]) {
        System::jvp_state(self, x, u, x_tan, next_tan);
    }

    fn jvp_control(&self, x: &[F], u: &[F], u_tan: &[F], next_tan: &mut [F]) {
        System::jvp_control(self, x, u, u_tan, next_tan);
    }
}

/// [`System::vjp`] of plain numbers: `[x_bar, u_bar]`.
pub(crate) fn vjp<F: Float>(system: &dyn AnySystem<F>, x: &[F], u: &[F], next_bar: &[F]) -> [Vec<F>; 2] {
    let next_bar: Vec<_> = next_bar.iter().map(|&bar| Columns([bar])).collect();
    // To be overwritten.
    let [mut x_bar, mut u_bar] = [x, u].map(|inputs| vec![Columns([F::lift(f64::NAN)]); inputs.len()]);
    system.vjp(x, u, &next_bar, &mut x_bar, &mut u_bar);
    [x_bar, u_bar].map(|bars| bars.into_iter().map(|Columns([bar])| bar).collect())
}
