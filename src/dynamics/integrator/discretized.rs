//! [`Discretized`]: run-time choice between the native scheme of a system and an integrator.

use super::any::Outlined;
use super::{AnyIntegrator, Integrator};
use crate::dynamics::cause::Cause;
use crate::dynamics::effect::HasModel;
use crate::dynamics::forward::{forward, forward_model};
use crate::dynamics::inputs::{Cotangents, Inputs};
use crate::dynamics::ode::Ode;
use crate::dynamics::outline::{OutlinedStep, OutlinedVjp, outline};
use crate::dynamics::system::System;
use crate::numbers::scalar::{Cotangent, Real, Scalar};

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
    forward!(System of system: state_dim, control_dim, param_dim, varied);

    #[inline(always)]
    fn step<T: Scalar>(&self, inputs: Inputs<'_, T>, next: &mut [T]) {
        match &self.integrator {
            None => outline::<T>(OutlinedStep { system: &self.system, inputs, next }),
            Some(integrator) => integrator.advance(&Outlined(&self.system), self.dt, inputs, next),
        }
    }

    #[inline(always)]
    fn vjp<R: Real, C: Cotangent<R>>(
        &self,
        inputs: Inputs<'_, R>,
        next_bar: &[C],
        cotangents: Cotangents<'_, C>,
    ) {
        match &self.integrator {
            None => {
                outline::<R>(OutlinedVjp { system: &self.system, inputs, next_bar, cotangents })
            }
            Some(integrator) => {
                integrator.vjp(&Outlined(&self.system), self.dt, inputs, next_bar, cotangents)
            }
        }
    }

    fn diagnose<R: Real>(&self, inputs: Inputs<'_, R>) -> Option<Cause> {
        let unsolved = self
            .integrator
            .as_ref()
            .and_then(|method| method.unsolved(&Outlined(&self.system), self.dt, inputs));
        System::diagnose(&self.system, inputs).or(unsolved.map(Cause::Unsolved))
    }
}

impl<B, S: Ode + HasModel<B>> HasModel<B> for Discretized<S> {
    forward_model!(system, B);
}
