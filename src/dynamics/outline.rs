//! Outlined code, monomorphized once per scalar type.
//!
//! Simulators are `#[inline(always)]`. Without outlining, every run-time choice would be inlined
//! into every loop over samples, which slows compilation.

use crate::dynamics::system::System;
use crate::numbers::kernels::{Vectorized, dispatch_lanes};
use crate::numbers::scalar::{Cotangent, CotangentPack, Float, Real, Scalar};

/// Runs `work` outlined, vectorized for this processor.
///
/// Scalar types other than the lanes of rollouts (`T::VECTORIZED` is false) take the portable path.
/// They are not performance-critical.
#[inline(always)]
pub(crate) fn outline<T: Scalar>(work: impl Vectorized) {
    #[inline(never)]
    fn best(work: impl Vectorized) {
        dispatch_lanes(work);
    }
    #[inline(never)]
    fn portable(work: impl Vectorized) {
        work.run::<false>();
    }
    if T::VECTORIZED { best(work) } else { portable(work) }
}

/// Outlined [`System::step`], to be run by [`outline`].
pub(crate) struct Step<'a, S, T> {
    pub(crate) system: &'a S,
    pub(crate) x: &'a [T],
    pub(crate) u: &'a [T],
    pub(crate) next: &'a mut [T],
}

impl<S: System, T: Scalar> Vectorized for Step<'_, S, T> {
    #[inline(always)]
    fn run<const FMA: bool>(self) {
        self.system.step(self.x, self.u, self.next);
    }
}

/// [`System::step`], never inlined. Used by checks and default derivatives, which have many call
/// sites and are not performance-critical.
#[inline(never)]
pub(crate) fn step<S: System + ?Sized, T: Scalar>(system: &S, x: &[T], u: &[T], next: &mut [T]) {
    system.step(x, u, next);
}

/// [`System::vjp`] with one cotangent column, never inlined.
#[inline(never)]
pub(crate) fn vjp<S: System + ?Sized, F: Float>(
    system: &S,
    x: &[F],
    u: &[F],
    next_bar: &[One<F>],
    x_bar: &mut [One<F>],
    u_bar: &mut [One<F>],
) {
    system.vjp(x, u, next_bar, x_bar, u_bar);
}

/// Cotangent of the reverse pass of one flow.
pub(crate) type One<F> = CotangentPack<F, 1>;

/// Outlined [`System::vjp`], to be run by [`outline`].
///
/// Also serves [`System::vjp_state`], which is used only by checks.
pub(crate) struct Reverse<'a, S, R, C> {
    pub(crate) system: &'a S,
    pub(crate) x: &'a [R],
    pub(crate) u: &'a [R],
    pub(crate) next_bar: &'a [C],
    pub(crate) x_bar: &'a mut [C],
    pub(crate) u_bar: &'a mut [C],
}

impl<S: System, R: Real, C: Cotangent<R>> Vectorized for Reverse<'_, S, R, C> {
    #[inline(always)]
    fn run<const FMA: bool>(self) {
        let Self { system, x, u, next_bar, x_bar, u_bar } = self;
        system.vjp(x, u, next_bar, x_bar, u_bar);
    }
}

/// Outlined [`System::vjp_control`], to be run by [`outline`].
pub(crate) struct ReverseToControl<'a, S, R, C> {
    pub(crate) system: &'a S,
    pub(crate) x: &'a [R],
    pub(crate) u: &'a [R],
    pub(crate) next_bar: &'a [C],
    pub(crate) u_bar: &'a mut [C],
}

impl<S: System, R: Real, C: Cotangent<R>> Vectorized for ReverseToControl<'_, S, R, C> {
    #[inline(always)]
    fn run<const FMA: bool>(self) {
        let Self { system, x, u, next_bar, u_bar } = self;
        system.vjp_control(x, u, next_bar, u_bar);
    }
}
