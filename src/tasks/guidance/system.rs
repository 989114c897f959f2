//! [`GuidanceSystem`]: drivers and evaders without forces between them.

use crate::dynamics::effect::{Effect, ForcedSystem, system_without_effects};
use crate::dynamics::inputs::{Cotangents, Inputs, OdeInputs};
use crate::dynamics::ode::ForcedOde;
use crate::numbers::scalar::{Cotangent, Real, Scalar};
use crate::numbers::zip::zip;
use serde::{Deserialize, Serialize};
use smallvec::SmallVec;
use std::hint::black_box;
use std::ops::Range;

/// State components per agent: x, y, vx, vy.
pub(super) const AGENT: usize = 4;

/// Number of agents up to which reverse steps do not allocate.
const STACK: usize = 32;

/// Agents in the plane: drivers, which the control accelerates, and evaders. Steps are explicit
/// Euler, so positions advance with the velocities before the step.
///
/// State `[x, y, vx, vy]` of every driver, then of every evader, in m and m/s. Control
/// `[radial, tangential]` of every driver, in 1/s². The radial control multiplies the vector `q`
/// from the evaders' [`center`](GuidanceSystem::center) to the driver. The tangential control
/// multiplies `q⊥ = (-q_y, q_x)`:
///
/// ```text
/// q_j      = D_j - center(E)
/// driver j : v̇ = c_j0 q_j + c_j1 q_j⊥
/// evader k : v̇ = 0
/// ẋ = v
/// ```
///
/// Forces, to which effects add: the accelerations `[ax, ay]` of every driver, then of every
/// evader, in m/s². All forces between agents are effects. [`herding`](GuidanceSystem::herding)
/// adds those of the paper.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(deny_unknown_fields, default)]
pub struct GuidanceSystem {
    /// Number of drivers.
    pub drivers: usize,
    /// Number of evaders.
    pub evaders: usize,
    /// Reference point of the vectors `q` that the controls multiply.
    pub center: Center,
    /// Softening of the distance between agents in effects, `d = softening + |r|`, m, positive. At
    /// 0, the force between coincident agents would be undefined.
    pub softening: f64,
    /// Time step, s.
    pub dt: f64,
}

/// Reference point of the controls, computed from the evaders' positions.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(rename_all = "snake_case")]
pub enum Center {
    /// Sum of the positions, as in the authors' code. The sum moves faster than the herd, and its
    /// place relative to the herd depends on the origin.
    #[default]
    Sum,
    /// Mean of the positions. The physics is then invariant under translation.
    Mean,
}

impl Default for GuidanceSystem {
    fn default() -> Self {
        Self { drivers: 2, evaders: 4, center: Center::Sum, softening: 0.1, dt: 4.0 / 60.0 }
    }
}

impl GuidanceSystem {
    pub(super) fn agents(&self) -> usize {
        self.drivers + self.evaders
    }

    /// Returns the indices of the drivers among the agents.
    pub(super) fn all_drivers(&self) -> Range<usize> {
        0..self.drivers
    }

    /// Returns the indices of the evaders among the agents.
    pub(super) fn all_evaders(&self) -> Range<usize> {
        self.drivers..self.agents()
    }

