//! Chains of actuators chosen at run time.

use super::{Actuator, Controls, OutputCotangents, STACK};
use crate::dynamics::inputs::add;
use crate::dynamics::outline::outline;
use crate::numbers::kernels::Vectorized;
use crate::numbers::scalar::{Cotangent, Real, Scalar};
use smallvec::{SmallVec, smallvec};

/// Composition in order, bit-identical to nested pairs. Outlined, because inlining every actuator
/// into every loop slows compilation.
impl<A: Actuator> Actuator for Vec<A> {
    fn state_dim(&self, controls: usize) -> usize {
        self.iter().map(|actuator| actuator.state_dim(controls)).sum()
    }

    #[inline(always)]
    fn is_identity(&self) -> bool {
        self.is_empty()
    }

    #[inline(always)]
    fn step<T: Scalar>(&self, own: &[T], u: &[T], own_next: &mut [T], out: &mut [T]) {
        outline::<T>(Step { chain: self, own, u, own_next, out });
    }

    #[inline(always)]
    fn reverse<R: Real, C: Cotangent<R>>(
        &self,
        own: &[R],
        u: &[R],
        next_bar: OutputCotangents<'_, C>,
        own_bar: Option<&mut [C]>,
        u_bar: Option<&mut [C]>,
    ) {
        outline::<R>(Reverse { chain: self, own, u, next_bar, own_bar, u_bar });
    }
}

/// Outlined [`Actuator::step`] of a chain.
struct Step<'a, A, T> {
    chain: &'a [A],
    own: &'a [T],
    u: &'a [T],
    own_next: &'a mut [T],
    out: &'a mut [T],
}

impl<A: Actuator, T: Scalar> Vectorized for Step<'_, A, T> {
    #[inline(always)]
    fn run<const FMA: bool>(self) {
        let Self { chain, mut own, u, mut own_next, out } = self;
        out.copy_from_slice(u);
        for actuator in chain {
            let n = actuator.state_dim(u.len());
            let before: Controls<T> = SmallVec::from_slice(out);
            let (here, rest) = own_next.split_at_mut(n);
            actuator.step(&own[..n], &before, here, out);
            (own, own_next) = (&own[n..], rest);
        }
    }
}

/// Outlined [`Actuator::reverse`] of a chain.
struct Reverse<'a, A, R, C> {
    chain: &'a [A],
    own: &'a [R],
    u: &'a [R],
    next_bar: OutputCotangents<'a, C>,
    own_bar: Option<&'a mut [C]>,
    u_bar: Option<&'a mut [C]>,
}

impl<A: Actuator, R: Real, C: Cotangent<R>> Vectorized for Reverse<'_, A, R, C> {
    #[inline(always)]
    fn run<const FMA: bool>(self) {
        let Self { chain, own, u, next_bar, mut own_bar, u_bar } = self;
        // Recompute the input of every actuator; the output of the last is not needed.
        let m = u.len();
        let mut given: SmallVec<[R; 4 * STACK]> = SmallVec::from_slice(u);
        let mut begin = 0;
        for actuator in chain.split_last().map_or(&[][..], |(_, before)| before) {
            let n = actuator.state_dim(m);
            let mut own_next: SmallVec<[R; 4 * STACK]> = smallvec![R::zero(); n];
            let mut out: Controls<R> = smallvec![R::zero(); m];
            actuator.step(&own[begin..begin + n], &given[given.len() - m..], &mut own_next, &mut out);
            given.extend_from_slice(&out);
            begin += n;
        }
        let mut end = own.len();
        let mut out_bar: Controls<C> = SmallVec::from_slice(next_bar.out);
        let mut before_bar: Controls<C> = smallvec![C::null(); m];
        for (i, (actuator, given)) in chain.iter().zip(given.chunks_exact(m)).enumerate().rev() {
            let begin = end - actuator.state_dim(m);
            let bars = OutputCotangents { own: &next_bar.own[begin..end], out: &out_bar };
            let here = own_bar.as_deref_mut().map(|own_bar| &mut own_bar[begin..end]);
            if i == 0 {
                return actuator.reverse(&own[begin..end], given, bars, here, u_bar);
            }
            before_bar.fill(C::null());
            actuator.reverse(&own[begin..end], given, bars, here, Some(&mut before_bar));
            std::mem::swap(&mut out_bar, &mut before_bar);
            end = begin;
        }
        // An empty chain is the identity.
        if let Some(u_bar) = u_bar {
            add(u_bar, next_bar.out);
        }
    }
}
