//! Forces between pairs of agents, and their reverse.
//!
//! Inner loops accumulate the force on one agent, which prevents compilers from vectorizing over
//! agents. The lanes of a scalar fill the registers already, so vectorizing would only move data.

use super::GuidanceSystem;
use super::gap::{Gap, Law};
use super::system::AGENT;
use crate::numbers::scalar::{Cotangent, Real, Scalar};
use crate::numbers::zip::zip;
use std::ops::Range;

/// Returns the separation of agent `b` from agent `a`.
#[inline(always)]
fn gap<T: Scalar>(model: &GuidanceSystem, a: &[T; AGENT], b: &[T; AGENT]) -> Gap<T> {
    Gap::new([b[0] - a[0], b[1] - a[1]], model.softening)
}

/// Adds the mutual forces of every pair of `agents`.
#[inline(always)]
pub(super) fn among<T: Scalar>(
    model: &GuidanceSystem,
    law: Law,
    agents: Range<usize>,
    x: &[T],
    forces: &mut [T],
) {
    let (x, forces) =
        (&x.as_chunks().0[agents.clone()], &mut forces.as_chunks_mut::<2>().0[agents]);
    for (b, at) in x.iter().enumerate() {
        let (before, own) = forces.split_at_mut(b);
        let mut force_sum = own[0];
        for (a, reaction) in zip(x.iter(), before) {
            let [along_x, along_y] = gap(model, a, at).force(law);
            force_sum[0] += along_x;
            force_sum[1] += along_y;
            reaction[0] -= along_x;
            reaction[1] -= along_y;
        }
        own[0] = force_sum;
    }
}

/// Reverse of [`among`].
#[inline(always)]
pub(super) fn among_vjp<R: Real, C: Cotangent<R>>(
    model: &GuidanceSystem,
    law: Law,
    agents: Range<usize>,
    x: &[R],
    forces_bar: &[C],
    x_bar: &mut [C],
) {
    let (x, forces_bar) =
        (&x.as_chunks().0[agents.clone()], &forces_bar.as_chunks::<2>().0[agents.clone()]);
    let x_bar = &mut x_bar.as_chunks_mut::<AGENT>().0[agents];
    for (b, (at, force_bar)) in zip(x.iter(), forces_bar).enumerate() {
        let (before, own) = x_bar.split_at_mut(b);
        let mut own_bar = [own[0][0], own[0][1]];
        for ((a, reaction_bar), a_bar) in zip(zip(x.iter(), forces_bar), before) {
            let bar = [force_bar[0] - reaction_bar[0], force_bar[1] - reaction_bar[1]];
            let [bar_x, bar_y] = gap(model, a, at).force_vjp(law, bar);
            own_bar[0] += bar_x;
            own_bar[1] += bar_y;
            a_bar[0] -= bar_x;
            a_bar[1] -= bar_y;
        }
        (own[0][0], own[0][1]) = (own_bar[0], own_bar[1]);
    }
}

/// Adds the forces of each of the `sources` on each of the `agents`, without reaction.
#[inline(always)]
pub(super) fn from_to<T: Scalar>(
    model: &GuidanceSystem,
    law: Law,
    sources: Range<usize>,
    agents: Range<usize>,
    x: &[T],
    forces: &mut [T],
) {
    let (x, forces) = (x.as_chunks().0, &mut forces.as_chunks_mut::<2>().0[agents.clone()]);
    for (at, force) in zip(x[agents].iter(), forces) {
        let mut force_sum = *force;
        for source in &x[sources.clone()] {
            let [along_x, along_y] = gap(model, source, at).force(law);
            force_sum[0] += along_x;
            force_sum[1] += along_y;
        }
        *force = force_sum;
    }
}

/// Reverse of [`from_to`].
#[inline(always)]
pub(super) fn from_to_vjp<R: Real, C: Cotangent<R>>(
    model: &GuidanceSystem,
    law: Law,
    sources: Range<usize>,
    agents: Range<usize>,
    x: &[R],
    forces_bar: &[C],
    x_bar: &mut [C],
) {
    let (x, forces_bar, x_bar) =
        (x.as_chunks().0, forces_bar.as_chunks::<2>().0, x_bar.as_chunks_mut::<AGENT>().0);
    for b in agents {
        let mut own_bar = [x_bar[b][0], x_bar[b][1]];
        for (source, source_bar) in zip(x[sources.clone()].iter(), &mut x_bar[sources.clone()]) {
            let [bar_x, bar_y] = gap(model, source, &x[b]).force_vjp(law, forces_bar[b]);
            own_bar[0] += bar_x;
            own_bar[1] += bar_y;
            source_bar[0] -= bar_x;
            source_bar[1] -= bar_y;
        }
        (x_bar[b][0], x_bar[b][1]) = (own_bar[0], own_bar[1]);
    }
}
