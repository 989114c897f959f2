//! Hard contacts along a line: a ball on a floor, two balls, a pusher and a box.
//!
//! All of them are one gap that opens and closes under an acceleration, constant during a step; what happens where it is
//! closed is a [`Contact`].

mod ball;
mod impact;
mod pair;

pub use ball::{Bounce, BouncingBall};
pub use pair::{Push, TwoBodies};

use crate::numbers::scalar::Scalar;

/// What happens where two bodies touch.
///
/// The trap: a step that reflects the speed after it has gone through the floor (`v ← -e v` where `h < 0`) has the right
/// limit as dt → 0, and a derivative that has not: moving the start up by δ moves the ball up by δ ever after, where in truth
/// it comes late and is lower by `e δ`. So it is with a spring that steps do not resolve.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Contact {
    /// The instant of the impact is found within the step; there the speed of the gap is multiplied by `-restitution`, and the
    /// rest of the step is gone from there. Exact for any dt, and so are its derivatives, that by the instant included
    /// ("saltation": Hiskens and Pai 2000, doi:10.1109/81.828574).
    ///
    /// Of the impacts within a step, of which there may be infinitely many (Zeno), 4 are followed; where a fifth would
    /// come, the gap stays closed and is at rest. It then loses what is left of the bounces, less than `|a| dt² / 128` high; it
    /// opens again when it is pulled apart.
    TimeOfImpact {
        /// Of the speed, from 0 (they stay together) to 1 (elastic).
        restitution: f64,
    },
    /// A spring and a damper that push apart and never pull, of Hunt and Crossley (doi:10.1115/1.3423596), with semi-implicit
    /// steps of Euler's around what falls freely: with the depth `δ = max(0, -gap)`,
    ///
    /// ```text
    /// F = stiffness δ max(0, 1 + damping δ̇)
    /// ```
    ///
    /// Without damping it converges to an elastic impact as the stiffness grows, at the rate of the contact's duration,
    /// `π sqrt(m / stiffness)`, m the reduced mass. Steps of length dt need `stiffness dt² < 4 m`.
    ///
    /// Derivatives are another matter. Where within a step the touch falls changes the speed afterwards by a share of about
    /// `stiffness dt² / m`, and so its derivative by the place by about `stiffness dt / m`: steps that resolve a contact well, 60
    /// of them in it, still give derivatives that have nothing to do with the impact's, the worse the stiffer the spring. They
    /// converge where `stiffness dt / m` is small beside them. With damping, restitution depends on the speed, and
    /// derivatives keep that: no stiffness makes them those of a constant restitution.
    Penalty {
        /// N/m, positive.
        stiffness: f64,
        /// s/m, not negative.
        damping: f64,
    },
}

/// What is between two bodies.
#[derive(Clone, Copy, Debug)]
struct Gap<T> {
    /// m; negative where they are in each other.
    width: T,
    /// m/s, positive where it opens.
    speed: T,
}

impl<T: Scalar> Gap<T> {
    /// A time later, if nothing touches.
    #[inline(always)]
    fn free(self, acceleration: T, time: T) -> Self {
        let speed = self.speed + acceleration * time;
        Self { width: self.width + (self.speed + speed) * time * T::lift(0.5), speed }
    }
}

impl Contact {
    /// The gap a time dt later, under an acceleration that is constant but for the contact; `mass` is the reduced one. What
    /// does not touch has the bits of [`Gap::free`].
    #[inline(always)]
    fn advance<T: Scalar>(&self, gap: Gap<T>, acceleration: T, mass: f64, dt: f64) -> Gap<T> {
        match *self {
            Self::TimeOfImpact { restitution } => impact::advance(gap, acceleration, restitution, dt),
            Self::Penalty { stiffness, damping } => {
                let depth = (-gap.width).max(T::zero());
                let factor = (T::one() - T::lift(damping) * gap.speed).max(T::zero());
                let gain = T::lift(stiffness / mass * dt) * depth * factor;
                let dt = T::lift(dt);
                let free = gap.free(acceleration, dt);
                Gap { width: free.width + gain * dt, speed: free.speed + gain }
            }
        }
    }
}
