//! [`Bumpers`]: springs at the ends of the rail.

use super::CartPoleSystem;
use crate::dynamics::effect::Effect;
use crate::dynamics::inputs::{Cotangents, OdeInputs};
use crate::dynamics::number::{Number, Numbers};
use crate::numbers::scalar::{Cotangent, Real, Scalar};
use serde::{Deserialize, Serialize};

/// Springs at both ends of the rail that push the cart back and never pull it. The depth at the
/// right end is `δ = max(0, x - half_travel)`, and likewise at the left:
///
/// ```text
/// F = -stiffness δ max(0, 1 + damping ẋ)
/// ```
///
/// The damping is that of Hunt and Crossley 1975 (doi:10.1115/1.3423596) with a linear spring. The
/// force is continuous at contact, but the derivative is not. At the point of contact, the
/// derivative is 0, as without contact. Semi-implicit steps of length dt need about
/// `stiffness dt² < 4 M`, with the total mass M.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(deny_unknown_fields, default)]
pub struct Bumpers {
    /// Position of the bumpers: contact at `|x| = half_travel`, m, positive.
    pub half_travel: f64,
    /// Stiffness, N/m, not negative.
    pub stiffness: Number,
    /// Damping, s/m, not negative. 0 conserves energy.
    pub damping: Number,
}

impl Default for Bumpers {
    fn default() -> Self {
        Self { half_travel: 2.4, stiffness: 1000.0.into(), damping: 0.5.into() }
    }
}

impl Effect<CartPoleSystem> for Bumpers {
    #[inline(always)]
    fn numbers(&self) -> Numbers<'_> {
        Numbers::new([("stiffness", &self.stiffness), ("damping", &self.damping)])
    }

    #[inline(always)]
    fn add_forces<T: Scalar>(
        &self,
        _model: &CartPoleSystem,
        OdeInputs { x, p, .. }: OdeInputs<'_, T>,
        forces: &mut [T],
    ) {
        let [stiffness, damping] = self.numbers().of(p);
        let (right, left) = self.sides(x, damping).into();
        forces[0] += stiffness * (left.depth * left.factor - right.depth * right.factor);
    }

    #[inline(always)]
    fn vjp<R: Real, C: Cotangent<R>>(
        &self,
        _model: &CartPoleSystem,
        OdeInputs { x, p, .. }: OdeInputs<'_, R>,
        forces_bar: &[C],
        cotangents: Cotangents<'_, C>,
    ) {
        let Some(x_bar) = cotangents.x else { return };
        let (zero, [stiffness, damping]) = (R::zero(), self.numbers().of(p));
        // Both forces grow with depth and outward speed, so both slopes have the same sign.
        let (mut by_x, mut by_speed) = (zero, zero);
        for side in self.sides(x, damping) {
            by_x += R::select_lt(zero, side.depth, side.factor, zero);
            by_speed += R::select_lt(zero, side.factor, side.depth, zero);
        }
        x_bar[0] -= forces_bar[0] * (stiffness * by_x);
        x_bar[1] -= forces_bar[0] * (stiffness * damping * by_speed);
    }
}

/// Contact at one end.
struct Side<T> {
    /// Depth δ.
    depth: T,
    /// `max(0, 1 + damping δ̇)`.
    factor: T,
}

impl Bumpers {
    /// Returns the contacts at the right and the left end.
    #[inline(always)]
    fn sides<T: Scalar>(&self, x: &[T], damping: T) -> [Side<T>; 2] {
        let (zero, half_travel) = (T::zero(), T::from(self.half_travel));
        let side = |x: T, speed: T| Side {
            depth: (x - half_travel).max(zero),
            factor: (T::one() + damping * speed).max(zero),
        };
        [side(x[0], x[1]), side(-x[0], -x[1])]
    }
}
