//! [`Substeps`]: several inner time steps per control.

use crate::dynamics::cause::Cause;
use crate::dynamics::effect::HasModel;
use crate::dynamics::system::System;
use crate::numbers::rng::Rng;
use crate::numbers::scalar::{Cotangent, Float, Real, Scalar};
use crate::numbers::zip::zip;
use smallvec::{SmallVec, smallvec};

/// Stack capacity for the intermediate states of one step, in numbers. Beyond it, every step
/// allocates.
const STACK: usize = 128;

/// A system whose time step consists of `count` steps of an inner system, with constant control.
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
    /// Initial states of the inner steps, concatenated.
    #[inline(always)]
    fn states<R: Real>(&self, x: &[R], u: &[R]) -> SmallVec<[R; STACK]> {
        let n = x.len();
        let mut states: SmallVec<[R; STACK]> = smallvec![R::zero(); n * self.count.max(1)];
        states[..n].copy_from_slice(x);
        for i in 1..self.count {
            let (before, after) = states.split_at_mut(n * i);
            self.system.step(&before[n * (i - 1)..], u, &mut after[..n]);
        }
        states
    }
}

impl<S: System> System for Substeps<S> {
    fn state_dim(&self) -> usize {
        self.system.state_dim()
    }

    fn control_dim(&self) -> usize {
        self.system.control_dim()
    }

    #[inline(always)]
    fn step<T: Scalar>(&self, x: &[T], u: &[T], next: &mut [T]) {
        self.system.step(x, u, next);
        let mut state: SmallVec<[T; STACK]> = smallvec![T::zero(); if self.count > 1 { x.len() } else { 0 }];
        for _ in 1..self.count {
            state.copy_from_slice(next);
            self.system.step(&state, u, next);
        }
    }

    fn diagnose<F: Float>(&self, x: &[F], u: &[F]) -> Option<Cause> {
        // Stop at the first non-finite state: a diagnosis requires a finite one.
        let is_finite = |state: &&[F]| state.iter().all(|number| number.as_().is_finite());
        self.states(x, u).chunks_exact(x.len()).take_while(is_finite).find_map(|state| self.system.diagnose(state, u))
    }

    #[inline(always)]
    fn vjp<R: Real, C: Cotangent<R>>(&self, x: &[R], u: &[R], next_bar: &[C], x_bar: &mut [C], u_bar: &mut [C]) {
        if self.count == 1 {
            return self.system.vjp(x, u, next_bar, x_bar, u_bar);
        }
        let mut bar: SmallVec<[C; STACK / 2]> = SmallVec::from_slice(next_bar);
        let mut part: SmallVec<[C; 8]> = smallvec![C::null(); u.len()];
        u_bar.fill(C::null());
        for state in self.states(x, u).chunks_exact(x.len()).rev() {
            self.system.vjp(state, u, &bar, x_bar, &mut part);
            bar.copy_from_slice(x_bar);
            for (u_bar, &part) in zip(u_bar.iter_mut(), &part) {
                *u_bar += part;
            }
        }
    }

    #[inline(always)]
    fn vjp_state<R: Real, C: Cotangent<R>>(&self, x: &[R], u: &[R], next_bar: &[C], x_bar: &mut [C]) {
        if self.count == 1 {
            return self.system.vjp_state(x, u, next_bar, x_bar);
        }
        let mut bar: SmallVec<[C; STACK / 2]> = SmallVec::from_slice(next_bar);
        for state in self.states(x, u).chunks_exact(x.len()).rev() {
            self.system.vjp_state(state, u, &bar, x_bar);
            bar.copy_from_slice(x_bar);
        }
    }

    /// Needs the full VJP: early inner steps influence the result through later states.
    #[inline(always)]
    fn vjp_control<R: Real, C: Cotangent<R>>(&self, x: &[R], u: &[R], next_bar: &[C], u_bar: &mut [C]) {
        if self.count == 1 {
            return self.system.vjp_control(x, u, next_bar, u_bar);
        }
        let mut x_bar: SmallVec<[C; STACK / 2]> = smallvec![C::null(); x.len()];
        self.vjp(x, u, next_bar, &mut x_bar, u_bar);
    }
}

impl<B, S: HasModel<B>> HasModel<B> for Substeps<S> {
    #[inline(always)]
    fn model(&self) -> &B {
        self.system.model()
    }

    fn start_extra(&self, rng: &mut Rng, x: &mut [f64]) {
        self.system.start_extra(rng, x);
    }
}
