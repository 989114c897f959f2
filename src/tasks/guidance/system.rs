//! The physics of drivers and evaders, and its reverse.

use super::gap::{Gap, Law};
use crate::scalar::{Cotangent, Real, Scalar};
use crate::system::System;
use serde::{Deserialize, Serialize};

/// Numbers per agent: x, y, vx, vy.
pub(super) const AGENT: usize = 4;

/// The physics: explicit Euler, positions with the old velocities.
///
/// State `[x, y, vx, vy]` of every driver, then of every evader, in m and m/s; control `[radial, tangential]` of every
/// driver, in 1/s²: it multiplies the way `q` from the evaders' [`center`](GuidanceSystem::center) and
/// `q⊥ = (-q_y, q_x)`. With `r` the separation and `d = softening + |r|`:
///
/// ```text
/// q_j      = D_j - center(E)
/// driver j : v̇ = c_j0 q_j + c_j1 q_j⊥ - driver_friction v + driver_repulsion Σ_{i≠j} (D_j - D_i) / d²
/// evader k : v̇ = flight Σ_j (E_k - D_j) / d² - evader_friction v
///                + flocking Σ_{i≠k} (flocking_distance / d - 1) / d (E_i - E_k)
/// ẋ = v
/// ```
///
/// Drivers do not feel the evaders. Evaders nearer than `flocking_distance` attract each other, farther ones repel.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(deny_unknown_fields, default)]
pub struct GuidanceSystem {
    /// Number of drivers.
    pub drivers: usize,
    /// Number of evaders.
    pub evaders: usize,
    /// What a driver steers by.
    pub center: Center,
    /// What slows a driver, 1/s.
    pub driver_friction: f64,
    /// What slows an evader, 1/s.
    pub evader_friction: f64,
    /// Repulsion between drivers, m²/s².
    pub driver_repulsion: f64,
    /// Repulsion of evaders by drivers, m²/s².
    pub flight: f64,
    /// Force between evaders, m/s².
    pub flocking: f64,
    /// The softened distance at which evaders neither attract nor repel each other, m.
    pub flocking_distance: f64,
    /// Added to every distance, m; positive, or there would be no force between agents at one place.
    pub softening: f64,
    /// Time step, s.
    pub dt: f64,
}

/// What is made of the evaders' positions for the drivers to steer by.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(rename_all = "snake_case")]
pub enum Center {
    /// Their sum, as in the authors' code. It moves with the herd, but faster, and depends on where the origin is.
    #[default]
    Sum,
    /// Their mean. The physics is then the same everywhere in the plane.
    Mean,
}

impl Default for GuidanceSystem {
    fn default() -> Self {
        Self {
            drivers: 2,
            evaders: 4,
            center: Center::Sum,
            driver_friction: 1.0,
            evader_friction: 4.0,
            driver_repulsion: 0.2,
            flight: 15.0,
            flocking: 0.2,
            flocking_distance: 0.5,
            softening: 0.1,
            dt: 4.0 / 60.0,
        }
    }
}

impl GuidanceSystem {
    /// The force on agent `b` as it depends on its separation from agent `a < b`, and whether `a` feels the reaction.
    #[inline(always)]
    fn law(&self, a: usize, b: usize) -> (Law, bool) {
        if b < self.drivers {
            (Law { far: 0.0, near: self.driver_repulsion }, true)
        } else if a < self.drivers {
            (Law { far: 0.0, near: self.flight }, false)
        } else {
            (Law { far: self.flocking, near: -self.flocking * self.flocking_distance }, true)
        }
    }

    /// The separation of agent `b` from agent `a`.
    #[inline(always)]
    fn gap<T: Scalar>(&self, x: &[T], a: usize, b: usize) -> Gap<T> {
        let (a, b) = (AGENT * a, AGENT * b);
        Gap::new([x[b] - x[a], x[b + 1] - x[a + 1]], self.softening)
    }

    fn friction(&self, agent: usize) -> f64 {
        if agent < self.drivers { self.driver_friction } else { self.evader_friction }
    }

    fn agents(&self) -> usize {
        self.drivers + self.evaders
    }

    /// The weight of an evader's position in the center of them.
    fn weight(&self) -> f64 {
        match self.center {
            Center::Sum => 1.0,
            Center::Mean => 1.0 / self.evaders as f64,
        }
    }

    /// The center of the evaders' positions.
    #[inline(always)]
    fn herd<T: Scalar>(&self, x: &[T]) -> [T; 2] {
        let mut sum = [T::zero(); 2];
        for evader in self.evaders_of(x) {
            sum[0] += evader[0];
            sum[1] += evader[1];
        }
        sum.map(|sum| sum * T::lift(self.weight()))
    }

    /// The evaders' parts of a state.
    #[inline(always)]
    pub(super) fn evaders_of<'a, T>(&self, x: &'a [T]) -> std::slice::ChunksExact<'a, T> {
        x[AGENT * self.drivers..].chunks_exact(AGENT)
    }
}

impl System for GuidanceSystem {
    fn state_dim(&self) -> usize {
        AGENT * (self.drivers + self.evaders)
    }

