//! Two bodies on a line.

use super::{Contact, Gap};
use crate::dynamics::system::System;
use crate::dynamics::task::Task;
use crate::numbers::rng::Rng;
use crate::numbers::scalar::{Real, Scalar};
use rand::RngExt;

/// The physics: two bodies on a line without friction, of which the first is pushed. State `[p, q, ṗ, q̇]`, the places of
/// their middles in m, `q` to the right of `p`, and their speeds in m/s; control `[push N]`, on the first, to the right.
///
/// They touch where `q - p = contact_distance`; then what [`Contact`] says. With equal masses they are two balls, with
/// a restitution of 0 a pusher and a box. The gap `g = q - p - contact_distance` is all that contacts know of, and the center of mass
/// knows nothing of them:
///
/// ```text
/// p̈ = u / m₁ - F / m₁,   q̈ = F / m₂        g̈ = -u / m₁ + F (m₁ + m₂) / (m₁ m₂)
/// ```
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct TwoBodies {
    /// `[m₁, m₂]`, kg, positive.
    pub masses: [f64; 2],
    /// The distance of their middles when they touch, m.
    pub contact_distance: f64,
    /// What they do then.
    pub contact: Contact,
    /// Time step, s.
    pub dt: f64,
}

impl TwoBodies {
    /// Two equal balls of 1 kg and a radius of 5 cm, elastic.
    pub fn balls() -> Self {
        Self { masses: [1.0, 1.0], contact_distance: 0.1, contact: Contact::TimeOfImpact { restitution: 1.0 }, dt: 0.01 }
    }

    /// A pusher of 1 kg and a box of 2 kg, which stay together once they touch, until the pusher is pulled back.
    pub fn pusher() -> Self {
        Self { masses: [1.0, 2.0], contact: Contact::TimeOfImpact { restitution: 0.0 }, ..Self::balls() }
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
    fn step<T: Scalar>(&self, x: &[T], u: &[T], next: &mut [T]) {
        let [first, second] = self.masses;
        let total = first + second;
        let (dt, push) = (T::lift(self.dt), u[0] * T::lift(1.0 / first));

        let gap = Gap { width: x[1] - x[0] - T::lift(self.contact_distance), speed: x[3] - x[2] };
        let (free, after) = (gap.free(-push, dt), self.contact.advance(gap, -push, first * second / total, self.dt));
        // What the contact has made of it falls to the two by the other's mass, so that their center does not move.
        let (wider, faster) = (after.width - free.width, after.speed - free.speed);
        let (share, other) = (T::lift(first / total), T::lift(second / total));

        let first = Gap { width: x[0], speed: x[2] }.free(push, dt);
        (next[0], next[2]) = (first.width - other * wider, first.speed - other * faster);
        (next[1], next[3]) = (x[1] + x[3] * dt + share * wider, x[3] + share * faster);
    }
}

/// Bring the second body to the origin by pushing the first: the cost is `q²` at the end, in m². The push is free.
///
/// At rest, the second starts 0.5 to 1.5 m to the left of the origin, with a gap of 0.1 to 0.3 m to the first.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Push {
    /// The physics.
    pub system: TwoBodies,
    /// Number of steps.
    pub horizon: usize,
}

impl Default for Push {
    /// 1 s with pusher and box.
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

    fn start(&self, rng: &mut Rng, x: &mut [f64]) {
        x.fill(0.0);
        x[1] = -rng.random_range(0.5..1.5);
        x[0] = x[1] - self.system.contact_distance - rng.random_range(0.1..0.3);
    }

    #[inline(always)]
    fn terminal_cost<T: Scalar>(&self, x: &[T]) -> T {
        x[1] * x[1]
    }

    #[inline(always)]
    fn terminal_cost_gradient<R: Real>(&self, x: &[R], x_bar: &mut [R]) {
        x_bar.fill(R::zero());
        x_bar[1] = R::lift(2.0) * x[1];
    }
}
