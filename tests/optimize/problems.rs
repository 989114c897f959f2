//! Optimization problems of these tests.

use physgrad::prelude::*;
use physgrad::tasks::CartPoleSystem;
use std::f64::consts::PI;

/// Swing-up of one pole on a cart, from hanging at rest to rest upright at the origin. SI units.
#[derive(Clone, Debug)]
pub struct SwingUp {
    pub system: CartPoleSystem,
    pub horizon: usize,
}

impl SwingUp {
    /// Returns the task with a horizon of 2 s in steps of 0.02 s.
    pub fn new() -> Self {
        Self { system: CartPoleSystem { dt: 0.02, ..CartPoleSystem::default() }, horizon: 100 }
    }

    /// Cart at rest at the origin, with the pole hanging at rest.
    pub const START: [f64; 4] = [0.0, 0.0, PI, 0.0];
}

impl Task for SwingUp {
    type System = CartPoleSystem;

    fn system(&self) -> &CartPoleSystem {
        &self.system
    }

    fn horizon(&self) -> usize {
        self.horizon
    }

    fn start(&self, _: &mut Rng, Start { x, .. }: Start<'_>) {
        x.copy_from_slice(&Self::START);
    }

    fn running_cost<T: Scalar>(&self, Inputs { x, u, .. }: Inputs<'_, T>, _next: &[T]) -> T {
        (u[0] * u[0] * 1e-3 + x[0] * x[0] * 0.1) * self.system.dt
    }

    fn terminal_cost<T: Scalar>(&self, x: &[T], _p: &[T]) -> T {
        (T::one() - x[2].cos()) * 100.0 + (x[0] * x[0] + x[1] * x[1] + x[3] * x[3]) * 10.0
    }
}

/// Swing-up of a pendulum of 1 kg and 1 m, from hanging at rest to rest upright.
///
/// State [angle rad (0 = up), rate rad/s], control [torque N m]. A torque of 9.81 N m holds the
/// pendulum horizontally.
#[derive(Clone, Debug)]
pub struct Pendulum {
    /// Time step, s.
    pub dt: f64,
    pub horizon: usize,
}

impl System for Pendulum {
    fn state_dim(&self) -> usize {
        2
    }

    fn control_dim(&self) -> usize {
        1
    }

    fn step<T: Scalar>(&self, Inputs { x, u, .. }: Inputs<'_, T>, next: &mut [T]) {
        next[1] = x[1] + (u[0] + x[0].sin() * 9.81) * self.dt;
        next[0] = x[0] + next[1] * self.dt;
    }
}

impl Task for Pendulum {
    type System = Self;

    fn system(&self) -> &Self {
        self
    }

    fn horizon(&self) -> usize {
        self.horizon
    }

    fn start(&self, _: &mut Rng, Start { x, .. }: Start<'_>) {
        x[0] = PI;
    }

    fn running_cost<T: Scalar>(&self, Inputs { u, .. }: Inputs<'_, T>, _next: &[T]) -> T {
        u[0] * u[0] * (1e-3 * self.dt)
    }

    fn terminal_cost<T: Scalar>(&self, x: &[T], _p: &[T]) -> T {
        (T::one() - x[0].cos()) * 100.0 + x[1] * x[1] * 10.0
    }
}

/// Affine system with a non-quadratic cost that couples states, controls and parameter.
///
/// Has two states, two controls and one parameter.
pub struct Coupled;

impl System for Coupled {
    fn state_dim(&self) -> usize {
        2
    }

    fn control_dim(&self) -> usize {
        2
    }

    fn param_dim(&self) -> usize {
        1
    }

    fn step<T: Scalar>(&self, Inputs { x, u, p, t }: Inputs<'_, T>, next: &mut [T]) {
        next[0] = x[0] * 0.9 + x[1] * 0.3 + u[0] * 0.2 + p[0] * 0.05;
        next[1] = x[1] * 0.8 - x[0] * 0.2 + u[1] * 0.4 - u[0] * 0.1 + 0.02 * t as f64;
    }
}

impl Task for Coupled {
    type System = Self;

    fn system(&self) -> &Self {
        self
    }

    fn horizon(&self) -> usize {
        12
    }

    fn start(&self, rng: &mut Rng, Start { x, p }: Start<'_>) {
        x.iter_mut().chain(p).for_each(|value| *value = rng.random_range(-1.0..1.0));
    }

    fn running_cost<T: Scalar>(&self, Inputs { x, u, p, t }: Inputs<'_, T>, next: &[T]) -> T {
        let sum = x[0] - u[0] * 0.7 + next[1] * 1.3 + p[0] * (0.1 * t as f64);
        let other = x[1] + u[1] - next[0] * 0.5;
        (sum * sum + 1.0).sqrt() + other * other + u[0] * u[0] * 0.5 + (u[1] * 0.5).exp() * 0.1
    }

    fn terminal_cost<T: Scalar>(&self, x: &[T], p: &[T]) -> T {
        (x[0] - p[0]).powi(4) + (x[0] * x[1] + x[1] * x[1] * 2.0 + x[0] * x[0]) * 0.5
    }
}

/// One state that grows by squaring, `x' = x² + u`. Only the last state has a cost.
pub struct Explosive;

impl System for Explosive {
    fn state_dim(&self) -> usize {
        1
    }

    fn control_dim(&self) -> usize {
        1
    }

    fn step<T: Scalar>(&self, Inputs { x, u, .. }: Inputs<'_, T>, next: &mut [T]) {
        next[0] = x[0] * x[0] + u[0];
    }
}

impl Task for Explosive {
    type System = Self;

    fn system(&self) -> &Self {
        self
    }

    fn horizon(&self) -> usize {
        20
    }

    fn start(&self, _: &mut Rng, _: Start<'_>) {}

    fn terminal_cost<T: Scalar>(&self, x: &[T], _p: &[T]) -> T {
        (x[0] - 3.0) * (x[0] - 3.0)
    }
}

/// Motion of 1 kg over 1.2 m in 2.5 s, to rest. State [position m, velocity m/s], control: force, N.
pub struct Saturating {
    /// Force at which the control saturates as `limit tanh(u / limit)`. None: no saturation.
    pub limit: Option<f64>,
}

impl Saturating {
    fn force<T: Scalar>(&self, u: T) -> T {
        self.limit.map_or(u, |limit| (u / limit).tanh() * limit)
    }
}

impl System for Saturating {
    fn state_dim(&self) -> usize {
        2
    }

    fn control_dim(&self) -> usize {
        1
    }

    fn step<T: Scalar>(&self, Inputs { x, u, .. }: Inputs<'_, T>, next: &mut [T]) {
        next[1] = x[1] + self.force(u[0]) * 0.05;
        next[0] = x[0] + next[1] * 0.05;
    }
}

impl Task for Saturating {
    type System = Self;

    fn system(&self) -> &Self {
        self
    }

    fn horizon(&self) -> usize {
        50
    }

    fn start(&self, _: &mut Rng, _: Start<'_>) {}

    fn running_cost<T: Scalar>(&self, Inputs { u, .. }: Inputs<'_, T>, _next: &[T]) -> T {
        let force = self.force(u[0]);
        force * force * 0.01
    }

    fn terminal_cost<T: Scalar>(&self, x: &[T], _p: &[T]) -> T {
        let distance = x[0] - 1.2;
        (distance * distance + x[1] * x[1]) * 50.0
    }
}
