//! Visitors of `explain`: operation counts, stored bytes and allocations.

use crate::program::operations::Visit;
use crate::program::settings::Precision;
use crate::rng::{Purpose, stream};
use crate::{Adjoint, Divergence, Field, Float, Policy, Rollout, Task, TaskOpCount, Weights, initial_states};

/// Number of samples in the measured rollout: one full block of lanes.
pub const SAMPLES: usize = 8;

/// Counts the operations of the physics, and of the costs and the observation.
pub struct Costing;

impl Visit for Costing {
    type Out = TaskOpCount;

    fn visit<T: Task, P: Policy>(self, task: T, _policy: P) -> TaskOpCount {
        TaskOpCount::of(&task)
    }
}

/// Measures a rollout of [`SAMPLES`] samples and its adjoint.
pub struct Storing {
    pub precision: Precision,
    /// Field of the adjoint. None for a rollout in evaluation mode.
    pub field: Option<Field>,
}

/// Memory of a rollout and its adjoint.
pub struct Stored {
    /// Bytes in the buffers of the rollout and the adjoint.
    pub bytes: usize,
    /// Allocations of the second run. None if the first run diverges.
    pub allocations: Option<u64>,
}

impl Visit for Storing {
    type Out = Stored;

    fn visit<T: Task, P: Policy>(self, task: T, policy: P) -> Stored {
        match self.precision {
            Precision::F32 => self.measure::<f32>(&task, &policy),
            Precision::F64 => self.measure::<f64>(&task, &policy),
        }
    }
}

impl Storing {
    fn measure<F: Float>(&self, task: &impl Task, policy: &impl Policy) -> Stored {
        let starts: Vec<F> = initial_states(task, 0, Purpose::Test, SAMPLES);
        let weights = Weights::init(policy, &mut stream(0, Purpose::Policy, 0));
        let Some(field) = self.field else {
            let mut rollout = Rollout::<F>::for_evaluation(task, policy, SAMPLES);
            let allocations = allocations_of_second_run(|| {
                rollout.start(&starts);
                rollout.run(task, policy, &weights)
            });
            return Stored { bytes: rollout.stored_bytes(), allocations };
        };
        let mut rollout = Rollout::<F>::new(task, policy, SAMPLES);
        let mut adjoint = Adjoint::new(task, policy, &rollout, &field.flows());
        let allocations = allocations_of_second_run(|| {
            rollout.start(&starts);
            rollout.run(task, policy, &weights)?;
            adjoint.run(task, policy, &weights, &rollout, F::one())
        });
        Stored { bytes: rollout.stored_bytes() + adjoint.stored_bytes(), allocations }
    }
}

/// Allocations of the second run, because the first run allocates the workspaces. None if the
/// first run diverges.
fn allocations_of_second_run<T>(mut run: impl FnMut() -> Result<T, Divergence>) -> Option<u64> {
    run().ok()?;
    Some(allocation_counter::measure(|| drop(run())).count_total)
}
