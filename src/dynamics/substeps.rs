//! [`Substeps`]: several inner time steps per control.

use crate::dynamics::cause::Cause;
use crate::dynamics::effect::HasModel;
use crate::dynamics::forward::{forward, forward_model};
use crate::dynamics::inputs::{Cotangents, Inputs, Tangents, add};
use crate::dynamics::system::System;
use crate::numbers::scalar::{Cotangent, Real, Scalar};
use smallvec::{SmallVec, smallvec};

/// Largest total length of the states of all inner steps for which a VJP does not allocate.
const STACK: usize = 128;

/// A system whose time step consists of `count` steps of an inner system, with constant control.
///
/// The inner steps of step t have the numbers `count t .. count (t + 1)`.
///
/// The reverse pass recomputes the intermediate states.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Substeps<S> {
    /// The inner system.
    pub system: S,
    /// Number of inner steps; 0 counts as 1.
    pub count: usize,
}

impl<S: System> Substeps<S> {
    /// Inputs of inner step `i`, with the state of `inputs`. Callers replace the state if `i > 0`.
    #[inline(always)]
    fn inner<'a, T: Scalar>(&self, inputs: Inputs<'a, T>, i: usize) -> Inputs<'a, T> {
        inputs.at(inputs.t * self.count.max(1) + i)
    }

    /// Initial states of the inner steps, concatenated.
    #[inline(always)]
    fn states<R: Real>(&self, inputs: Inputs<'_, R>) -> SmallVec<[R; STACK]> {
        let n = inputs.x.len();
        let mut states: SmallVec<[R; STACK]> = smallvec![R::zero(); n * self.count.max(1)];
        states[..n].copy_from_slice(inputs.x);
        for i in 1..self.count {
            let (before, after) = states.split_at_mut(n * i);
            self.system
                .step(self.inner(inputs, i - 1).with_x(&before[n * (i - 1)..]), &mut after[..n]);
        }
        states
    }
}

impl<S: System> System for Substeps<S> {
    forward!(System of system: state_dim, control_dim, param_dim, varied);

    #[inline(always)]
    fn step<T: Scalar>(&self, inputs: Inputs<'_, T>, next: &mut [T]) {
        self.system.step(self.inner(inputs, 0), next);
        let mut state: SmallVec<[T; STACK]> =
            smallvec![T::zero(); if self.count > 1 { next.len() } else { 0 }];
        for i in 1..self.count {
            state.copy_from_slice(next);
            self.system.step(self.inner(inputs, i).with_x(&state), next);
        }
    }

    /// With two or more inner steps, computes the state cotangent even if it is not requested.
    /// Early inner steps influence the result through later states.
    #[inline(always)]
    fn vjp<R: Real, C: Cotangent<R>>(
        &self,
        inputs: Inputs<'_, R>,
        next_bar: &[C],
        mut cotangents: Cotangents<'_, C>,
    ) {
        if self.count <= 1 {
            return self.system.vjp(inputs, next_bar, cotangents);
        }
        let n = inputs.x.len();
        let mut bar: SmallVec<[C; STACK / 2]> = SmallVec::from_slice(next_bar);
        let mut before: SmallVec<[C; STACK / 2]> = smallvec![C::null(); n];
        for (i, state) in self.states(inputs).chunks_exact(n).enumerate().rev() {
            before.fill(C::null());
            let mut step_bars = cotangents.reborrow();
            step_bars.x = Some(&mut before);
            self.system.vjp(self.inner(inputs, i).with_x(state), &bar, step_bars);
            std::mem::swap(&mut bar, &mut before);
        }
        if let Some(x_bar) = cotangents.x {
            add(x_bar, &bar);
        }
    }

    fn jvp<R: Real>(&self, inputs: Inputs<'_, R>, tangents: Tangents<'_, R>, next_tan: &mut [R]) {
        if self.count <= 1 {
            return self.system.jvp(self.inner(inputs, 0), tangents, next_tan);
        }
        let states = self.states(inputs);
        let mut state_tan: SmallVec<[R; STACK]> = SmallVec::new();
        for (i, state) in states.chunks_exact(inputs.x.len()).enumerate() {
            let x = if i == 0 { tangents.x } else { Some(&state_tan[..]) };
            self.system.jvp(
                self.inner(inputs, i).with_x(state),
                Tangents { x, ..tangents },
                next_tan,
            );
            state_tan = SmallVec::from_slice(next_tan);
        }
    }

    fn diagnose<R: Real>(&self, inputs: Inputs<'_, R>) -> Option<Cause> {
        // Stops at the first non-finite state: a diagnosis requires a finite one.
        let is_finite = |(_, state): &(usize, &[R])| state.iter().all(Real::is_finite);
        let states = self.states(inputs);
        let mut finite = states.chunks_exact(inputs.x.len()).enumerate().take_while(is_finite);
        finite.find_map(|(i, state)| self.system.diagnose(self.inner(inputs, i).with_x(state)))
    }
}

impl<B, S: HasModel<B>> HasModel<B> for Substeps<S> {
    forward_model!(system, B);
}
