//! Central forces, at any distance.

use crate::numbers::extended::power_of_two;
use crate::numbers::scalar::{Cotangent, Float, Real, Scalar};

/// A central force `(far / d + near / d²) r`; positive pushes apart.
#[derive(Clone, Copy)]
pub(super) struct Law {
    pub far: f64,
    pub near: f64,
}

/// A separation `r` in the plane and its softened length `d = softening + |r|`, from which come a force and its slope.
///
/// Exact: coordinates whose squares would overflow or lose digits are first multiplied by a power of two, which rounds
/// nothing, so |r| is `sqrt(x² + y²)`, to the bit wherever that works and as accurate where it does not. At `r = 0` the
/// derivative of |r|, which has none there, is taken as 0; that of the force is then right, since |r| enters it only
/// with the factor `r`. All of it holds for the tangents of duals too; they never meet a root of 0.
pub(super) struct Gap<T> {
    /// r / d.
    share: [T; 2],
    /// |r| / d.
    length_share: T,
    /// 1 / d.
    per_distance: T,
    /// r / |r|, and 0 at r = 0. For the reverse only: its own derivative has no bound.
    direction: [T; 2],
}

impl<T: Scalar> Gap<T> {
    #[inline(always)]
    pub(super) fn new(r: [T; 2], softening: f64) -> Self {
        // Squares of numbers within 2^±range, and of all others times 2^∓shift, neither overflow nor lose digits, nor
        // do their tangents.
        let (range, shift) = if T::Real::EPSILON < 1e-10 { (500, 600) } else { (60, 90) };
        let (huge, tiny) = (T::lift(power_of_two(range)), T::lift(power_of_two(-range)));
        let (up, down) = (T::lift(power_of_two(shift)), T::lift(power_of_two(-shift)));
        let (zero, one) = (T::zero(), T::one());
        let [x, y] = r;
        let largest = x.abs().max(y.abs()).detach();
        // From here on huge separations are measured in 2^shift m, or the slope of 1/d, -1/d², would vanish before it
        // is multiplied by r.
        let unit = T::select_lt(huge, largest, down, one);
        let (x, y) = (x * unit, y * unit);
        // Tiny ones are magnified for their length only: beside the softening they are what they are.
        let enlarged = T::select_lt(largest, tiny, up, one);
        let reduced = T::select_lt(largest, tiny, down, one);
        let (near_x, near_y) = (x * enlarged, y * enlarged);
        let square = near_x * near_x + near_y * near_y;
        let root = T::select_lt(zero, square, square, one).sqrt();
        let length = T::select_lt(zero, square, root * reduced, zero);

        let per_length = one / (T::lift(softening) * unit + length);
        let per_root = one / root;
        Self {
            share: [x * per_length, y * per_length],
            length_share: length * per_length,
            per_distance: unit * per_length,
            direction: [near_x * per_root, near_y * per_root],
        }
    }

    /// `F = (far / d + near / d²) r`.
    #[inline(always)]
    pub(super) fn force(&self, law: Law) -> [T; 2] {
        let strength = T::lift(law.far) + T::lift(law.near) * self.per_distance;
        [self.share[0] * strength, self.share[1] * strength]
    }

    /// `(radius - |r|) / d`, or 0 if that is negative.
    #[inline(always)]
    pub(super) fn depth_share(&self, radius: f64) -> T {
        (T::lift(radius) * self.per_distance - self.length_share).max(T::zero())
    }
}

impl<R: Real> Gap<R> {
    /// `r̄ = (∂F/∂r)ᵀ F̄`, with `F = f(|r|) r` and so `∂F/∂r = f + |r| f' r̂ r̂ᵀ`.
    #[inline(always)]
    pub(super) fn force_vjp<C: Cotangent<R>>(&self, law: Law, force_bar: [C; 2]) -> [C; 2] {
        let (far, near) = (R::lift(law.far), R::lift(law.near) * self.per_distance);
        let across = (far + near) * self.per_distance;
        let along = -((far + near + near) * self.per_distance * self.length_share);
        self.central_vjp(across, along, force_bar)
    }

    /// The same for `F = stiffness max(0, radius - |r|) / d r`; at `|r| = radius` the derivative is that of the outside.
    #[inline(always)]
    pub(super) fn depth_vjp<C: Cotangent<R>>(&self, radius: f64, softening: f64, stiffness: f64, force_bar: [C; 2]) -> [C; 2] {
        let (zero, stiffness, share) = (R::zero(), R::lift(stiffness), self.depth_share(radius));
        let along = -(R::lift(radius + softening) * self.per_distance * self.length_share);
        let along = R::select_lt(zero, share, along, zero);
        self.central_vjp(stiffness * share, stiffness * along, force_bar)
    }

    /// `(across + along r̂ r̂ᵀ) F̄`.
    #[inline(always)]
    fn central_vjp<C: Cotangent<R>>(&self, across: R, along: R, force_bar: [C; 2]) -> [C; 2] {
        let [x, y] = self.direction;
        let radial = (force_bar[0] * x + force_bar[1] * y) * along;
        [force_bar[0] * across + radial * x, force_bar[1] * across + radial * y]
    }
}
