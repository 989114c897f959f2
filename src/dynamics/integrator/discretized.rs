//! [`Discretized`]: run-time choice between the native scheme of a system and an integrator.

use super::any::Apart;
use super::{AnyIntegrator, Integrator, StepInput, room};
use crate::dynamics::cause::Cause;
use crate::dynamics::effect::HasModel;
use crate::dynamics::ode::Ode;
use crate::dynamics::outline::{Reverse, ReverseToControl, Step, outline};
use crate::dynamics::system::System;
use crate::numbers::rng::Rng;
use crate::numbers::scalar::{Cotangent, Float, Real, Scalar};

/// A system that is also a vector field, advanced by its native scheme or by an integrator.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Discretized<S> {
    /// The system. The time step of the native scheme must equal `dt`.
    pub system: S,
    /// The integrator; `None` selects the native scheme, [`System::step`].
    pub integrator: Option<AnyIntegrator>,
    /// Time step, s.
    pub dt: f64,
}

impl<S: System + Ode> System for Discretized<S> {
    fn state_dim(&self) -> usize {
        System::state_dim(&self.system)
    }

    fn control_dim(&self) -> usize {
        System::control_dim(&self.system)
    }

    #[inline(always)]
    fn step<T: Scalar>(&self, x: &[T], u: &[T], next: &mut [T]) {
        match &self.integrator {
            None => outline::<T>(Step { system: &self.system, x, u, next }),
            Some(integrator) => integrator.advance(&Apart(&self.system), StepInput { h: T::lift(self.dt), x, u }, next),
        }
    }

    fn diagnose<F: Float>(&self, x: &[F], u: &[F]) -> Option<Cause> {
        let step = StepInput { h: F::lift(self.dt), x, u };
        let unsolved = self.integrator.as_ref().and_then(|integrator| integrator.unsolved(&Apart(&self.system), step));
        System::diagnose(&self.system, x, u).or(unsolved.map(Cause::Unsolved))
    }

    #[inline(always)]
    fn vjp<R: Real, C: Cotangent<R>>(&self, x: &[R], u: &[R], next_bar: &[C], x_bar: &mut [C], u_bar: &mut [C]) {
        match &self.integrator {
            None => outline::<R>(Reverse { system: &self.system, x, u, next_bar, x_bar, u_bar }),
            Some(integrator) => {
                u_bar.fill(C::null());
                integrator.reverse(&Apart(&self.system), StepInput { h: R::lift(self.dt), x, u }, next_bar, x_bar, Some(u_bar));
            }
        }
    }

    #[inline(always)]
    fn vjp_state<R: Real, C: Cotangent<R>>(&self, x: &[R], u: &[R], next_bar: &[C], x_bar: &mut [C]) {
        self.vjp(x, u, next_bar, x_bar, &mut room(C::null(), u.len()));
    }

    #[inline(always)]
    fn vjp_control<R: Real, C: Cotangent<R>>(&self, x: &[R], u: &[R], next_bar: &[C], u_bar: &mut [C]) {
        if self.integrator.is_none() {
            return outline::<R>(ReverseToControl { system: &self.system, x, u, next_bar, u_bar });
        }
        let mut x_bar = room(C::null(), x.len());
        self.vjp(x, u, next_bar, &mut x_bar, u_bar);
    }
}

impl<B, S: Ode + HasModel<B>> HasModel<B> for Discretized<S> {
    #[inline(always)]
    fn model(&self) -> &B {
        self.system.model()
    }

    fn start_extra(&self, rng: &mut Rng, x: &mut [f64]) {
        self.system.start_extra(rng, x);
    }
}