    /// Returns the evader components of a state.
    #[inline(always)]
    pub(super) fn evaders_of<'a, T>(&self, x: &'a [T]) -> std::slice::ChunksExact<'a, T> {
        x[AGENT * self.drivers..AGENT * self.agents()].chunks_exact(AGENT)
    }

    /// Returns the weight of one evader's position in the center.
    fn weight(&self) -> f64 {
        match self.center {
            Center::Sum => 1.0,
            Center::Mean => 1.0 / self.evaders as f64,
        }
    }

    /// Returns the center of the evaders' positions.
    #[inline(always)]
    fn herd<T: Scalar>(&self, x: &[T]) -> [T; 2] {
        let mut sum = [T::zero(); 2];
        for evader in self.evaders_of(x) {
            sum[0] += evader[0];
            sum[1] += evader[1];
        }
        let weight = T::from(self.weight());
        [sum[0] * weight, sum[1] * weight]
    }

    /// Adds the cotangents of the control.
    #[inline(always)]
    fn reverse_control<R: Real, C: Cotangent<R>>(&self, x: &[R], next_bar: &[C], u_bar: &mut [C]) {
        let dt = R::from(self.dt);
        let herd = self.herd(x);
        for ((c_bar, x), next) in
            zip(zip(u_bar.chunks_exact_mut(2), x.chunks_exact(AGENT)), next_bar.chunks_exact(AGENT))
        {
            let q = [(x[0] - herd[0]) * dt, (x[1] - herd[1]) * dt];
            c_bar[0] += next[2] * q[0] + next[3] * q[1];
            c_bar[1] += next[3] * q[0] - next[2] * q[1];
        }
    }

    /// Adds the cotangents of the state due to steering, given those of the accelerations.
    #[inline(always)]
    fn reverse_steering<R: Real, C: Cotangent<R>>(
        &self,
        u: &[R],
        forces_bar: &[C],
        x_bar: &mut [C],
    ) {
        // q̄ = (∂v̇/∂q)ᵀ v̇̄. Every evader receives the negative sum of q̄ over the drivers, times
        // its weight in the center.
        let mut herd_bar = [C::null(); 2];
        for ((bar, force), c) in
            zip(zip(x_bar.chunks_exact_mut(AGENT), forces_bar.chunks_exact(2)), u.chunks_exact(2))
        {
            let q_bar = [force[0] * c[0] + force[1] * c[1], force[1] * c[0] - force[0] * c[1]];
            for axis in 0..2 {
                bar[axis] += q_bar[axis];
                herd_bar[axis] -= q_bar[axis];
            }
        }
        let weight = R::from(self.weight());
        let herd_bar = [herd_bar[0] * weight, herd_bar[1] * weight];
        for bar in x_bar[AGENT * self.drivers..AGENT * self.agents()].chunks_exact_mut(AGENT) {
            bar[0] += herd_bar[0];
            bar[1] += herd_bar[1];
        }
    }
}

impl GuidanceSystem {
    /// Writes the accelerations of all agents to `forces`.
    #[inline(always)]
    fn accelerate<E: Effect<Self>, T: Scalar>(
        &self,
        effects: &E,
        inputs: OdeInputs<'_, T>,
        forces: &mut [T],
    ) {
        let Inputs { x, u, .. } = inputs;
        let herd = self.herd(x);
        for ((force, x), c) in
            zip(zip(forces.chunks_exact_mut(2), x.chunks_exact(AGENT)), u.chunks_exact(2))
        {
            let q = [x[0] - herd[0], x[1] - herd[1]];
            force[0] = c[0] * q[0] - c[1] * q[1];
            force[1] = c[0] * q[1] + c[1] * q[0];
        }
        // `black_box` prevents a memset call, which is slower than a short loop.
        forces[2 * self.drivers..].fill(black_box(T::zero()));
        effects.add_forces(self, inputs, forces);
    }
}

impl ForcedSystem for GuidanceSystem {
    type Model = Self;

    fn model(&self) -> &Self {
        self
    }

    fn state_dim(&self) -> usize {
        AGENT * self.agents()
    }

    fn control_dim(&self) -> usize {
        2 * self.drivers
    }

    fn force_dim(&self) -> usize {
        2 * self.agents()
    }

    fn dt(&self) -> f64 {
        self.dt
    }

    #[inline(always)]
    fn forced_step<E: Effect<Self>, T: Scalar>(
        &self,
        effects: &E,
        inputs: Inputs<'_, T>,
        next: &mut [T],
    ) {
        // Stores the accelerations in the second half of the next state.
        let half = 2 * self.agents();
        self.accelerate(effects, inputs.continuous(self.dt), &mut next[half..2 * half]);
        let x = inputs.x;
        let dt = T::from(self.dt);
        for agent in 0..self.agents() {
            // Each agent overwrites only the accelerations of itself and of earlier agents.
            let (force, at) = ([next[half + 2 * agent], next[half + 2 * agent + 1]], AGENT * agent);
            (next[at], next[at + 1]) = (x[at] + dt * x[at + 2], x[at + 1] + dt * x[at + 3]);
            (next[at + 2], next[at + 3]) = (x[at + 2] + dt * force[0], x[at + 3] + dt * force[1]);
        }
    }

