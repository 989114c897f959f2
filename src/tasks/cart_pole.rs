//! Cart-pole with any number of poles on one cart, to be swung up by one force.
//!
//! The model of "Stabilizing Backpropagation Through Time to Learn Complex Physics" (ICLR 2024), after Barto, Sutton
//! and Anderson 1983 (doi:10.1109/TSMC.1983.6313077). The poles share the control and nothing else: each pole's
//! acceleration sees only its own centrifugal term, and the total mass counts one pole whatever their number.

use crate::rng::Rng;
use crate::scalar::{Cotangent, Real, Scalar};
use crate::system::System;
use crate::task::Task;
use crate::tasks::LossMode;
use rand::RngExt;
use serde::{Deserialize, Serialize};
use std::f64::consts::PI;

/// The physics: semi-implicit Euler, velocities first.
///
/// State `[x, ẋ, θ₁, ω₁, θ₂, ω₂, …]` in m, m/s, rad, rad/s, θ = 0 upright; control `[u]` in N.
///
/// ```text
/// A_i = (u + m l sin θ_i ω_i²) / M
/// α_i = (g sin θ_i - cos θ_i A_i) / (l (4/3 - m cos² θ_i / M))
/// ẍ   = (u + m l Σ_i (sin θ_i ω_i² - α_i cos θ_i)) / M
/// ```
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(deny_unknown_fields, default)]
pub struct CartPoleSystem {
    /// Number of poles.
    pub poles: usize,
    /// Mass of the cart, kg; M is this plus one pole.
    pub cart_mass: f64,
    /// Mass m of a pole, kg.
    pub pole_mass: f64,
    /// Half the length of a pole, l, m.
    pub half_length: f64,
    /// Gravity g, m/s².
    pub gravity: f64,
    /// Time step, s.
    pub dt: f64,
}

impl Default for CartPoleSystem {
    fn default() -> Self {
        Self { poles: 1, cart_mass: 1.0, pole_mass: 0.1, half_length: 0.5, gravity: 9.8, dt: 0.01 }
    }
}

/// The constants of [`CartPoleSystem`] as numbers of one kind.
struct Constants<T> {
    dt: T,
    gravity: T,
    /// m l.
    moment: T,
    /// 1 / M.
    per_mass: T,
    /// 4 l / 3.
    inertia: T,
    /// l m / M.
    coupling: T,
}

impl CartPoleSystem {
    #[inline(always)]
    fn constants<T: Scalar>(&self) -> Constants<T> {
        let mass = self.cart_mass + self.pole_mass;
        Constants {
            dt: T::lift(self.dt),
            gravity: T::lift(self.gravity),
            moment: T::lift(self.pole_mass * self.half_length),
            per_mass: T::lift(1.0 / mass),
            inertia: T::lift(4.0 / 3.0 * self.half_length),
            coupling: T::lift(self.half_length * self.pole_mass / mass),
        }
    }

    /// The reverse of [`step`](System::step), with the state's cotangents only if `x_bar` is there.
    #[inline(always)]
    fn reverse<R: Real, C: Cotangent<R>>(&self, x: &[R], u: &[R], next_bar: &[C], mut x_bar: Option<&mut [C]>, u_bar: &mut [C]) {
        let k = self.constants::<R>();
        let speed_bar = next_bar[1] + next_bar[0] * k.dt;
        // Of the bracket in ẍ = (…) / M.
        let force_bar = speed_bar * (k.dt * k.per_mass);
        let mut control_bar = force_bar;
        if let Some(x_bar) = &mut x_bar {
            (x_bar[0], x_bar[1]) = (next_bar[0], speed_bar);
        }
        for (i, pole) in x[2..].chunks_exact(2).enumerate() {
            let (sin, cos) = pole[0].sin_cos();
            let omega = pole[1];
            let spin = omega * omega;
            let a = (u[0] + k.moment * sin * spin) * k.per_mass;
            let per_inertia = R::one() / (k.inertia - k.coupling * cos * cos);
            let alpha = (k.gravity * sin - cos * a) * per_inertia;

            let (theta_bar, omega_bar) = (next_bar[2 + 2 * i], next_bar[3 + 2 * i]);
            let omega_bar = omega_bar + theta_bar * k.dt;
            let alpha_bar = omega_bar * k.dt - force_bar * (k.moment * cos);
            // α = numerator / denominator.
            let numerator_bar = alpha_bar * per_inertia;
            let thrust_bar = -(numerator_bar * (cos * k.per_mass));
            control_bar += thrust_bar;
            if let Some(x_bar) = &mut x_bar {
                let push_bar = force_bar + thrust_bar;
                let sin_bar = numerator_bar * k.gravity + push_bar * (k.moment * spin);
                let cos_bar = numerator_bar * (R::lift(2.0) * k.coupling * cos * alpha - a) - force_bar * (k.moment * alpha);
                x_bar[2 + 2 * i] = theta_bar + sin_bar * cos - cos_bar * sin;
                x_bar[3 + 2 * i] = omega_bar + push_bar * (R::lift(2.0) * k.moment * sin * omega);
            }
        }
        u_bar[0] = control_bar;
    }
}

