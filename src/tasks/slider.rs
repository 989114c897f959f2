//! [`Slider`]: stopping a block that slides on a table with dry friction.

use crate::dynamics::inputs::{Cotangents, Inputs, Start};
use crate::dynamics::system::System;
use crate::dynamics::task::Task;
use crate::numbers::rng::Rng;
use crate::numbers::scalar::{Cotangent, Real, Scalar};
use rand::RngExt;
use serde::{Deserialize, Serialize};

/// Gravitational acceleration g, m/s².
const GRAVITY: f64 = 9.81;

/// Number of Newton iterations for the speed v' after a step. Convergence is slowest where friction
/// nearly cancels the speed after the push. There, it takes at most two iterations per unit of
/// `|v'| / ε`, and five more. The default block has `|v'| / ε ≤ 9` there, even with a smoothing
/// speed ε of 1e-9 m/s.
const ROUNDS: usize = 24;

/// Block on a table, pushed along one line. State `[position m, speed m/s]`, control `[push N]`.
///
/// ```text
/// v̇ = u / m - μ g tanh(v / ε)
/// x' = x + dt v'
/// ```
///
/// Dry (Coulomb) friction is smoothed below the speed ε, where the block creeps instead of
/// sticking. The [`FrictionScheme`] determines v'.
///
/// Source: Andersson, Söderberg and Björklund 2007 (doi:10.1016/j.triboint.2005.11.014), eq. 3.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(deny_unknown_fields, default)]
pub struct SliderSystem {
    /// Mass m, kg, positive.
    pub mass: f64,
    /// Coefficient of friction μ, not negative.
    pub coefficient: f64,
    /// Smoothing speed ε, m/s, positive. At this speed, friction reaches three quarters of its full
    /// value.
    pub smoothing: f64,
    /// Time step, s.
    pub dt: f64,
    /// Speed at which a step evaluates friction.
    pub scheme: FrictionScheme,
}

/// Speed at which a step evaluates friction.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(rename_all = "snake_case")]
pub enum FrictionScheme {
    /// Speed before the step: `v' = v + dt (u/m - μ g tanh(v/ε))`.
    ///
    /// A step multiplies a disturbance of a resting block by `1 - dt μ g/ε`. If `dt μ g > 2 ε`, the
    /// block chatters and never comes to rest.
    Explicit,
    /// Speed after the step: `v' = v + dt (u/m - μ g tanh(v'/ε))`, backward Euler.
    ///
    /// Stable for any ε. A step divides a disturbance by `1 + dt μ g/ε (1 - tanh²(v'/ε))`.
    #[default]
    Implicit,
}

impl Default for SliderSystem {
    /// Returns a block of 1 kg with the friction of wood on wood.
    fn default() -> Self {
        Self {
            mass: 1.0,
            coefficient: 0.5,
            smoothing: 1e-3,
            dt: 0.01,
            scheme: FrictionScheme::Implicit,
        }
    }
}

/// Speed after a step, and its derivatives with respect to the push and the speed before the step.
struct Slid<T> {
    speed: T,
    by_speed: T,
    by_push: T,
}

impl SliderSystem {
    /// Returns the largest change of speed due to friction in one step, `dt μ g`, m/s.
    pub fn grip(&self) -> f64 {
        self.dt * self.coefficient * GRAVITY
    }

    #[inline(always)]
    fn slide<T: Scalar>(&self, speed: T, push: T) -> Slid<T> {
        let per_push = T::from(self.dt / self.mass);
        let pushed = speed + push * per_push;
        match self.scheme {
            FrictionScheme::Explicit => {
                let at = speed * (1.0 / self.smoothing);
                let by_speed = T::one() - T::from(self.grip() / self.smoothing) * decline(at);
                Slid {
                    speed: pushed - T::from(self.grip()) * tanh(at),
                    by_speed,
                    by_push: per_push,
                }
            }
            FrictionScheme::Implicit => {
                let (speed, share) = self.solve(pushed);
                Slid { speed, by_speed: share, by_push: share * per_push }
            }
        }
    }

