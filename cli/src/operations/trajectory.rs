//! Trajectories of a policy, independent of task and policy types.

use physgrad::engine::Variable;
use physgrad::engine::any::AnyTask;
use physgrad::policy::{Action, AnyPolicy, Observed};
use physgrad::{Divergence, Float, Inputs, Policy, Rollout, System, Task, Weights};
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

/// The rollout of a policy from a start whose noise stays at its mean, up to the first state that is not
/// finite.
pub fn follow<T: Task, P: Policy>(
    task: &T,
    policy: &P,
    theta: &[f64],
    start: Trajectory,
) -> Trajectory {
    let Trajectory { mut states, params, .. } = start;
    let (system, observed) = (task.system(), task.observation_dim());
    let (mut x, p) = (states[0].clone(), &params[0]);
    let mut memory = vec![0.0; policy.memory_dim()];
    let mut controls = Vec::new();
    for t in 0..task.horizon() {
        let mut y = x.clone();
        if let Some(observed) = observed {
            y = vec![0.0; observed];
            task.observe(Inputs { x: &x, u: &[], p, t }, &mut y);
        }
        let mut u = vec![0.0; policy.control_dim()];
        let mut next_memory = memory.clone();
        let action = Action { u: &mut u, memory: &mut next_memory };
        policy.act(theta, Observed { y: &y, memory: &memory, t }, action);
        let mut next = x.clone();
        system.step(Inputs { x: &x, u: &u, p, t }, &mut next);
        if next.iter().chain(&u).any(|number| !number.is_finite()) {
            break;
        }
        (x, memory) = (next, next_memory);
        states.push(x.clone());
        controls.push(u);
    }
    let params = vec![params[0].clone(); states.len()];
    Trajectory { states, controls, params }
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
