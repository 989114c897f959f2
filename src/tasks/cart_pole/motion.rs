//! Angles and rates of the poles from their accelerations, in a step and in a vector field. Shared
//! by the uncoupled and the coupled model.

use crate::numbers::scalar::{Cotangent, Real, Scalar};

/// Returns a function of a pole and its angular acceleration α. The function computes the next
/// angle and rate by semi-implicit Euler.
#[inline(always)]
pub(super) fn moved<T: Scalar>(dt: T) -> impl Fn(&[T], T) -> [T; 2] {
    move |pole, alpha| {
        let omega = pole[1] + dt * alpha;
        [pole[0] + dt * omega, omega]
    }
}

/// Reverse of [`moved`], as a function of the pole index. The function returns the cotangents of
/// angle and rate that do not pass through α, and the cotangent of α.
#[inline(always)]
pub(super) fn moved_bar<R: Real, C: Cotangent<R>>(
    next_bar: &[C],
    dt: R,
) -> impl Fn(usize) -> ([C; 2], C) {
    move |i| {
        let theta_bar = next_bar[2 + 2 * i];
        let omega_bar = next_bar[3 + 2 * i] + theta_bar * dt;
        ([theta_bar, omega_bar], omega_bar * dt)
    }
}

/// Returns the time derivatives of a pole's angle and rate.
#[inline(always)]
pub(super) fn rate_of<T: Scalar>(pole: &[T], alpha: T) -> [T; 2] {
    [pole[1], alpha]
}

/// Reverse of [`rate_of`], as a function of the pole index. The function returns zero cotangents of
/// angle and rate, and the cotangent of α. The caller adds the cotangent of the rate ω due to
/// `dθ/dt = ω`.
#[inline(always)]
pub(super) fn rate_of_bar<R: Real, C: Cotangent<R>>(
    rate_bar: &[C],
) -> impl Fn(usize) -> ([C; 2], C) {
    move |i| ([C::null(); 2], rate_bar[3 + 2 * i])
}

/// Returns the index of the velocity of position `i`, or `None` if `i` is a velocity. Positions and
/// velocities alternate.
pub(super) fn velocity_of(i: usize) -> Option<usize> {
    i.is_multiple_of(2).then_some(i + 1)
}
