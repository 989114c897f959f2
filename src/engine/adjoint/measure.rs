//! Measurements of the adjoint along the recursion: norms and growth. Only the adjoints of flows
//! with a `cut` depend on them.

use super::exponents::{BlockExponents, Exponents};
use crate::engine::flow::Flow;
use crate::engine::growth::Meter;
use crate::engine::pass::Pass;
use crate::engine::rollout::Rollout;
use crate::numbers::extended::{exponent_of, times_power_of_two};
use crate::numbers::scalar::{CotangentPack, Float, LANES, Lane, Real};
use crate::numbers::zip::zip;
use std::ops::Range;

/// Records the root mean square of ‖λ_t‖ over the samples, divided by `scale`, in f64. `norms` has
/// one row per flow, or no rows.
///
/// A power of two scales the components, because their squares may be out of range.
pub(super) fn record_norms<F: Float, const K: usize>(
    lambda: &[CotangentPack<Lane<F>, K>],
    exponents: &Exponents<F, K>,
    pass: &Pass<'_, F>,
    t: usize,
    norms: &mut [Vec<f64>],
) {
    let Pass { rollout, scale, .. } = *pass;
    let of_sample = |k: usize, sample: usize| {
        let block = &lambda[sample / LANES * rollout.state_dim..][..rollout.state_dim];
        let exponent = exponents.of(k, sample);
        block.iter().map(move |c| times_power_of_two(c.0[k].lane(sample % LANES).as_(), exponent))
    };
    for (k, norms) in norms.iter_mut().enumerate() {
        let all = || (0..rollout.samples).flat_map(|sample| of_sample(k, sample));
        let nonzero = |x: &f64| *x != 0.0 && x.is_finite();
        let largest = all().filter(nonzero).map(exponent_of).max().unwrap_or(0);
        let squares: f64 = all().map(|x| times_power_of_two(x, -largest)).map(|x| x * x).sum();
        norms[t] =
            times_power_of_two((squares / rollout.samples as f64).sqrt(), largest) / scale.as_();
    }
}

/// Growth of λ per sample and flow.
#[derive(Debug)]
pub(super) struct GrowthMeters<const K: usize> {
    /// `[sample][flow]`: meter, `‖λ + ∂l/∂x_{t+1}‖²` of the stored values, and exponent of λ. The
    /// last two are those before the current step.
    meters: Vec<[(Meter, f64, i32); K]>,
}

impl<const K: usize> GrowthMeters<K> {
    pub(super) fn new(samples: usize) -> Self {
        Self { meters: vec![[(Meter::default(), 0.0, 0); K]; samples] }
    }

    pub(super) fn bytes_of(samples: usize) -> usize {
        samples * size_of::<[(Meter, f64, i32); K]>()
    }

    pub(super) fn stored_bytes(&self) -> usize {
        size_of_val(&self.meters[..])
    }

    pub(super) fn reset(&mut self) {
        self.meters.fill([(Meter::default(), 0.0, 0); K]);
    }

    /// Records `‖λ + ∂l/∂x_{t+1}‖²` and the exponents of the samples of a block before a step.
    pub(super) fn before<F: Float>(
        &mut self,
        samples: Range<usize>,
        lambda: &[CotangentPack<Lane<F>, K>],
        cost_next: &[Lane<F>],
        exponents: &BlockExponents<F, K>,
    ) {
        for (lane, meters) in self.meters[samples].iter_mut().enumerate() {
            for (k, (_, before, exponent)) in meters.iter_mut().enumerate() {
                let sum = |(lambda, cost): (&CotangentPack<Lane<F>, K>, &Lane<F>)| -> f64 {
                    (lambda.0[k].lane(lane) + cost.lane(lane) * exponents.inject.0[k].lane(lane))
                        .as_()
                };
                let terms = zip(lambda.iter(), cost_next).map(sum);
                (*before, *exponent) = (terms.map(|x| x * x).sum(), exponents.of[k][lane]);
            }
        }
    }

    /// Adds the growth over step `t`, or registers a cut if the flow is truncated there.
    pub(super) fn after<F: Float>(
        &mut self,
        rollout: &Rollout<F>,
        lambda: &[CotangentPack<Lane<F>, K>],
        exponents: &Exponents<F, K>,
        flows: [Flow; K],
        t: usize,
    ) {
        let n = rollout.state_dim;
        for (sample, meters) in self.meters[..rollout.samples].iter_mut().enumerate() {
            let (block, lane) = (sample / LANES, sample % LANES);
            for (k, (meter, before, exponent)) in meters.iter_mut().enumerate() {
                if flows[k].at(t) != flows[k] {
                    meter.cut();
                    continue;
                }
                let of_lane =
                    |lambda: &CotangentPack<Lane<F>, K>| -> f64 { lambda.0[k].lane(lane).as_() };
                let after = lambda[block * n..][..n].iter().map(of_lane).map(|x| x * x).sum();
                meter.step(*before, after, exponents.of(k, sample) - *exponent);
            }
        }
    }

    /// Returns true if the adjoint has grown by more than `decades` since its last cut or
    /// truncation, or since it last became 0. If so, registers a cut.
    pub(super) fn reset_if_grown(&mut self, k: usize, sample: usize, decades: f64) -> bool {
        let meter = &mut self.meters[sample][k].0;
        let grown = meter.since_cut() > decades;
        if grown {
            meter.cut();
        }
        grown
    }

    /// Meters of flow `k` for the first `samples` samples.
    pub(super) fn of(&self, k: usize, samples: usize) -> impl Iterator<Item = &Meter> {
        self.meters[..samples].iter().map(move |meters| &meters[k].0)
    }
}