    fn control_dim(&self) -> usize {
        2 * self.drivers
    }

    #[inline(always)]
    fn step<T: Scalar>(&self, x: &[T], u: &[T], next: &mut [T]) {
        // Accelerations, gathered where the next velocities will be.
        for (agent, (next, x)) in next.chunks_exact_mut(AGENT).zip(x.chunks_exact(AGENT)).enumerate() {
            let friction = T::lift(-self.friction(agent));
            (next[2], next[3]) = (friction * x[2], friction * x[3]);
        }
        let herd = self.herd(x);
        for ((next, x), c) in next.chunks_exact_mut(AGENT).zip(x.chunks_exact(AGENT)).zip(u.chunks_exact(2)) {
            let q = [x[0] - herd[0], x[1] - herd[1]];
            next[2] += c[0] * q[0] - c[1] * q[1];
            next[3] += c[0] * q[1] + c[1] * q[0];
        }
        for a in 0..self.agents() {
            for b in a + 1..self.agents() {
                let (law, reaction) = self.law(a, b);
                let [x, y] = self.gap(x, a, b).force(law);
                next[AGENT * b + 2] += x;
                next[AGENT * b + 3] += y;
                if reaction {
                    next[AGENT * a + 2] -= x;
                    next[AGENT * a + 3] -= y;
                }
            }
        }
        let dt = T::lift(self.dt);
        for (next, x) in next.chunks_exact_mut(AGENT).zip(x.chunks_exact(AGENT)) {
            (next[0], next[1]) = (x[0] + dt * x[2], x[1] + dt * x[3]);
            (next[2], next[3]) = (x[2] + dt * next[2], x[3] + dt * next[3]);
        }
    }

    /// State and control meet only in products of the two, so that the halves share no work.
    #[inline(always)]
    fn vjp<R: Real, C: Cotangent<R>>(&self, x: &[R], u: &[R], next_bar: &[C], x_bar: &mut [C], u_bar: &mut [C]) {
        self.vjp_state(x, u, next_bar, x_bar);
        self.vjp_control(x, u, next_bar, u_bar);
    }

    #[inline(always)]
    fn vjp_state<R: Real, C: Cotangent<R>>(&self, x: &[R], u: &[R], next_bar: &[C], x_bar: &mut [C]) {
        let dt = R::lift(self.dt);
        for (agent, (bar, next)) in x_bar.chunks_exact_mut(AGENT).zip(next_bar.chunks_exact(AGENT)).enumerate() {
            let kept = R::lift(1.0 - self.dt * self.friction(agent));
            (bar[0], bar[1]) = (next[0], next[1]);
            (bar[2], bar[3]) = (next[2] * kept + next[0] * dt, next[3] * kept + next[1] * dt);
        }
        // q̄ = (∂v̇/∂q)ᵀ v̇̄, which every evader receives with the opposite sign.
        let mut herd_bar = [C::null(); 2];
        for ((bar, next), c) in x_bar.chunks_exact_mut(AGENT).zip(next_bar.chunks_exact(AGENT)).zip(u.chunks_exact(2)) {
            let (radial, tangential) = (c[0] * dt, c[1] * dt);
            let q_bar = [next[2] * radial + next[3] * tangential, next[3] * radial - next[2] * tangential];
            for axis in 0..2 {
                bar[axis] += q_bar[axis];
                herd_bar[axis] -= q_bar[axis];
            }
        }
        let herd_bar = herd_bar.map(|bar| bar * R::lift(self.weight()));
        for bar in x_bar[AGENT * self.drivers..].chunks_exact_mut(AGENT) {
            bar[0] += herd_bar[0];
            bar[1] += herd_bar[1];
        }
        for a in 0..self.agents() {
            for b in a + 1..self.agents() {
                let (law, reaction) = self.law(a, b);
                let mut force_bar = [next_bar[AGENT * b + 2] * dt, next_bar[AGENT * b + 3] * dt];
                if reaction {
                    force_bar[0] -= next_bar[AGENT * a + 2] * dt;
                    force_bar[1] -= next_bar[AGENT * a + 3] * dt;
                }
                let [x, y] = self.gap(x, a, b).force_vjp(law, force_bar);
                x_bar[AGENT * b] += x;
                x_bar[AGENT * b + 1] += y;
                x_bar[AGENT * a] -= x;
                x_bar[AGENT * a + 1] -= y;
            }
        }
    }

    #[inline(always)]
    fn vjp_control<R: Real, C: Cotangent<R>>(&self, x: &[R], _u: &[R], next_bar: &[C], u_bar: &mut [C]) {
        let dt = R::lift(self.dt);
        let herd = self.herd(x);
        for ((c_bar, x), next) in u_bar.chunks_exact_mut(2).zip(x.chunks_exact(AGENT)).zip(next_bar.chunks_exact(AGENT)) {
            let q = [(x[0] - herd[0]) * dt, (x[1] - herd[1]) * dt];
            c_bar[0] = next[2] * q[0] + next[3] * q[1];
            c_bar[1] = next[3] * q[0] - next[2] * q[1];
        }
    }
}
