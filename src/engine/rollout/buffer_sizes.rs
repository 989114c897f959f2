//! Buffer lengths of a rollout, for allocation and for size estimates.

use crate::engine::any::AnyTask;
use crate::numbers::aligned::Aligned;
use crate::numbers::scalar::{Float, LANES, Lane};
use crate::policy::AnyPolicy;

/// Buffer lengths of a rollout: in numbers for inputs, outputs and tape, in lanes for the others.
pub(super) struct BufferSizes {
    pub(super) states: usize,
    pub(super) controls: usize,
    /// Parameters of the initial states, and with noise those of each stored step.
    pub(super) params: usize,
    pub(super) keys: usize,
    noise_bytes: usize,
    pub(super) costs: usize,
    pub(super) observations: usize,
    pub(super) inputs: usize,
    pub(super) outputs: usize,
    pub(super) tape: usize,
}

impl BufferSizes {
    pub(super) fn new<F: Float>(
        task: &dyn AnyTask<F>,
        policy: &dyn AnyPolicy<F>,
        samples: usize,
        kept: usize,
    ) -> Self {
        let carried = task.state_dim() + policy.memory_dim();
        let (blocks, columns) = (samples.div_ceil(LANES), samples * kept);
        let noise = task.noise();
        let param_rows = if noise.is_empty() { 1 } else { 1 + kept };
        Self {
            states: (kept + 1) * blocks * carried,
            controls: kept * blocks * task.control_dim(),
            params: param_rows * blocks * task.param_dim(),
            keys: noise.key_dim() * samples,
            noise_bytes: noise.stored_bytes(),
            costs: blocks,
            observations: task.own_observation().map_or(0, |dim| blocks * dim),
            inputs: columns * policy.input_dim(),
            outputs: columns * policy.output_dim(),
            tape: policy.sizes(columns).tape,
        }
    }

    pub(super) fn bytes<F: Float>(&self) -> usize {
        let lanes = self.states + self.controls + self.params + self.observations + 2 * self.costs;
        lanes * size_of::<Lane<F>>()
            + (self.inputs + self.outputs + self.keys) * size_of::<F>()
            + self.noise_bytes
            + Aligned::<F>::bytes_of(self.tape)
    }
}
