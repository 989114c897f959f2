//! [`Upright`]: swing-up and balancing of any mechanical system with angles.

use crate::dynamics::inputs::{Cotangents, Inputs, Start};
use crate::dynamics::integrator::{Integrated, RungeKutta};
use crate::dynamics::system::System;
use crate::dynamics::task::Task;
use crate::numbers::rng::Rng;
use crate::numbers::scalar::{Real, Scalar};
use crate::numbers::zip::zip;
use crate::tasks::{CartPoleSystem, DoublePendulum, LossMode, PoleChain};
use rand::RngExt;
use std::f64::consts::PI;

/// Task to swing up or balance, with the mean of `1 - cos θ` over the angles as loss.
///
/// This mean lies between 0 (all upright) and 2 (all hanging). It is evaluated at the last state or
/// averaged over time, as in [`CartPole`](crate::tasks::CartPole). The loss also contains the mean
/// over time of `control_weight |u|²/2`.
///
/// The angles are every second component of the state, starting at
/// [`first_angle`](Upright::first_angle).
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Upright<S> {
    /// System to control.
    pub system: S,
    /// Index of the first angle in the state.
    pub first_angle: usize,
    /// Center of the initial angles, rad: 0 upright, π hanging.
    pub from: f64,
    /// Largest initial deviation of every component, SI units: of angles from `from`, of others
    /// from 0.
    pub spread: f64,
    /// States that enter the loss.
    pub loss: LossMode,
    /// Weight of `|u|²/2` in the loss, per squared unit of the control.
    pub control_weight: f64,
    /// Largest control that the task is meant for, by magnitude, in units of the control.
    pub control_bound: f64,
    /// Number of steps.
    pub horizon: usize,
}

/// ODE integrated by a Runge-Kutta method.
type Stepped<O> = Integrated<O, RungeKutta>;

impl<S> Upright<S> {
    /// Creates a swing-up: 100 steps, terminal loss, no control cost, controls up to 30. Initial angles lie within
    /// ±π/6 of hanging, other components within ±π/6 of 0.
    fn swing_up(system: S, first_angle: usize) -> Self {
        Self {
            system,
            first_angle,
            from: PI,
            spread: PI / 6.0,
            loss: LossMode::Terminal,
            control_weight: 0.0,
            control_bound: 30.0,
            horizon: 100,
        }
    }

    /// Converts the task to balancing: running loss, control weight 0.001. Initial components lie
    /// within ±0.05 of upright or of 0.
    pub fn held(self) -> Self {
        Self { from: 0.0, spread: 0.05, loss: LossMode::Running, control_weight: 1e-3, ..self }
    }
}

impl Upright<Stepped<DoublePendulum>> {
    /// Creates the swing-up of the default double pendulum, with steps of 0.01 s.
    pub fn double_pendulum() -> Self {
        Self::swing_up(
            Integrated { ode: DoublePendulum::default(), integrator: RungeKutta::RK4, dt: 0.01 },
            0,
        )
    }
}

impl Upright<Stepped<PoleChain>> {
    /// Creates the swing-up of a chain of default poles, with steps of 0.01 s.
    ///
    /// # Panics
    /// If the number of poles is 0 or too large.
    #[track_caller]
    pub fn pole_chain(poles: usize) -> Self {
        let model = CartPoleSystem { poles, ..CartPoleSystem::default() };
        if let Err(error) = PoleChain(model).check() {
            panic!("{error}");
        }
        Self::swing_up(
            Integrated { ode: PoleChain(model), integrator: RungeKutta::RK4, dt: model.dt },
            2,
        )
    }
}

impl<S: System> Upright<S> {
    /// Returns one over the number of angles.
    fn share(&self) -> f64 {
        1.0 / (self.system.state_dim() - self.first_angle).div_ceil(2) as f64
    }

    /// Returns `factor` times the mean of `1 - cos θ`.
    #[inline(always)]
    fn height<T: Scalar>(&self, factor: f64, x: &[T]) -> T {
        let mut sum = T::zero();
        for i in (self.first_angle..x.len()).step_by(2) {
            sum += T::one() - x[i].cos();
        }
        sum * (factor * self.share())
    }

    /// Adds the gradient of [`height`](Self::height).
    #[inline(always)]
    fn height_gradient<R: Real>(&self, factor: f64, x: &[R], x_bar: &mut [R]) {
        let factor = R::from(factor * self.share());
        for i in (self.first_angle..x.len()).step_by(2) {
            x_bar[i] += x[i].sin() * factor;
        }
    }

    /// Returns the weights of the angles in the running and the terminal cost.
    fn worth(&self) -> [f64; 2] {
        match self.loss {
            LossMode::Terminal => [0.0, 1.0],
            LossMode::Running => [1.0 / self.horizon as f64, 0.0],
        }
    }

    fn effort_per_step(&self) -> f64 {
        self.control_weight / self.horizon as f64
    }
}

impl<S: System> Task for Upright<S> {
    type System = S;

    fn system(&self) -> &S {
        &self.system
    }

    fn horizon(&self) -> usize {
        self.horizon
    }

    /// ±[`control_bound`](Upright::control_bound).
    fn control_bounds(&self) -> Option<Vec<[f64; 2]>> {
        Some(vec![[-self.control_bound, self.control_bound]; self.system.control_dim()])
    }

    fn start(&self, rng: &mut Rng, start: Start<'_>) {
        for (i, x) in start.x.iter_mut().enumerate() {
            let is_angle = i >= self.first_angle && (i - self.first_angle).is_multiple_of(2);
            *x = if is_angle { self.from } else { 0.0 } + self.spread * rng.random_range(-1.0..1.0);
        }
    }

    #[inline(always)]
    fn running_cost<T: Scalar>(&self, Inputs { u, .. }: Inputs<'_, T>, next: &[T]) -> T {
        let mut cost = self.height(self.worth()[0], next);
        for &u in u {
            cost += u * u * (0.5 * self.effort_per_step());
        }
        cost
    }

    #[inline(always)]
    fn terminal_cost<T: Scalar>(&self, x: &[T], _p: &[T]) -> T {
        self.height(self.worth()[1], x)
    }

    #[inline(always)]
    fn running_cost_gradient<R: Real>(
        &self,
        inputs: Inputs<'_, R>,
        next: &[R],
        cotangents: Cotangents<'_, R>,
        next_bar: &mut [R],
    ) {
        self.height_gradient(self.worth()[0], next, next_bar);
        if let Some(u_bar) = cotangents.u {
            for (u_bar, &u) in zip(u_bar.iter_mut(), inputs.u) {
                *u_bar += u * self.effort_per_step();
            }
        }
    }

    #[inline(always)]
    fn terminal_cost_gradient<R: Real>(
        &self,
        x: &[R],
        _p: &[R],
        x_bar: &mut [R],
        _p_bar: Option<&mut [R]>,
    ) {
        self.height_gradient(self.worth()[1], x, x_bar);
    }
}
