//! Round obstacles.

use super::GuidanceSystem;
use super::gap::Gap;
use super::system::AGENT;
use crate::dynamics::effect::Effect;
use crate::numbers::scalar::{Cotangent, Real, Scalar};
use crate::numbers::zip::zip;
use serde::{Deserialize, Serialize};

/// Round obstacles that push drivers and evaders out, and never pull. With `r` the way from an obstacle's center to the
/// agent and `d = softening + |r|`:
///
/// ```text
/// v̇ += stiffness max(0, radius - |r|) r / d
/// ```
///
/// A penalty spring in the depth (Moore and Wilhelms 1988, Collision Detection and Response for Computer Animation).
/// `r / d` stands for the direction, as in the forces between agents, so that force and slope are finite at the very
/// center, where nothing points outwards: the force there is 0. The derivative leaps where an agent touches; at the point
/// of touch it is that of the outside.
///
/// Explicit steps of length dt give an agent more speed back than it came with, unless `stiffness dt` is less than its
/// friction: with the paper's dt and [`Friction`](super::Friction), 15/s² for drivers and 60/s² for evaders.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(deny_unknown_fields, default)]
pub struct Obstacles {
    /// Where they are, m. The default is three of them around the origin, with gaps between.
    pub centers: Vec<[f64; 2]>,
    /// Of each, m, positive.
    pub radius: f64,
    /// 1/s², not negative.
    pub stiffness: f64,
}

impl Default for Obstacles {
    fn default() -> Self {
        Self { centers: vec![[1.0, 0.0], [-0.5, 0.85], [-0.5, -0.85]], radius: 0.5, stiffness: 10.0 }
    }
}

/// The way of an agent from a center.
#[inline(always)]
fn way<T: Scalar>(agent: &[T], center: [f64; 2]) -> [T; 2] {
    [agent[0] - T::lift(center[0]), agent[1] - T::lift(center[1])]
}

impl Effect<GuidanceSystem> for Obstacles {
    #[inline(always)]
    fn add_forces<T: Scalar>(&self, model: &GuidanceSystem, x: &[T], forces: &mut [T]) {
        let stiffness = T::lift(self.stiffness);
        for (force, agent) in zip(forces.chunks_exact_mut(2), x.chunks_exact(AGENT)) {
            for &center in &self.centers {
                let r = way(agent, center);
                let push = stiffness * Gap::new(r, model.softening).depth_share(self.radius);
                force[0] += push * r[0];
                force[1] += push * r[1];
            }
        }
    }

    #[inline(always)]
    fn vjp<R: Real, C: Cotangent<R>>(&self, model: &GuidanceSystem, x: &[R], forces_bar: &[C], x_bar: &mut [C]) {
        let agents = zip(x.chunks_exact(AGENT), x_bar.chunks_exact_mut(AGENT));
        for (force_bar, (agent, x_bar)) in zip(forces_bar.chunks_exact(2), agents) {
            let force_bar = [force_bar[0], force_bar[1]];
            for &center in &self.centers {
                let gap = Gap::new(way(agent, center), model.softening);
                let [by_x, by_y] = gap.depth_vjp(self.radius, model.softening, self.stiffness, force_bar);
                x_bar[0] += by_x;
                x_bar[1] += by_y;
            }
        }
    }
}
