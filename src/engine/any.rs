//! Object-safe [`Task`] and [`System`] for one precision: [`AnyTask`] and `AnySystem`.
//!
//! Rollouts and reverse passes thus compile once per precision, not once per task. One call of
//! `step_forward` or `step_back` steps all samples, so the cost of dynamic dispatch is negligible.

use crate::dynamics::cause::Cause;
use crate::dynamics::outline::{self, One};
use crate::dynamics::system::System;
use crate::dynamics::task::Task;
use crate::engine::adjoint::StepBack;
use crate::engine::rollout::{Lane, StepForward};
use crate::numbers::rng::Rng;
use crate::numbers::scalar::{CotangentPack, Float};

/// Object-safe [`Task`] for one precision.
///
/// Every task implements it, so `&task` coerces to `&dyn AnyTask<F>`. The trait is sealed. The
/// hidden methods forward to those of the task.
#[allow(missing_docs)]
pub trait AnyTask<F: Float>: StepForward<F> + StepBack<F, 1> + StepBack<F, 2> + Send + Sync {
    #[doc(hidden)]
    fn state_dim(&self) -> usize;
    #[doc(hidden)]
    fn control_dim(&self) -> usize;
    #[doc(hidden)]
    fn horizon(&self) -> usize;
    #[doc(hidden)]
    fn start(&self, rng: &mut Rng, x: &mut [f64]);
    #[doc(hidden)]
    fn terminal_cost(&self, x: &[Lane<F>]) -> Lane<F>;
    #[doc(hidden)]
    fn terminal_cost_gradient(&self, x: &[Lane<F>], x_bar: &mut [Lane<F>]);
    #[doc(hidden)]
    fn stage_cost_gradient(&self, x: &[Lane<F>], u: &[Lane<F>], x_bar: &mut [Lane<F>], u_bar: &mut [Lane<F>]);
    #[doc(hidden)]
    fn diagnose(&self, x: &[F], u: &[F]) -> Option<Cause>;
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

    fn diagnose(&self, x: &[F], u: &[F]) -> Option<Cause> {
        self.system().diagnose(x, u)
    }
}

/// Object-safe [`System`] for one precision and one sample at a time.
///
/// Used where a loop over steps should compile only once. Methods forward to those of the system.
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
        outline::step(self, x, u, next);
    }

    fn vjp(&self, x: &[F], u: &[F], next_bar: &[One<F>], x_bar: &mut [One<F>], u_bar: &mut [One<F>]) {
        outline::vjp(self, x, u, next_bar, x_bar, u_bar);
    }

    fn jvp_state(&self, x: &[F], u: &[F], x_tan: &[F], next_tan: &mut [F]) {
        System::jvp_state(self, x, u, x_tan, next_tan);
    }

    fn jvp_control(&self, x: &[F], u: &[F], u_tan: &[F], next_tan: &mut [F]) {
        System::jvp_control(self, x, u, u_tan, next_tan);
    }
}

/// Evaluates [`System::vjp`] on plain numbers. Returns `[x_bar, u_bar]`.
pub(crate) fn vjp<F: Float>(system: &dyn AnySystem<F>, x: &[F], u: &[F], next_bar: &[F]) -> [Vec<F>; 2] {
    let next_bar: Vec<_> = next_bar.iter().map(|&bar| CotangentPack([bar])).collect();
    // NaN reveals an output that `vjp` does not overwrite.
    let [mut x_bar, mut u_bar] = [x, u].map(|inputs| vec![CotangentPack([F::lift(f64::NAN)]); inputs.len()]);
    system.vjp(x, u, &next_bar, &mut x_bar, &mut u_bar);
    [x_bar, u_bar].map(|bars| bars.into_iter().map(|CotangentPack([bar])| bar).collect())
}
