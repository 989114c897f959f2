//! Consumers of values per grid point, called from loops that also do other work.

use super::QuantumSystem;
use crate::dynamics::effect::Effect;
use crate::numbers::scalar::{Cotangent, Real};
use std::ops::AddAssign;

/// Consumer of the potential, one grid point at a time. A trait, because closures may be compiled
/// as calls.
pub(super) trait PointByPoint<T> {
    fn put(&mut self, v: T);
}

/// Consumer of the cotangent of the potential, one grid point at a time. When called, the state's
/// cotangent at that point is that of the step without effects.
pub(super) trait PotentialBar<C> {
    fn put(&mut self, j: usize, bar: C, x_bar: &mut [C]);
}

/// Discards the cotangents.
pub(super) struct Dropped;

impl<C> PotentialBar<C> for Dropped {
    #[inline(always)]
    fn put(&mut self, _j: usize, _bar: C, _x_bar: &mut [C]) {}
}

/// Stores the cotangents.
pub(super) struct Kept<'a, C>(pub(super) &'a mut [C]);

impl<C: Copy> PotentialBar<C> for Kept<'_, C> {
    #[inline(always)]
    fn put(&mut self, j: usize, bar: C, _x_bar: &mut [C]) {
        self.0[j] = bar;
    }
}

/// Adds the cotangents to stored ones of another factor.
pub(super) struct Added<'a, C>(pub(super) &'a mut [C]);

impl<C: Copy + AddAssign> PotentialBar<C> for Added<'_, C> {
    #[inline(always)]
    fn put(&mut self, j: usize, bar: C, _x_bar: &mut [C]) {
        self.0[j] += bar;
    }
}

/// Passes the cotangents to local effects immediately.
pub(super) struct AtOnce<'a, E, R> {
    pub(super) effects: &'a E,
    /// Owned copy: values behind a reference may be reloaded after every write.
    pub(super) model: QuantumSystem,
    pub(super) x: &'a [R],
}

impl<E: Effect<QuantumSystem>, R: Real, C: Cotangent<R>> PotentialBar<C> for AtOnce<'_, E, R> {
    #[inline(always)]
    fn put(&mut self, j: usize, bar: C, x_bar: &mut [C]) {
        self.effects.vjp_at(&self.model, self.x, j, bar, x_bar);
    }
}
