//! [`Recursion::restart`]: lower exponents for cotangents that have become small.

use super::exponents::Limits;
use super::state::Recursion;
use crate::engine::pass::Pass;
use crate::engine::rollout::Rollout;
use crate::numbers::extended::{exponent_of, scaled};
use crate::numbers::scalar::{Float, LANES, Lane, Real};
use std::ops::Range;

/// Place of a [`restart`](Recursion::restart) within a step.
#[derive(Clone, Copy, PartialEq)]
pub(super) enum Place {
    /// λ, h and μ are small before the policy reads h and μ.
    BeforePolicy,
    /// λ and μ are small after the step.
    AfterPolicy,
    /// λ and μ are cut after the step.
    Cut,
}

impl<F: Float, const K: usize> Recursion<F, K> {
    /// Restarts the flows and samples whose cotangents are too small for a positive exponent.
    pub(super) fn restart_small(&mut self, pass: &Pass<'_, F>, t: usize, place: Place) {
        for k in 0..K {
            for sample in 0..pass.rollout.samples {
                if self.exponents.of(k, sample) > 0 && self.is_small(k, sample, pass.rollout, place)
                {
                    self.restart(pass, k, sample, t, place);
                }
            }
        }
        self.exponents.update();
    }

    /// Ranges in `lambda` and `u_bar` of the cotangents that [`restart`](Self::restart) changes in
    /// one block.
    fn carried(block: usize, rollout: &Rollout<F>, place: Place) -> [Range<usize>; 2] {
        let (n, m, outputs) =
            (rollout.state_dim, rollout.control_dim, rollout.control_dim + rollout.memory_dim);
        let controls = if place == Place::BeforePolicy { 0 } else { m };
        [block * n..(block + 1) * n, block * outputs + controls..(block + 1) * outputs]
    }

    /// Returns whether the cotangents of one flow and sample are too small for their exponent.
    fn is_small(&self, k: usize, sample: usize, rollout: &Rollout<F>, place: Place) -> bool {
        let [of_lambda, of_outputs] = Self::carried(sample / LANES, rollout, place);
        // Sums in the order of `reverse_step`, as `rescale` does.
        let bars = self.u_bar[of_outputs].iter().chain(&self.lambda[of_lambda]);
        bars.fold(F::zero(), |sum, bar| sum + bar.0[k].lane(sample % LANES).abs())
            < Limits::new().low
    }

    /// Sets the exponent of one flow and sample, in step `t`, to the exponent of the cotangents
    /// from later steps, or to 0 if negative. These cotangents are 0 after a truncation and where
    /// derivatives are 0. A cut sets them to 0.
    ///
    /// With a large previous exponent, the cost gradients would underflow.
    #[cold]
    pub(super) fn restart(
        &mut self,
        pass: &Pass<'_, F>,
        k: usize,
        sample: usize,
        t: usize,
        place: Place,
    ) {
        let Pass { rollout, scale, .. } = *pass;
        let block = sample / LANES;
        self.evaluate_cost(pass, t, block);
        let [of_lambda, of_outputs] = Self::carried(block, rollout, place);
        let (lambda, outputs) = (&mut self.lambda[of_lambda], &mut self.u_bar[of_outputs]);
        // Gradient of the cost with respect to u, unless the policy has already read h. μ has no
        // cost.
        let of_controls = if place == Place::BeforePolicy { &self.cost.u[..] } else { &[] };
        let no_cost = Lane::splat(F::zero());
        let costs = || self.cost.x.iter().chain(of_controls).chain(std::iter::repeat(&no_cost));
        let exponents = &mut self.exponents.blocks[block];
        // The unused lanes of the last block are copies of the last sample.
        let end = if sample + 1 == rollout.samples { LANES } else { sample % LANES + 1 };
        for lane in sample % LANES..end {
            let own = exponents.of[k][lane];
            for (bar, cost) in lambda.iter_mut().chain(&mut *outputs).zip(costs()) {
                let later = bar.0[k].lane(lane) - exponents.added(k, lane, cost.lane(lane), scale);
                bar.0[k].set_lane(lane, if place == Place::Cut { F::zero() } else { later });
            }
            let later = lambda.iter().chain(&*outputs).map(|bar| bar.0[k].lane(lane).abs());
            let size: f64 = later.fold(F::zero(), |sum, size| sum + size).as_();
            let exponent = if size == 0.0 { 0 } else { (own + exponent_of(size)).max(0) };
            exponents.set(k, lane, exponent, scale);
            let inject = exponents.inject.0[k].lane(lane);
            for (bar, cost) in lambda.iter_mut().chain(&mut *outputs).zip(costs()) {
                let later = scaled(bar.0[k].lane(lane), own - exponent);
                bar.0[k].set_lane(lane, later + inject * cost.lane(lane));
            }
            if let (Place::Cut, Some(starts)) = (place, &mut self.starts) {
                starts.cut(k, block, lane);
            }
        }
    }
}
