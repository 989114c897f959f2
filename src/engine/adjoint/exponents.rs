//! Exponents: the cotangents of each sample and flow are mantissas times a common power of two.
//!
//! The recursion is linear in λ and μ. A power of two taken out of λ, h and μ is therefore taken
//! out of all later values, exactly. Only the cost gradients added at each step must be divided by
//! this power. At moderate sizes all exponents are 0, and results are bitwise those of plain
//! numbers.

use super::cost_gradient::CostGradient;
use crate::engine::flow::Flow;
use crate::engine::pass::Pass;
use crate::numbers::extended::{exponent_of, scaled};
use crate::numbers::scalar::{CotangentPack, Float, LANES, Lane, Real};

/// Exponents of all samples, for `K` flows.
#[derive(Debug)]
pub(super) struct Exponents<F: Float, const K: usize> {
    pub(super) blocks: Vec<BlockExponents<F, K>>,
    /// True if an exponent may differ from 0.
    pub(super) any: bool,
    /// True if an exponent is so low that scaled cost gradients may overflow.
    low: bool,
}

/// Error: a cotangent is non-finite.
pub(super) struct NonFinite;

impl<F: Float, const K: usize> Exponents<F, K> {
    pub(super) fn new(blocks: usize) -> Self {
        Self { blocks: vec![BlockExponents::new(); blocks], any: false, low: false }
    }

    pub(super) fn bytes_of(blocks: usize) -> usize {
        blocks * size_of::<BlockExponents<F, K>>()
    }

    pub(super) fn stored_bytes(&self) -> usize {
        size_of_val(&self.blocks[..])
    }

    /// Sets all exponents to 0, for a pass with this `scale`.
    pub(super) fn reset(&mut self, scale: F) {
        self.blocks.iter_mut().for_each(|block| block.reset(scale));
        (self.any, self.low) = (false, false);
    }

    /// Exponent of one flow and sample.
    pub(super) fn of(&self, k: usize, sample: usize) -> i32 {
        self.blocks[sample / LANES].of[k][sample % LANES]
    }

    /// Returns true if an exponent is so low that scaled cost gradients may overflow.
    pub(super) fn any_low(&self) -> bool {
        self.low
    }

    /// Rescales cotangents outside the range of [`Limits`].
    #[cold]
    pub(super) fn rescale(
        &mut self,
        flows: [Flow; K],
        pass: &Pass<'_, F>,
        lambda: &mut [CotangentPack<Lane<F>, K>],
        u_bar: &mut [CotangentPack<Lane<F>, K>],
    ) -> Result<(), NonFinite> {
        let Pass { rollout, scale, .. } = *pass;
        let (n, outputs) = (rollout.state_dim, rollout.control_dim + rollout.memory_dim);
        for (index, block) in
            self.blocks.iter_mut().enumerate().take(rollout.samples.div_ceil(LANES))
        {
            let (lambda, u_bar) =
                (&mut lambda[index * n..][..n], &mut u_bar[index * outputs..][..outputs]);
            for (k, flow) in flows.into_iter().enumerate() {
                for lane in 0..LANES {
                    block.rescale(flow, (k, lane), scale, lambda, u_bar)?;
                }
            }
        }
        self.update();
        Ok(())
    }

    /// Resets to 0 the exponents of a block that are too low for its cost gradients.
    ///
    /// Exponents of samples whose cost gradients are 0 do not change.
    pub(super) fn raise(
        &mut self,
        block: usize,
        scale: F,
        lambda: &mut [CotangentPack<Lane<F>, K>],
        u_bar: &mut [CotangentPack<Lane<F>, K>],
        cost: &CostGradient<Lane<F>>,
    ) {
        for lane in 0..LANES {
            if cost.values().any(|cost| cost.lane(lane) != F::zero()) {
                (0..K).for_each(|k| self.blocks[block].raise((k, lane), scale, lambda, u_bar));
            }
        }
    }

    /// Ends a step in which [`rescale`](Self::rescale) was called.
    pub(super) fn clear_shifts(&mut self) {
        self.blocks.iter_mut().for_each(|block| block.shifts = [[0; LANES]; K]);
    }

    /// Updates `any` and [`any_low`](Self::any_low) after a change of exponents.
    pub(super) fn update(&mut self) {
        self.any = self.blocks.iter().any(BlockExponents::any);
        self.low = self.blocks.iter().any(BlockExponents::any_low);
    }
}

/// Exponents of one block of samples, for `K` flows.
#[derive(Clone, Debug)]
pub(super) struct BlockExponents<F: Float, const K: usize> {
    /// Exponents, `[flow][lane]`: λ, h and μ are the stored values times 2^exponent.
    pub(super) of: [[i32; LANES]; K],
    /// Factor of the cost gradients: `scale` of the pass times 2^-exponent.
    pub(super) inject: CotangentPack<Lane<F>, K>,
    /// Increase of each exponent by [`rescale`](Exponents::rescale) in the current step.
    shifts: [[i32; LANES]; K],
}

/// Range of the size Σ|λ| + Σ|h| + Σ|μ|, `low` to `high`, that needs no rescaling.
#[derive(Clone, Copy, Debug)]
pub(super) struct Limits<F> {
    pub(super) low: F,
    high: F,
}

/// Binary exponent of `high`. The binary exponent of `low` is `-reach`.
///
/// The limits are far from the ends of the range of `F`, so that one step may multiply cotangents
/// by 1e19 (f32).
const fn reach<F: Float>() -> i32 {
    if F::EPSILON < 1e-10 { 300 } else { 60 }
}

