//! Stored bytes of a rollout, for `explain`.

use crate::settings::Precision;
use physgrad::{Adjoint, DynTask, Field, Float, Policy, Rollout};

/// Number of samples in the rollout: one full block of lanes.
pub const SAMPLES: usize = 8;

/// Bytes in the buffers of a rollout of [`SAMPLES`] samples, and of the adjoint of a field. Without
/// a field, of a rollout in evaluation mode.
pub fn stored(
    task: &DynTask,
    policy: &impl Policy,
    precision: Precision,
    field: Option<Field>,
) -> usize {
    match precision {
        Precision::F32 => bytes::<f32>(task, policy, field),
        Precision::F64 => bytes::<f64>(task, policy, field),
    }
}

fn bytes<F: Float>(task: &DynTask, policy: &impl Policy, field: Option<Field>) -> usize {
    let Some(field) = field else {
        return Rollout::<F>::for_evaluation(task, policy, SAMPLES).stored_bytes();
    };
    let rollout = Rollout::<F>::new(task, policy, SAMPLES);
    rollout.stored_bytes() + Adjoint::new(task, policy, &rollout, &field.flows()).stored_bytes()
}