impl System for CartPoleSystem {
    fn state_dim(&self) -> usize {
        2 + 2 * self.poles
    }

    fn control_dim(&self) -> usize {
        1
    }

    #[inline(always)]
    fn step<T: Scalar>(&self, x: &[T], u: &[T], next: &mut [T]) {
        let k = self.constants::<T>();
        let mut force = u[0];
        for (pole, next) in x[2..].chunks_exact(2).zip(next[2..].chunks_exact_mut(2)) {
            let (sin, cos) = pole[0].sin_cos();
            let centrifugal = k.moment * sin * pole[1] * pole[1];
            let a = (u[0] + centrifugal) * k.per_mass;
            let alpha = (k.gravity * sin - cos * a) / (k.inertia - k.coupling * cos * cos);
            force += centrifugal - k.moment * alpha * cos;
            next[1] = pole[1] + k.dt * alpha;
            next[0] = pole[0] + k.dt * next[1];
        }
        next[1] = x[1] + k.dt * force * k.per_mass;
        next[0] = x[0] + k.dt * next[1];
    }

    #[inline(always)]
    fn vjp<R: Real, C: Cotangent<R>>(&self, x: &[R], u: &[R], next_bar: &[C], x_bar: &mut [C], u_bar: &mut [C]) {
        self.reverse(x, u, next_bar, Some(x_bar), u_bar);
    }

    #[inline(always)]
    fn vjp_control<R: Real, C: Cotangent<R>>(&self, x: &[R], u: &[R], next_bar: &[C], u_bar: &mut [C]) {
        self.reverse(x, u, next_bar, None, u_bar);
    }
}

/// Swing all poles up: the loss is the mean of `1 - cos θ`, between 0 (all upright) and 2 (all hanging). Position and
/// force are free.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct CartPole {
    /// The physics.
    pub system: CartPoleSystem,
    /// When the angles are paid for.
    pub loss: LossMode,
    /// Number of steps.
    pub horizon: usize,
}

impl CartPole {
    /// The paper's task: `poles` poles, 100 steps of 0.01 s, the last state counts.
    pub fn new(poles: usize) -> Self {
        Self { system: CartPoleSystem { poles, ..CartPoleSystem::default() }, loss: LossMode::Final, horizon: 100 }
    }

    /// Mean of `1 - cos θ` over the poles.
    #[inline(always)]
    fn height<T: Scalar>(&self, x: &[T]) -> T {
        let mut cosines = T::zero();
        for pole in x[2..].chunks_exact(2) {
            cosines += pole[0].cos();
        }
        T::one() - cosines * T::lift(1.0 / self.system.poles as f64)
    }

    /// Gradient of `factor` times the mean of `1 - cos θ`.
    #[inline(always)]
    fn height_gradient<R: Real>(&self, factor: f64, x: &[R], x_bar: &mut [R]) {
        let factor = R::lift(factor / self.system.poles as f64);
        (x_bar[0], x_bar[1]) = (R::zero(), R::zero());
        for (x_bar, pole) in x_bar[2..].chunks_exact_mut(2).zip(x[2..].chunks_exact(2)) {
            (x_bar[0], x_bar[1]) = (pole[0].sin() * factor, R::zero());
        }
    }

    /// The share of one step in the mean over time.
    fn stage_factor(&self) -> f64 {
        1.0 / self.horizon as f64
    }
}

impl Task for CartPole {
    type System = CartPoleSystem;

    fn system(&self) -> &CartPoleSystem {
        &self.system
    }

    fn horizon(&self) -> usize {
        self.horizon
    }

    /// Angles within ±30° of hanging; position, speed and rates within ±1.
    fn start(&self, rng: &mut Rng, x: &mut [f64]) {
        for (i, x) in x.iter_mut().enumerate() {
            let draw = rng.random_range(-1.0..1.0);
            let is_angle = i >= 2 && i % 2 == 0;
            *x = if is_angle { PI + PI / 6.0 * draw } else { draw };
        }
    }

    #[inline(always)]
    fn stage_cost<T: Scalar>(&self, x: &[T], _u: &[T]) -> T {
        match self.loss {
            LossMode::Final => T::zero(),
            LossMode::Continuous => self.height(x) * T::lift(self.stage_factor()),
        }
    }

    #[inline(always)]
    fn terminal_cost<T: Scalar>(&self, x: &[T]) -> T {
        match self.loss {
            LossMode::Final => self.height(x),
            LossMode::Continuous => T::zero(),
        }
    }

    #[inline(always)]
    fn stage_cost_gradient<R: Real>(&self, x: &[R], _u: &[R], x_bar: &mut [R], u_bar: &mut [R]) {
        u_bar[0] = R::zero();
        match self.loss {
            LossMode::Final => x_bar.fill(R::zero()),
            LossMode::Continuous => self.height_gradient(self.stage_factor(), x, x_bar),
        }
    }

    #[inline(always)]
    fn terminal_cost_gradient<R: Real>(&self, x: &[R], x_bar: &mut [R]) {
        match self.loss {
            LossMode::Final => self.height_gradient(1.0, x, x_bar),
            LossMode::Continuous => x_bar.fill(R::zero()),
        }
    }
}