impl<F: Float> Limits<F> {
    pub(super) fn new() -> Self {
        let power = |exponent: i32| F::from_f64(crate::numbers::extended::power_of_two(exponent));
        Self { low: power(-reach::<F>()), high: power(reach::<F>()) }
    }

    /// Returns false if rescaling is needed or `size` is NaN.
    ///
    /// `any_scaled`: some exponent is not 0, so the exponent of a zero cotangent may need a reset.
    #[inline(always)]
    pub(super) fn holds(self, size: F, any_scaled: bool) -> bool {
        size <= self.high && (size >= self.low || (size == F::zero() && !any_scaled))
    }
}

impl<F: Float, const K: usize> BlockExponents<F, K> {
    fn new() -> Self {
        Self {
            of: [[0; LANES]; K],
            inject: CotangentPack([Lane::splat(F::zero()); K]),
            shifts: [[0; LANES]; K],
        }
    }

    /// Sets all exponents to 0, for a pass with this `scale`.
    fn reset(&mut self, scale: F) {
        *self = Self { inject: CotangentPack([Lane::splat(scale); K]), ..Self::new() };
    }

    /// Returns true if an exponent is not 0.
    fn any(&self) -> bool {
        self.of.iter().flatten().any(|&exponent| exponent != 0)
    }

    /// Returns true if an exponent is so low that scaled cost gradients may overflow.
    fn any_low(&self) -> bool {
        self.of.iter().flatten().any(|&exponent| exponent < -reach::<F>())
    }

    /// Sets the exponent of one flow and lane. The caller scales the cotangents.
    pub(super) fn set(&mut self, k: usize, lane: usize, exponent: i32, scale: F) {
        self.of[k][lane] = exponent;
        self.inject.0[k].set_lane(lane, Self::factor(exponent, scale));
    }

    /// Factor of the cost gradients of a flow and sample with this exponent.
    fn factor(exponent: i32, scale: F) -> F {
        // The limit keeps the factor finite. It applies only to exponents below `-reach`, which
        // `raise` resets before the recursion adds a nonzero cost gradient.
        let limit = reach::<F>() * 3 / 2;
        scaled(scale, (-exponent).min(limit))
    }

    /// Number that the current step added to a cotangent for this cost gradient.
    pub(super) fn added(&self, k: usize, lane: usize, cost: F, scale: F) -> F {
        let shift = self.shifts[k][lane];
        scaled(Self::factor(self.of[k][lane] - shift, scale) * cost, -shift)
    }

    /// Rescales the cotangents of one sample and flow to a size of about 1, if needed. If all
    /// cotangents are 0, sets a negative exponent to 0.
    ///
    /// `lambda` is λ of the block. `u_bar` contains h and μ of the block.
    fn rescale(
        &mut self,
        flow: Flow,
        (k, lane): (usize, usize),
        scale: F,
        lambda: &mut [CotangentPack<Lane<F>, K>],
        u_bar: &mut [CotangentPack<Lane<F>, K>],
    ) -> Result<(), NonFinite> {
        // Sums in the order of `reverse_step`, so that both sizes are bitwise equal. The decision
        // is therefore independent of other samples.
        let sizes = || u_bar.iter().chain(&*lambda).map(|bar| bar.0[k].lane(lane).abs());
        let mut size = sizes().fold(F::zero(), |sum, size| sum + size);
        if !size.as_().is_finite() {
            if sizes().any(|size| !size.as_().is_finite()) {
                return Err(NonFinite);
            }
            // The sum of finite numbers overflows. The largest of them gives an exponent.
            size = sizes()
                .fold(F::zero(), |largest, size| if size > largest { size } else { largest });
        }
        // The adjoint of S covers one step, so it cannot explode or vanish.
        let carries = [flow.physics, flow.control, flow.memory].iter().any(|&weight| weight != 0.0);
        if !carries || Limits::new().holds(size, false) && size != F::zero() {
            return Ok(());
        }
        let own = self.of[k][lane];
        if own > 0 && size < Limits::new().low {
            // `Recursion::restart` lowers the exponent, and adds the cost gradients again: they may
            // have underflowed.
            return Ok(());
        }
        let by = if size == F::zero() { -own } else { exponent_of(size.as_()) };
        for bar in lambda.iter_mut().chain(u_bar) {
            let bar = &mut bar.0[k];
            bar.set_lane(lane, scaled(bar.lane(lane), -by));
        }
        self.set(k, lane, own.saturating_add(by), scale);
        self.shifts[k][lane] = by;
        Ok(())
    }

    /// Resets the exponent of one sample and flow to 0, if scaled cost gradients may overflow.
    ///
    /// λ and μ may underflow to 0, which is negligible relative to the cost gradients.
    fn raise(
        &mut self,
        (k, lane): (usize, usize),
        scale: F,
        lambda: &mut [CotangentPack<Lane<F>, K>],
        u_bar: &mut [CotangentPack<Lane<F>, K>],
    ) {
        let own = self.of[k][lane];
        if own < -reach::<F>() {
            for bar in lambda.iter_mut().chain(u_bar) {
                let bar = &mut bar.0[k];
                bar.set_lane(lane, scaled(bar.lane(lane), own));
            }
            self.set(k, lane, 0, scale);
        }
    }
}
