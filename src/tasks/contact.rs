//! Hard contacts along a line: a ball on a floor, two balls, a pusher and a box.
//!
//! Each system reduces to one gap that opens and closes under an acceleration, which is constant
//! during a step. [`Contact`] selects the contact model. [`Bounce`] and [`Push`] are the tasks.

mod ball;
mod impact;
mod pair;

pub use ball::{Bounce, BouncingBall};
pub use pair::{Push, TwoBodies};

use crate::numbers::scalar::Scalar;

/// Contact model of two bodies.
///
/// A naive step with restitution e reflects the speed of a ball below the floor: `v ← -e v` where
/// the height `h < 0`. States converge as dt → 0, but derivatives do not. According to the
/// derivative of the naive step, raising the initial height by δ raises all later heights by δ.
/// Without gravity, the ball actually arrives later, and is lower by `e δ` afterwards. Springs that
/// the time step does not resolve have the same defect.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Contact {
    /// Exact impact at the time of contact within the step.
    ///
    /// The impact multiplies the speed of the gap by `-restitution`, and the remainder of the step
    /// continues from there. With at most four impacts per step, states and derivatives are exact
    /// for any dt. The derivatives include the dependence on the impact time ("saltation": Hiskens
    /// and Pai 2000, doi:10.1109/81.828574).
    ///
    /// A step may contain infinitely many impacts (Zeno), of which the code computes only four. At
    /// a fifth, the gap closes and stays at rest until a positive acceleration opens it. This
    /// discards bounces lower than `|a| dt² / 128`, where a is the acceleration of the gap.
    TimeOfImpact {
        /// Coefficient of restitution, from 0 (perfectly inelastic) to 1 (elastic).
        restitution: f64,
    },
    /// Repulsive spring and damper of Hunt and Crossley (doi:10.1115/1.3423596), which never pull.
    /// Steps are semi-implicit Euler for the contact force and exact for free fall. With the depth
    /// `δ = max(0, -gap)`,
    ///
    /// ```text
    /// F = stiffness δ max(0, 1 + damping δ̇)
    /// ```
    ///
    /// Without damping, the model converges to an elastic impact as the stiffness grows. The error
    /// is proportional to the duration of the contact, `π sqrt(m / stiffness)`, where m is the
    /// reduced mass. Steps of length dt are stable if `stiffness dt² < 4 m`.
    ///
    /// Derivatives need much smaller time steps. The time of contact within a step changes the
    /// later speed by a fraction of about `stiffness dt² / m`. The derivative of that speed with
    /// respect to position therefore has an error of about `stiffness dt / m`. Derivatives may be
    /// wrong even if many steps resolve a contact; `docs/stability.md` gives errors. Derivatives
    /// converge only if `stiffness dt / m` is small relative to them.
    ///
    /// With damping, restitution depends on the speed, and so do the derivatives. They do not
    /// converge to those of a constant restitution at any stiffness.
    Penalty {
        /// Stiffness, N/m, positive.
        stiffness: f64,
        /// Damping, s/m, not negative.
        damping: f64,
    },
}

/// Gap between two bodies.
#[derive(Clone, Copy, Debug)]
struct Gap<T> {
    /// Width, m; negative if the bodies overlap.
    width: T,
    /// Speed, m/s; positive if the gap opens.
    speed: T,
}

impl<T: Scalar> Gap<T> {
    /// Returns the gap after `time` without contact.
    #[inline(always)]
    fn free(self, acceleration: T, time: T) -> Self {
        let speed = self.speed + acceleration * time;
        Self { width: self.width + (self.speed + speed) * time * 0.5, speed }
    }
}

impl Contact {
    /// Returns the gap after dt under a constant acceleration and the contact. `mass` is the
    /// reduced mass. Without contact, the result equals [`Gap::free`] exactly.
    #[inline(always)]
    fn advance<T: Scalar>(&self, gap: Gap<T>, acceleration: T, mass: f64, dt: f64) -> Gap<T> {
        match *self {
            Self::TimeOfImpact { restitution } => {
                impact::advance(gap, acceleration, restitution, dt)
            }
            Self::Penalty { stiffness, damping } => {
                let depth = (-gap.width).max(T::zero());
                let factor = (T::one() - T::from(damping) * gap.speed).max(T::zero());
                let gain = T::from(stiffness / mass * dt) * depth * factor;
                let dt = T::from(dt);
                let free = gap.free(acceleration, dt);
                Gap { width: free.width + gain * dt, speed: free.speed + gain }
            }
        }
    }
}
