//! Chains of actuators chosen at run time.

use super::{Actuator, Controls, OutputCotangents, STACK};
use crate::dynamics::inputs::add;
use crate::dynamics::outline::outline;
use crate::numbers::kernels::Vectorized;
use crate::numbers::scalar::{Cotangent, Real, Scalar};
use smallvec::{SmallVec, smallvec};

/// Composition in order, bit-identical to nested pairs. Outlines steps and VJPs, because inlining
/// every actuator into every loop over samples slows compilation.
impl<A: Actuator> Actuator for Vec<A> {
    fn state_dim(&self, controls: usize) -> usize {
        self.iter().map(|actuator| actuator.state_dim(controls)).sum()
    }

    /// The range of the first actuator that has one.
    fn range(&self) -> Option<[f64; 2]> {
        self.iter().find_map(Actuator::range)
    }

    #[inline(always)]
    fn is_identity(&self) -> bool {
        self.is_empty()
    }

    #[inline(always)]
    fn step<T: Scalar>(&self, state: &[T], u: &[T], next_state: &mut [T], out: &mut [T]) {
        outline::<T>(Step { chain: self, state, u, next_state, out });
    }

    #[inline(always)]
    fn vjp<R: Real, C: Cotangent<R>>(
        &self,
        state: &[R],
        u: &[R],
        next_bar: OutputCotangents<'_, C>,
        state_bar: Option<&mut [C]>,
        u_bar: Option<&mut [C]>,
    ) {
        outline::<R>(Reverse { chain: self, state, u, next_bar, state_bar, u_bar });
    }
}

/// Outlined [`Actuator::step`] of a chain.
struct Step<'a, A, T> {
    chain: &'a [A],
    state: &'a [T],
    u: &'a [T],
    next_state: &'a mut [T],
    out: &'a mut [T],
}

impl<A: Actuator, T: Scalar> Vectorized for Step<'_, A, T> {
    #[inline(always)]
    fn run<const FMA: bool>(self) {
        let Self { chain, mut state, u, mut next_state, out } = self;
        out.copy_from_slice(u);
        for actuator in chain {
            let n = actuator.state_dim(u.len());
            let before: Controls<T> = SmallVec::from_slice(out);
            let (here, rest) = next_state.split_at_mut(n);
            actuator.step(&state[..n], &before, here, out);
            (state, next_state) = (&state[n..], rest);
        }
    }
}

/// Outlined [`Actuator::vjp`] of a chain.
struct Reverse<'a, A, R, C> {
    chain: &'a [A],
    state: &'a [R],
    u: &'a [R],
    next_bar: OutputCotangents<'a, C>,
    state_bar: Option<&'a mut [C]>,
    u_bar: Option<&'a mut [C]>,
}

impl<A: Actuator, R: Real, C: Cotangent<R>> Vectorized for Reverse<'_, A, R, C> {
    #[inline(always)]
    fn run<const FMA: bool>(self) {
        let Self { chain, state, u, next_bar, mut state_bar, u_bar } = self;
        // Recomputes the input of every actuator, but not the output of the last.
        let m = u.len();
        let mut given: SmallVec<[R; 4 * STACK]> = SmallVec::from_slice(u);
        let mut begin = 0;
        for actuator in chain.split_last().map_or(&[][..], |(_, before)| before) {
            let n = actuator.state_dim(m);
            let mut next_state: SmallVec<[R; 4 * STACK]> = smallvec![R::zero(); n];
            let mut out: Controls<R> = smallvec![R::zero(); m];
            actuator.step(
                &state[begin..begin + n],
                &given[given.len() - m..],
                &mut next_state,
                &mut out,
            );
            given.extend_from_slice(&out);
            begin += n;
        }
        let mut end = state.len();
        let mut out_bar: Controls<C> = SmallVec::from_slice(next_bar.out);
        let mut before_bar: Controls<C> = smallvec![C::null(); m];
        for (i, actuator) in chain.iter().enumerate().rev() {
            let given = &given[i * m..][..m];
            let begin = end - actuator.state_dim(m);
            let cotangents = OutputCotangents { state: &next_bar.state[begin..end], out: &out_bar };
            let here = state_bar.as_deref_mut().map(|state_bar| &mut state_bar[begin..end]);
            if i == 0 {
                return actuator.vjp(&state[begin..end], given, cotangents, here, u_bar);
            }
            before_bar.fill(C::null());
            actuator.vjp(&state[begin..end], given, cotangents, here, Some(&mut before_bar));
            std::mem::swap(&mut out_bar, &mut before_bar);
            end = begin;
        }
        // An empty chain is the identity.
        if let Some(u_bar) = u_bar {
            add(u_bar, next_bar.out);
        }
    }
}
