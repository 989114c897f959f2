//! Buffer lengths of a rollout, for allocation and for size estimates.

use crate::engine::any::AnyTask;
use crate::numbers::aligned::Aligned;
use crate::numbers::scalar::{Float, LANES, Lane};
use crate::policy::AnyPolicy;

/// Buffer lengths of a rollout: in numbers for inputs, outputs and tape, in lanes for the others.
pub(super) struct BufferSizes {
    pub(super) states: usize,
    pub(super) controls: usize,
    pub(super) params: usize,
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
        Self {
            states: (kept + 1) * blocks * carried,
            controls: kept * blocks * task.control_dim(),
            params: blocks * task.param_dim(),
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
            + (self.inputs + self.outputs) * size_of::<F>()
            + Aligned::<F>::bytes_of(self.tape)
    }
}
