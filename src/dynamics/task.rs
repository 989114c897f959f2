//! [`Task`]: what is to be achieved with a system.

use crate::dynamics::system::System;
use crate::numbers::forward_mode::{concat, jacobian};
use crate::numbers::rng::Rng;
use crate::numbers::scalar::{Real, Scalar};

/// A system, how long it runs, where it starts, and what it costs.
///
/// The loss of one sample is `terminal_cost(x_T) + Σ_t stage_cost(x_{t+1}, u_t)` for `t = 0 .. T-1`; the loss of a
/// batch is the mean over its samples.
pub trait Task: Send + Sync {
    /// The physics.
    type System: System;

    /// The physics.
    fn system(&self) -> &Self::System;
    /// Number of steps `T` of one rollout.
    fn horizon(&self) -> usize;
    /// Draws a start state into `x`, `state_dim` zeros.
    fn start(&self, rng: &mut Rng, x: &mut [f64]);

    /// Cost `l(x_{t+1}, u_t)` of one step: the state it led to and the control it used.
    #[inline(always)]
    fn stage_cost<T: Scalar>(&self, _x: &[T], _u: &[T]) -> T {
        T::zero()
    }
    /// Cost `φ(x_T)` of the last state.
    #[inline(always)]
    fn terminal_cost<T: Scalar>(&self, _x: &[T]) -> T {
        T::zero()
    }

    /// Gradient of [`stage_cost`](Task::stage_cost); overwrites both. Exact by duals until overridden for speed.
    #[inline(always)]
    fn stage_cost_gradient<R: Real>(&self, x: &[R], u: &[R], x_bar: &mut [R], u_bar: &mut [R]) {
        let n = x.len();
        let inputs = concat(x, u);
        let cost = |xu: &[_], cost: &mut [_]| cost[0] = self.stage_cost(&xu[..n], &xu[n..]);
        jacobian(&inputs, 0..inputs.len(), 1, cost, |i, slope: &[R]| {
            *if i < n { &mut x_bar[i] } else { &mut u_bar[i - n] } = slope[0];
        });
    }
    /// Gradient of [`terminal_cost`](Task::terminal_cost); overwrites it. Exact by duals until overridden for speed.
    #[inline(always)]
    fn terminal_cost_gradient<R: Real>(&self, x: &[R], x_bar: &mut [R]) {
        let cost = |x: &[_], cost: &mut [_]| cost[0] = self.terminal_cost(x);
        jacobian(x, 0..x.len(), 1, cost, |i, slope: &[R]| x_bar[i] = slope[0]);
    }
}
