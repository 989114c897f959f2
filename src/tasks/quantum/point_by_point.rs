//! What takes numbers for the grid points, one after another, from the middle of a loop that has other work as well.

use super::QuantumSystem;
use crate::dynamics::effect::Effect;
use crate::numbers::scalar::{Cotangent, Real};
use std::ops::AddAssign;

/// What takes the potential, grid point by grid point. (Not a closure: those may be compiled as calls.)
pub(super) trait PointByPoint<T> {
    fn put(&mut self, v: T);
}

/// What takes the potential's cotangent, grid point by grid point. There, the state's has just become that of the step
/// without effects.
pub(super) trait PotentialBar<C> {
    fn put(&mut self, j: usize, bar: C, x_bar: &mut [C]);
}

/// Nothing needs it.
pub(super) struct Dropped;

impl<C> PotentialBar<C> for Dropped {
    #[inline(always)]
    fn put(&mut self, _j: usize, _bar: C, _x_bar: &mut [C]) {}
}

/// Kept.
pub(super) struct Kept<'a, C>(pub(super) &'a mut [C]);

impl<C: Copy> PotentialBar<C> for Kept<'_, C> {
    #[inline(always)]
    fn put(&mut self, j: usize, bar: C, _x_bar: &mut [C]) {
        self.0[j] = bar;
    }
}

/// Added to what another factor left.
pub(super) struct Added<'a, C>(pub(super) &'a mut [C]);

impl<C: Copy + AddAssign> PotentialBar<C> for Added<'_, C> {
    #[inline(always)]
    fn put(&mut self, j: usize, bar: C, _x_bar: &mut [C]) {
        self.0[j] += bar;
    }
}

/// Carried on by local effects at once.
pub(super) struct AtOnce<'a, E, R> {
    pub(super) effects: &'a E,
    /// Of its own: what a reference leads to may have to be read again after every number that is written.
    pub(super) model: QuantumSystem,
    pub(super) x: &'a [R],
}

impl<E: Effect<QuantumSystem>, R: Real, C: Cotangent<R>> PotentialBar<C> for AtOnce<'_, E, R> {
    #[inline(always)]
    fn put(&mut self, j: usize, bar: C, x_bar: &mut [C]) {
        self.effects.vjp_at(&self.model, self.x, j, bar, x_bar);
    }
}
