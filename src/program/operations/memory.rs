//! Memory that a run needs, and memory of the machine.

use crate::program::operations::Visit;
use crate::program::operations::trajectory::ROLLOUTS;
use crate::program::settings::Precision;
use physgrad::{Float, Policy, System, Task};
use std::fs::read_to_string;

/// Visitor that estimates the memory of a run before it is allocated.
pub struct Memory {
    pub precision: Precision,
    /// Samples of a mini-batch.
    pub samples: usize,
    /// Samples of both data sets.
    pub start_states: usize,
}

/// Memory of a run, in bytes.
pub struct Needs {
    /// For rollouts and gradients of a mini-batch, without recomputation.
    pub batch: f64,
    /// For everything else.
    pub rest: f64,
}

impl Visit for Memory {
    type Out = Needs;

    fn visit<T: Task, P: Policy>(self, task: T, policy: P) -> Needs {
        match self.precision {
            Precision::F32 => self.needs::<f32>(&task, &policy),
            Precision::F64 => self.needs::<f64>(&task, &policy),
        }
    }
}

impl Memory {
    fn needs<F: Float>(&self, task: &impl Task, policy: &impl Policy) -> Needs {
        let (n, m) = (task.system().state_dim(), task.system().control_dim());
        let (steps, number) = (task.horizon() as f64, size_of::<F>() as f64);
        // The memory of the policy is linear in the number of columns.
        let sizes = policy.sizes::<F>(64);
        let tape = sizes.tape as f64 / 64.0;
        let per_column = tape + sizes.tape_bar as f64 / 32.0 + 4.0 * (n + m) as f64;
        // θ and packed θ, state of the optimizer and its copy, gradients of two flows.
        let parameters = policy.param_count() as f64 * 16.0;
        let data_sets = self.start_states as f64 * n as f64;
        // Trajectories written at the end: numbers, their text, and vectors of both.
        let text = ROLLOUTS as f64 * steps * (48.0 * (n + m) as f64 + 80.0);
        Needs {
            batch: self.samples as f64 * steps * per_column * number,
            rest: (parameters + data_sets + ROLLOUTS as f64 * steps * tape) * number + text,
        }
    }
}

/// Memory limit of this process in bytes: of the machine or its control group. 32 GB if unknown.
pub fn of_this_machine() -> f64 {
    const UNKNOWN: f64 = 32e9;
    let limits = ["/sys/fs/cgroup/memory.max", "/sys/fs/cgroup/memory/memory.limit_in_bytes"];
    let limits = limits.into_iter().filter_map(|path| read_to_string(path).ok()?.trim().parse().ok());
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
    fn the_memory_of_a_machine_is_read() {
        assert_eq!(total("MemFree:  7 kB\nMemTotal:       24576 kB\n"), Some(24576.0 * 1024.0));
        assert_eq!(total("MemTotal: much"), None);
        assert!(of_this_machine() > 1e8);
    }
}
