//! States, controls and parameters of rollouts, at which a task is checked in its own units.

use super::{Comparison, Failure, Finding, Passed, finite_weights, systems};
use crate::dynamics::inputs::Inputs;
use crate::dynamics::task::Task;
use crate::engine::any::{AnySystem, AnyTask};
use crate::engine::divergence::{Divergence, Variable};
use crate::engine::rollout::Rollout;
use crate::numbers::rng::{Purpose, Rng, stream};
use crate::policy::{AnyPolicy, Policy, Weights};
use rand::RngExt;

/// Number of rollouts of the checks along rollouts.
const SAMPLES: usize = 4;

/// Finite steps of rollouts, which end before the first non-finite number.
pub(super) struct Visited {
    pub(super) samples: Vec<Sample>,
}

/// Finite steps of one rollout.
pub(super) struct Sample {
    /// States `[step][component]`, the initial state first: one more than controls.
    pub(super) x: Vec<Vec<f64>>,
    /// Controls `[step][component]`.
    pub(super) u: Vec<Vec<f64>>,
    /// Parameters `[step][component]`, at least one step.
    p: Vec<Vec<f64>>,
}

impl Sample {
    /// Parameters of step `t`, or of the last step.
    pub(super) fn p_at(&self, t: usize) -> &[f64] {
        &self.p[t.min(self.p.len() - 1)]
    }
}

/// One step of a rollout, or a step between two of them.
pub(super) struct VisitedStep {
    pub(super) x: Vec<f64>,
    pub(super) u: Vec<f64>,
    pub(super) p: Vec<f64>,
    pub(super) next: Vec<f64>,
    pub(super) t: usize,
}

impl Visited {
    pub(super) fn of(
        task: &dyn AnyTask<f64>,
        policy: &dyn AnyPolicy<f64>,
        weights: &Weights<f64>,
        starts: &[f64],
    ) -> Self {
        let (n, m) = (task.state_dim(), task.control_dim());
        let mut rollout = Rollout::new(task, policy, starts.len() / task.start_dim());
        rollout.start(starts);
        let steps = match rollout.run(task, policy, weights) {
            Err(Divergence::Forward { variable: Variable::State, step, .. }) => {
                step.saturating_sub(1)
            }
            Err(Divergence::Forward { step, .. }) => step,
            _ => task.horizon(),
        };
        let sample = |i: usize| Sample {
            x: (0..=steps).map(|t| (0..n).map(|k| rollout.state(t, i, k)).collect()).collect(),
            u: (0..steps).map(|t| (0..m).map(|k| rollout.control(t, i, k)).collect()).collect(),
            p: (0..steps.max(1)).map(|t| rollout.params_at_step(t, i).collect()).collect(),
        };
        Self { samples: (0..rollout.samples()).map(sample).collect() }
    }

    /// Rollouts of the policy with the parameters `theta`, or random ones. Noise in the parameters
    /// of the policy lets its controls differ from 0.
    fn near(
        task: &dyn AnyTask<f64>,
        policy: &dyn AnyPolicy<f64>,
        theta: Option<&[f64]>,
    ) -> Result<Self, Finding> {
        let mut starts = vec![0.0; SAMPLES * task.start_dim()];
        let mut rng = stream(0, Purpose::Check, 4);
        for start in starts.chunks_exact_mut(task.start_dim()) {
            task.draw(&mut rng, start);
        }
        let weights = finite_weights(task, policy, theta, &starts, 0)?;
        Ok(Self::of(task, policy, &weights, &starts))
    }

    /// Draws a step between two steps of rollouts: state, control and next state. Parameters and
    /// number of the step are those of the first one. With `share` 0, the step is the first one.
    fn draw(&self, rng: &mut Rng, share: f64) -> VisitedStep {
        let mut one = || {
            let sample = &self.samples[rng.random_range(0..self.samples.len())];
            (sample, rng.random_range(0..sample.u.len()))
        };
        let ((a, t), (b, other)) = (one(), one());
        let mixed =
            |a: &[f64], b: &[f64]| a.iter().zip(b).map(|(a, b)| a + share * (b - a)).collect();
        VisitedStep {
            x: mixed(&a.x[t], &b.x[other]),
            u: mixed(&a.u[t], &b.u[other]),
            next: mixed(&a.x[t + 1], &b.x[other + 1]),
            p: a.p_at(t).to_vec(),
            t,
        }
    }

