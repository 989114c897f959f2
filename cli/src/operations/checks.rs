//! Gradient checks of a task and its policy, in a table. Kinks along rollouts, and slope of the loss.

use crate::operations::amplification::ROLLOUTS;
use crate::platform::table::Table;
use crate::platform::terminal::{print_text, progress_bar};
use indicatif::ProgressBar;
use physgrad::check::{self, Failure, Finding, Jumps, Kink, Passed, Plateau};
use physgrad::count::TaskOpCount;
use physgrad::rng::Purpose;
use physgrad::text::rough;
use physgrad::{Divergence, DynTask, Flow, Policy, Rollout, System, Task, Weights, initial_states};

/// Adds the checks of one task and policy to the results. Rollouts have the parameters `theta`, or
/// random ones. The system and the costs are checked in states of rollouts, so that states have the
/// units of the task.
///
/// One cause fails several checks: rollouts consist of steps, costs and the policy. Rollouts are
/// therefore skipped if one of these fails, and several flows have one message.
pub fn check(
    task: &DynTask,
    policy: &impl Policy,
    theta: Option<&[f64]>,
    variant: &str,
    results: &mut Results,
) {
    let system = task.system();
    let (n, m) = (system.state_dim(), system.control_dim());
    let before = results.failures.len();
    let diverges = |failure: &Failure| matches!(*failure.finding, Finding::Diverged { .. });
    let along =
        results.add(&format!("{variant}: system"), || check::system_along(task, policy, theta));
    if along.as_ref().is_some_and(diverges) {
        results.skip(&format!("{variant}: costs"));
    } else {
        results.add(&format!("{variant}: costs"), || check::cost_along(task, policy, theta));
    }
    // Skips the policy check if the dimensions did not change since the last variant.
    if results.dims.replace((n, m)) != Some((n, m)) {
        results.add(&format!("{variant}: network"), || check::policy(policy));
    }
    let mut first: Option<usize> = None;
    let flows = check::Flows::new(task, policy, theta);
    for flow in Flow::ALL {
        let name = format!("{variant}: rollout, {flow}");
        if first.is_none() && results.failures.len() > before {
            results.skip(&name);
            continue;
        }
        let failed = results.add(&name, || flows.check(flow));
        match (failed, first) {
            (Some(_), Some(index)) => {
                results.failures.pop();
                results.failures[index] += &format!(" (also flow {flow})");
            }
            (Some(_), None) => first = Some(results.failures.len() - 1),
            (None, _) => {}
        }
    }
}

/// Kinks and jumps of the step, the observation and the costs along test rollouts.
pub fn kinks(task: &DynTask, policy: &impl Policy, theta: &[f64], seed: u64) -> Vec<Kink> {
    let weights = Weights::new(policy, theta.to_vec());
    check::kinks(task, policy, &weights, &initial_states(task, seed, Purpose::Test, ROLLOUTS))
}

/// Numbers of steps of test episodes. `None` if episodes cannot end, or if a rollout diverges.
pub fn lengths(
    task: &DynTask,
    policy: &impl Policy,
    theta: &[f64],
    seed: u64,
) -> Option<Vec<usize>> {
    Task::ended(task)?;
    let mut rollout = Rollout::for_evaluation(task, policy, ROLLOUTS);
    rollout.start(&initial_states(task, seed, Purpose::Test, ROLLOUTS));
    rollout.run(task, policy, &Weights::new(policy, theta.to_vec())).ok()?;
    (0..ROLLOUTS).map(|sample| rollout.length(task, sample)).collect()
}

/// Loss and gradient at the parameters `theta` and at parameters nearby.
pub fn plateau(
    task: &DynTask,
    policy: &impl Policy,
    theta: &[f64],
    seed: u64,
) -> Result<Plateau, Divergence> {
    let weights = Weights::new(policy, theta.to_vec());
    check::plateau(task, policy, &weights, &initial_states(task, seed, Purpose::Test, ROLLOUTS))
}

/// Compares R with the derivative of the mean loss over a ball of these coordinates around the
/// parameters `theta`. `None` if rollouts are so long that some seconds do not suffice.
pub fn jumps(
    task: &DynTask,
    policy: &impl Policy,
    theta: &[f64],
    seed: u64,
    coordinates: &dyn Fn(&mut [f64]),
) -> Option<Result<Jumps, Divergence>> {
    /// Bound on the operations. A core makes about 2e9 per second in lanes.
    const OPERATIONS: f64 = 8e9;
    const SAMPLES: usize = 512;
    let operations = TaskOpCount::of(task);
    let forward = operations.system.step.total() as f64 + 2.0 * theta.len() as f64;
    let reverse = operations.system.vjp.total() as f64 + 4.0 * theta.len() as f64;
    let step = check::JUMP_PASSES[0] as f64 * forward + check::JUMP_PASSES[1] as f64 * reverse;
    let most = OPERATIONS / (step * Task::horizon(task).max(1) as f64);
    let samples = (most as usize).min(SAMPLES);
    let starts = || initial_states(task, seed, Purpose::Test, samples);
    (samples >= check::FEWEST).then(|| {
        let weights = Weights::new(policy, theta.to_vec());
        check::jumps_in_coordinates(task, policy, &weights, &starts(), coordinates)
    })
}

