//! Outputs that a task or policy leaves unwritten, and parameters that an initial state leaves at 0.

use super::Rollout;
use crate::dynamics::inputs::Inputs;
use crate::engine::any::AnyTask;
use crate::engine::pass::Closed;
use crate::numbers::scalar::{Float, LANES, Lane, Real, Scalar};
use crate::policy::{AnyPolicy, Weights};

impl<F: Float> Rollout<F> {
    /// First component that the first step from `starts` leaves unwritten, with the method that
    /// should write it: `observe`, `act` (controls, then memory) or `step`.
    ///
    /// Buffers of a rollout begin with zeros and keep the values of earlier steps, so an unwritten
    /// component is otherwise finite, and wrong. Controls that `act` leaves unwritten are always 0, which
    /// only policies with batched passes of their own reveal; `check::policy` checks them.
    pub(crate) fn first_unwritten(
        task: &dyn AnyTask<F>,
        policy: &dyn AnyPolicy<F>,
        weights: &Weights<F>,
        starts: &[F],
    ) -> Option<(&'static str, usize)> {
        // A rollout names parameters that nothing sets. They are NaN.
        if starts.iter().any(|number| number.as_().is_nan()) {
            return None;
        }
        let stepped = |initial: f64| {
            let initial = F::from_f64(initial);
            let mut rollout = Self::with_steps(task, policy, starts.len() / task.start_dim(), 1);
            rollout.start(starts);
            rollout.carried_at_mut(1).fill(Lane::splat(initial));
            rollout.observations.fill(Lane::splat(initial));
            rollout.outputs.fill(initial);
            // The step is complete even if it returns an error.
            _ = rollout.step(Closed { task, policy, weights }, 0);
            rollout
        };
        let (from_nans, from_zeros) = (stepped(f64::NAN), stepped(0.0));
        let outputs = policy.control_dim() + policy.memory_dim();
        let lanes = |a: &[Lane<F>], b: &[Lane<F>]| {
            let is_unwritten =
                |(a, b): (&Lane<F>, &Lane<F>)| (0..LANES).any(|i| unwritten(a.lane(i), b.lane(i)));
            a.iter().zip(b).position(is_unwritten)
        };
        let observed = lanes(&from_nans.observations, &from_zeros.observations);
        let acted = || {
            from_nans.outputs.iter().zip(&from_zeros.outputs).position(|(&a, &b)| unwritten(a, b))
        };
        let moved = || lanes(from_nans.states_at(1), from_zeros.states_at(1));
        let place = |method, at: Option<usize>, of: usize| at.map(|at| (method, at % of));
        // The first one causes those after it.
        place("observe", observed, task.observed_dim())
            .or_else(|| place("act", acted(), outputs))
            .or_else(|| place("step", moved(), task.state_dim()))
    }
}

/// Compares a number written over NaN with the same number written over 0.
fn unwritten<F: Float>(from_nan: F, from_zero: F) -> bool {
    from_nan.as_().is_nan() && !from_zero.as_().is_nan()
}

/// First parameter of a sample that is 0, if the step is finite with 1 in its place. `inputs` are
/// those of the block of the sample.
#[cold]
pub(super) fn zero_param<F: Float>(
    task: &dyn AnyTask<F>,
    inputs: Inputs<'_, Lane<F>>,
    lane: usize,
) -> Option<usize> {
    let is_finite = |i: &usize| {
        let (mut p, mut next, mut costs) = (inputs.p.to_vec(), inputs.x.to_vec(), [Lane::zero()]);
        p[*i].set_lane(lane, F::from_f64(1.0));
        task.step_forward(Inputs { p: &p, ..inputs }, &mut next, &mut costs);
        next.iter().all(|next| next.lane(lane).as_().is_finite())
    };
    (0..inputs.p.len()).filter(|&i| inputs.p[i].lane(lane).as_() == 0.0).find(is_finite)
}
