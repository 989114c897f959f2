//! [`Trajectory`]: states, controls and cost of one rollout.

use super::OptimizeError;
use super::model::Model;
use crate::dynamics::inputs::Inputs;
use std::sync::atomic::{AtomicBool, Ordering};

/// States, controls and cost of one rollout.
#[derive(Clone, Debug)]
pub(super) struct Trajectory {
    /// States, `[step][component]`, at steps `0 ..= horizon`.
    pub(super) x: Vec<f64>,
    /// Controls, `[step][control]`.
    pub(super) u: Vec<f64>,
    /// Running costs plus terminal cost.
    pub(super) cost: f64,
}

/// Task with the parameters of one sample.
pub(super) struct Problem<'a> {
    pub(super) model: &'a dyn Model,
    pub(super) p: &'a [f64],
    /// Number of state components.
    pub(super) n: usize,
    /// Number of controls.
    pub(super) m: usize,
    /// Flag of the options.
    pub(super) stop: Option<&'a AtomicBool>,
}

impl Problem<'_> {
    /// Returns an error if the flag of the options is set.
    pub(super) fn check_stop(&self) -> Result<(), OptimizeError> {
        let stopped = self.stop.is_some_and(|stop| stop.load(Ordering::Relaxed));
        if stopped { Err(OptimizeError::Stopped) } else { Ok(()) }
    }

    /// Simulates the controls that `control(t, x, u)` writes.
    ///
    /// # Errors
    /// [`OptimizeError`] with the place of the first number that is not finite, or
    /// [`OptimizeError::Stopped`].
    pub(super) fn simulate(
        &self,
        x0: &[f64],
        mut control: impl FnMut(usize, &[f64], &mut [f64]),
    ) -> Result<Trajectory, OptimizeError> {
        let Self { model, p, n, m, .. } = *self;
        let steps = model.horizon();
        let (mut x, mut u, mut cost) = (vec![0.0; (steps + 1) * n], vec![0.0; steps * m], 0.0);
        x[..n].copy_from_slice(x0);
        for t in 0..steps {
            self.check_stop()?;
            let (past, future) = x.split_at_mut((t + 1) * n);
            let (now, next, u) = (&past[t * n..], &mut future[..n], &mut u[t * m..][..m]);
            control(t, now, u);
            finite("control", t, u)?;
            let inputs = Inputs { x: now, u, p, t };
            model.step(inputs, next);
            finite("state", t + 1, next)?;
            cost += model.running_cost(inputs, next);
            if !cost.is_finite() {
                return Err(OptimizeError::Cost { step: Some(t) });
            }
        }
        cost += model.terminal_cost(&x[steps * n..], p);
        if cost.is_finite() {
            Ok(Trajectory { x, u, cost })
        } else {
            Err(OptimizeError::Cost { step: None })
        }
    }
}

fn finite(variable: &'static str, step: usize, values: &[f64]) -> Result<(), OptimizeError> {
    match values.iter().position(|value| !value.is_finite()) {
        None => Ok(()),
        Some(component) => Err(OptimizeError::Diverged { variable, step, component }),
    }
}
