//! [`Integrator`]: how an [`Ode`] becomes a [`System`], step by step.
//!
//! Every reverse here is that of the steps that were taken, by hand, once for all vector fields: gradients are exact for the
//! computed trajectory. The reverse computes the stages of a step again rather than storing them.

mod adaptive;
mod any;
mod discretized;
mod implicit;
mod partitioned;
mod runge_kutta;

pub use adaptive::Adaptive;
pub use any::AnyIntegrator;
pub use discretized::Discretized;
pub use implicit::ImplicitMidpoint;
pub use partitioned::{SemiImplicit, Verlet};
pub use runge_kutta::RungeKutta;

use crate::dynamics::cause::Cause;
use crate::dynamics::effect::Around;
use crate::dynamics::ode::{Ode, RateOn, ReverseOn};
use crate::dynamics::system::System;
use crate::numbers::rng::Rng;
use crate::numbers::scalar::{Cotangent, Float, Real, Scalar};
use smallvec::{SmallVec, smallvec};
use std::fmt::Debug;

/// What a step works with: on the stack for small systems, else allocated in every step.
type Room<T> = SmallVec<[T; 64]>;

/// Room for `len` numbers.
#[inline(always)]
fn room<T: Copy>(value: T, len: usize) -> Room<T> {
    smallvec![value; len]
}

/// Where a step begins, and how far it goes.
#[derive(Clone, Copy, Debug)]
pub struct Stretch<'a, T> {
    /// The time that it takes, s.
    pub h: T,
    /// The state in which it begins.
    pub x: &'a [T],
    /// The control, constant during it.
    pub u: &'a [T],
}

/// A way to go from one state to that of a time `h` later.
pub trait Integrator: Clone + Debug + Send + Sync {
    /// Writes the state at its end.
    fn advance<T: Scalar>(&self, ode: &dyn RateOn<T>, step: Stretch<'_, T>, next: &mut [T]);

    /// The size of the residual that a step is left with which has to solve an equation, if it could not.
    fn unsolved<F: Float>(&self, _ode: &dyn RateOn<F>, _step: Stretch<'_, F>) -> Option<f64> {
        None
    }

    /// The reverse of [`advance`](Integrator::advance) of the same stretch: overwrites `x_bar`, and adds to `u_bar` if it is asked
    /// for.
    fn reverse<R: Real, C: Cotangent<R>>(
        &self,
        ode: &dyn ReverseOn<R, C>,
        step: Stretch<'_, R>,
        next_bar: &[C],
        x_bar: &mut [C],
        u_bar: Option<&mut [C]>,
    );
}

/// A vector field as a [`System`]: one step of the integrator for each of `dt`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Integrated<O, I> {
    /// The vector field.
    pub ode: O,
    /// The way to go along it.
    pub integrator: I,
    /// Time step, s.
    pub dt: f64,
}

impl<O: Ode, I: Integrator> System for Integrated<O, I> {
    fn state_dim(&self) -> usize {
        self.ode.state_dim()
    }

    fn control_dim(&self) -> usize {
        self.ode.control_dim()
    }

    #[inline(always)]
    fn step<T: Scalar>(&self, x: &[T], u: &[T], next: &mut [T]) {
        self.integrator.advance(&self.ode, Stretch { h: T::lift(self.dt), x, u }, next);
    }

    fn cause<F: Float>(&self, x: &[F], u: &[F]) -> Option<Cause> {
        let unsolved = self.integrator.unsolved(&self.ode, Stretch { h: F::lift(self.dt), x, u });
        self.ode.cause(x, u).or(unsolved.map(Cause::Unsolved))
    }

    #[inline(always)]
    fn vjp<R: Real, C: Cotangent<R>>(&self, x: &[R], u: &[R], next_bar: &[C], x_bar: &mut [C], u_bar: &mut [C]) {
        u_bar.fill(C::null());
        self.integrator.reverse(&self.ode, Stretch { h: R::lift(self.dt), x, u }, next_bar, x_bar, Some(u_bar));
    }

    #[inline(always)]
    fn vjp_state<R: Real, C: Cotangent<R>>(&self, x: &[R], u: &[R], next_bar: &[C], x_bar: &mut [C]) {
        self.integrator.reverse(&self.ode, Stretch { h: R::lift(self.dt), x, u }, next_bar, x_bar, None);
    }

    /// The control of the first stage reaches the end through the states of those after it.
    #[inline(always)]
    fn vjp_control<R: Real, C: Cotangent<R>>(&self, x: &[R], u: &[R], next_bar: &[C], u_bar: &mut [C]) {
        let mut x_bar = room(C::null(), x.len());
        self.vjp(x, u, next_bar, &mut x_bar, u_bar);
    }
}

impl<B, O: Ode + Around<B>, I: Integrator> Around<B> for Integrated<O, I> {
    #[inline(always)]
    fn body(&self) -> &B {
        self.ode.body()
    }

    fn start_beyond(&self, rng: &mut Rng, x: &mut [f64]) {
        self.ode.start_beyond(rng, x);
    }
}