    /// Computes the cotangents of state and control independently. Neither requires the
    /// accelerations.
    #[inline(always)]
    fn forced_vjp<E: Effect<Self>, R: Real, C: Cotangent<R>>(
        &self,
        effects: &E,
        inputs: Inputs<'_, R>,
        next_bar: &[C],
        mut cotangents: Cotangents<'_, C>,
    ) {
        let dt = R::from(self.dt);
        let next_bars = &next_bar.as_chunks::<AGENT>().0[..self.agents()];
        let mut forces_bar = SmallVec::<[[C; 2]; STACK]>::new();
        forces_bar.extend(next_bars.iter().map(|next| [next[2] * dt, next[3] * dt]));
        let forces_bar = forces_bar.as_flattened();
        if let Some(x_bar) = &mut cotangents.x {
            for (bar, next) in zip(x_bar.as_chunks_mut::<AGENT>().0.iter_mut(), next_bars) {
                bar[0] += next[0];
                bar[1] += next[1];
                bar[2] += next[2] + next[0] * dt;
                bar[3] += next[3] + next[1] * dt;
            }
            self.reverse_steering(inputs.u, forces_bar, x_bar);
        }
        if let Some(u_bar) = &mut cotangents.u {
            self.reverse_control(inputs.x, next_bar, u_bar);
        }
        effects.vjp(self, inputs.continuous(self.dt), forces_bar, cotangents);
    }
}

impl ForcedOde for GuidanceSystem {
    #[inline(always)]
    fn forced_rate<E: Effect<Self>, T: Scalar>(
        &self,
        effects: &E,
        inputs: OdeInputs<'_, T>,
        rate: &mut [T],
    ) {
        let half = 2 * self.agents();
        self.accelerate(effects, inputs, &mut rate[half..2 * half]);
        let x = inputs.x;
        for agent in 0..self.agents() {
            // Each agent overwrites only the accelerations of itself and of earlier agents.
            let (force, at) = ([rate[half + 2 * agent], rate[half + 2 * agent + 1]], AGENT * agent);
            (rate[at], rate[at + 1], rate[at + 2], rate[at + 3]) =
                (x[at + 2], x[at + 3], force[0], force[1]);
        }
    }

    #[inline(always)]
    fn forced_rate_vjp<E: Effect<Self>, R: Real, C: Cotangent<R>>(
        &self,
        effects: &E,
        inputs: OdeInputs<'_, R>,
        rate_bar: &[C],
        mut cotangents: Cotangents<'_, C>,
    ) {
        let rate_bars = &rate_bar.as_chunks::<AGENT>().0[..self.agents()];
        let mut forces_bar = SmallVec::<[[C; 2]; STACK]>::new();
        forces_bar.extend(rate_bars.iter().map(|rate| [rate[2], rate[3]]));
        let forces_bar = forces_bar.as_flattened();
        if let Some(x_bar) = &mut cotangents.x {
            for (bar, rate) in zip(x_bar.as_chunks_mut::<AGENT>().0.iter_mut(), rate_bars) {
                bar[2] += rate[0];
                bar[3] += rate[1];
            }
            self.reverse_steering(inputs.u, forces_bar, x_bar);
        }
        if let Some(u_bar) = &mut cotangents.u {
            let x = inputs.x;
            let herd = self.herd(x);
            for ((c_bar, x), force) in zip(
                zip(u_bar.chunks_exact_mut(2), x.chunks_exact(AGENT)),
                forces_bar.chunks_exact(2),
            ) {
                let q = [x[0] - herd[0], x[1] - herd[1]];
                c_bar[0] += force[0] * q[0] + force[1] * q[1];
                c_bar[1] += force[1] * q[0] - force[0] * q[1];
            }
        }
        effects.vjp(self, inputs, forces_bar, cotangents);
    }

    fn velocity_of(&self, i: usize) -> Option<usize> {
        (i % AGENT < 2).then_some(i + 2)
    }
}

system_without_effects!(GuidanceSystem);
