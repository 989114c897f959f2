//! [`Obstacles`]: round obstacles.

use super::GuidanceSystem;
use super::gap::Gap;
use super::system::AGENT;
use crate::dynamics::effect::Effect;
use crate::dynamics::inputs::{Cotangents, OdeInputs};
use crate::numbers::scalar::{Cotangent, Real, Scalar};
use crate::numbers::zip::zip;
use serde::{Deserialize, Serialize};

/// Round obstacles that push drivers and evaders out and never pull. With the vector `r` from the
/// center of an obstacle to the agent and `d = softening + |r|`:
///
/// ```text
/// v̇ += stiffness max(0, radius - |r|) r / d
/// ```
///
/// The force is a penalty spring in the depth (Moore and Wilhelms 1988, Collision Detection and
/// Response for Computer Animation). As in the forces between agents, `r / d` replaces the
/// direction. Force and derivative are therefore finite at the center, where the force is 0. The
/// derivative is discontinuous at `|r| = radius`, where its value is 0, as outside the obstacle.
///
/// Explicit steps of length dt return an agent faster than it arrived, unless `stiffness dt` is
/// less than the friction coefficient of the agent. With the paper's dt and
/// [`Friction`](super::Friction), the largest stiffness is 15/s² for drivers and 60/s² for evaders.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(deny_unknown_fields, default)]
pub struct Obstacles {
    /// Centers of the obstacles, m. The default is three obstacles around the origin, with gaps
    /// between them.
    pub centers: Vec<[f64; 2]>,
    /// Radius of each obstacle, m, positive.
    pub radius: f64,
    /// Stiffness, 1/s², not negative.
    pub stiffness: f64,
}

impl Default for Obstacles {
    fn default() -> Self {
        Self {
            centers: vec![[1.0, 0.0], [-0.5, 0.85], [-0.5, -0.85]],
            radius: 0.5,
            stiffness: 10.0,
        }
    }
}

/// Returns the vector from `center` to an agent.
#[inline(always)]
fn offset<T: Scalar>(agent: &[T], center: [f64; 2]) -> [T; 2] {
    [agent[0] - center[0], agent[1] - center[1]]
}

impl Effect<GuidanceSystem> for Obstacles {
    #[inline(always)]
    fn add_forces<T: Scalar>(
        &self,
        model: &GuidanceSystem,
        OdeInputs { x, .. }: OdeInputs<'_, T>,
        forces: &mut [T],
    ) {
        let stiffness = T::from(self.stiffness);
        for (force, agent) in zip(forces.chunks_exact_mut(2), x.chunks_exact(AGENT)) {
            for &center in &self.centers {
                let r = offset(agent, center);
                let push = stiffness * Gap::new(r, model.softening).depth_share(self.radius);
                force[0] += push * r[0];
                force[1] += push * r[1];
            }
        }
    }

    #[inline(always)]
    fn vjp<R: Real, C: Cotangent<R>>(
        &self,
        model: &GuidanceSystem,
        OdeInputs { x, .. }: OdeInputs<'_, R>,
        forces_bar: &[C],
        cotangents: Cotangents<'_, C>,
    ) {
        let Some(x_bar) = cotangents.x else { return };
        let agents = zip(x.chunks_exact(AGENT), x_bar.chunks_exact_mut(AGENT));
        for (force_bar, (agent, x_bar)) in zip(forces_bar.chunks_exact(2), agents) {
            let force_bar = [force_bar[0], force_bar[1]];
            for &center in &self.centers {
                let gap = Gap::new(offset(agent, center), model.softening);
                let [by_x, by_y] =
                    gap.depth_vjp(self.radius, model.softening, self.stiffness, force_bar);
                x_bar[0] += by_x;
                x_bar[1] += by_y;
            }
        }
    }
}
