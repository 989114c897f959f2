//! [`Task`]: an optimal control problem over a [`System`].

use crate::dynamics::system::System;
use crate::numbers::forward_mode::{concat, jacobian};
use crate::numbers::rng::Rng;
use crate::numbers::scalar::{Real, Scalar};

/// A system with a horizon, a distribution of initial states, and costs.
///
/// The loss of one sample is `φ(x_T) + Σ_t l(x_{t+1}, u_t)` for `t = 0 .. T-1`, with the running
/// cost `l` ([`stage_cost`](Task::stage_cost)) and the terminal cost `φ`
/// ([`terminal_cost`](Task::terminal_cost)). The loss of a batch is the mean over its samples.
pub trait Task: Send + Sync {
    /// Type of the system.
    type System: System;

    /// The system.
    fn system(&self) -> &Self::System;
    /// Number of time steps `T` of one rollout.
    fn horizon(&self) -> usize;
    /// Draws an initial state into `x`, which holds `state_dim` zeros.
    fn start(&self, rng: &mut Rng, x: &mut [f64]);

    /// Running cost `l(x_{t+1}, u_t)` of one step, with `x` the next state. Default: 0.
    #[inline(always)]
    fn stage_cost<T: Scalar>(&self, _x: &[T], _u: &[T]) -> T {
        T::zero()
    }
    /// Terminal cost `φ(x_T)` of the final state. Default: 0.
    #[inline(always)]
    fn terminal_cost<T: Scalar>(&self, _x: &[T]) -> T {
        T::zero()
    }

    /// Gradient of [`stage_cost`](Task::stage_cost). Overwrites `x_bar` and `u_bar`.
    ///
    /// Defaults to exact derivatives by dual numbers. Override it for speed.
    #[inline(always)]
    fn stage_cost_gradient<R: Real>(&self, x: &[R], u: &[R], x_bar: &mut [R], u_bar: &mut [R]) {
        let n = x.len();
        let inputs = concat(x, u);
        let cost = |xu: &[_], cost: &mut [_]| cost[0] = self.stage_cost(&xu[..n], &xu[n..]);
        jacobian(&inputs, 0..inputs.len(), 1, cost, |i, slope: &[R]| {
            *if i < n { &mut x_bar[i] } else { &mut u_bar[i - n] } = slope[0];
        });
    }
    /// Gradient of [`terminal_cost`](Task::terminal_cost). Overwrites `x_bar`.
    ///
    /// Defaults to exact derivatives by dual numbers. Override it for speed.
    #[inline(always)]
    fn terminal_cost_gradient<R: Real>(&self, x: &[R], x_bar: &mut [R]) {
        let cost = |x: &[_], cost: &mut [_]| cost[0] = self.terminal_cost(x);
        jacobian(x, 0..x.len(), 1, cost, |i, slope: &[R]| x_bar[i] = slope[0]);
    }
}
