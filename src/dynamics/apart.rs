//! Work that is compiled apart from the loops that need it.

use crate::dynamics::system::System;
use crate::numbers::kernels::{Vectorized, dispatch_lanes};
use crate::numbers::scalar::{Columns, Cotangent, Float, Real, Scalar};

/// Runs it with the instructions of this processor, and is never inlined: what is chosen while the program runs is in
/// every loop of every system, and with all choices inlined such a loop takes minutes to compile.
///
/// Numbers that no rollout runs on take the portable path alone: nobody waits for them.
#[inline(always)]
pub(crate) fn apart<T: Scalar>(work: impl Vectorized) {
    #[inline(never)]
    fn best(work: impl Vectorized) {
        dispatch_lanes(work);
    }
    #[inline(never)]
    fn portable(work: impl Vectorized) {
        work.run::<false>();
    }
    if T::WIDE { best(work) } else { portable(work) }
}

/// A step of a system, to be compiled apart: what chooses while the program runs is a call, and what is around it may have
/// several.
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

/// [`System::step`] in one place for each kind of number: simulators are inlined wherever they are called, and checks call them
/// from many places, and are in no hurry.
#[inline(never)]
pub(crate) fn step<S: System + ?Sized, T: Scalar>(system: &S, x: &[T], u: &[T], next: &mut [T]) {
    system.step(x, u, next);
}

/// [`System::vjp`], likewise, of the columns that rollouts have.
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

/// What a reverse pass of one flow carries.
pub(crate) type One<F> = Columns<F, 1>;

/// Its reverse. To the state alone nothing asks for it but checks, which get it from here as well.
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

/// Its reverse to the control alone.
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
