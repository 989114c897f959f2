//! [`Hard`]: seven small tasks, chosen at run time. As they have a single type, training code is
//! compiled once.

use super::{Bounce, DoublePendulum, Lqr, MultiPendulum, PoleChain, Push, Slider, Upright};
use crate::dynamics::cause::Cause;
use crate::dynamics::effect::HasModel;
use crate::dynamics::inputs::{Cotangents, Inputs, Start};
use crate::dynamics::integrator::{AnyIntegrator, Integrated};
use crate::dynamics::number::Varied;
use crate::dynamics::outline::{Reverse, Step, outline};
use crate::dynamics::system::System;
use crate::dynamics::task::Task;
use crate::numbers::rng::Rng;
use crate::numbers::scalar::{Cotangent, Real, Scalar};

/// Any of the seven small tasks. As a [`System`], it is the physics of the task, with outlined
/// steps. [`Hard`] is the task.
#[derive(Clone, Debug, PartialEq)]
#[allow(clippy::large_enum_variant)] // One value per task.
pub enum AnyHard {
    /// Linear-quadratic regulator: [`Lqr`].
    Lqr(Lqr),
    /// Swing-up of a [`DoublePendulum`].
    DoublePendulum(Upright<Integrated<DoublePendulum, AnyIntegrator>>),
    /// Swing-up of a [`MultiPendulum`].
    MultiPendulum(Upright<Integrated<MultiPendulum, AnyIntegrator>>),
    /// Swing-up of a [`PoleChain`].
    PoleChain(Upright<Integrated<PoleChain, AnyIntegrator>>),
    /// Stopping with dry friction: [`Slider`].
    Slider(Slider),
    /// Bouncing ball: [`Bounce`].
    Bounce(Bounce),
    /// Pushing a box: [`Push`].
    Push(Push),
}

/// Evaluates an expression for the task of any variant.
macro_rules! whichever {
    ($any:expr, $task:ident => $work:expr) => {
        match $any {
            AnyHard::Lqr($task) => $work,
            AnyHard::DoublePendulum($task) => $work,
            AnyHard::MultiPendulum($task) => $work,
            AnyHard::PoleChain($task) => $work,
            AnyHard::Slider($task) => $work,
            AnyHard::Bounce($task) => $work,
            AnyHard::Push($task) => $work,
        }
    };
}

impl System for AnyHard {
    fn state_dim(&self) -> usize {
        whichever!(self, task => task.system().state_dim())
    }

    fn control_dim(&self) -> usize {
        whichever!(self, task => task.system().control_dim())
    }

    fn param_dim(&self) -> usize {
        whichever!(self, task => task.system().param_dim())
    }

    fn varied(&self, params: usize) -> Vec<Varied> {
        whichever!(self, task => task.system().varied(params))
    }

    #[inline(always)]
    fn step<T: Scalar>(&self, inputs: Inputs<'_, T>, next: &mut [T]) {
        whichever!(self, task => outline::<T>(Step { system: task.system(), inputs, next }));
    }

    #[inline(always)]
    fn vjp<R: Real, C: Cotangent<R>>(&self, inputs: Inputs<'_, R>, next_bar: &[C], cotangents: Cotangents<'_, C>) {
        whichever!(self, task => outline::<R>(Reverse { system: task.system(), inputs, next_bar, cotangents }));
    }

    fn diagnose<R: Real>(&self, inputs: Inputs<'_, R>) -> Option<Cause> {
        whichever!(self, task => task.system().diagnose(inputs))
    }
}

impl HasModel<AnyHard> for AnyHard {
    #[inline(always)]
    fn model(&self) -> &AnyHard {
        self
    }

    fn start_extra(&self, _rng: &mut Rng, _start: Start<'_>) {}
}

/// Any of the seven small tasks. `S` is any system that contains an [`AnyHard`]: alone, or behind an
/// actuator.
#[derive(Clone, Debug, PartialEq)]
pub struct Hard<S = AnyHard> {
    /// System to control.
    pub system: S,
}

/// Costs are not inlined. Otherwise each loop would contain the code of all tasks.
impl AnyHard {
    #[inline(never)]
    fn running_cost<T: Scalar>(&self, inputs: Inputs<'_, T>, next: &[T]) -> T {
        whichever!(self, task => task.running_cost(inputs, next))
    }

    #[inline(never)]
    fn terminal_cost<T: Scalar>(&self, x: &[T], p: &[T]) -> T {
        whichever!(self, task => task.terminal_cost(x, p))
    }

    #[inline(never)]
    fn running_cost_gradient<R: Real>(
        &self,
        inputs: Inputs<'_, R>,
        next: &[R],
        cotangents: Cotangents<'_, R>,
        next_bar: &mut [R],
    ) {
        match self {
            // These tasks have a terminal cost only.
            Self::Slider(_) | Self::Bounce(_) | Self::Push(_) => {}
            Self::Lqr(task) => task.running_cost_gradient(inputs, next, cotangents, next_bar),
            Self::DoublePendulum(task) => task.running_cost_gradient(inputs, next, cotangents, next_bar),
            Self::MultiPendulum(task) => task.running_cost_gradient(inputs, next, cotangents, next_bar),
            Self::PoleChain(task) => task.running_cost_gradient(inputs, next, cotangents, next_bar),
        }
    }

    #[inline(never)]
    fn terminal_cost_gradient<R: Real>(&self, x: &[R], p: &[R], x_bar: &mut [R]) {
        whichever!(self, task => task.terminal_cost_gradient(x, p, x_bar, None));
    }
}

impl<S: HasModel<AnyHard>> Task for Hard<S> {
    type System = S;

    fn system(&self) -> &S {
        &self.system
    }

    fn horizon(&self) -> usize {
        whichever!(self.system.model(), task => task.horizon())
    }

    fn start(&self, rng: &mut Rng, start: Start<'_>) {
        let task = self.system.model();
        let own = task.state_dim();
        whichever!(task, task => task.start(rng, Start { x: &mut start.x[..own], p: &mut [] }));
        self.system.start_extra(rng, start);
    }

    fn running_cost<T: Scalar>(&self, inputs: Inputs<'_, T>, next: &[T]) -> T {
        let task = self.system.model();
        let n = task.state_dim();
        task.running_cost(inputs.with_x(&inputs.x[..n]), &next[..n])
    }

    fn terminal_cost<T: Scalar>(&self, x: &[T], p: &[T]) -> T {
        let task = self.system.model();
        task.terminal_cost(&x[..task.state_dim()], p)
    }

    fn running_cost_gradient<R: Real>(
        &self,
        inputs: Inputs<'_, R>,
        next: &[R],
        mut cotangents: Cotangents<'_, R>,
        next_bar: &mut [R],
    ) {
        let task = self.system.model();
        let n = task.state_dim();
        cotangents.x = cotangents.x.map(|x_bar| &mut x_bar[..n]);
        task.running_cost_gradient(inputs.with_x(&inputs.x[..n]), &next[..n], cotangents, &mut next_bar[..n]);
    }

    fn terminal_cost_gradient<R: Real>(&self, x: &[R], p: &[R], x_bar: &mut [R], _p_bar: Option<&mut [R]>) {
        let task = self.system.model();
        let n = task.state_dim();
        task.terminal_cost_gradient(&x[..n], p, &mut x_bar[..n]);
    }
}
