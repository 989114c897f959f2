//! Object-safe [`Task`] for one precision, and [`System`] for one scalar type: [`AnyTask`] and
//! `AnySystem`.
//!
//! Rollouts and reverse passes thus compile once per precision, not once per task. One call of
//! `step_forward` or `step_back` steps all samples, so the cost of dynamic dispatch is negligible.

use crate::dynamics::cause::Cause;
use crate::dynamics::inputs::{Cotangents, Inputs, Start, Tangents};
use crate::dynamics::number::{NoiseNumbers, draw_key};
use crate::dynamics::outline::{self, One};
use crate::dynamics::system::System;
use crate::dynamics::task::Task;
use crate::engine::adjoint::StepBack;
use crate::engine::observe::Observe;
use crate::engine::step_forward::StepForward;
use crate::numbers::rng::Rng;
use crate::numbers::scalar::{Cotangent, CotangentPack, Float, Lane, Real};

/// Object-safe [`Task`] for one precision.
///
/// Every task implements the trait, so `&task` coerces to `&dyn AnyTask<F>`. The trait is sealed.
/// Hidden methods forward to the methods of the task and its system. `start` also draws the
/// physical numbers that vary.
#[allow(missing_docs)]
pub trait AnyTask<F: Float>:
    StepForward<F> + Observe<F> + StepBack<F, 1> + StepBack<F, 2> + Send + Sync
{
    #[doc(hidden)]
    fn state_dim(&self) -> usize;
    #[doc(hidden)]
    fn control_dim(&self) -> usize;
    #[doc(hidden)]
    fn ended(&self) -> Option<usize>;
    #[doc(hidden)]
    fn first_step(&self) -> usize;
    /// Number of components of the observation. `None` if the policy observes the state.
    #[doc(hidden)]
    fn own_observation(&self) -> Option<usize>;
    #[doc(hidden)]
    fn horizon(&self) -> usize;
    #[doc(hidden)]
    fn param_dim(&self) -> usize;
    #[doc(hidden)]
    fn start(&self, rng: &mut Rng, start: Start<'_>);
    /// Numbers that are drawn anew during a rollout.
    #[doc(hidden)]
    fn noise(&self) -> NoiseNumbers;
    #[doc(hidden)]
    fn terminal_cost(&self, x: &[Lane<F>], p: &[Lane<F>]) -> Lane<F>;
    #[doc(hidden)]
    fn terminal_cost_gradient(
        &self,
        x: &[Lane<F>],
        p: &[Lane<F>],
        x_bar: &mut [Lane<F>],
        p_bar: Option<&mut [Lane<F>]>,
    );
    #[doc(hidden)]
    fn running_cost(&self, inputs: Inputs<'_, Lane<F>>, next: &[Lane<F>]) -> Lane<F>;
    #[doc(hidden)]
    fn running_cost_gradient(
        &self,
        inputs: Inputs<'_, Lane<F>>,
        next: &[Lane<F>],
        cotangents: Cotangents<'_, Lane<F>>,
        next_bar: &mut [Lane<F>],
    );
    #[doc(hidden)]
    fn diagnose(&self, inputs: Inputs<'_, Lane<F>>) -> Option<Cause>;

    /// Number of components that the policy observes.
    fn observed_dim(&self) -> usize {
        self.own_observation().unwrap_or(self.state_dim())
    }

    /// Numbers per sample in a list of initial states: the state, then the parameters, then the key
    /// of the noise, if there is noise.
    fn start_dim(&self) -> usize {
        self.state_dim() + self.param_dim() + self.noise().key_dim()
    }

    /// Draws one initial state into `start`, [`start_dim`](AnyTask::start_dim) zeros.
    #[doc(hidden)]
    fn draw(&self, rng: &mut Rng, start: &mut [f64]) {
        let (x, rest) = start.split_at_mut(self.state_dim());
        let (p, key) = rest.split_at_mut(self.param_dim());
        self.start(rng, Start { x, p });
        key.iter_mut().for_each(|key| *key = draw_key(rng));
    }
}

impl<T: Task, F: Float> AnyTask<F> for T {
    fn state_dim(&self) -> usize {
        System::state_dim(self.system())
    }

    fn control_dim(&self) -> usize {
        System::control_dim(self.system())
    }

    fn ended(&self) -> Option<usize> {
        Task::ended(self)
    }

    fn first_step(&self) -> usize {
        Task::first_step(self)
    }

    fn own_observation(&self) -> Option<usize> {
        Task::observation_dim(self)
    }

    fn horizon(&self) -> usize {
        Task::horizon(self)
    }

    fn param_dim(&self) -> usize {
        Task::param_dim(self)
    }

    fn start(&self, rng: &mut Rng, start: Start<'_>) {
        Task::draw_start(self, rng, start);
    }

    fn noise(&self) -> NoiseNumbers {
        NoiseNumbers::of(&self.system().varied(Task::param_dim(self)))
    }

    #[inline(never)]
    fn terminal_cost(&self, x: &[Lane<F>], p: &[Lane<F>]) -> Lane<F> {
        Task::terminal_cost(self, x, p)
    }

    #[inline(never)]
    fn terminal_cost_gradient(
        &self,
        x: &[Lane<F>],
        p: &[Lane<F>],
        x_bar: &mut [Lane<F>],
        p_bar: Option<&mut [Lane<F>]>,
    ) {
        Task::terminal_cost_gradient(self, x, p, x_bar, p_bar);
    }

    #[inline(never)]
    fn running_cost(&self, inputs: Inputs<'_, Lane<F>>, next: &[Lane<F>]) -> Lane<F> {
        Task::running_cost(self, inputs, next)
    }

    #[inline(never)]
    fn running_cost_gradient(
        &self,
        inputs: Inputs<'_, Lane<F>>,
        next: &[Lane<F>],
        cotangents: Cotangents<'_, Lane<F>>,
        next_bar: &mut [Lane<F>],
    ) {
        Task::running_cost_gradient(self, inputs, next, cotangents, next_bar);
    }

    #[inline(never)]
    fn diagnose(&self, inputs: Inputs<'_, Lane<F>>) -> Option<Cause> {
        self.system().diagnose(inputs)
    }
}

/// Object-safe [`System`] for one scalar type. Steps one sample at a time.
///
/// Used for loops over steps that should compile only once. Methods forward to those of the system.
pub(crate) trait AnySystem<R: Real> {
    fn state_dim(&self) -> usize;
    fn control_dim(&self) -> usize;
    fn param_dim(&self) -> usize;
    fn step(&self, inputs: Inputs<'_, R>, next: &mut [R]);
    fn vjp(&self, inputs: Inputs<'_, R>, next_bar: &[One<R>], cotangents: Cotangents<'_, One<R>>);
    fn jvp(&self, inputs: Inputs<'_, R>, tangents: Tangents<'_, R>, next_tan: &mut [R]);
}

impl<S: System, R: Real> AnySystem<R> for S {
    fn state_dim(&self) -> usize {
        System::state_dim(self)
    }

    fn control_dim(&self) -> usize {
        System::control_dim(self)
    }

    fn param_dim(&self) -> usize {
        System::param_dim(self)
    }

    fn step(&self, inputs: Inputs<'_, R>, next: &mut [R]) {
        outline::step(self, inputs, next);
    }

    fn vjp(&self, inputs: Inputs<'_, R>, next_bar: &[One<R>], cotangents: Cotangents<'_, One<R>>) {
        outline::vjp(self, inputs, next_bar, cotangents);
    }

    fn jvp(&self, inputs: Inputs<'_, R>, tangents: Tangents<'_, R>, next_tan: &mut [R]) {
        System::jvp(self, inputs, tangents, next_tan);
    }
}

/// Evaluates [`System::vjp`] for one cotangent of the next state. Returns `[x_bar, u_bar, p_bar]`.
pub(crate) fn vjp<R: Real>(
    system: &dyn AnySystem<R>,
    inputs: Inputs<'_, R>,
    next_bar: &[R],
) -> [Vec<R>; 3] {
    let next_bar: Vec<_> = next_bar.iter().map(|&bar| CotangentPack([bar])).collect();
    let [mut x, mut u, mut p] =
        [inputs.x, inputs.u, inputs.p].map(|inputs| vec![CotangentPack::null(); inputs.len()]);
    let cotangents =
        Cotangents { x: Some(&mut x), u: Some(&mut u), p: (!p.is_empty()).then_some(&mut p) };
    system.vjp(inputs, &next_bar, cotangents);
    [x, u, p].map(|cotangents| cotangents.into_iter().map(|CotangentPack([bar])| bar).collect())
}
