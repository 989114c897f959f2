//! What accelerations make of the poles, in a step and in a vector field; the same for both models.

use crate::numbers::scalar::{Cotangent, Real, Scalar};

/// The next angle and rate of a pole with the angular acceleration α, by semi-implicit Euler.
#[inline(always)]
pub(super) fn moved<T: Scalar>(dt: T) -> impl Fn(&[T], T) -> [T; 2] {
    move |pole, alpha| {
        let omega = pole[1] + dt * alpha;
        [pole[0] + dt * omega, omega]
    }
}

/// The reverse of [`moved`]: for pole `i`, the cotangents of angle and rate but for what α brings, and that of α.
#[inline(always)]
pub(super) fn moved_bar<R: Real, C: Cotangent<R>>(next_bar: &[C], dt: R) -> impl Fn(usize, Option<&[C]>) -> ([C; 2], C) {
    move |i, _| {
        let theta_bar = next_bar[2 + 2 * i];
        let omega_bar = next_bar[3 + 2 * i] + theta_bar * dt;
        ([theta_bar, omega_bar], omega_bar * dt)
    }
}

/// The rates of a pole's angle and rate.
#[inline(always)]
pub(super) fn rate_of<T: Scalar>(pole: &[T], alpha: T) -> [T; 2] {
    [pole[1], alpha]
}

/// The reverse of [`rate_of`], to be added to what is in `x_bar` for pole `i`.
#[inline(always)]
pub(super) fn rate_of_bar<R: Real, C: Cotangent<R>>(rate_bar: &[C]) -> impl Fn(usize, Option<&[C]>) -> ([C; 2], C) {
    move |i, x_bar| {
        let there = x_bar.map_or([C::null(); 2], |x_bar| [x_bar[2 + 2 * i], x_bar[3 + 2 * i]]);
        (there, rate_bar[3 + 2 * i])
    }
}

/// Positions and their velocities come in turn.
pub(super) fn velocity_of(i: usize) -> Option<usize> {
    i.is_multiple_of(2).then_some(i + 1)
}
