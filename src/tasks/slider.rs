//! A block that slides on a table with dry friction, to be stopped at a place.

use crate::dynamics::system::System;
use crate::dynamics::task::Task;
use crate::numbers::rng::Rng;
use crate::numbers::scalar::{Cotangent, Real, Scalar};
use rand::RngExt;

/// Standard gravity, m/s².
const GRAVITY: f64 = 9.81;

/// Rounds of Newton's iteration. From where it begins it needs two for each unit of `|v'| / smoothing` where friction and
/// push are nearly equal, up to about 9 at a smoothing of 1e-9 m/s, and five to end with.
const ROUNDS: usize = 24;

/// The physics: a block on a table, pushed along one line. State `[place m, speed m/s]`, control `[push N]`.
///
/// ```text
/// v̇ = u / m - μ g tanh(v / ε)
/// x' = x + dt v'
/// ```
///
/// Dry (Coulomb's) friction, smoothed below the speed ε, where the block creeps instead of sticking. Andersson, Söderberg
/// and Björklund 2007 (doi:10.1016/j.triboint.2005.11.014), eq. 3. How v' is found is a [`FrictionScheme`].
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SliderSystem {
    /// m, kg, positive.
    pub mass: f64,
    /// Coefficient of friction μ, not negative.
    pub coefficient: f64,
    /// ε, m/s, positive: the speed at which three quarters of the friction are there.
    pub smoothing: f64,
    /// Time step, s.
    pub dt: f64,
    /// At which speed friction is taken.
    pub scheme: FrictionScheme,
}

/// At which speed the friction of a step is taken.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum FrictionScheme {
    /// At that before the step: `v' = v + dt (u/m - μ g tanh(v/ε))`. A disturbance of a resting block is multiplied by
    /// `1 - dt μ g/ε` in a step: where `dt μ g > 2 ε` it chatters and never comes to rest.
    Explicit,
    /// At that after it: `v' = v + dt (u/m - μ g tanh(v'/ε))`, backward Euler. Stable for every ε: a disturbance is divided
    /// by `1 + dt μ g/ε (1 - tanh²(v'/ε))`.
    #[default]
    Implicit,
}

impl Default for SliderSystem {
    /// 1 kg of wood on wood.
    fn default() -> Self {
        Self { mass: 1.0, coefficient: 0.5, smoothing: 1e-3, dt: 0.01, scheme: FrictionScheme::Implicit }
    }
}

/// A speed after a step and its derivatives by the speed before it and by the push.
struct Slid<T> {
    speed: T,
    by_speed: T,
    by_push: T,
}

impl SliderSystem {
    /// What friction can take from the speed in a step, `dt μ g`.
    pub fn grip(&self) -> f64 {
        self.dt * self.coefficient * GRAVITY
    }

    #[inline(always)]
    fn slide<T: Scalar>(&self, speed: T, push: T) -> Slid<T> {
        let per_push = T::lift(self.dt / self.mass);
        let pushed = speed + push * per_push;
        match self.scheme {
            FrictionScheme::Explicit => {
                let at = speed * T::lift(1.0 / self.smoothing);
                let by_speed = T::one() - T::lift(self.grip() / self.smoothing) * decline(at);
                Slid { speed: pushed - T::lift(self.grip()) * tanh(at), by_speed, by_push: per_push }
            }
            FrictionScheme::Implicit => {
                let (speed, share) = self.solve(pushed);
                Slid { speed, by_speed: share, by_push: share * per_push }
            }
        }
    }

    /// The root z of `z + b tanh(z/ε) = w`, with `b = dt μ g`, and dz/dw.
    ///
    /// In `y = |z|/ε` the left side, `ε y + b tanh y`, is rising and concave: from below, Newton's iteration neither leaps
    /// over the root nor needs a safeguard, but that no rounding may take it back, to where a saturated tanh would throw it. It
    /// begins at the better of two lower bounds, from `tanh y ≤ y` and `tanh y ≤ 1`. It runs on plain values; duals get the
    /// derivative of the root by the theorem of implicit functions, `dz/dw = ε / (ε + b (1 - tanh² y))`.
    #[inline(always)]
    fn solve<T: Scalar>(&self, w: T) -> (T, T) {
        let (eps, grip, one) = (T::lift(self.smoothing), T::lift(self.grip()), T::one());
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

/// tanh, with a derivative that has all its digits: duals take `1 - tanh²`, whose rounding `dt μ g/ε` multiplies.
#[inline(always)]
fn tanh<T: Scalar>(y: T) -> T {
    let at = y.detach();
    at.tanh() + decline(at) * (y - at)
}

/// `1 - tanh² y`, with all its digits where that is small.
#[inline(always)]
fn decline<T: Scalar>(y: T) -> T {
    let e = (-(y.abs() + y.abs())).exp();
    let sum = T::one() + e;
    T::lift(4.0) * e / (sum * sum)
}

impl System for SliderSystem {
    fn state_dim(&self) -> usize {
        2
    }

    fn control_dim(&self) -> usize {
        1
    }

    #[inline(always)]
    fn step<T: Scalar>(&self, x: &[T], u: &[T], next: &mut [T]) {
        next[1] = self.slide(x[1], u[0]).speed;
        next[0] = x[0] + next[1] * T::lift(self.dt);
    }

    #[inline(always)]
    fn vjp<R: Real, C: Cotangent<R>>(&self, x: &[R], u: &[R], next_bar: &[C], x_bar: &mut [C], u_bar: &mut [C]) {
        let slid = self.slide(x[1], u[0]);
        let speed_bar = next_bar[1] + next_bar[0] * R::lift(self.dt);
        (x_bar[0], x_bar[1]) = (next_bar[0], speed_bar * slid.by_speed);
        u_bar[0] = speed_bar * slid.by_push;
    }

    #[inline(always)]
    fn vjp_state<R: Real, C: Cotangent<R>>(&self, x: &[R], u: &[R], next_bar: &[C], x_bar: &mut [C]) {
        self.vjp(x, u, next_bar, x_bar, &mut [C::null()]);
    }

    #[inline(always)]
    fn vjp_control<R: Real, C: Cotangent<R>>(&self, x: &[R], u: &[R], next_bar: &[C], u_bar: &mut [C]) {
        self.vjp(x, u, next_bar, &mut [C::null(); 2], u_bar);
    }
}

/// Stop the block at the origin: the cost of the last state is `x² + speed_weight v²`, in m². The push is free.
///
/// Blocks start within 1 m of it, at up to 2 m/s: friction alone stops them somewhere else.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Slider {
    /// The physics.
    pub system: SliderSystem,
    /// What a squared speed costs, s².
    pub speed_weight: f64,
    /// Number of steps.
    pub horizon: usize,
}

impl Default for Slider {
    /// 1 s.
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

    fn start(&self, rng: &mut Rng, x: &mut [f64]) {
        x[0] = rng.random_range(-1.0..1.0);
        x[1] = rng.random_range(-2.0..2.0);
    }

    #[inline(always)]
    fn terminal_cost<T: Scalar>(&self, x: &[T]) -> T {
        x[0] * x[0] + x[1] * x[1] * T::lift(self.speed_weight)
    }

    #[inline(always)]
    fn terminal_cost_gradient<R: Real>(&self, x: &[R], x_bar: &mut [R]) {
        (x_bar[0], x_bar[1]) = (R::lift(2.0) * x[0], R::lift(2.0 * self.speed_weight) * x[1]);
    }
}
