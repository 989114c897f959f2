//! [`Push`] and [`TwoBodies`]: two bodies on a line.

use super::{Contact, Gap};
use crate::dynamics::inputs::{Inputs, Start};
use crate::dynamics::system::System;
use crate::dynamics::task::Task;
use crate::numbers::rng::Rng;
use crate::numbers::scalar::{Real, Scalar};
use rand::RngExt;

/// Two bodies on a line without friction. The control pushes the first body.
///
/// State `[p, q, ṗ, q̇]`: positions of the centers in m, with `q` to the right of `p`, and speeds
/// in m/s. Control `[push N]`, on the first body, to the right.
///
/// The bodies touch where `q - p = contact_distance`; see [`Contact`]. Contacts depend only on the
/// gap `g = q - p - contact_distance` and do not affect the motion of the center of mass. With the
/// contact force F:
///
/// ```text
/// p̈ = u / m₁ - F / m₁,   q̈ = F / m₂        g̈ = -u / m₁ + F (m₁ + m₂) / (m₁ m₂)
/// ```
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct TwoBodies {
    /// Masses `[m₁, m₂]`, kg, positive.
    pub masses: [f64; 2],
    /// Distance between the centers at contact, m.
    pub contact_distance: f64,
    /// Contact model of the bodies.
    pub contact: Contact,
    /// Time step, s.
    pub dt: f64,
}

impl TwoBodies {
    /// Creates two equal, elastic balls of 1 kg with a radius of 5 cm.
    pub fn balls() -> Self {
        Self {
            masses: [1.0, 1.0],
            contact_distance: 0.1,
            contact: Contact::TimeOfImpact { restitution: 1.0 },
            dt: 0.01,
        }
    }

    /// Creates a pusher of 1 kg and a box of 2 kg. After contact, both stay together until the
    /// control pulls the pusher back.
    pub fn pusher() -> Self {
        Self {
            masses: [1.0, 2.0],
            contact: Contact::TimeOfImpact { restitution: 0.0 },
            ..Self::balls()
        }
    }
}

impl System for TwoBodies {
    fn state_dim(&self) -> usize {
        4
    }

    fn control_dim(&self) -> usize {
        1
    }

    #[inline(always)]
    fn step<T: Scalar>(&self, Inputs { x, u, .. }: Inputs<'_, T>, next: &mut [T]) {
        let [first, second] = self.masses;
        let total = first + second;
        let (dt, push) = (T::from(self.dt), u[0] * (1.0 / first));

        let gap = Gap { width: x[1] - x[0] - self.contact_distance, speed: x[3] - x[2] };
        let (free, after) = (
            gap.free(-push, dt),
            self.contact.advance(gap, -push, first * second / total, self.dt),
        );
        // Each body takes a share of the change of the gap that the contact causes. The share is
        // proportional to the mass of the other body, which preserves the center of mass.
        let (wider, faster) = (after.width - free.width, after.speed - free.speed);
        let (share, other) = (T::from(first / total), T::from(second / total));

        let first = Gap { width: x[0], speed: x[2] }.free(push, dt);
        (next[0], next[2]) = (first.width - other * wider, first.speed - other * faster);
        (next[1], next[3]) = (x[1] + x[3] * dt + share * wider, x[3] + share * faster);
    }
}

/// Task to bring the second body to the origin by pushing the first. The cost is `q²` at the end,
/// in m². The push carries no cost.
///
/// Both bodies start at rest. The second is 0.5 to 1.5 m to the left of the origin, with a gap of
/// 0.1 to 0.3 m to the first.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Push {
    /// System to control.
    pub system: TwoBodies,
    /// Number of steps.
    pub horizon: usize,
}

impl Default for Push {
    /// Returns a pusher and a box with a horizon of 1 s.
    fn default() -> Self {
        Self { system: TwoBodies::pusher(), horizon: 100 }
    }
}

impl Task for Push {
    type System = TwoBodies;

    fn system(&self) -> &TwoBodies {
        &self.system
    }

    fn horizon(&self) -> usize {
        self.horizon
    }

    /// ±10 N.
    fn control_bounds(&self) -> Option<Vec<[f64; 2]>> {
        Some(vec![[-10.0, 10.0]; self.system.control_dim()])
    }

    fn start(&self, rng: &mut Rng, Start { x, .. }: Start<'_>) {
        x[1] = -rng.random_range(0.5..1.5);
        x[0] = x[1] - self.system.contact_distance - rng.random_range(0.1..0.3);
    }

    #[inline(always)]
    fn terminal_cost<T: Scalar>(&self, x: &[T], _p: &[T]) -> T {
        x[1] * x[1]
    }

    #[inline(always)]
    fn terminal_cost_gradient<R: Real>(
        &self,
        x: &[R],
        _p: &[R],
        x_bar: &mut [R],
        _p_bar: Option<&mut [R]>,
    ) {
        x_bar[1] += R::from(2.0) * x[1];
    }
}
