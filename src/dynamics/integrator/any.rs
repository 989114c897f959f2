//! [`AnyIntegrator`]: an integrator chosen at run time.

use super::{Adaptive, ImplicitMidpoint, Integrator, RungeKutta, Sdirk2, SemiImplicit, Verlet};
use crate::dynamics::inputs::{Cotangents, Inputs, OdeInputs};
use crate::dynamics::ode::{DynOde, DynOdeVjp, Ode};
use crate::dynamics::outline::outline;
use crate::numbers::kernels::Vectorized;
use crate::numbers::scalar::{Cotangent, Real, Scalar};

/// An integrator chosen at run time.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum AnyIntegrator {
    /// [`RungeKutta`], any tableau.
    RungeKutta(RungeKutta),
    /// [`SemiImplicit`].
    SemiImplicit(SemiImplicit),
    /// [`Verlet`].
    Verlet(Verlet),
    /// [`Adaptive`].
    Adaptive(Adaptive),
    /// [`ImplicitMidpoint`].
    ImplicitMidpoint(ImplicitMidpoint),
    /// [`Sdirk2`].
    Sdirk2(Sdirk2),
}

/// A vector field whose evaluations are outlined calls.
pub(super) struct Outlined<'a, O>(pub &'a O);

/// Outlined [`Ode::rate`].
struct Rate<'a, O, T> {
    ode: &'a O,
    inputs: OdeInputs<'a, T>,
    rate: &'a mut [T],
}

impl<O: Ode, T: Scalar> Vectorized for Rate<'_, O, T> {
    #[inline(always)]
    fn run<const FMA: bool>(self) {
        self.ode.rate(self.inputs, self.rate);
    }
}

/// Outlined [`Ode::rate_vjp`].
struct RateBack<'a, O, R, C> {
    ode: &'a O,
    inputs: OdeInputs<'a, R>,
    rate_bar: &'a [C],
    cotangents: Cotangents<'a, C>,
}

impl<O: Ode, R: Real, C: Cotangent<R>> Vectorized for RateBack<'_, O, R, C> {
    #[inline(always)]
    fn run<const FMA: bool>(self) {
        self.ode.rate_vjp(self.inputs, self.rate_bar, self.cotangents);
    }
}

impl<O: Ode> Ode for Outlined<'_, O> {
    fn state_dim(&self) -> usize {
        self.0.state_dim()
    }

    fn control_dim(&self) -> usize {
        self.0.control_dim()
    }

    fn param_dim(&self) -> usize {
        self.0.param_dim()
    }

    #[inline(always)]
    fn rate<T: Scalar>(&self, inputs: OdeInputs<'_, T>, rate: &mut [T]) {
        outline::<T>(Rate { ode: self.0, inputs, rate });
    }

    #[inline(always)]
    fn rate_vjp<R: Real, C: Cotangent<R>>(
        &self,
        inputs: OdeInputs<'_, R>,
        rate_bar: &[C],
        cotangents: Cotangents<'_, C>,
    ) {
        outline::<R>(RateBack { ode: self.0, inputs, rate_bar, cotangents });
    }

    #[inline(always)]
    fn velocity(&self, i: usize) -> Option<usize> {
        self.0.velocity(i)
    }
}

/// Outlined [`Integrator::advance`]. Inlining would compile all methods into every loop over
/// samples.
struct Advance<'a, I, T> {
    method: &'a I,
    ode: &'a dyn DynOde<T>,
    dt: f64,
    inputs: Inputs<'a, T>,
    next: &'a mut [T],
}

impl<I: Integrator, T: Scalar> Vectorized for Advance<'_, I, T> {
    #[inline(always)]
    fn run<const FMA: bool>(self) {
        self.method.advance(self.ode, self.dt, self.inputs, self.next);
    }
}

/// Outlined [`Integrator::vjp`].
struct IntegratorVjp<'a, I, R, C> {
    method: &'a I,
    ode: &'a dyn DynOdeVjp<R, C>,
    dt: f64,
    inputs: Inputs<'a, R>,
    next_bar: &'a [C],
    cotangents: Cotangents<'a, C>,
}

impl<I: Integrator, R: Real, C: Cotangent<R>> Vectorized for IntegratorVjp<'_, I, R, C> {
    #[inline(always)]
    fn run<const FMA: bool>(self) {
        let Self { method, ode, dt, inputs, next_bar, cotangents } = self;
        method.vjp(ode, dt, inputs, next_bar, cotangents);
    }
}

impl Integrator for AnyIntegrator {
    #[inline(always)]
    fn advance<T: Scalar>(
        &self,
        ode: &dyn DynOde<T>,
        dt: f64,
        inputs: Inputs<'_, T>,
        next: &mut [T],
    ) {
        match self {
            Self::RungeKutta(method) => outline::<T>(Advance { method, ode, dt, inputs, next }),
            Self::SemiImplicit(method) => outline::<T>(Advance { method, ode, dt, inputs, next }),
            Self::Verlet(method) => outline::<T>(Advance { method, ode, dt, inputs, next }),
            Self::Adaptive(method) => outline::<T>(Advance { method, ode, dt, inputs, next }),
            Self::ImplicitMidpoint(method) => {
                outline::<T>(Advance { method, ode, dt, inputs, next })
            }
            Self::Sdirk2(method) => outline::<T>(Advance { method, ode, dt, inputs, next }),
        }
    }

    fn unsolved<R: Real>(
        &self,
        ode: &dyn DynOde<R>,
        dt: f64,
        inputs: Inputs<'_, R>,
    ) -> Option<f64> {
        match self {
            Self::ImplicitMidpoint(method) => method.unsolved(ode, dt, inputs),
            Self::Sdirk2(method) => method.unsolved(ode, dt, inputs),
            _ => None,
        }
    }

    #[inline(always)]
    fn vjp<R: Real, C: Cotangent<R>>(
        &self,
        ode: &dyn DynOdeVjp<R, C>,
        dt: f64,
        inputs: Inputs<'_, R>,
        next_bar: &[C],
        cotangents: Cotangents<'_, C>,
    ) {
        match self {
            Self::RungeKutta(method) => {
                outline::<R>(IntegratorVjp { method, ode, dt, inputs, next_bar, cotangents })
            }
            Self::SemiImplicit(method) => {
                outline::<R>(IntegratorVjp { method, ode, dt, inputs, next_bar, cotangents })
            }
            Self::Verlet(method) => {
                outline::<R>(IntegratorVjp { method, ode, dt, inputs, next_bar, cotangents })
            }
            Self::Adaptive(method) => {
                outline::<R>(IntegratorVjp { method, ode, dt, inputs, next_bar, cotangents })
            }
            Self::ImplicitMidpoint(method) => {
                outline::<R>(IntegratorVjp { method, ode, dt, inputs, next_bar, cotangents })
            }
            Self::Sdirk2(method) => {
                outline::<R>(IntegratorVjp { method, ode, dt, inputs, next_bar, cotangents })
            }
        }
    }
}
