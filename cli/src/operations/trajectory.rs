//! Trajectories of a policy, independent of task and policy types.

use physgrad::engine::Variable;
use physgrad::engine::any::AnyTask;
use physgrad::policy::AnyPolicy;
use physgrad::{Divergence, Float, Rollout, Weights};
use std::ops::Range;

/// Largest number of test rollouts in the `trajectory.csv` of a run.
pub const ROLLOUTS: usize = 4;

/// One rollout. If the batch of rollouts diverges, all its rollouts end before the first non-finite
/// state, control or memory, but contain the initial state.
pub struct Trajectory {
    /// States `[step][component]`, the initial state first.
    pub states: Vec<Vec<f64>>,
    /// Controls `[step][component]`, one entry fewer than the states.
    pub controls: Vec<Vec<f64>>,
    /// Parameters `[step][component]`, as many as states. Only noise differs between steps. The last
    /// entry repeats the one before.
    pub params: Vec<Vec<f64>>,
}

impl Trajectory {
    /// The trajectory up to the first state in which the component `ended` is not 0.
    pub fn until_end(mut self, ended: Option<usize>) -> Self {
        let last = ended.and_then(|i| self.states.iter().position(|state| state[i] > 0.0));
        if let Some(last) = last {
            self.states.truncate(last + 1);
            self.controls.truncate(last);
            self.params.truncate(last + 1);
        }
        self
    }
}

/// Rollouts of the policy from a range of the initial states, each up to the end of its episode.
/// Truncates the end of the range to the available states.
pub fn rollouts<F: Float>(
    task: &dyn AnyTask<F>,
    policy: &dyn AnyPolicy<F>,
    weights: &Weights<F>,
    starts: &[F],
    chosen: Range<usize>,
) -> Vec<Trajectory> {
    let rollouts = until_divergence(task, policy, weights, starts, chosen).0;
    rollouts.into_iter().map(|rollout| rollout.until_end(task.ended())).collect()
}

/// Rollouts over the whole horizon, and the first non-finite number.
pub fn until_divergence<F: Float>(
    task: &dyn AnyTask<F>,
    policy: &dyn AnyPolicy<F>,
    weights: &Weights<F>,
    starts: &[F],
    chosen: Range<usize>,
) -> (Vec<Trajectory>, Option<Divergence>) {
    let (n, m, len) = (task.state_dim(), task.control_dim(), task.start_dim());
    let starts = &starts[chosen.start * len..starts.len().min(chosen.end * len)];
    let samples = starts.len() / len;
    let mut rollout = Rollout::new(task, policy, samples);
    rollout.start(starts);
    let divergence = rollout.run(task, policy, weights).err();
    let steps = match divergence {
        Some(Divergence::Forward { variable: Variable::State, step, .. }) => step.saturating_sub(1),
        Some(Divergence::Forward {
            variable: Variable::Control | Variable::Memory | Variable::Parameter,
            step,
            ..
        }) => step,
        _ => task.horizon(),
    };
    let trajectory = |sample: usize| Trajectory {
        states: (0..=steps)
            .map(|t| (0..n).map(|i| rollout.state(t, sample, i).as_()).collect())
            .collect(),
        controls: (0..steps)
            .map(|t| (0..m).map(|i| rollout.control(t, sample, i).as_()).collect())
            .collect(),
        params: (0..=steps)
            .map(|t| t.min(steps.saturating_sub(1)))
            .map(|t| rollout.params_at_step(t, sample).map(|p| p.as_()).collect())
            .collect(),
    };
    ((0..samples).map(trajectory).collect(), divergence)
}
