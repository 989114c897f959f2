//! Gradient checks of a task and its policy, collected in a table.

use crate::check::{self, Failure, Passed};
use crate::program::operations::trajectory::rollouts;
use crate::rng::{Purpose, stream};
use crate::{DynTask, Flow, Inputs, Policy, System, Task, Weights, initial_states};
use comfy_table::Table;
use comfy_table::presets::UTF8_FULL_CONDENSED;
use indicatif::ProgressBar;
use std::time::Duration;

/// Adds the checks of one task and policy to the results.
pub fn check(task: &DynTask, policy: &impl Policy, variant: &str, results: &mut Results) {
    let system = task.system();
    let (n, m) = (system.state_dim(), system.control_dim());
    results.add(&format!("{variant}: system"), || check::try_system(system).map_err(Failure::from));
    // Skips the policy check if the dimensions did not change since the last variant.
    if results.dims.replace((n, m)) != Some((n, m)) {
        results.add(&format!("{variant}: network"), || check::try_policy(policy).map_err(Failure::from));
    }
    for flow in Flow::ALL {
        results.add(&format!("{variant}: rollout, {flow}"), || check::try_flow(task, policy, flow));
    }
}

/// Stability of the step in states of test rollouts with initial parameters, and the slope of the
/// loss there, as sentences.
pub fn diagnosis(task: &DynTask, policy: &impl Policy, seed: u64, state_names: &[String]) -> Vec<String> {
    let weights = Weights::<f64>::init(policy, &mut stream(seed, Purpose::Policy, 0));
    let starts = initial_states(task, seed, Purpose::Test, ROLLOUTS);
    let rollouts = rollouts(task, policy, &weights, &starts, 0..ROLLOUTS);
    let slope = match check::plateau(task, policy, &weights, &starts) {
        Ok(plateau) => format!("loss at the initial parameters: {plateau}"),
        Err(divergence) => format!("loss at the initial parameters: {divergence}"),
    };
    if state_names.len() > MAX_STATES {
        return vec![format!("time step: not checked beyond {MAX_STATES} state components"), slope];
    }
    let states = rollouts.iter().enumerate().flat_map(|(sample, rollout)| {
        let steps = (0..rollout.controls.len()).step_by(rollout.controls.len().div_ceil(STATES).max(1));
        steps.map(move |t| (sample, t, Inputs { x: &rollout.states[t], u: &rollout.controls[t], p: &rollout.params, t }))
    });
    let found = states.map(|(sample, t, inputs)| (sample, t, check::stability(task.system(), inputs)));
    // A NaN is the worst.
    let worst = found.max_by(|(_, _, a), (_, _, b)| a.multiplier.total_cmp(&b.multiplier));
    let step = worst.map_or_else(String::new, |(sample, t, worst)| {
        let name = &state_names[worst.component];
        format!("time step, worst in test rollout {sample}, step {t}, component {} ({name}): {worst}", worst.component)
    });
    vec![step, slope]
}

/// Number of rollouts of [`diagnosis`].
const ROLLOUTS: usize = 4;
/// Largest number of states per rollout in [`diagnosis`].
const STATES: usize = 8;
/// Largest number of state components whose stability is computed.
const MAX_STATES: usize = 100;

/// Results of the checks so far.
pub struct Results {
    /// Name of the task under check.
    task: &'static str,
    /// Dimensions of state and control in the last policy check of this task.
    dims: Option<(usize, usize)>,
    table: Table,
    failures: Vec<String>,
    spinner: ProgressBar,
}

impl Results {
    pub fn new() -> Self {
        let mut table = Table::new();
        table.load_style(UTF8_FULL_CONDENSED).set_header(["task", "checked", "compared", "worst error", "allowed", ""]);
        let spinner = ProgressBar::new_spinner();
        spinner.enable_steady_tick(Duration::from_millis(100));
        Self { task: "", dims: None, table, failures: Vec::new(), spinner }
    }

    /// Sets the task of the following checks.
    pub fn begin(&mut self, task: &'static str) {
        if self.task != task {
            (self.task, self.dims) = (task, None);
        }
    }

    /// Returns the table and one message per failure.
    pub fn finish(self) -> (Table, Vec<String>) {
        self.spinner.finish_and_clear();
        (self.table, self.failures)
    }

    fn add(&mut self, name: &str, check: impl FnOnce() -> Result<Passed, Failure>) {
        let task = self.task;
        self.spinner.set_message(format!("{task}, {name}"));
        let (compared, worst, allowed, verdict) = match check() {
            Ok(p) => (p.compared.to_string(), format!("{:.1e}", p.worst), format!("{:.0e}", p.allowed), "ok"),
            Err(failure) => {
                self.failures.push(format!("{task}, {name}: {failure}"));
                (String::new(), String::new(), String::new(), "FAILED")
            }
        };
        self.table.add_row([task, name, &compared, &worst, &allowed, verdict]);
    }
}
