//! [`Substeps`]: several small steps for each one that the policy sees.

use crate::divergence::Cause;
use crate::effect::Around;
use crate::rng::Rng;
use crate::scalar::{Cotangent, Float, Real, Scalar};
use crate::system::System;
use crate::zip::zip;
use smallvec::{SmallVec, smallvec};

/// Numbers that all states within a step may have to be kept on the stack; more are allocated in every step.
const STACK: usize = 128;

/// A system that takes `count` steps of its own, under the same control, for one of this one.
///
/// The reverse pass computes the states in between again rather than storing them.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Substeps<S> {
    /// The system that takes the small steps: its time step is one of them.
    pub system: S,
    /// How many, at least 1.
    pub count: usize,
}

impl<S: System> Substeps<S> {
    /// The states in which the small steps begin.
    #[inline(always)]
    fn states<R: Real>(&self, x: &[R], u: &[R]) -> SmallVec<[R; STACK]> {
        let n = x.len();
        let mut states: SmallVec<[R; STACK]> = smallvec![R::zero(); n * self.count];
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

    fn cause<F: Float>(&self, x: &[F], u: &[F]) -> Option<Cause> {
        // From the first state that is not finite on, everything looks like a cause.
        let is_finite = |state: &&[F]| state.iter().all(|number| number.as_().is_finite());
        self.states(x, u).chunks_exact(x.len()).take_while(is_finite).find_map(|state| self.system.cause(state, u))
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

    /// The control of one small step reaches the end through the state of those after it.
    #[inline(always)]
    fn vjp_control<R: Real, C: Cotangent<R>>(&self, x: &[R], u: &[R], next_bar: &[C], u_bar: &mut [C]) {
        if self.count == 1 {
            return self.system.vjp_control(x, u, next_bar, u_bar);
        }
        let mut x_bar: SmallVec<[C; STACK / 2]> = smallvec![C::null(); x.len()];
        self.vjp(x, u, next_bar, &mut x_bar, u_bar);
    }
}

impl<B, S: Around<B>> Around<B> for Substeps<S> {
    #[inline(always)]
    fn body(&self) -> &B {
        self.system.body()
    }

    fn start_beyond(&self, rng: &mut Rng, x: &mut [f64]) {
        self.system.start_beyond(rng, x);
    }
}
