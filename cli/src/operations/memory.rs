//! Memory that a run needs.

use crate::operations::trajectory::ROLLOUTS;
use crate::settings::Precision;
use physgrad::engine::any::AnyTask;
use physgrad::engine::{Batch, Schedule};
use physgrad::{DynTask, Float, Flow, Policy, System, Task};

/// Memory of a run, in bytes.
pub struct Needs {
    /// Rollouts and gradients of a mini-batch, without recomputation.
    pub batch: f64,
    /// Parameters, optimizer, data sets and the trajectories written at the end.
    pub rest: f64,
}

/// Estimates the memory of a run before allocation. `samples` is the size of a mini-batch,
/// `start_states` the total number of initial states in both data sets.
pub fn needs(
    task: &DynTask,
    policy: &impl Policy,
    precision: Precision,
    samples: usize,
    start_states: usize,
) -> Needs {
    match precision {
        Precision::F32 => needs_in::<f32>(task, policy, samples, start_states),
        Precision::F64 => needs_in::<f64>(task, policy, samples, start_states),
    }
}

/// Largest horizon for which the estimate counts bytes. The bytes are nearly linear in the number
/// of steps, so the estimate scales them to longer horizons.
const COUNTED_STEPS: usize = 10_000;

fn needs_in<F: Float>(
    task: &DynTask,
    policy: &impl Policy,
    samples: usize,
    start_states: usize,
) -> Needs {
    let (n, m) = (task.system().state_dim(), task.system().control_dim());
    let steps = Task::horizon(task).min(COUNTED_STEPS);
    let scale = Task::horizon(task) as f64 / steps as f64;
    let flows = [Flow::REGULAR, Flow::MODIFIED];
    let of = |samples: usize| {
        Batch::<F>::bytes_of(task, policy, samples, &flows, 1, &Schedule::store_all(steps)) as f64
            * scale
    };
    // Parameters and two moments of the optimizer, each with a copy, and both data sets.
    let numbers = policy.param_count() as f64 * 6.0
        + start_states as f64 * AnyTask::<F>::start_dim(task) as f64;
    // Trajectories written at the end, as text and vectors: 48 bytes per component and 80 per step.
    let text = ROLLOUTS as f64 * Task::horizon(task) as f64 * (48.0 * (n + m) as f64 + 80.0);
    Needs { batch: of(samples), rest: numbers * size_of::<F>() as f64 + of(ROLLOUTS) + text }
}
