//! Central forces, accurate at any distance.

use crate::numbers::extended::power_of_two;
use crate::numbers::scalar::{Cotangent, Float, Real, Scalar};

/// Central force per mass, `(far / d + near / d²) r`, with the r and d of a [`Gap`]. Positive
/// coefficients repel.
#[derive(Clone, Copy)]
pub(super) struct Law {
    /// Coefficient of the force that dominates at large distances, m/s².
    pub far: f64,
    /// Coefficient of the force that dominates at small distances, m²/s².
    pub near: f64,
}

/// Separation `r` in the plane with its softened norm `d = softening + |r|`. Provides central
/// forces and their derivatives.
///
/// The norm is `sqrt(x² + y²)` without overflow or loss of digits. If the square of the larger
/// coordinate could overflow or underflow, the code first multiplies both by a power of two. This
/// does not round digits that affect the norm.
///
/// The derivative of |r| is undefined at `r = 0`, where the code uses 0. The derivative of the
/// force is still correct there, because |r| enters the force only multiplied by `r`. The code
/// never takes the square root of 0, so the tangents of dual numbers are finite.
pub(super) struct Gap<T> {
    /// r / d.
    r_over_d: [T; 2],
    /// |r| / d.
    norm_over_d: T,
    /// 1 / d, in 1/m.
    inverse_d: T,
    /// r / |r|, and 0 at r = 0. Used only in the reverse pass, because its derivative is unbounded.
    direction: [T; 2],
}

impl<T: Scalar> Gap<T> {
    #[inline(always)]
    pub(super) fn new(r: [T; 2], softening: f64) -> Self {
        // Squares of numbers within 2^±range neither overflow nor lose digits, nor do their
        // tangents. Multiplication by 2^∓shift brings all other finite, nonzero numbers into this
        // range.
        let (range, shift) = if T::Real::EPSILON < 1e-10 { (500, 600) } else { (60, 90) };
        let (huge, tiny) = (T::from(power_of_two(range)), T::from(power_of_two(-range)));
        let (up, down) = (T::from(power_of_two(shift)), T::from(power_of_two(-shift)));
        let (zero, one) = (T::zero(), T::one());
        let [x, y] = r;
        let largest = x.abs().max(y.abs()).detach();
        // Huge separations are converted to units of 2^shift m. Otherwise the derivative of 1/d,
        // -1/d², would underflow before the multiplication by r.
        let unit = T::select_lt(huge, largest, down, one);
        let (x, y) = (x * unit, y * unit);
        // Tiny separations are scaled only for the norm. They are negligible beside the softening.
        let enlarged = T::select_lt(largest, tiny, up, one);
        let reduced = T::select_lt(largest, tiny, down, one);
        let (near_x, near_y) = (x * enlarged, y * enlarged);
        let square = near_x * near_x + near_y * near_y;
        let root = T::select_lt(zero, square, square, one).sqrt();
        let length = T::select_lt(zero, square, root * reduced, zero);

        let per_length = one / (T::from(softening) * unit + length);
        let per_root = one / root;
        Self {
            r_over_d: [x * per_length, y * per_length],
            norm_over_d: length * per_length,
            inverse_d: unit * per_length,
            direction: [near_x * per_root, near_y * per_root],
        }
    }

    /// Returns `F = (far / d + near / d²) r`.
    #[inline(always)]
    pub(super) fn force(&self, law: Law) -> [T; 2] {
        let strength = T::from(law.far) + T::from(law.near) * self.inverse_d;
        [self.r_over_d[0] * strength, self.r_over_d[1] * strength]
    }

    /// Returns `max(0, radius - |r|) / d`, for a radius in m.
    #[inline(always)]
    pub(super) fn depth_share(&self, radius: f64) -> T {
        (T::from(radius) * self.inverse_d - self.norm_over_d).max(T::zero())
    }
}

impl<R: Real> Gap<R> {
    /// Returns `r̄ = (∂F/∂r)ᵀ F̄` of the force `F = f(|r|) r`, where `∂F/∂r = f + |r| f' r̂ r̂ᵀ`.
    #[inline(always)]
    pub(super) fn force_vjp<C: Cotangent<R>>(&self, law: Law, force_bar: [C; 2]) -> [C; 2] {
        let (far, near) = (R::from(law.far), R::from(law.near) * self.inverse_d);
        let across = (far + near) * self.inverse_d;
        let along = -((far + near + near) * self.inverse_d * self.norm_over_d);
        self.central_vjp(across, along, force_bar)
    }

    /// Returns `r̄ = (∂F/∂r)ᵀ F̄` of the force `F = stiffness max(0, radius - |r|) r / d`. The
    /// derivative is 0 at `|r| = radius`, as outside the radius.
    #[inline(always)]
    pub(super) fn depth_vjp<C: Cotangent<R>>(
        &self,
        radius: f64,
        softening: f64,
        stiffness: f64,
        force_bar: [C; 2],
    ) -> [C; 2] {
        let (zero, stiffness, share) = (R::zero(), R::from(stiffness), self.depth_share(radius));
        let along = -(R::from(radius + softening) * self.inverse_d * self.norm_over_d);
        let along = R::select_lt(zero, share, along, zero);
        self.central_vjp(stiffness * share, stiffness * along, force_bar)
    }

    /// Returns `(across + along r̂ r̂ᵀ) F̄`.
    #[inline(always)]
    fn central_vjp<C: Cotangent<R>>(&self, across: R, along: R, force_bar: [C; 2]) -> [C; 2] {
        let [x, y] = self.direction;
        let radial = (force_bar[0] * x + force_bar[1] * y) * along;
        [force_bar[0] * across + radial * x, force_bar[1] * across + radial * y]
    }
}
