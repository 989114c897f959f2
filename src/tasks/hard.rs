//! [`Hard`]: the small hard tasks, chosen at run time. A single type means that training code is
//! compiled once.

use super::{Bounce, DoublePendulum, Lqr, PoleChain, Push, Slider, Upright};
use crate::dynamics::cause::Cause;
use crate::dynamics::effect::HasModel;
use crate::dynamics::integrator::{AnyIntegrator, Integrated};
use crate::dynamics::outline::{Reverse, ReverseToControl, Step, outline};
use crate::dynamics::system::System;
use crate::dynamics::task::Task;
use crate::numbers::rng::Rng;
use crate::numbers::scalar::{Cotangent, Float, Real, Scalar};
use smallvec::{SmallVec, smallvec};

/// Any of the small hard tasks. As a [`System`], it is the physics of the task, with outlined
/// steps. [`Hard`] is the task.
#[derive(Clone, Debug, PartialEq)]
pub enum AnyHard {
    /// Linear-quadratic regulator: [`Lqr`].
    Lqr(Lqr),
    /// Swing-up of a [`DoublePendulum`].
    DoublePendulum(Upright<Integrated<DoublePendulum, AnyIntegrator>>),
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

    #[inline(always)]
    fn step<T: Scalar>(&self, x: &[T], u: &[T], next: &mut [T]) {
        whichever!(self, task => outline::<T>(Step { system: task.system(), x, u, next }));
    }

    fn diagnose<F: Float>(&self, x: &[F], u: &[F]) -> Option<Cause> {
        whichever!(self, task => task.system().diagnose(x, u))
    }

    #[inline(always)]
    fn vjp<R: Real, C: Cotangent<R>>(&self, x: &[R], u: &[R], next_bar: &[C], x_bar: &mut [C], u_bar: &mut [C]) {
        whichever!(self, task => outline::<R>(Reverse { system: task.system(), x, u, next_bar, x_bar, u_bar }));
    }

    #[inline(always)]
    fn vjp_state<R: Real, C: Cotangent<R>>(&self, x: &[R], u: &[R], next_bar: &[C], x_bar: &mut [C]) {
        let mut u_bar: SmallVec<[C; 8]> = smallvec![C::null(); u.len()];
        self.vjp(x, u, next_bar, x_bar, &mut u_bar);
    }

    #[inline(always)]
    fn vjp_control<R: Real, C: Cotangent<R>>(&self, x: &[R], u: &[R], next_bar: &[C], u_bar: &mut [C]) {
        whichever!(self, task => outline::<R>(ReverseToControl { system: task.system(), x, u, next_bar, u_bar }));
    }
}

impl HasModel<AnyHard> for AnyHard {
    #[inline(always)]
    fn model(&self) -> &AnyHard {
        self
    }

    fn start_extra(&self, _rng: &mut Rng, _x: &mut [f64]) {}
}

/// Any of the small hard tasks. `S` is any system around an [`AnyHard`]: alone, or behind an
/// actuator.
#[derive(Clone, Debug, PartialEq)]
pub struct Hard<S = AnyHard> {
    /// System to control.
    pub system: S,
}

impl<S: HasModel<AnyHard>> Hard<S> {
    /// Returns the inner task, and the components of the state that belong to its physics.
    #[inline(always)]
    fn own<'a, T>(&self, x: &'a [T]) -> (&AnyHard, &'a [T]) {
        let task = self.system.model();
        (task, &x[..task.state_dim()])
    }
}

/// Costs are not inlined. Otherwise each loop would contain the code of all tasks.
impl AnyHard {
    #[inline(never)]
    fn stage_cost<T: Scalar>(&self, x: &[T], u: &[T]) -> T {
        whichever!(self, task => task.stage_cost(x, u))
    }

    #[inline(never)]
    fn terminal_cost<T: Scalar>(&self, x: &[T]) -> T {
        whichever!(self, task => task.terminal_cost(x))
    }

    #[inline(never)]
    fn stage_cost_gradient<R: Real>(&self, x: &[R], u: &[R], x_bar: &mut [R], u_bar: &mut [R]) {
        match self {
            // These tasks have a terminal cost only.
            Self::Slider(_) | Self::Bounce(_) | Self::Push(_) => {
                x_bar.fill(R::zero());
                u_bar.fill(R::zero());
            }
            Self::Lqr(task) => task.stage_cost_gradient(x, u, x_bar, u_bar),
            Self::DoublePendulum(task) => task.stage_cost_gradient(x, u, x_bar, u_bar),
            Self::PoleChain(task) => task.stage_cost_gradient(x, u, x_bar, u_bar),
        }
    }

    #[inline(never)]
    fn terminal_cost_gradient<R: Real>(&self, x: &[R], x_bar: &mut [R]) {
        whichever!(self, task => task.terminal_cost_gradient(x, x_bar));
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

    fn start(&self, rng: &mut Rng, x: &mut [f64]) {
        let task = self.system.model();
        let own = task.state_dim();
        whichever!(task, task => task.start(rng, &mut x[..own]));
        self.system.start_extra(rng, x);
    }

    fn stage_cost<T: Scalar>(&self, x: &[T], u: &[T]) -> T {
        let (task, x) = self.own(x);
        task.stage_cost(x, u)
    }

    fn terminal_cost<T: Scalar>(&self, x: &[T]) -> T {
        let (task, x) = self.own(x);
        task.terminal_cost(x)
    }

    fn stage_cost_gradient<R: Real>(&self, x: &[R], u: &[R], x_bar: &mut [R], u_bar: &mut [R]) {
        let (task, x) = self.own(x);
        let (own, beyond) = x_bar.split_at_mut(x.len());
        beyond.fill(R::zero());
        task.stage_cost_gradient(x, u, own, u_bar);
    }

    fn terminal_cost_gradient<R: Real>(&self, x: &[R], x_bar: &mut [R]) {
        let (task, x) = self.own(x);
        let (own, beyond) = x_bar.split_at_mut(x.len());
        beyond.fill(R::zero());
        task.terminal_cost_gradient(x, own);
    }
}
