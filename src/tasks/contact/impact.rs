//! Impacts of a gap that closes within a step.

use super::Gap;
use crate::numbers::scalar::Scalar;

/// Largest number of impacts computed within a step.
const IMPACTS: usize = 4;

/// Next impact of a gap.
struct Impact<T> {
    /// Time until the impact, s.
    time: T,
    /// Closing speed at the impact, m/s, not negative.
    speed: T,
}

impl<T: Scalar> Impact<T> {
    /// Returns the impact at the first root t of `g + v t + a t²/2` at which the gap closes. The
    /// gap has the width g, the speed v and the acceleration a. The closing speed is
    /// `s = sqrt(max(0, v² - 2 a g))`.
    ///
    /// ```text
    /// closing, v ≤ 0 : t = 2 g / (s - v)      if s > 0
    ///                  t = 0                  if s = 0 and a < 0
    /// opening, v > 0 : t = (v + s) / -a       if a < 0
    /// otherwise      : no impact, t = 4 dt
    /// ```
    ///
    /// Neither quotient subtracts nearly equal numbers. Unused roots have the argument 1, unused
    /// quotients the denominator 1. No derivative therefore divides by 0.
    ///
    /// Rounding may leave a closing gap slightly negative. If `v² > 2 |a g|`, the impact time is
    /// negative, at least -dt. Otherwise the gap is at rest if `a < 0`, and moves freely if not.
    #[inline(always)]
    fn next(gap: Gap<T>, acceleration: T, dt: f64) -> Self {
        let (zero, one, never) = (T::zero(), T::one(), T::from(4.0 * dt));
        let (speed_squared, gain) =
            (gap.speed * gap.speed, -(acceleration + acceleration) * gap.width);
        let square = speed_squared + gain;
        let certain = T::select_lt(gap.width, zero, speed_squared - gain.abs(), square);
        let root = T::select_lt(zero, square, square, one).sqrt();
        // The factor 0 propagates NaN.
        let speed = T::select_lt(zero, square, root, square * zero);

        let pressed = T::select_lt(acceleration, zero, zero, never);
        let closing = T::select_lt(zero, certain, root - gap.speed, one);
        let ahead = T::select_lt(zero, certain, (gap.width + gap.width) / closing, pressed);
        let pull = T::select_lt(acceleration, zero, -acceleration, one);
        let back = T::select_lt(acceleration, zero, (gap.speed + speed) / pull, never);
        let time = T::select_lt(zero, gap.speed, back, ahead);
        Self { time: time.max(T::from(-dt)), speed }
    }
}

/// Advances a gap as described in [`Contact::TimeOfImpact`](super::Contact::TimeOfImpact). At an
/// impact, the width is the constant 0, with derivative 0. The impact time enters the result
/// through the remaining time.
#[inline(always)]
pub(super) fn advance<T: Scalar>(
    mut gap: Gap<T>,
    acceleration: T,
    restitution: f64,
    dt: f64,
) -> Gap<T> {
    let (zero, restitution) = (T::zero(), T::from(restitution));
    let mut left = T::from(dt);
    for _ in 0..IMPACTS {
        let impact = Impact::next(gap, acceleration, dt);
        gap.width = T::select_lt(impact.time, left, zero, gap.width);
        gap.speed = T::select_lt(impact.time, left, restitution * impact.speed, gap.speed);
        left = T::select_lt(impact.time, left, left - impact.time, left);
    }
    let fifth = Impact::next(gap, acceleration, dt);
    let free = gap.free(acceleration, left);
    // A fifth impact sets the gap to rest. The factor 0 sets the speed to 0 but propagates NaN.
    Gap {
        width: T::select_lt(fifth.time, left, zero, free.width),
        speed: T::select_lt(fifth.time, left, free.speed * zero, free.speed),
    }
}
