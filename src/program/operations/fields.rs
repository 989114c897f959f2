//! Vectors of several fields for one mini-batch.

use crate::any::AnyTask;
use crate::policy::AnyPolicy;
use crate::{Batch, Divergence, Field, Float, Flow, Gradient, Weights};

/// Vectors of the fields for the mean loss of rollouts from `starts`, bit for bit those of a
/// training with this mini-batch.
///
/// # Errors
/// The first [`Divergence`].
pub fn vectors<F: Float>(
    task: &dyn AnyTask<F>,
    policy: &dyn AnyPolicy<F>,
    weights: &Weights<F>,
    starts: &[F],
    fields: &[Field],
) -> Result<Vec<Vec<F>>, Divergence> {
    let mut flows: Vec<Flow> = Vec::new();
    for flow in fields.iter().flat_map(Field::flows) {
        if !flows.contains(&flow) {
            flows.push(flow);
        }
    }
    let mut gradients: Vec<Gradient<F>> = Vec::with_capacity(flows.len());
    // One reverse pass carries up to two flows.
    for flows in flows.chunks(2) {
        let mut batch = Batch::new(task, policy, starts.len() / task.start_dim(), flows, 1);
        batch.run(task, policy, weights, starts)?;
        gradients.extend_from_slice(batch.gradients());
    }
    let vector = |field: &Field| {
        let own: Vec<Gradient<F>> = field
            .flows()
            .iter()
            .filter_map(|flow| flows.iter().position(|known| known == flow))
            .map(|k| gradients[k].clone())
            .collect();
        let mut out = Gradient::zeros(weights.theta().len());
        field.combine(&own, &mut out);
        out.to_vec()
    };
    Ok(fields.iter().map(vector).collect())
}
