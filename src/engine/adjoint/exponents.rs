//! Block exponents: the cotangents of each sample and flow are mantissas times a common power of
//! two.
//!
//! The recursion is linear in λ. A power of two taken out of λ and h is therefore taken out of all
//! later values, exactly. Only the cost gradients added at each step must be divided by it. At
//! moderate sizes all exponents are 0, and results are bitwise those of plain numbers.

use super::Flow;
use crate::engine::rollout::{Lane, WIDTH};
use crate::numbers::extended::{exponent_of, scaled};
use crate::numbers::scalar::{CotangentPack, Float, Real};

/// Exponents of one block of samples, for `K` flows.
#[derive(Clone, Debug)]
pub(super) struct Exponents<F: Float, const K: usize> {
    /// Exponents, `[flow][lane]`: λ and h are the stored values times 2^exponent.
    pub(super) of: [[i32; WIDTH]; K],
    /// Factor of the cost gradients: `scale` of the pass times 2^-exponent.
    pub(super) inject: CotangentPack<Lane<F>, K>,
}

/// Range of sizes, `low` to `high`, that needs no rescaling.
#[derive(Clone, Copy, Debug)]
pub(super) struct Limits<F> {
    low: F,
    high: F,
}

/// Exponent of `high`, and of `low` with a negative sign.
///
/// Far from the ends of the range of `F`: one step may multiply by 1e19 (f32).
const fn reach<F: Float>() -> i32 {
    if F::EPSILON < 1e-10 { 300 } else { 60 }
}

impl<F: Float> Limits<F> {
    pub(super) fn new() -> Self {
        let power = |exponent: i32| F::lift(crate::numbers::extended::power_of_two(exponent));
        Self { low: power(-reach::<F>()), high: power(reach::<F>()) }
    }

    /// Returns false if rescaling is needed. False for NaN.
    ///
    /// `any_scaled`: some exponent is not 0, so the exponent of a zero cotangent may need a reset.
    #[inline(always)]
    pub(super) fn holds(self, size: F, any_scaled: bool) -> bool {
        size <= self.high && (size >= self.low || (size == F::zero() && !any_scaled))
    }
}

/// Outcome of a rescaling.
#[derive(Clone, Copy, PartialEq)]
pub(super) enum Size {
    Carried,
    NotFinite,
}

impl<F: Float, const K: usize> Exponents<F, K> {
    pub(super) fn new() -> Self {
        Self { of: [[0; WIDTH]; K], inject: CotangentPack([Lane::splat(F::zero()); K]) }
    }

    /// Sets all exponents to 0, for a pass with this `scale`.
    pub(super) fn reset(&mut self, scale: F) {
        (self.of, self.inject) = ([[0; WIDTH]; K], CotangentPack([Lane::splat(scale); K]));
    }

    /// Returns true if an exponent is not 0.
    pub(super) fn any(&self) -> bool {
        self.of.iter().flatten().any(|&exponent| exponent != 0)
    }

    /// Returns true if an exponent is so low that scaled cost gradients may overflow.
    pub(super) fn any_low(&self) -> bool {
        self.of.iter().flatten().any(|&exponent| exponent < -reach::<F>())
    }

    fn set(&mut self, k: usize, lane: usize, exponent: i32, scale: F) {
        self.of[k][lane] = exponent;
        // Limited to stay finite. `lift` resets such exponents before a non-zero cost gradient is
        // added.
        let limit = reach::<F>() * 3 / 2;
        self.inject.0[k].set_lane(lane, scaled(scale, (-exponent).min(limit)));
    }

    /// Rescales the cotangents of one sample and flow to a size of about 1, if needed.
    ///
    /// `lambda` and `u_bar` are λ and h of the block.
    pub(super) fn rescale(
        &mut self,
        flow: Flow,
        (k, lane): (usize, usize),
        scale: F,
        lambda: &mut [CotangentPack<Lane<F>, K>],
        u_bar: &mut [CotangentPack<Lane<F>, K>],
    ) -> Size {
        // Sums in the order of the step, so the decision does not depend on other samples.
        let size = u_bar.iter().chain(&*lambda).fold(F::zero(), |size, bar| size + bar.0[k].lane(lane).abs());
        if !size.as_().is_finite() {
            return Size::NotFinite;
        }
        // S carries nothing back, so it cannot explode or vanish.
        let carries = flow.physics || flow.control;
        if !carries || Limits::new().holds(size, false) && size != F::zero() {
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

    /// Resets the exponent of one sample and flow to 0, if cost gradients may overflow beside it.
    ///
    /// λ may underflow to 0, which is negligible beside such cost gradients.
    pub(super) fn lift(&mut self, (k, lane): (usize, usize), scale: F, lambda: &mut [CotangentPack<Lane<F>, K>]) {
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
