//! Outlined code, monomorphized once per scalar type.
//!
//! Steps and effects are `#[inline(always)]`. Without outlining, every run-time choice would be
//! inlined into every loop over samples, which slows compilation.

use crate::dynamics::inputs::{Cotangents, Inputs};
use crate::dynamics::system::System;
use crate::numbers::kernels::{Vectorized, dispatch_lanes};
use crate::numbers::scalar::{Cotangent, CotangentPack, Real, Scalar};

/// Runs `work` outlined, vectorized for this processor.
///
/// Scalar types other than the lanes of rollouts (`T::VECTORIZED` is false) take the portable path.
/// Work on such types is not performance-critical.
#[inline(always)]
pub fn outline<T: Scalar>(work: impl Vectorized) {
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
pub(crate) struct OutlinedStep<'a, S, T> {
    pub(crate) system: &'a S,
    pub(crate) inputs: Inputs<'a, T>,
    pub(crate) next: &'a mut [T],
}

impl<S: System, T: Scalar> Vectorized for OutlinedStep<'_, S, T> {
    #[inline(always)]
    fn run<const FMA: bool>(self) {
        self.system.step(self.inputs, self.next);
    }
}

/// [`System::step`], never inlined. Callers are less performance-critical than rollouts: checks,
/// Jacobian-vector products, derivatives with respect to parameters, optimization, identification.
#[inline(never)]
pub(crate) fn step<S: System + ?Sized, T: Scalar>(
    system: &S,
    inputs: Inputs<'_, T>,
    next: &mut [T],
) {
    system.step(inputs, next);
}

/// [`System::vjp`] with the cotangents of one flow, never inlined.
#[inline(never)]
pub(crate) fn vjp<S: System + ?Sized, R: Real>(
    system: &S,
    inputs: Inputs<'_, R>,
    next_bar: &[One<R>],
    cotangents: Cotangents<'_, One<R>>,
) {
    system.vjp(inputs, next_bar, cotangents);
}

/// Cotangent of the reverse pass of one flow.
pub(crate) type One<F> = CotangentPack<F, 1>;

/// Outlined [`System::vjp`], to be run by [`outline`].
pub(crate) struct OutlinedVjp<'a, S, R, C> {
    pub(crate) system: &'a S,
    pub(crate) inputs: Inputs<'a, R>,
    pub(crate) next_bar: &'a [C],
    pub(crate) cotangents: Cotangents<'a, C>,
}

impl<S: System, R: Real, C: Cotangent<R>> Vectorized for OutlinedVjp<'_, S, R, C> {
    #[inline(always)]
    fn run<const FMA: bool>(self) {
        let Self { system, inputs, next_bar, cotangents } = self;
        match cotangents {
            // Most reverse passes request state and control. Known requests compile to no branches.
            Cotangents { x: Some(x), u: Some(u), p: None } => {
                system.vjp(inputs, next_bar, Cotangents::of(x, u))
            }
            cotangents => system.vjp(inputs, next_bar, cotangents),
        }
    }
}
