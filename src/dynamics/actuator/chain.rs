//! Chains of actuators chosen at run time.

use super::{Actuator, Controls, OutputCotangents, STACK};
use crate::dynamics::inputs::{Cotangents, Inputs, add};
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
    fn step<T: Scalar>(&self, inputs: Inputs<'_, T>, next: &mut [T], out: &mut [T]) {
        outline::<T>(ChainStep { chain: self, inputs, next, out });
    }

    #[inline(always)]
    fn vjp<R: Real, C: Cotangent<R>>(
        &self,
        inputs: Inputs<'_, R>,
        next_bar: OutputCotangents<'_, C>,
        cotangents: Cotangents<'_, C>,
    ) {
        outline::<R>(ChainVjp { chain: self, inputs, next_bar, cotangents });
    }
}

/// Outlined [`Actuator::step`] of a chain.
struct ChainStep<'a, A, T> {
    chain: &'a [A],
    inputs: Inputs<'a, T>,
    next: &'a mut [T],
    out: &'a mut [T],
}

impl<A: Actuator, T: Scalar> Vectorized for ChainStep<'_, A, T> {
    #[inline(always)]
    fn run<const FMA: bool>(self) {
        let Self { chain, inputs: Inputs { x: mut state, u, .. }, next: mut next_state, out } =
            self;
        out.copy_from_slice(u);
        for actuator in chain {
            let n = actuator.state_dim(u.len());
            let before: Controls<T> = SmallVec::from_slice(out);
            let (here, rest) = next_state.split_at_mut(n);
            actuator.step(Inputs::new(&state[..n], &before), here, out);
            (state, next_state) = (&state[n..], rest);
        }
    }
}

/// Outlined [`Actuator::vjp`] of a chain.
struct ChainVjp<'a, A, R, C> {
    chain: &'a [A],
    inputs: Inputs<'a, R>,
    next_bar: OutputCotangents<'a, C>,
    cotangents: Cotangents<'a, C>,
}

impl<A: Actuator, R: Real, C: Cotangent<R>> Vectorized for ChainVjp<'_, A, R, C> {
    #[inline(always)]
    fn run<const FMA: bool>(self) {
        let Self { chain, inputs: Inputs { x: state, u, .. }, next_bar, cotangents } = self;
        let Cotangents { x: mut state_bar, u: u_bar, .. } = cotangents;
        // Recomputes the input of every actuator, but not the output of the last.
        let m = u.len();
        let mut given: SmallVec<[R; 4 * STACK]> = SmallVec::from_slice(u);
        let mut begin = 0;
        for actuator in chain.split_last().map_or(&[][..], |(_, before)| before) {
            let n = actuator.state_dim(m);
            let mut next_state: SmallVec<[R; 4 * STACK]> = smallvec![R::zero(); n];
            let mut out: Controls<R> = smallvec![R::zero(); m];
            let inputs = Inputs::new(&state[begin..begin + n], &given[given.len() - m..]);
            actuator.step(inputs, &mut next_state, &mut out);
            given.extend_from_slice(&out);
            begin += n;
        }
        let mut end = state.len();
        let mut out_bar: Controls<C> = SmallVec::from_slice(next_bar.out);
        let mut before_bar: Controls<C> = smallvec![C::null(); m];
        for (i, actuator) in chain.iter().enumerate().rev() {
            let given = &given[i * m..][..m];
            let begin = end - actuator.state_dim(m);
            let inputs = Inputs::new(&state[begin..end], given);
            let next_bar = OutputCotangents { state: &next_bar.state[begin..end], out: &out_bar };
            let x = state_bar.as_deref_mut().map(|state_bar| &mut state_bar[begin..end]);
            if i == 0 {
                return actuator.vjp(inputs, next_bar, Cotangents { x, u: u_bar, p: None });
            }
            before_bar.fill(C::null());
            let cotangents = Cotangents { x, u: Some(&mut before_bar), p: None };
            actuator.vjp(inputs, next_bar, cotangents);
            std::mem::swap(&mut out_bar, &mut before_bar);
            end = begin;
        }
        // An empty chain is the identity.
        if let Some(u_bar) = u_bar {
            add(u_bar, next_bar.out);
        }
    }
}
