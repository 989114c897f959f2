//! [`Integrator`]: discretizes an [`Ode`] into a [`System`].
//!
//! - Explicit methods: [`RungeKutta`], [`Adaptive`].
//! - Methods for mechanics: [`SemiImplicit`], [`Verlet`].
//! - Stiff systems: [`ImplicitMidpoint`], and [`Sdirk2`], which damps stiff components.
//! - Choice at run time: [`AnyIntegrator`], [`Discretized`].
//!
//! Each integrator has an analytic VJP for all vector fields (discretize, then differentiate).
//! Gradients are therefore exact for the computed trajectory. The VJP recomputes the stages of a
//! step. Start with [`Integrated`].

mod adaptive;
mod any;
mod discretized;
mod implicit;
mod newton;
mod partitioned;
mod runge_kutta;
mod sdirk;

pub use adaptive::Adaptive;
pub use any::AnyIntegrator;
pub use discretized::Discretized;
pub use implicit::ImplicitMidpoint;
pub use partitioned::{SemiImplicit, Verlet};
pub use runge_kutta::RungeKutta;
pub use sdirk::Sdirk2;

use crate::dynamics::cause::Cause;
use crate::dynamics::effect::HasModel;
use crate::dynamics::forward::{forward, forward_model};
use crate::dynamics::inputs::{Cotangents, Inputs};
use crate::dynamics::ode::{DynOde, DynOdeVjp, Ode};
use crate::dynamics::system::System;
use crate::numbers::scalar::{Cotangent, Real, Scalar};
use smallvec::{SmallVec, smallvec};
use std::fmt::Debug;

/// Workspace of one step. Every step allocates each buffer of more than 64 numbers.
type Buffer<T> = SmallVec<[T; 64]>;

/// A workspace of `len` copies of `value`.
#[inline(always)]
fn buffer<T: Copy>(value: T, len: usize) -> Buffer<T> {
    smallvec![value; len]
}

/// Time in s at a fraction of step number `step`, with steps of `dt` seconds.
#[inline(always)]
fn stage_time<T: Scalar>(step: usize, dt: f64, fraction: f64) -> T {
    T::from((step as f64 + fraction) * dt)
}

/// A one-step method for `dx/dt = f(x, u, p, t)` with steps of `dt` seconds.
pub trait Integrator: Clone + Debug + Send + Sync {
    /// Writes the state at the end of the step.
    fn advance<T: Scalar>(
        &self,
        ode: &dyn DynOde<T>,
        dt: f64,
        inputs: Inputs<'_, T>,
        next: &mut [T],
    );

    /// Returns the largest absolute residual of a state component if an implicit step did not
    /// converge, else `None`. Infinite if a residual is NaN.
    fn unsolved<R: Real>(
        &self,
        _ode: &dyn DynOde<R>,
        _dt: f64,
        _inputs: Inputs<'_, R>,
    ) -> Option<f64> {
        None
    }

    /// VJP of [`advance`](Integrator::advance). Adds to the requested cotangents.
    fn vjp<R: Real, C: Cotangent<R>>(
        &self,
        ode: &dyn DynOdeVjp<R, C>,
        dt: f64,
        inputs: Inputs<'_, R>,
        next_bar: &[C],
        cotangents: Cotangents<'_, C>,
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
    forward!(Ode of ode: state_dim, control_dim, param_dim, varied);

    #[inline(always)]
    fn step<T: Scalar>(&self, inputs: Inputs<'_, T>, next: &mut [T]) {
        self.integrator.advance(&self.ode, self.dt, inputs, next);
    }

    #[inline(always)]
    fn vjp<R: Real, C: Cotangent<R>>(
        &self,
        inputs: Inputs<'_, R>,
        next_bar: &[C],
        cotangents: Cotangents<'_, C>,
    ) {
        self.integrator.vjp(&self.ode, self.dt, inputs, next_bar, cotangents);
    }

    fn diagnose<R: Real>(&self, inputs: Inputs<'_, R>) -> Option<Cause> {
        let unsolved = self.integrator.unsolved(&self.ode, self.dt, inputs);
        self.ode.diagnose(inputs.continuous(self.dt)).or(unsolved.map(Cause::Unsolved))
    }
}

impl<B, O: Ode + HasModel<B>, I: Integrator> HasModel<B> for Integrated<O, I> {
    forward_model!(ode, B);
}
