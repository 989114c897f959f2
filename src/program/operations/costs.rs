//! Stored bytes and allocations of a rollout, for `explain`.

use crate::program::settings::Precision;
use crate::rng::{Purpose, stream};
use crate::{Adjoint, Divergence, DynTask, Field, Float, Policy, Rollout, Weights, initial_states};

/// Number of samples in the measured rollout: one full block of lanes.
pub const SAMPLES: usize = 8;

/// Memory of a rollout, with its adjoint or in evaluation mode.
pub struct Stored {
    /// Bytes in the buffers of the rollout, and of the adjoint if there is one.
    pub bytes: usize,
    /// Allocations of the second run. None if the first run diverges.
    pub allocations: Option<u64>,
}

/// Measures a rollout of [`SAMPLES`] samples and the adjoint of a field. Without a field, measures
/// a rollout in evaluation mode.
pub fn stored(task: &DynTask, policy: &impl Policy, precision: Precision, field: Option<Field>) -> Stored {
    match precision {
        Precision::F32 => measure::<f32>(task, policy, field),
        Precision::F64 => measure::<f64>(task, policy, field),
    }
}

fn measure<F: Float>(task: &DynTask, policy: &impl Policy, field: Option<Field>) -> Stored {
    let starts: Vec<F> = initial_states(task, 0, Purpose::Test, SAMPLES);
    let weights = Weights::init(policy, &mut stream(0, Purpose::Policy, 0));
    let Some(field) = field else {
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

/// Counts the allocations of the second run, because the first run allocates the workspaces. None
/// if the first run diverges.
fn allocations_of_second_run<T>(mut run: impl FnMut() -> Result<T, Divergence>) -> Option<u64> {
    run().ok()?;
    Some(allocation_counter::measure(|| drop(run())).count_total)
}
