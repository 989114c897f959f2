//! Forces between agents, pair by pair, and their reverse.
//!
//! Inner loops add up what one agent feels, so that compilers leave them alone: the lanes of a number fill the registers
//! already, and a loop that is vectorized over agents as well only moves numbers about.

use super::GuidanceSystem;
use super::gap::{Gap, Law};
use super::system::AGENT;
use crate::scalar::{Cotangent, Real, Scalar};
use std::ops::Range;

/// The separation of agent `b` from agent `a`.
#[inline(always)]
fn gap<T: Scalar>(body: &GuidanceSystem, x: &[T], a: usize, b: usize) -> Gap<T> {
    let (a, b) = (AGENT * a, AGENT * b);
    Gap::new([x[b] - x[a], x[b + 1] - x[a + 1]], body.softening)
}

/// Adds the cotangent of a separation of `b` from `a` to those of their positions.
#[inline(always)]
fn add_gap_bar<R, C: Cotangent<R>>([x, y]: [C; 2], a: usize, b: usize, x_bar: &mut [C]) {
    x_bar[AGENT * b] += x;
    x_bar[AGENT * b + 1] += y;
    x_bar[AGENT * a] -= x;
    x_bar[AGENT * a + 1] -= y;
}

/// Every two of the `agents` act on each other.
#[inline(always)]
pub(super) fn among<T: Scalar>(body: &GuidanceSystem, law: Law, agents: Range<usize>, x: &[T], forces: &mut [T]) {
    for a in agents.clone() {
        let mut felt = [forces[2 * a], forces[2 * a + 1]];
        for b in a + 1..agents.end {
            let [along_x, along_y] = gap(body, x, a, b).force(law);
            forces[2 * b] += along_x;
            forces[2 * b + 1] += along_y;
            felt[0] -= along_x;
            felt[1] -= along_y;
        }
        (forces[2 * a], forces[2 * a + 1]) = (felt[0], felt[1]);
    }
}

/// The reverse of [`among`].
#[inline(always)]
pub(super) fn among_vjp<R: Real, C: Cotangent<R>>(
    body: &GuidanceSystem,
    law: Law,
    agents: Range<usize>,
    x: &[R],
    forces_bar: &[C],
    x_bar: &mut [C],
) {
    for a in agents.clone() {
        for b in a + 1..agents.end {
            let bar = [forces_bar[2 * b] - forces_bar[2 * a], forces_bar[2 * b + 1] - forces_bar[2 * a + 1]];
            add_gap_bar(gap(body, x, a, b).force_vjp(law, bar), a, b, x_bar);
        }
    }
}

/// Each of the `sources` acts on each of the `agents`, and feels no reaction.
#[inline(always)]
pub(super) fn from_to<T: Scalar>(
    body: &GuidanceSystem,
    law: Law,
    sources: Range<usize>,
    agents: Range<usize>,
    x: &[T],
    forces: &mut [T],
) {
    for b in agents {
        let mut felt = [forces[2 * b], forces[2 * b + 1]];
        for a in sources.clone() {
            let [along_x, along_y] = gap(body, x, a, b).force(law);
            felt[0] += along_x;
            felt[1] += along_y;
        }
        (forces[2 * b], forces[2 * b + 1]) = (felt[0], felt[1]);
    }
}

/// The reverse of [`from_to`].
#[inline(always)]
pub(super) fn from_to_vjp<R: Real, C: Cotangent<R>>(
    body: &GuidanceSystem,
    law: Law,
    sources: Range<usize>,
    agents: Range<usize>,
    x: &[R],
    forces_bar: &[C],
    x_bar: &mut [C],
) {
    for b in agents {
        for a in sources.clone() {
            let bar = [forces_bar[2 * b], forces_bar[2 * b + 1]];
            add_gap_bar(gap(body, x, a, b).force_vjp(law, bar), a, b, x_bar);
        }
    }
}