    /// Draws a step at which `is_valid` holds: between two steps of rollouts, otherwise one of them.
    pub(super) fn draw_valid(
        &self,
        rng: &mut Rng,
        is_valid: impl Fn(&VisitedStep) -> bool,
    ) -> VisitedStep {
        let mut same = rng.clone();
        let share = rng.random_range(0.0..0.5);
        let step = self.draw(rng, share);
        if is_valid(&step) {
            return step;
        }
        let _: f64 = same.random_range(0.0..0.5);
        self.draw(&mut same, 0.0)
    }
}

/// Checks the derivatives of the system of a task in states, controls and parameters of rollouts,
/// and between them. See [`system_at`](super::system_at).
///
/// The rollouts start from initial states of the task. The policy has the parameters `theta` or
/// random ones, with noise. The states therefore have the units and the range of the task, for
/// instance temperatures of 300 K, unlike those of [`system`](super::system).
/// ```
/// use physgrad::{check, policy::Linear, tasks::CartPole};
///
/// check::system_along(&CartPole::new(1), &Linear::new(4, 1), None).unwrap();
/// ```
///
/// # Errors
/// Returns the first [`Mismatch`](super::Mismatch), or [`Finding::Diverged`] if the rollouts are
/// non-finite.
///
/// # Panics
/// If the shapes of task and policy differ, or the length of `theta` is not
/// [`Policy::param_count`].
#[inline(never)]
pub fn system_along<T: Task, P: Policy>(
    task: &T,
    policy: &P,
    theta: Option<&[f64]>,
) -> Result<Passed, Failure> {
    check_system(task, policy, theta).map_err(Failure::along)
}

fn check_system<T: Task, P: Policy>(
    task: &T,
    policy: &P,
    theta: Option<&[f64]>,
) -> Result<Passed, Finding> {
    let visited = Visited::near(task, policy, theta)?;
    let system = task.system();
    let is_finite = |step: &VisitedStep| {
        let mut next = vec![0.0; step.x.len()];
        AnySystem::<f64>::step(
            system,
            Inputs { x: &step.x, u: &step.u, p: &step.p, t: step.t },
            &mut next,
        );
        next.iter().all(|next| next.is_finite())
    };
    let draw = |rng: &mut Rng, x: &mut [f64], u: &mut [f64], p: &mut [f64]| {
        let step = visited.draw_valid(rng, is_finite);
        x.copy_from_slice(&step.x);
        u.copy_from_slice(&step.u);
        let len = p.len();
        p.copy_from_slice(&step.p[..len]);
    };
    Ok(systems::check(system, &draw, Task::horizon(task))?)
}

/// Checks the costs and the observation of a task in rollouts; see
/// [`system_along`] and [`cost`](super::cost).
///
/// # Errors
/// As [`system_along`].
///
/// # Panics
/// As [`system_along`].
#[inline(never)]
pub fn cost_along<T: Task, P: Policy>(
    task: &T,
    policy: &P,
    theta: Option<&[f64]>,
) -> Result<Passed, Failure> {
    check_costs(task, policy, theta).map_err(Failure::along)
}

fn check_costs<T: Task, P: Policy>(
    task: &T,
    policy: &P,
    theta: Option<&[f64]>,
) -> Result<Passed, Finding> {
    let visited = Visited::near(task, policy, theta)?;
    let is_finite = |VisitedStep { x, u, p, next, t }: &VisitedStep| {
        let mut y = vec![0.0; task.observation_dim().unwrap_or(0)];
        if !y.is_empty() {
            task.observe(Inputs { x, u: &[], p, t: *t }, &mut y);
        }
        y.push(task.running_cost(Inputs { x, u, p, t: *t }, next) + task.terminal_cost(x, p));
        y.iter().all(|y| y.is_finite())
    };
    let mut c = Comparison::new(super::ONE_STEP);
    for case in 0..super::CASES {
        c.case = case;
        let mut rng = stream(case, Purpose::Check, 0);
        let step = visited.draw_valid(&mut rng, is_finite);
        super::costs::check_at(task, &step, "in a rollout", &mut rng, &mut c)?;
    }
    Ok(c.passed)
}
