//! [`AnyIntegrator`]: an integrator chosen at run time.

use super::{Adaptive, ImplicitMidpoint, Integrator, RungeKutta, SemiImplicit, StepInput, Verlet};
use crate::dynamics::ode::{DynOde, DynOdeVjp, Ode};
use crate::dynamics::outline::outline;
use crate::numbers::kernels::Vectorized;
use crate::numbers::scalar::{Cotangent, Float, Real, Scalar};

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
}

/// A vector field whose evaluations are outlined calls.
pub(super) struct Apart<'a, O>(pub &'a O);

/// Outlined [`Ode::rate`].
struct Rate<'a, O, T> {
    ode: &'a O,
    x: &'a [T],
    u: &'a [T],
    rate: &'a mut [T],
}

impl<O: Ode, T: Scalar> Vectorized for Rate<'_, O, T> {
    #[inline(always)]
    fn run<const FMA: bool>(self) {
        self.ode.rate(self.x, self.u, self.rate);
    }
}

/// Outlined [`Ode::rate_vjp`].
struct RateBack<'a, O, R, C> {
    ode: &'a O,
    x: &'a [R],
    u: &'a [R],
    rate_bar: &'a [C],
    x_bar: &'a mut [C],
    u_bar: Option<&'a mut [C]>,
}

impl<O: Ode, R: Real, C: Cotangent<R>> Vectorized for RateBack<'_, O, R, C> {
    #[inline(always)]
    fn run<const FMA: bool>(self) {
        self.ode.rate_vjp(self.x, self.u, self.rate_bar, self.x_bar, self.u_bar);
    }
}

impl<O: Ode> Ode for Apart<'_, O> {
    fn state_dim(&self) -> usize {
        self.0.state_dim()
    }

    fn control_dim(&self) -> usize {
        self.0.control_dim()
    }

    #[inline(always)]
    fn rate<T: Scalar>(&self, x: &[T], u: &[T], rate: &mut [T]) {
        outline::<T>(Rate { ode: self.0, x, u, rate });
    }

    #[inline(always)]
    fn rate_vjp<R: Real, C: Cotangent<R>>(&self, x: &[R], u: &[R], rate_bar: &[C], x_bar: &mut [C], u_bar: Option<&mut [C]>) {
        outline::<R>(RateBack { ode: self.0, x, u, rate_bar, x_bar, u_bar });
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
    step: StepInput<'a, T>,
    next: &'a mut [T],
}

impl<I: Integrator, T: Scalar> Vectorized for Advance<'_, I, T> {
    #[inline(always)]
    fn run<const FMA: bool>(self) {
        self.method.advance(self.ode, self.step, self.next);
    }
}

/// Outlined [`Integrator::reverse`].
struct Reverse<'a, I, R, C> {
    method: &'a I,
    ode: &'a dyn DynOdeVjp<R, C>,
    step: StepInput<'a, R>,
    next_bar: &'a [C],
    x_bar: &'a mut [C],
    u_bar: Option<&'a mut [C]>,
}

impl<I: Integrator, R: Real, C: Cotangent<R>> Vectorized for Reverse<'_, I, R, C> {
    #[inline(always)]
    fn run<const FMA: bool>(self) {
        let Self { method, ode, step, next_bar, x_bar, u_bar } = self;
        method.reverse(ode, step, next_bar, x_bar, u_bar);
    }
}

impl Integrator for AnyIntegrator {
    #[inline(always)]
    fn advance<T: Scalar>(&self, ode: &dyn DynOde<T>, step: StepInput<'_, T>, next: &mut [T]) {
        match self {
            Self::RungeKutta(method) => outline::<T>(Advance { method, ode, step, next }),
            Self::SemiImplicit(method) => outline::<T>(Advance { method, ode, step, next }),
            Self::Verlet(method) => outline::<T>(Advance { method, ode, step, next }),
            Self::Adaptive(method) => outline::<T>(Advance { method, ode, step, next }),
            Self::ImplicitMidpoint(method) => outline::<T>(Advance { method, ode, step, next }),
        }
    }

    fn unsolved<F: Float>(&self, ode: &dyn DynOde<F>, step: StepInput<'_, F>) -> Option<f64> {
        match self {
            Self::ImplicitMidpoint(method) => method.unsolved(ode, step),
            _ => None,
        }
    }

    #[inline(always)]
    fn reverse<R: Real, C: Cotangent<R>>(
        &self,
        ode: &dyn DynOdeVjp<R, C>,
        step: StepInput<'_, R>,
        next_bar: &[C],
        x_bar: &mut [C],
        u_bar: Option<&mut [C]>,
    ) {
        match self {
            Self::RungeKutta(method) => outline::<R>(Reverse { method, ode, step, next_bar, x_bar, u_bar }),
            Self::SemiImplicit(method) => outline::<R>(Reverse { method, ode, step, next_bar, x_bar, u_bar }),
            Self::Verlet(method) => outline::<R>(Reverse { method, ode, step, next_bar, x_bar, u_bar }),
            Self::Adaptive(method) => outline::<R>(Reverse { method, ode, step, next_bar, x_bar, u_bar }),
            Self::ImplicitMidpoint(method) => outline::<R>(Reverse { method, ode, step, next_bar, x_bar, u_bar }),
        }
    }
}
