//! [`Walls`]: walls around a rectangular field.

use super::GuidanceSystem;
use super::system::AGENT;
use crate::dynamics::effect::Effect;
use crate::dynamics::inputs::{Cotangents, OdeInputs};
use crate::numbers::scalar::{Cotangent, Real, Scalar};
use crate::numbers::zip::zip;
use serde::{Deserialize, Serialize};

/// Walls around a rectangular field about the origin: springs that push drivers and evaders back in
/// and never pull. At the right wall, and likewise at the other three:
///
/// ```text
/// v̇_x += -stiffness max(0, x - half_width)
/// ```
///
/// The force is a penalty spring in the depth (Moore and Wilhelms 1988, Collision Detection and
/// Response for Computer Animation). The derivative is discontinuous at contact. At the point of
/// contact, the derivative is 0, as inside the field.
///
/// Explicit steps of length dt return an agent faster than it arrived, unless `stiffness dt` is
/// less than the friction coefficient of the agent. With the paper's dt and
/// [`Friction`](super::Friction), the largest stiffness is 15/s² for drivers and 60/s² for evaders.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(deny_unknown_fields, default)]
pub struct Walls {
    /// Half the width of the field, along x, m, positive.
    pub half_width: f64,
    /// Half the height of the field, along y, m, positive. The default field contains all initial
    /// states.
    pub half_height: f64,
    /// Stiffness, 1/s², not negative.
    pub stiffness: f64,
}

impl Default for Walls {
    fn default() -> Self {
        Self { half_width: 6.0, half_height: 4.0, stiffness: 10.0 }
    }
}

impl Walls {
    fn halves(&self) -> [f64; 2] {
        [self.half_width, self.half_height]
    }
}

impl Effect<GuidanceSystem> for Walls {
    #[inline(always)]
    fn add_forces<T: Scalar>(
        &self,
        _model: &GuidanceSystem,
        OdeInputs { x, .. }: OdeInputs<'_, T>,
        forces: &mut [T],
    ) {
        let (zero, stiffness) = (T::zero(), T::from(self.stiffness));
        for (force, agent) in zip(forces.chunks_exact_mut(2), x.chunks_exact(AGENT)) {
            for (axis, half) in self.halves().into_iter().enumerate() {
                let half = T::from(half);
                let (right, left) =
                    ((agent[axis] - half).max(zero), (-agent[axis] - half).max(zero));
                force[axis] += stiffness * (left - right);
            }
        }
    }

    #[inline(always)]
    fn vjp<R: Real, C: Cotangent<R>>(
        &self,
        _model: &GuidanceSystem,
        OdeInputs { x, .. }: OdeInputs<'_, R>,
        forces_bar: &[C],
        cotangents: Cotangents<'_, C>,
    ) {
        let Some(x_bar) = cotangents.x else { return };
        let (zero, stiffness) = (R::zero(), R::from(self.stiffness));
        let agents = zip(x.chunks_exact(AGENT), x_bar.chunks_exact_mut(AGENT));
        for (force_bar, (agent, x_bar)) in zip(forces_bar.chunks_exact(2), agents) {
            for (axis, half) in self.halves().into_iter().enumerate() {
                let slope = R::select_lt(R::from(half), agent[axis].abs(), stiffness, zero);
                x_bar[axis] -= force_bar[axis] * slope;
            }
        }
    }
}