/// Results of the checks so far.
pub struct Results {
    /// Name of the task under check.
    task: &'static str,
    /// Dimensions of state and control in the last policy check of this task.
    dims: Option<(usize, usize)>,
    table: Table,
    failures: Vec<String>,
    /// Prints each result when it is known.
    prints: bool,
    spinner: ProgressBar,
}

impl Results {
    /// Results that print each row when it is known, if `prints` is true.
    pub fn new(prints: bool) -> Self {
        let table = Table::new(["task", "checked", "compared", "worst error", "allowed", "result"])
            .optional(&["compared"]);
        let spinner = progress_bar(0, "{spinner} {msg}", false);
        Self { task: "", dims: None, table, failures: Vec::new(), prints, spinner }
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

    /// Adds the result of a check. Returns its failure.
    fn add(
        &mut self,
        name: &str,
        check: impl FnOnce() -> Result<Passed, Failure>,
    ) -> Option<Failure> {
        let task = self.task;
        self.spinner.set_message(format!("{task}, {name}"));
        match check() {
            Ok(p) => {
                let beyond = match p.infinite {
                    0 => "ok".to_owned(),
                    count => format!("ok, {count} beyond {:.1e}", f64::MAX),
                };
                self.row([
                    task,
                    name,
                    &p.compared.to_string(),
                    &rough(p.worst),
                    &format!("{:.0e}", p.allowed),
                    &beyond,
                ]);
                None
            }
            Err(failure) => {
                self.failures.push(format!("{task}, {name}: {failure}"));
                self.row([task, name, "", "", "", "FAILED"]);
                Some(failure)
            }
        }
    }

    /// Adds a check that was not made, because an earlier one failed.
    fn skip(&mut self, name: &str) {
        self.row([self.task, name, "", "", "", "skipped"]);
    }

    fn row(&mut self, cells: [&str; 6]) {
        self.table.row(cells);
        if self.prints {
            let [task, name, compared, worst, allowed, result] = cells;
            let line = format!(
                "│ {task} ┆ {name:<28} ┆ {compared:>6} ┆ {worst:>7} ┆ {allowed:>5} ┆ {result} │"
            );
            // A closed pipe ends the program with the next result.
            self.spinner.suspend(|| _ = print_text(&line));
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use physgrad::policy::Linear;
    use physgrad::rng::Rng;
    use physgrad::{Cotangent, Cotangents, Inputs, Real, Scalar, Start, System};

    /// A component that decays. Its VJP is wrong by `factor`, and the state is not finite after the
    /// step `last`.
    struct Broken {
        factor: f64,
        last: usize,
    }

    impl System for Broken {
        fn state_dim(&self) -> usize {
            1
        }
        fn control_dim(&self) -> usize {
            1
        }
        fn step<T: Scalar>(&self, Inputs { x, u, t, .. }: Inputs<'_, T>, next: &mut [T]) {
            next[0] = x[0] * if t > self.last { f64::NAN } else { 0.5 } + u[0];
        }
        fn vjp<R: Real, C: Cotangent<R>>(
            &self,
            _inputs: Inputs<'_, R>,
            next_bar: &[C],
            cotangents: Cotangents<'_, C>,
        ) {
            if let Some(x_bar) = cotangents.x {
                x_bar[0] += next_bar[0] * R::from(0.5 * self.factor);
            }
            if let Some(u_bar) = cotangents.u {
                u_bar[0] += next_bar[0];
            }
        }
    }

    impl Task for Broken {
        type System = Self;
        fn system(&self) -> &Self {
            self
        }
        fn horizon(&self) -> usize {
            6
        }
        fn start(&self, _rng: &mut Rng, Start { x, .. }: Start<'_>) {
            x.fill(1.0);
        }
        fn terminal_cost<T: Scalar>(&self, x: &[T], _p: &[T]) -> T {
            x[0] * x[0]
        }
    }

    #[test]
    fn one_cause_has_one_message() {
        for (factor, last, expected, rows) in [
            (1.0, 9, None, ["ok"; 7]),
            (
                1.1,
                9,
                Some("vjp: x_bar[0]"),
                ["FAILED", "ok", "ok", "skipped", "skipped", "skipped", "skipped"],
            ),
            (
                1.0,
                3,
                Some("not finite"),
                ["FAILED", "skipped", "ok", "skipped", "skipped", "skipped", "skipped"],
            ),
        ] {
            let mut results = Results::new(false);
            results.begin("broken");
            check(
                &DynTask::new(Broken { factor, last }),
                &Linear::with_bias(1, 1),
                None,
                "scene",
                &mut results,
            );
            let (table, failures) = results.finish();
            assert_eq!(failures.len(), usize::from(expected.is_some()), "{failures:?}");
            assert!(
                failures.iter().all(|failure| expected.is_some_and(|text| failure.contains(text))),
                "{failures:?}"
            );
            let found = table.objects();
            let found: Vec<_> =
                found.as_array().expect("rows").iter().map(|row| row["result"].clone()).collect();
            assert_eq!(found, rows, "{found:?}");
        }
    }
}
