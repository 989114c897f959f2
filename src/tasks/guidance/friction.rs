//! What slows agents down.

use super::GuidanceSystem;
use super::system::AGENT;
use crate::effect::Effect;
use crate::scalar::{Cotangent, Real, Scalar};
use serde::{Deserialize, Serialize};

/// Viscous friction: `v̇ += -friction v`, with a coefficient for drivers and one for evaders.
///
/// Ko and Zuazua 2020 (doi:10.1142/S0218202520400047), with the coefficients of the authors' code
/// (tum-pbs/StableBPTT). Explicit steps of length dt need `friction dt < 2`; below 1, no velocity changes its sign.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(deny_unknown_fields, default)]
pub struct Friction {
    /// What slows a driver, 1/s, not negative.
    pub drivers: f64,
    /// What slows an evader, 1/s, not negative.
    pub evaders: f64,
}

impl Default for Friction {
    fn default() -> Self {
        Self { drivers: 1.0, evaders: 4.0 }
    }
}

impl Friction {
    /// The coefficient of every agent, as numbers of one kind.
    #[inline(always)]
    fn each<T: Scalar>(&self, body: &GuidanceSystem) -> impl Fn(usize) -> T {
        let (split, drivers, evaders) = (body.drivers, T::lift(self.drivers), T::lift(self.evaders));
        move |agent| if agent < split { drivers } else { evaders }
    }
}

impl Effect<GuidanceSystem> for Friction {
    #[inline(always)]
    fn act<T: Scalar>(&self, body: &GuidanceSystem, x: &[T], forces: &mut [T]) {
        let each = self.each::<T>(body);
        for (agent, (force, x)) in forces.chunks_exact_mut(2).zip(x.chunks_exact(AGENT)).enumerate() {
            let friction = each(agent);
            force[0] -= friction * x[2];
            force[1] -= friction * x[3];
        }
    }

    #[inline(always)]
    fn vjp<R: Real, C: Cotangent<R>>(&self, body: &GuidanceSystem, _x: &[R], forces_bar: &[C], x_bar: &mut [C]) {
        let each = self.each::<R>(body);
        for (agent, (force_bar, x_bar)) in forces_bar.chunks_exact(2).zip(x_bar.chunks_exact_mut(AGENT)).enumerate() {
            let friction = each(agent);
            x_bar[2] -= force_bar[0] * friction;
            x_bar[3] -= force_bar[1] * friction;
        }
    }
}
