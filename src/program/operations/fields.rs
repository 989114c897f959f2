//! Vectors of several fields from shared forward passes.

use crate::any::AnyTask;
use crate::engine::batch::GROUP;
use crate::policy::AnyPolicy;
use crate::{Adjoint, Divergence, Field, Float, Flow, Gradient, Rollout, Weights};
use anyhow::Result;

/// Largest number of samples in one rollout.
const BLOCK: usize = 8 * GROUP;

/// Vectors of the fields for the mean loss of rollouts from `starts`. For up to 32 samples, the
/// vectors are bit for bit those of a training update with the mini-batch `starts`. Calls `begin`
/// before each block of samples.
///
/// # Errors
/// The first [`Divergence`], or an error of `begin`.
pub fn vectors<F: Float>(
    task: &dyn AnyTask<F>,
    policy: &dyn AnyPolicy<F>,
    weights: &Weights<F>,
    starts: &[F],
    fields: &[Field],
    begin: &mut dyn FnMut() -> Result<()>,
) -> Result<Vec<Vec<F>>> {
    let mut flows: Vec<Flow> = Vec::new();
    for flow in fields.iter().flat_map(Field::flows) {
        if !flows.contains(&flow) {
            flows.push(flow);
        }
    }
    let zeros = || Gradient::<F>::zeros(weights.theta().len());
    let mut sums: Vec<Gradient<F>> = flows.iter().map(|_| zeros()).collect();
    let mut one = zeros();
    let (width, samples) = (task.start_dim(), starts.len() / task.start_dim());
    let scale = F::from_f64(1.0 / samples as f64);
    for (block, starts) in starts.chunks(BLOCK * width).enumerate() {
        begin()?;
        let count = starts.len() / width;
        let offset = |divergence: Divergence| divergence.offset(block * BLOCK);
        let mut rollout = Rollout::new(task, policy, count);
        rollout.start(starts);
        rollout.run(task, policy, weights).map_err(offset)?;
        // One reverse pass carries up to two flows.
        for (flows, sums) in flows.chunks(2).zip(sums.chunks_mut(2)) {
            let mut adjoint = Adjoint::new(task, policy, &rollout, flows);
            adjoint.run(task, policy, weights, &rollout, scale).map_err(offset)?;
            for (k, sum) in sums.iter_mut().enumerate() {
                for first in (0..count).step_by(GROUP) {
                    let group = first..count.min(first + GROUP);
                    adjoint.param_gradient(k, policy, weights, &rollout, group, &mut one);
                    if block == 0 && first == 0 {
                        sum.copy_from(&one);
                    } else {
                        sum.add(&one);
                    }
                }
            }
        }
    }
    sums.iter_mut().for_each(Gradient::normalize);
    let vector = |field: &Field| {
        let own: Vec<Gradient<F>> = field
            .flows()
            .iter()
            .filter_map(|flow| flows.iter().position(|known| known == flow))
            .map(|k| sums[k].clone())
            .collect();
        let mut out = zeros();
        field.combine(&own, &mut out);
        out.to_vec()
    };
    Ok(fields.iter().map(vector).collect())
}
