//! [`Tracking`]: the task to follow a plan.

use super::options::check_length;
use super::{OptimizeError, Plan};
use crate::dynamics::inputs::{Inputs, Start};
use crate::dynamics::system::System;
use crate::dynamics::task::Task;
use crate::numbers::rng::Rng;
use crate::numbers::scalar::Scalar;
use rand::RngExt;

/// Task to follow a [`Plan`] from initial states near that of the plan.
///
/// ```text
/// l = Σ_i w_i (x_{t+1,i} - x̄_{t+1,i})²/2 + Σ_j v_j (u_{t,j} - ū_{t,j})²/2
/// ```
///
/// x̄ and ū are the states and controls of the plan. The observation is the deviation `x_t - x̄_t`.
/// A suitable policy is a [`Sum`](crate::policy::Sum) of a feedback and an
/// [`OpenLoop`](crate::policy::OpenLoop) with the controls of the plan. If the feedback is
/// initially 0, the initial controls are those of the plan. The system is that of the planned task.
/// All samples have the parameters of the plan. The plan needs as many steps as the planned task.
#[derive(Clone, Debug, PartialEq)]
pub struct Tracking<'a, T> {
    task: &'a T,
    plan: &'a Plan,
    /// Weights w of the state components.
    pub state_weights: Vec<f64>,
    /// Weights v of the controls.
    pub control_weights: Vec<f64>,
    /// Largest deviation of each component of the initial state from that of the plan.
    pub spread: f64,
}

impl<'a, T: Task> Tracking<'a, T> {
    /// Follows the plan of a task, with weights of 1 for states and 0 for controls, and a spread
    /// of 0.
    ///
    /// # Errors
    /// [`OptimizeError::Length`] if the plan does not fit the task.
    pub fn new(task: &'a T, plan: &'a Plan) -> Result<Self, OptimizeError> {
        let (n, m, steps) =
            (task.system().state_dim(), task.system().control_dim(), task.horizon());
        check_length(
            "a state of the plan",
            "components of a state of the task",
            n,
            plan.state_dim,
        )?;
        check_length(
            "a control of the plan",
            "components of a control of the task",
            m,
            plan.control_dim,
        )?;
        check_length("plan.x", "states of all steps", (steps + 1) * n, plan.x.len())?;
        check_length("plan.u", "controls of all steps", steps * m, plan.u.len())?;
        check_length("plan.p", "the parameters of the task", task.param_dim(), plan.p.len())?;
        Ok(Self {
            task,
            plan,
            state_weights: vec![1.0; n],
            control_weights: vec![0.0; m],
            spread: 0.0,
        })
    }
}

/// Returns `Σ_i weights_i (values_i - planned_i)²/2`.
#[inline(always)]
fn distance<T: Scalar>(weights: &[f64], values: &[T], planned: &[f64]) -> T {
    assert_eq!(
        weights.len(),
        values.len(),
        "tracking needs one weight per state component and one per control"
    );
    let mut sum = T::zero();
    for ((&weight, &value), &planned) in weights.iter().zip(values).zip(planned) {
        let deviation = value - planned;
        sum += deviation * deviation * (0.5 * weight);
    }
    sum
}

impl<T: Task> Task for Tracking<'_, T> {
    type System = T::System;

    fn system(&self) -> &T::System {
        self.task.system()
    }

    fn horizon(&self) -> usize {
        self.task.horizon()
    }

    fn param_dim(&self) -> usize {
        self.task.param_dim()
    }

    fn start(&self, rng: &mut Rng, start: Start<'_>) {
        for (x, planned) in start.x.iter_mut().zip(self.plan.state(0)) {
            *x = planned + self.spread * rng.random_range(-1.0..1.0);
        }
        start.p.copy_from_slice(&self.plan.p);
    }

    fn draw_start(&self, rng: &mut Rng, start: Start<'_>) {
        // Draws no physical numbers: all parameters have the values of the plan.
        self.start(rng, start);
    }

    fn observation_dim(&self) -> Option<usize> {
        Some(self.system().state_dim())
    }

    #[inline(always)]
    fn observe<S: Scalar>(&self, Inputs { x, t, .. }: Inputs<'_, S>, y: &mut [S]) {
        for ((y, &x), &planned) in y.iter_mut().zip(x).zip(self.plan.state(t)) {
            *y = x - planned;
        }
    }

    #[inline(always)]
    fn running_cost<S: Scalar>(&self, Inputs { u, t, .. }: Inputs<'_, S>, next: &[S]) -> S {
        distance(&self.state_weights, next, self.plan.state(t + 1))
            + distance(&self.control_weights, u, self.plan.control(t))
    }
}
