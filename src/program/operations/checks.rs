//! Gradient checks of a task and its policy, in a table. Stability of the time step, and slope of
//! the loss.

use crate::check::{self, Failure, Jumps, Passed, Plateau, Stability};
use crate::numbers::text::rough;
use crate::program::operations::trajectory::rollouts;
use crate::program::platform::table::Table;
use crate::program::platform::terminal::progress_bar;
use crate::rng::Purpose;
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
    /// Number of states that were evaluated.
    pub evaluated: usize,
    /// Number of states of the test rollouts.
    pub states: usize,
}

/// Largest amplification in states of test rollouts with the parameters `theta`. `None` if a
/// rollout diverges in the first step.
pub fn amplification(task: &DynTask, policy: &impl Policy, theta: &[f64], seed: u64) -> Option<Amplification> {
    let weights = Weights::new(policy, theta.to_vec());
    let starts = initial_states(task, seed, Purpose::Test, ROLLOUTS);
    let rollouts = rollouts(task, policy, &weights, &starts, 0..ROLLOUTS);
    let states: Vec<(usize, Inputs<'_, f64>)> = rollouts
        .iter()
        .enumerate()
        .flat_map(|(sample, rollout)| {
            let inputs = |t: usize| Inputs { x: &rollout.states[t][..], u: &rollout.controls[t][..], p: &rollout.params[..], t };
            (0..rollout.controls.len()).map(move |t| (sample, inputs(t)))
        })
        .collect();
    let evaluated = evaluated(task, &states);
    let count = evaluated.len();
    let amplifications = evaluated.into_iter().map(|i| {
        let (sample, inputs) = states[i];
        let stability = check::stability(task.system(), inputs);
        Amplification { sample, step: inputs.t, stability, evaluated: count, states: states.len() }
    });
    // `check::stability` returns NaN with a positive sign. `total_cmp` ranks this NaN above every
    // number.
    amplifications.max_by(|a, b| a.stability.multiplier.total_cmp(&b.stability.multiplier))
}

/// Indices of the states that [`amplification`] evaluates: all if the cost permits. Otherwise half
/// of them are evenly spaced, and the others have the largest norms of ∂S/∂x.
///
/// A contact may occupy few steps of a rollout, but its stiffness enlarges the norm.
fn evaluated(task: &DynTask, states: &[(usize, Inputs<'_, f64>)]) -> Vec<usize> {
    let n = task.system().state_dim();
    let most = (PRODUCTS / n.pow(3).max(1)).max(LEAST);
    if states.len() <= most {
        return (0..states.len()).collect();
    }
    let spaced = |count: usize| (0..states.len()).step_by(states.len().div_ceil(count));
    let candidates = spaced(CANDIDATES.min(states.len()));
    let mut by_norm: Vec<(f64, usize)> = candidates.map(|i| (check::jacobian_norm(task.system(), states[i].1), i)).collect();
    by_norm.sort_by(|a, b| b.0.total_cmp(&a.0));
    spaced(most / 2).chain(by_norm.into_iter().take(most / 2).map(|(_, i)| i)).collect()
}

/// Loss and gradient at the parameters `theta` and at parameters nearby.
pub fn plateau(task: &DynTask, policy: &impl Policy, theta: &[f64], seed: u64) -> Result<Plateau, Divergence> {
    let weights = Weights::new(policy, theta.to_vec());
    check::plateau(task, policy, &weights, &initial_states(task, seed, Purpose::Test, ROLLOUTS))
}

/// Compares R with differences of the mean loss over finite distances, at the parameters `theta`.
/// `None` for horizons above 10,000 steps.
pub fn jumps(task: &DynTask, policy: &impl Policy, theta: &[f64], seed: u64) -> Option<Result<Jumps, Divergence>> {
    /// Bound on the number of samples times steps.
    const STEPS: usize = 400_000;
    let horizon = Task::horizon(task).max(1);
    let samples = (STEPS / horizon).min(512);
    let starts = || initial_states(task, seed, Purpose::Test, samples);
    (samples >= 40).then(|| check::jumps(task, policy, &Weights::new(policy, theta.to_vec()), &starts()))
}

/// Number of test rollouts of [`amplification`] and [`plateau`].
const ROLLOUTS: usize = 4;
/// Bound on the number of evaluated states times the cubed number of state components. The time is
/// about 30 multiplications and additions each.
const PRODUCTS: usize = 20_000_000;
/// Smallest number of states that [`amplification`] evaluates, if the rollouts have as many.
const LEAST: usize = 32;
/// Largest number of states whose norms of ∂S/∂x are compared.
const CANDIDATES: usize = 4_000;

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

#[cfg(test)]
mod tests {
    use super::*;
    use crate::numbers::scalar::Scalar;
    use crate::policy::Linear;
    use crate::program::operations::policy_file;
    use crate::{Start, rng::Rng};

    /// `N` components that decay, except in one step of 750, in which the first grows by 3.
    struct Kick<const N: usize>;

    impl<const N: usize> System for Kick<N> {
        fn state_dim(&self) -> usize {
            N
        }
        fn control_dim(&self) -> usize {
            1
        }
        fn step<T: Scalar>(&self, Inputs { x, u, t, .. }: Inputs<'_, T>, next: &mut [T]) {
            for (next, &x) in next.iter_mut().zip(x) {
                *next = x * 0.5;
            }
            next[0] = x[0] * if t == 7 { 3.0 } else { 0.5 } + u[0];
        }
    }

    impl<const N: usize> Task for Kick<N> {
        type System = Self;
        fn system(&self) -> &Self {
            self
        }
        fn horizon(&self) -> usize {
            750
        }
        fn start(&self, _rng: &mut Rng, Start { x, .. }: Start<'_>) {
            x.fill(1.0);
        }
        fn running_cost<T: Scalar>(&self, _inputs: Inputs<'_, T>, next: &[T]) -> T {
            next[0] * next[0]
        }
    }

    fn found<const N: usize>() -> Amplification {
        let policy = Linear::new(N, 1);
        amplification(&DynTask::new(Kick::<N>), &policy, &policy_file::random(&policy, 0), 0).expect("finite rollouts")
    }

    #[test]
    fn a_single_unstable_step_is_found_also_if_only_some_states_are_evaluated() {
        let all = found::<2>();
        assert_eq!((all.step, all.evaluated, all.states), (7, 3000, 3000));
        assert!((all.stability.multiplier - 3.0).abs() < 1e-6);
        let some = found::<40>();
        assert!(some.step == 7 && some.evaluated < some.states);
    }
}
