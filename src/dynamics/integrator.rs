//! [`Integrator`]: discretizes an [`Ode`] into a [`System`].
//!
//! - Explicit methods: [`RungeKutta`], [`Adaptive`].
//! - Methods for mechanics: [`SemiImplicit`], [`Verlet`].
//! - Stiff systems: [`ImplicitMidpoint`].
//! - Choice at run time: [`AnyIntegrator`], [`Discretized`].
//!
//! Each integrator has an analytic VJP for all vector fields (discretize, then differentiate).
//! Gradients are therefore exact for the computed trajectory. The VJP recomputes the stages of a
//! step. Start with [`Integrated`].

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
use crate::dynamics::effect::HasModel;
use crate::dynamics::ode::{DynOde, DynOdeVjp, Ode};
use crate::dynamics::system::System;
use crate::numbers::rng::Rng;
use crate::numbers::scalar::{Cotangent, Float, Real, Scalar};
use smallvec::{SmallVec, smallvec};
use std::fmt::Debug;

/// Workspace of one step. Beyond 64 numbers, every step allocates.
type Room<T> = SmallVec<[T; 64]>;

/// A workspace of `len` copies of `value`.
#[inline(always)]
fn room<T: Copy>(value: T, len: usize) -> Room<T> {
    smallvec![value; len]
}

/// Inputs of one integration step.
#[derive(Clone, Copy, Debug)]
pub struct StepInput<'a, T> {
    /// Duration of the step, s.
    pub h: T,
    /// State at the start of the step.
    pub x: &'a [T],
    /// Control, constant during the step.
    pub u: &'a [T],
}

/// A one-step method for `dx/dt = f(x, u)`.
pub trait Integrator: Clone + Debug + Send + Sync {
    /// Writes the state at the end of the step.
    fn advance<T: Scalar>(&self, ode: &dyn DynOde<T>, step: StepInput<'_, T>, next: &mut [T]);

    /// Largest remaining residual of an implicit step that did not converge, else `None`.
    fn unsolved<F: Float>(&self, _ode: &dyn DynOde<F>, _step: StepInput<'_, F>) -> Option<f64> {
        None
    }

    /// VJP of [`advance`](Integrator::advance). Overwrites `x_bar`; adds to `u_bar` if given.
    fn reverse<R: Real, C: Cotangent<R>>(
        &self,
        ode: &dyn DynOdeVjp<R, C>,
        step: StepInput<'_, R>,
        next_bar: &[C],
        x_bar: &mut [C],
        u_bar: Option<&mut [C]>,
    );
}

/// An [`Ode`] as a [`System`]: each time step is one step of the integrator.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Integrated<O, I> {
    /// The vector field.
    pub ode: O,
    /// The integration method.
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
        self.integrator.advance(&self.ode, StepInput { h: T::lift(self.dt), x, u }, next);
    }

    fn diagnose<F: Float>(&self, x: &[F], u: &[F]) -> Option<Cause> {
        let unsolved = self.integrator.unsolved(&self.ode, StepInput { h: F::lift(self.dt), x, u });
        self.ode.diagnose(x, u).or(unsolved.map(Cause::Unsolved))
    }

    #[inline(always)]
    fn vjp<R: Real, C: Cotangent<R>>(&self, x: &[R], u: &[R], next_bar: &[C], x_bar: &mut [C], u_bar: &mut [C]) {
        u_bar.fill(C::null());
        self.integrator.reverse(&self.ode, StepInput { h: R::lift(self.dt), x, u }, next_bar, x_bar, Some(u_bar));
    }

    #[inline(always)]
    fn vjp_state<R: Real, C: Cotangent<R>>(&self, x: &[R], u: &[R], next_bar: &[C], x_bar: &mut [C]) {
        self.integrator.reverse(&self.ode, StepInput { h: R::lift(self.dt), x, u }, next_bar, x_bar, None);
    }

    /// Needs the full VJP: early stages influence the result through later ones.
    #[inline(always)]
    fn vjp_control<R: Real, C: Cotangent<R>>(&self, x: &[R], u: &[R], next_bar: &[C], u_bar: &mut [C]) {
        let mut x_bar = room(C::null(), x.len());
        self.vjp(x, u, next_bar, &mut x_bar, u_bar);
    }
}

impl<B, O: Ode + HasModel<B>, I: Integrator> HasModel<B> for Integrated<O, I> {
    #[inline(always)]
    fn model(&self) -> &B {
        self.ode.model()
    }

    fn start_extra(&self, rng: &mut Rng, x: &mut [f64]) {
        self.ode.start_extra(rng, x);
    }
}
