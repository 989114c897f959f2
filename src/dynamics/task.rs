//! [`Task`]: an optimal control problem over a [`System`].

use crate::dynamics::default_vjp::{Add, Function, default_vjp};
use crate::dynamics::inputs::{Cotangents, Inputs, Start};
use crate::dynamics::number::Varied;
use crate::dynamics::system::System;
use crate::numbers::rng::Rng;
use crate::numbers::scalar::{Cotangent, Over, Real, Scalar};

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
    /// Number of parameters, at least those of the system. Default: those of the system.
    ///
    /// Parameters of the task follow those of the system and its effects. Physical numbers of the
    /// system that vary come last.
    fn param_dim(&self) -> usize {
        self.system().param_dim()
    }
    /// Draws an initial state into `start.x` and parameters into `start.p`. On entry, these are
    /// `state_dim` and `param_dim` zeros. Physical numbers that vary are drawn afterwards, so their
    /// entries must remain 0. All other parameters must be written, also those that are 0: an entry
    /// that is neither written, drawn nor trained is NaN, and rollouts refuse it.
    fn start(&self, rng: &mut Rng, start: Start<'_>);
    /// Draws an initial state, parameters, and physical numbers that vary. Entries of `p` that
    /// nothing sets become NaN.
    #[doc(hidden)]
    fn draw_start(&self, rng: &mut Rng, Start { x, p }: Start<'_>) {
        let (own, system) = (p.len(), self.system().param_dim());
        assert!(
            own >= system,
            "`Task::param_dim` is {own}, but the system has {system} parameters; add `self.system().param_dim()`"
        );
        // Equal to 0, but distinguishable from a written 0.
        let unwritten = -0.0_f64;
        p.fill(unwritten);
        self.start(rng, Start { x, p: &mut *p });
        for Varied { index, number, name } in self.system().varied(p.len()) {
            assert!(
                p[index] == 0.0,
                "`Task::start` writes p[{index}], which holds the number `{name}`; add the parameters of the task to \
                 `Task::param_dim`, or leave this entry unwritten"
            );
            p[index] = number.draw(rng);
        }
        p.iter_mut().filter(|p| p.to_bits() == unwritten.to_bits()).for_each(|p| *p = f64::NAN);
    }

    /// Smallest and largest value of each control that the task is meant for, in the units of the
    /// controls. One entry per control; infinite where there is no bound. Default: `None`, no
    /// bounds.
    ///
    /// Nothing enforces these bounds. Environments that scale actions use them, and the command
    /// `optimize` names controls that leave them. [`optimize`](crate::optimize::optimize) has the
    /// bounds of its options only. An [`Actuator`](crate::actuator::Actuator) limits controls.
    fn control_bounds(&self) -> Option<Vec<[f64; 2]>> {
        None
    }

    /// Returns whether episodes can end before the horizon, where [`margin`](Task::margin) is
    /// negative. Default: no. [`Ending`](crate::episode::Ending) ends them.
    fn can_end(&self) -> bool {
        false
    }
    /// Negative in a state that ends an episode, for example the height above which a robot has not
    /// fallen. Only its sign matters. Read only if [`can_end`](Task::can_end).
    #[inline(always)]
    fn margin<T: Scalar>(&self, _x: &[T], _p: &[T]) -> T {
        T::one()
    }
    /// Index of the state component that is 0 while an episode runs, and afterwards the number of
    /// steps that it lasted. Default: `None`; [`Ending`](crate::episode::Ending) adds it.
    fn ended(&self) -> Option<usize> {
        None
    }
    /// Steps before the first one of a rollout, for its noise. Default: 0.
    #[doc(hidden)]
    fn first_step(&self) -> usize {
        0
    }

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
    /// [`observe`](Task::observe) to those of `cotangents` that are requested.
    ///
    /// Defaults to exact derivatives, as [`System::vjp`] does. Override it for speed.
    #[inline(always)]
    fn observe_vjp<R: Real, C: Cotangent<R>>(
        &self,
        inputs: Inputs<'_, R>,
        y_bar: &[C],
        cotangents: Cotangents<'_, C>,
    ) {
        let observation = Observation { task: self, t: inputs.t };
        default_vjp(&observation, inputs.lists(), y_bar, cotangents.lists(), Add::Sum);
    }

    /// Running cost `l` of the step from `inputs` to the state `next`. Default: 0.
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
    /// `cotangents` that are requested.
    ///
    /// Defaults to exact derivatives, as [`System::vjp`] does. Override it for speed.
    #[inline(always)]
    fn running_cost_gradient<R: Real>(
        &self,
        inputs: Inputs<'_, R>,
        next: &[R],
        cotangents: Cotangents<'_, R>,
        next_bar: &mut [R],
    ) {
        let (cost, Inputs { x, u, p, .. }) = (RunningCost { task: self, t: inputs.t }, inputs);
        let cotangents = [cotangents.x, cotangents.u, cotangents.p, Some(next_bar)];
        default_vjp(&cost, [x, u, p, next], &[R::one()], cotangents, Add::Sum);
    }
    /// Adds the gradient of [`terminal_cost`](Task::terminal_cost) to `x_bar`, and to `p_bar` if
    /// requested.
    ///
    /// Defaults to exact derivatives, as [`System::vjp`] does. Override it for speed.
    #[inline(always)]
    fn terminal_cost_gradient<R: Real>(
        &self,
        x: &[R],
        p: &[R],
        x_bar: &mut [R],
        p_bar: Option<&mut [R]>,
    ) {
        default_vjp(&TerminalCost(self), [x, p], &[R::one()], [Some(x_bar), p_bar], Add::Sum);
    }
}

/// [`Task::observe`] as a function of state, control and parameters.
struct Observation<'a, T: ?Sized> {
    task: &'a T,
    t: usize,
}

impl<S: Task + ?Sized, R> Function<R, 3> for Observation<'_, S> {
    #[inline(always)]
    fn eval<T: Over<R>>(&self, [x, u, p]: [&[T]; 3], y: &mut [T]) {
        self.task.observe(Inputs { x, u, p, t: self.t }, y);
    }
}

/// [`Task::running_cost`] as a function of state, control, parameters and next state.
struct RunningCost<'a, T: ?Sized> {
    task: &'a T,
    t: usize,
}

impl<S: Task + ?Sized, R> Function<R, 4> for RunningCost<'_, S> {
    #[inline(always)]
    fn eval<T: Over<R>>(&self, [x, u, p, next]: [&[T]; 4], cost: &mut [T]) {
        cost[0] = self.task.running_cost(Inputs { x, u, p, t: self.t }, next);
    }
}

/// [`Task::terminal_cost`] as a function of state and parameters.
struct TerminalCost<'a, T: ?Sized>(&'a T);

impl<S: Task + ?Sized, R> Function<R, 2> for TerminalCost<'_, S> {
    #[inline(always)]
    fn eval<T: Over<R>>(&self, [x, p]: [&[T]; 2], cost: &mut [T]) {
        cost[0] = self.0.terminal_cost(x, p);
    }
}
