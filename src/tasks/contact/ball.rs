//! [`Bounce`] and [`BouncingBall`]: a ball above a floor.

use super::{Contact, Gap};
use crate::dynamics::inputs::{Inputs, Start};
use crate::dynamics::system::System;
use crate::dynamics::task::Task;
use crate::numbers::rng::Rng;
use crate::numbers::scalar::{Real, Scalar};
use rand::RngExt;

/// Ball that falls on a floor and bounces. State `[height m, speed m/s]`, upwards; control
/// `[thrust N]`, upwards.
///
/// ```text
/// v̇ = u / m - g
/// ```
///
/// The floor is at height 0; see [`Contact`]. Steps without contact are exact with either model.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct BouncingBall {
    /// Mass m, kg, positive.
    pub mass: f64,
    /// Gravitational acceleration g, m/s².
    pub gravity: f64,
    /// Contact model of the floor.
    pub contact: Contact,
    /// Time step, s.
    pub dt: f64,
}

impl Default for BouncingBall {
    fn default() -> Self {
        Self {
            mass: 1.0,
            gravity: 9.81,
            contact: Contact::TimeOfImpact { restitution: 0.8 },
            dt: 0.01,
        }
    }
}

impl System for BouncingBall {
    fn state_dim(&self) -> usize {
        2
    }

    fn control_dim(&self) -> usize {
        1
    }

    #[inline(always)]
    fn step<T: Scalar>(&self, Inputs { x, u, .. }: Inputs<'_, T>, next: &mut [T]) {
        let acceleration = u[0] * (1.0 / self.mass) - self.gravity;
        let gap = self.contact.advance(
            Gap { width: x[0], speed: x[1] },
            acceleration,
            self.mass,
            self.dt,
        );
        (next[0], next[1]) = (gap.width, gap.speed);
    }
}

/// Task to reach a height at the end. The terminal cost is `(h - target)²` in m², with the height
/// h. The thrust carries no cost.
///
/// Initial heights are 0.5 to 1.5 m, initial speeds within ±1 m/s.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Bounce {
    /// System to control.
    pub system: BouncingBall,
    /// Target height, m.
    pub target: f64,
    /// Number of steps.
    pub horizon: usize,
}

impl Default for Bounce {
    /// Returns a task with a target of 1 m after 1 s. The ball bounces about once.
    fn default() -> Self {
        Self { system: BouncingBall::default(), target: 1.0, horizon: 100 }
    }
}

impl Task for Bounce {
    type System = BouncingBall;

    fn system(&self) -> &BouncingBall {
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
        start.x[0] = rng.random_range(0.5..1.5);
        start.x[1] = rng.random_range(-1.0..1.0);
    }

    #[inline(always)]
    fn terminal_cost<T: Scalar>(&self, x: &[T], _p: &[T]) -> T {
        let miss = x[0] - self.target;
        miss * miss
    }

    #[inline(always)]
    fn terminal_cost_gradient<R: Real>(
        &self,
        x: &[R],
        _p: &[R],
        x_bar: &mut [R],
        _p_bar: Option<&mut [R]>,
    ) {
        x_bar[0] += R::from(2.0) * (x[0] - R::from(self.target));
    }
}
