//! Block exponents: every sample's cotangents are mantissas times a power of two, which goes with them.
//!
//! The recursion is linear in λ, so a power of two taken out of λ and h is taken out of all that follows, exactly; only the
//! gradients of the costs, which are added on the way, have to be multiplied by it. As long as nothing is very large or
//! small all exponents are 0, and every number has the bits it would have without them.

use super::Flow;
use crate::engine::rollout::{Lane, WIDTH};
use crate::numbers::scalar::{Columns, Float, Real};
use crate::numbers::wide::{exponent_of, scaled};

/// The exponents of one block of samples, for `K` flows.
#[derive(Clone, Debug)]
pub(super) struct Exponents<F: Float, const K: usize> {
    /// `[flow][lane]`: λ and h are what is carried, times 2 to the power of this.
    pub(super) of: [[i32; WIDTH]; K],
    /// What gradients of costs are multiplied by: the scale of the pass, over that power of two.
    pub(super) inject: Columns<Lane<F>, K>,
}

/// Cotangents of a size from `low` to `high` are left as they are.
#[derive(Clone, Copy, Debug)]
pub(super) struct Calm<F> {
    low: F,
    high: F,
}

/// Exponents of `high` and, negative, `low`: far from the ends of the range, for a step may multiply by 1e19 (f32).
const fn reach<F: Float>() -> i32 {
    if F::EPSILON < 1e-10 { 300 } else { 60 }
}

impl<F: Float> Calm<F> {
    pub(super) fn new() -> Self {
        let power = |exponent: i32| F::lift(crate::numbers::wide::power_of_two(exponent));
        Self { low: power(-reach::<F>()), high: power(reach::<F>()) }
    }

    /// Whether a size asks for nothing. `any_scaled`: 0 then asks for the exponent 0. A NaN is not calm.
    #[inline(always)]
    pub(super) fn holds(self, size: F, any_scaled: bool) -> bool {
        size <= self.high && (size >= self.low || (size == F::zero() && !any_scaled))
    }
}

/// Whether a sample's cotangents can be carried on.
#[derive(Clone, Copy, PartialEq)]
pub(super) enum Size {
    Carried,
    NotFinite,
}

impl<F: Float, const K: usize> Exponents<F, K> {
    pub(super) fn new() -> Self {
        Self { of: [[0; WIDTH]; K], inject: Columns([Lane::splat(F::zero()); K]) }
    }

    /// No exponents, for a pass of this scale.
    pub(super) fn reset(&mut self, scale: F) {
        (self.of, self.inject) = ([[0; WIDTH]; K], Columns([Lane::splat(scale); K]));
    }

    /// Whether any is not 0.
    pub(super) fn any(&self) -> bool {
        self.of.iter().flatten().any(|&exponent| exponent != 0)
    }

    /// Whether the gradients of costs may be too large beside what is carried to be added to it.
    pub(super) fn any_low(&self) -> bool {
        self.of.iter().flatten().any(|&exponent| exponent < -reach::<F>())
    }

    fn set(&mut self, k: usize, lane: usize, exponent: i32, scale: F) {
        self.of[k][lane] = exponent;
        // Where it would be infinite nothing is added: see `lift`.
        let limit = reach::<F>() * 3 / 2;
        self.inject.0[k].set_lane(lane, scaled(scale, (-exponent).min(limit)));
    }

    /// Brings one sample's cotangents of one flow to a size of about 1. `sizes` are λ and h.
    pub(super) fn settle(
        &mut self,
        flow: Flow,
        (k, lane): (usize, usize),
        scale: F,
        lambda: &mut [Columns<Lane<F>, K>],
        u_bar: &mut [Columns<Lane<F>, K>],
    ) -> Size {
        // In the order of the loop that noticed it: whether a sample is scaled does not depend on its neighbours.
        let size = u_bar.iter().chain(&*lambda).fold(F::zero(), |size, bar| size + bar.0[k].lane(lane).abs());
        if !size.as_().is_finite() {
            return Size::NotFinite;
        }
        // Where nothing is carried back, nothing explodes or vanishes.
        let carries = flow.physics || flow.control;
        if !carries || Calm::new().holds(size, false) && size != F::zero() {
            return Size::Carried;
        }
        let own = self.of[k][lane];
        let by = if size == F::zero() { -own } else { exponent_of(size.as_()) };
        for bar in lambda.iter_mut().chain(u_bar) {
            let bar = &mut bar.0[k];
            bar.set_lane(lane, scaled(bar.lane(lane), -by));
        }
        self.set(k, lane, own.saturating_add(by), scale);
        Size::Carried
    }

    /// Takes one sample's exponent of one flow back to 0, if it is so small that what is to be added to λ would be infinite
    /// beside it. What is carried may become 0, as it does beside numbers so much larger.
    pub(super) fn lift(&mut self, (k, lane): (usize, usize), scale: F, lambda: &mut [Columns<Lane<F>, K>]) {
        let own = self.of[k][lane];
        if own < -reach::<F>() {
            for bar in lambda {
                let bar = &mut bar.0[k];
                bar.set_lane(lane, scaled(bar.lane(lane), own));
            }
            self.set(k, lane, 0, scale);
        }
    }
}
