//! Memory that a run needs, and memory of the machine.

use crate::any::AnyTask;
use crate::program::operations::trajectory::ROLLOUTS;
use crate::program::settings::Precision;
use crate::{Batch, DynTask, Float, Flow, Policy, Schedule, System, Task};
use std::fs::read_to_string;
use std::path::Path;

/// Memory of a run, in bytes.
pub struct Needs {
    /// Rollouts and gradients of a mini-batch, without recomputation.
    pub batch: f64,
    /// Parameters, optimizer, data sets and the trajectories written at the end.
    pub rest: f64,
}

/// Estimates the memory of a run before allocation. `samples` is the size of a mini-batch,
/// `start_states` the total number of initial states in both data sets.
pub fn needs(task: &DynTask, policy: &impl Policy, precision: Precision, samples: usize, start_states: usize) -> Needs {
    match precision {
        Precision::F32 => needs_in::<f32>(task, policy, samples, start_states),
        Precision::F64 => needs_in::<f64>(task, policy, samples, start_states),
    }
}

/// Largest horizon for which the estimate counts bytes. The bytes are nearly linear in the number
/// of steps, so the estimate scales them to longer horizons.
const COUNTED_STEPS: usize = 10_000;

fn needs_in<F: Float>(task: &DynTask, policy: &impl Policy, samples: usize, start_states: usize) -> Needs {
    let (n, m) = (task.system().state_dim(), task.system().control_dim());
    let steps = Task::horizon(task).min(COUNTED_STEPS);
    let scale = Task::horizon(task) as f64 / steps as f64;
    let flows = [Flow::REGULAR, Flow::MODIFIED];
    let of = |samples: usize| Batch::<F>::bytes_of(task, policy, samples, &flows, 1, &Schedule::store_all(steps)) as f64 * scale;
    // Parameters and two moments of the optimizer, each with a copy, and both data sets.
    let numbers = policy.param_count() as f64 * 6.0 + start_states as f64 * AnyTask::<F>::start_dim(task) as f64;
    // Trajectories written at the end, as text and vectors: 48 bytes per component and 80 per step.
    let text = ROLLOUTS as f64 * Task::horizon(task) as f64 * (48.0 * (n + m) as f64 + 80.0);
    Needs { batch: of(samples), rest: numbers * size_of::<F>() as f64 + of(ROLLOUTS) + text }
}

/// Memory limit of this process, in bytes: the smallest of the machine's memory and the limits of
/// the control groups. 32 GB if all are unknown.
pub fn of_this_machine() -> f64 {
    const UNKNOWN: f64 = 32e9;
    // Limits by version 2 of control groups: those of the group of this process, and of the groups
    // that contain it. The last path has the limit by version 1.
    let groups = read_to_string("/proc/self/cgroup").unwrap_or_default();
    let group = groups.lines().find_map(|line| line.strip_prefix("0::/")).unwrap_or_default();
    let groups = Path::new(group).ancestors().map(|group| Path::new("/sys/fs/cgroup").join(group).join("memory.max"));
    let paths = groups.chain(["/sys/fs/cgroup/memory/memory.limit_in_bytes".into()]);
    let limits = paths.filter_map(|path| read_to_string(path).ok()?.trim().parse().ok());
    let machine = read_to_string("/proc/meminfo").ok().and_then(|text| total(&text));
    limits.chain(machine).reduce(f64::min).unwrap_or(UNKNOWN)
}

/// Total memory in `/proc/meminfo`, in bytes.
fn total(meminfo: &str) -> Option<f64> {
    let kib = meminfo.lines().find_map(|line| line.strip_prefix("MemTotal:")?.trim().strip_suffix("kB"))?;
    kib.trim().parse().ok().map(|kib: f64| kib * 1024.0)
}

#[cfg(test)]
mod tests {
    use super::of_this_machine;
    use super::total;

    #[test]
    fn mem_total_is_read_in_kb_and_this_machine_has_more_than_100_mb() {
        assert_eq!(total("MemFree:  7 kB\nMemTotal:       24576 kB\n"), Some(24576.0 * 1024.0));
        assert_eq!(total("MemTotal: much"), None);
        assert!(of_this_machine() > 1e8);
    }
}
