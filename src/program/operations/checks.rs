//! Gradient checks of a task and its policy, in a table. Stability of the time step, and slope of
//! the loss.

use crate::check::{self, Failure, Passed, Plateau, Stability};
use crate::numbers::text::rough;
use crate::program::operations::trajectory::rollouts;
use crate::program::platform::table::Table;
use crate::program::platform::terminal::progress_bar;
use crate::rng::{Purpose, stream};
use crate::{Divergence, DynTask, Flow, Inputs, Policy, System, Task, Weights, initial_states};
use indicatif::ProgressBar;

/// Adds the checks of one task and policy to the results. Rollouts have the parameters `theta`, or
/// random ones.
pub fn check(task: &DynTask, policy: &impl Policy, theta: Option<&[f64]>, variant: &str, results: &mut Results) {
    let system = task.system();
    let (n, m) = (system.state_dim(), system.control_dim());
    results.add(&format!("{variant}: system"), || check::try_system(system).map_err(Failure::from));
    results.add(&format!("{variant}: costs"), || check::try_cost(task).map_err(Failure::from));
    // Skips the policy check if the dimensions did not change since the last variant.
    if results.dims.replace((n, m)) != Some((n, m)) {
        results.add(&format!("{variant}: network"), || check::try_policy(policy).map_err(Failure::from));
    }
    for flow in Flow::ALL {
        results.add(&format!("{variant}: rollout, {flow}"), || match theta {
            Some(theta) => check::try_flow_at(task, policy, flow, theta),
            None => check::try_flow(task, policy, flow),
        });
    }
}

/// Largest amplification of a perturbation by a step, among states of test rollouts.
pub struct Amplification {
    /// Index of the test rollout.
    pub sample: usize,
    /// Step of the rollout.
    pub step: usize,
    pub stability: Stability,
}

/// Largest amplification in states of test rollouts, with parameters drawn by [`Policy::init`].
/// `None` if a rollout diverges in the first step.
pub fn amplification(task: &DynTask, policy: &impl Policy, seed: u64) -> Option<Amplification> {
    let weights = Weights::<f64>::init(policy, &mut stream(seed, Purpose::Policy, 0));
    let starts = initial_states(task, seed, Purpose::Test, ROLLOUTS);
    let rollouts = rollouts(task, policy, &weights, &starts, 0..ROLLOUTS);
    let states = rollouts.iter().enumerate().flat_map(|(sample, rollout)| {
        let steps = (0..rollout.controls.len()).step_by(rollout.controls.len().div_ceil(STATES).max(1));
        steps.map(move |t| (sample, t, Inputs { x: &rollout.states[t], u: &rollout.controls[t], p: &rollout.params, t }))
    });
    let amplifications =
        states.map(|(sample, step, inputs)| Amplification { sample, step, stability: check::stability(task.system(), inputs) });
    // `check::stability` returns NaN with a positive sign. `total_cmp` ranks this NaN above every
    // number.
    amplifications.max_by(|a, b| a.stability.multiplier.total_cmp(&b.stability.multiplier))
}

/// Loss and gradient at parameters drawn by [`Policy::init`] and at parameters nearby.
pub fn plateau(task: &DynTask, policy: &impl Policy, seed: u64) -> Result<Plateau, Divergence> {
    let weights = Weights::<f64>::init(policy, &mut stream(seed, Purpose::Policy, 0));
    check::plateau(task, policy, &weights, &initial_states(task, seed, Purpose::Test, ROLLOUTS))
}

/// Number of test rollouts of [`amplification`] and [`plateau`].
const ROLLOUTS: usize = 4;
/// Largest number of states per rollout that [`amplification`] evaluates.
const STATES: usize = 8;

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
        let table = Table::new(["task", "checked", "compared", "worst error", "allowed", "result"]).optional(&["compared"]);
        let spinner = progress_bar(0, "{spinner} {msg}", false);
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
            Ok(p) => (p.compared.to_string(), rough(p.worst), format!("{:.0e}", p.allowed), "ok"),
            Err(failure) => {
                self.failures.push(format!("{task}, {name}: {failure}"));
                (String::new(), String::new(), String::new(), "FAILED")
            }
        };
        self.table.row([task, name, &compared, &worst, &allowed, verdict]);
    }
}