    /// Returns the root z of `z + b tanh(z/ε) = w`, with `b = dt μ g`, and dz/dw.
    ///
    /// In `y = |z|/ε`, the left side `ε y + b tanh y` is increasing and concave. Newton's iteration
    /// from below the root therefore converges monotonically and needs no safeguard. Increments of
    /// y are clamped at 0, because rounding could otherwise make them negative. The initial value
    /// is the larger of two lower bounds, which follow from `tanh y ≤ y` and `tanh y ≤ 1`.
    ///
    /// The iteration uses plain values. Dual numbers receive the derivative by the implicit
    /// function theorem, `dz/dw = ε / (ε + b (1 - tanh² y))`.
    #[inline(always)]
    fn solve<T: Scalar>(&self, w: T) -> (T, T) {
        let (eps, grip, one) = (T::from(self.smoothing), T::from(self.grip()), T::one());
        let size = w.detach().abs();
        let mut y = (size / (eps + grip)).max((size - grip) / eps);
        for _ in 0..ROUNDS {
            let tanh = y.tanh();
            y += (size - eps * y - grip * tanh).max(T::zero()) / (eps + grip * (one - tanh * tanh));
        }
        let speed = eps * T::select_lt(w, T::zero(), -y, y);
        let share = eps / (eps + grip * decline(y));
        (speed + (w - w.detach()) * share, share)
    }
}

/// Computes tanh with an accurate derivative. Dual numbers would compute the derivative as
/// `1 - tanh²`, and the factor `dt μ g/ε` would amplify the rounding error of this difference.
#[inline(always)]
fn tanh<T: Scalar>(y: T) -> T {
    let at = y.detach();
    at.tanh() + decline(at) * (y - at)
}

/// Returns `1 - tanh² y` without cancellation.
#[inline(always)]
fn decline<T: Scalar>(y: T) -> T {
    let e = (-(y.abs() + y.abs())).exp();
    let sum = T::one() + e;
    T::from(4.0) * e / (sum * sum)
}

impl System for SliderSystem {
    fn state_dim(&self) -> usize {
        2
    }

    fn control_dim(&self) -> usize {
        1
    }

    #[inline(always)]
    fn step<T: Scalar>(&self, Inputs { x, u, .. }: Inputs<'_, T>, next: &mut [T]) {
        next[1] = self.slide(x[1], u[0]).speed;
        next[0] = x[0] + next[1] * self.dt;
    }

    #[inline(always)]
    fn vjp<R: Real, C: Cotangent<R>>(
        &self,
        Inputs { x, u, .. }: Inputs<'_, R>,
        next_bar: &[C],
        cotangents: Cotangents<'_, C>,
    ) {
        let slid = self.slide(x[1], u[0]);
        let speed_bar = next_bar[1] + next_bar[0] * R::from(self.dt);
        if let Some(x_bar) = cotangents.x {
            x_bar[0] += next_bar[0];
            x_bar[1] += speed_bar * slid.by_speed;
        }
        if let Some(u_bar) = cotangents.u {
            u_bar[0] += speed_bar * slid.by_push;
        }
    }
}

/// Task to stop the block at the origin. The terminal cost is `x² + speed_weight v²`, in m². The
/// push carries no cost.
///
/// Initial positions lie within 1 m of the origin, speeds within ±2 m/s. Without control, friction
/// stops the block away from the origin.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Slider {
    /// System to control.
    pub system: SliderSystem,
    /// Weight of the squared speed, s².
    pub speed_weight: f64,
    /// Number of steps.
    pub horizon: usize,
}

impl Default for Slider {
    /// Returns the task for the default block, with a horizon of 1 s.
    fn default() -> Self {
        Self { system: SliderSystem::default(), speed_weight: 0.1, horizon: 100 }
    }
}

impl Task for Slider {
    type System = SliderSystem;

    fn system(&self) -> &SliderSystem {
        &self.system
    }

    fn horizon(&self) -> usize {
        self.horizon
    }

    /// ±5 N.
    fn control_bounds(&self) -> Option<Vec<[f64; 2]>> {
        Some(vec![[-5.0, 5.0]; self.system.control_dim()])
    }

    fn start(&self, rng: &mut Rng, start: Start<'_>) {
        start.x[0] = rng.random_range(-1.0..1.0);
        start.x[1] = rng.random_range(-2.0..2.0);
    }

    #[inline(always)]
    fn terminal_cost<T: Scalar>(&self, x: &[T], _p: &[T]) -> T {
        x[0] * x[0] + x[1] * x[1] * self.speed_weight
    }

    #[inline(always)]
    fn terminal_cost_gradient<R: Real>(
        &self,
        x: &[R],
        _p: &[R],
        x_bar: &mut [R],
        _p_bar: Option<&mut [R]>,
    ) {
        x_bar[0] += R::from(2.0) * x[0];
        x_bar[1] += R::from(2.0 * self.speed_weight) * x[1];
    }
}
