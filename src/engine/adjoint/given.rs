//! [`Given`]: cotangents of states and controls, in place of the gradients of the costs.

use super::cost_gradient::CostGradient;
use crate::numbers::scalar::{Cotangent, Float, LANES, Lane, Real};

/// Cotangents of all states and controls of a rollout, which the recursion adds where it otherwise
/// adds the gradients of the costs.
#[derive(Debug)]
pub(super) struct Given<F: Float> {
    /// `[block][step][component]`, steps 0 to T.
    states: Vec<Lane<F>>,
    /// `[block][step][component]`, steps 0 to T - 1.
    controls: Vec<Lane<F>>,
    horizon: usize,
}

impl<F: Float> Given<F> {
    /// Cotangents in the layout `[sample][step][component]`.
    pub(super) fn new(states: &[F], controls: &[F], samples: usize, horizon: usize) -> Self {
        Self { states: lanes(states, samples), controls: lanes(controls, samples), horizon }
    }

    pub(super) fn stored_bytes(&self) -> usize {
        size_of_val(&self.states[..]) + size_of_val(&self.controls[..])
    }

    /// Writes the cotangents that step `t` adds. That of the initial state belongs to step 0.
    pub(super) fn write(&self, t: usize, block: usize, cost: &mut CostGradient<Lane<F>>) {
        let (n, m) = (cost.next.len(), cost.u.len());
        let states = &self.states[block * (self.horizon + 1) * n..];
        cost.next.copy_from_slice(&states[(t + 1) * n..][..n]);
        match t {
            0 => cost.x.copy_from_slice(&states[..n]),
            _ => cost.x.fill(Lane::null()),
        }
        cost.u.copy_from_slice(&self.controls[(block * self.horizon + t) * m..][..m]);
        cost.p.fill(Lane::null());
    }
}

/// The numbers of each sample, in lanes. Unused lanes repeat the last sample, as in a rollout.
fn lanes<F: Float>(numbers: &[F], samples: usize) -> Vec<Lane<F>> {
    let (each, blocks) = (numbers.len() / samples, samples.div_ceil(LANES));
    let mut lanes = vec![Lane::null(); blocks * each];
    for (block, lanes) in lanes.chunks_exact_mut(each.max(1)).enumerate() {
        for lane in 0..LANES {
            let first = (block * LANES + lane).min(samples - 1) * each;
            for (number, &value) in lanes.iter_mut().zip(&numbers[first..first + each]) {
                number.set_lane(lane, value);
            }
        }
    }
    lanes
}
