//! [`Task`]: an optimal control problem over a [`System`].

use crate::dynamics::inputs::{Cotangents, Inputs, Start, add};
use crate::dynamics::system::{System, each_column};
use crate::numbers::rng::Rng;
use crate::numbers::scalar::{Cotangent, Real, Scalar};
use crate::numbers::zip::zip;
use smallvec::SmallVec;

/// A system with a horizon, a distribution of initial states, and costs.
///
/// The loss of one sample is `φ(x_T, p) + Σ_t l(x_t, u_t, p, t, x_{t+1})` for `t = 0 .. T-1`, with
/// the running cost `l` ([`running_cost`](Task::running_cost)) and the terminal cost `φ`
/// ([`terminal_cost`](Task::terminal_cost)). The loss of a batch is the mean over its samples.
#[diagnostic::on_unimplemented(
    message = "`{Self}` is not a task",
    note = "implement `physgrad::Task`: `system`, `horizon`, `start` and a cost; `check::system` checks a system alone"
)]
pub trait Task: Send + Sync {
    /// Type of the system.
    type System: System;

    /// The system.
    fn system(&self) -> &Self::System;
    /// Number of time steps `T` of one rollout.
    fn horizon(&self) -> usize;
    /// Number of parameters, at least those of the system, which come first. Default: those of the
    /// system.
    fn param_dim(&self) -> usize {
        self.system().param_dim()
    }
    /// Draws an initial state into `start.x`, of `state_dim` zeros, and parameters into `start.p`,
    /// of `param_dim` zeros.
    fn start(&self, rng: &mut Rng, start: Start<'_>);

    /// Number of components of [`observe`](Task::observe). Default: `None`, the policy observes the
    /// state.
    fn observation_dim(&self) -> Option<usize> {
        None
    }
    /// Writes the observation `y(x_t, p, t)`, the input of the policy. `inputs.u` is empty. Not
    /// called if [`observation_dim`](Task::observation_dim) is `None`.
    ///
    /// ```
    /// # use physgrad::{Inputs, Scalar};
    /// // An angle as sine and cosine, and the distance to a goal, a parameter of the sample.
    /// fn observe<T: Scalar>(Inputs { x, p, .. }: Inputs<'_, T>, y: &mut [T]) {
    ///     (y[0], y[1]) = x[0].sin_cos();
    ///     y[2] = p[0] - x[1];
    /// }
    /// ```
    #[inline(always)]
    fn observe<T: Scalar>(&self, inputs: Inputs<'_, T>, y: &mut [T]) {
        y.copy_from_slice(inputs.x);
    }
    /// Adds the Jacobian products `(∂y/∂x)ᵀ y_bar` and `(∂y/∂p)ᵀ y_bar` of
    /// [`observe`](Task::observe) to those of `bars` that are requested.
    ///
    /// Defaults to exact derivatives by dual numbers. Override it for speed.
    #[inline(always)]
    fn observe_vjp<R: Real, C: Cotangent<R>>(&self, inputs: Inputs<'_, R>, y_bar: &[C], bars: Cotangents<'_, C>) {
        let t = inputs.t;
        let observe = |inputs: Inputs<'_, _, ()>, y: &mut [_]| self.observe(inputs.at(t), y);
        each_column(inputs, y_bar.len(), bars, observe, |bar: &mut C, column: &[R]| {
            let mut sum = C::null();
            for (&y_bar, &slope) in zip(y_bar.iter(), column) {
                sum += y_bar * slope;
            }
            *bar += sum;
        });
    }

    /// Running cost `l` of the step from `inputs` to `next`. Default: 0.
    #[inline(always)]
    fn running_cost<T: Scalar>(&self, _inputs: Inputs<'_, T>, _next: &[T]) -> T {
        T::zero()
    }
    /// Terminal cost `φ(x_T, p)` of the final state. Default: 0.
    #[inline(always)]
    fn terminal_cost<T: Scalar>(&self, _x: &[T], _p: &[T]) -> T {
        T::zero()
    }

    /// Adds the gradient of [`running_cost`](Task::running_cost) to `next_bar` and to those of
    /// `bars` that are requested.
    ///
    /// Defaults to exact derivatives by dual numbers. Override it for speed.
    #[inline(always)]
    fn running_cost_gradient<R: Real>(&self, inputs: Inputs<'_, R>, next: &[R], bars: Cotangents<'_, R>, next_bar: &mut [R]) {
        let (n, t) = (next.len(), inputs.t);
        // Appends the next state to the parameters.
        let p: SmallVec<[R; 16]> = inputs.p.iter().chain(next).copied().collect();
        let own = inputs.p.len();
        let all = Inputs { p: &p, ..inputs };
        let cost = |all: Inputs<'_, _, ()>, cost: &mut [_]| {
            let (p, next) = all.p.split_at(own);
            cost[0] = self.running_cost(Inputs { p, ..all.at(t) }, next);
        };
        let mut p_bar: SmallVec<[R; 16]> = SmallVec::from_elem(R::null(), own + n);
        let Cotangents { x, u, p } = bars;
        let all_bars = Cotangents { x, u, p: Some(&mut p_bar) };
        each_column(all, 1, all_bars, cost, |bar: &mut R, slope: &[R]| *bar += slope[0]);
        let (own_bar, of_next) = p_bar.split_at(own);
        add(next_bar, of_next);
        if let Some(p) = p {
            add(p, own_bar);
        }
    }
    /// Adds the gradient of [`terminal_cost`](Task::terminal_cost) to `x_bar`, and to `p_bar` if
    /// requested.
    ///
    /// Defaults to exact derivatives by dual numbers. Override it for speed.
    #[inline(always)]
    fn terminal_cost_gradient<R: Real>(&self, x: &[R], p: &[R], x_bar: &mut [R], p_bar: Option<&mut [R]>) {
        let inputs = Inputs { x, u: &[], p, t: () };
        let cost = |inputs: Inputs<'_, _, ()>, cost: &mut [_]| cost[0] = self.terminal_cost(inputs.x, inputs.p);
        let bars = Cotangents { x: Some(x_bar), u: None, p: p_bar };
        each_column(inputs, 1, bars, cost, |bar: &mut R, slope: &[R]| *bar += slope[0]);
    }
}
