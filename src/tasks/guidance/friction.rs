//! [`Friction`]: viscous friction of the agents.

use super::GuidanceSystem;
use super::system::AGENT;
use crate::dynamics::effect::Effect;
use crate::dynamics::inputs::{Cotangents, OdeInputs};
use crate::numbers::scalar::{Cotangent, Real, Scalar};
use crate::numbers::zip::zip;
use serde::{Deserialize, Serialize};

/// Viscous friction: `v̇ += -friction v`, with separate coefficients for drivers and evaders.
///
/// Explicit steps of length dt need `friction dt < 2`. If `friction dt < 1`, velocities do not
/// change sign.
///
/// Source: Ko and Zuazua 2020 (doi:10.1142/S0218202520400047), with the coefficients of the
/// authors' code (tum-pbs/StableBPTT).
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(deny_unknown_fields, default)]
pub struct Friction {
    /// Friction coefficient of drivers, 1/s, not negative.
    pub drivers: f64,
    /// Friction coefficient of evaders, 1/s, not negative.
    pub evaders: f64,
}

impl Default for Friction {
    fn default() -> Self {
        Self { drivers: 1.0, evaders: 4.0 }
    }
}

impl Effect<GuidanceSystem> for Friction {
    #[inline(always)]
    fn add_forces<T: Scalar>(
        &self,
        model: &GuidanceSystem,
        OdeInputs { x, .. }: OdeInputs<'_, T>,
        forces: &mut [T],
    ) {
        let (forces, agents) = (forces.as_chunks_mut::<2>().0, x.as_chunks::<AGENT>().0);
        for (friction, range) in
            [(self.drivers, model.all_drivers()), (self.evaders, model.all_evaders())]
        {
            let friction = T::from(friction);
            for (force, agent) in zip(forces[range.clone()].iter_mut(), &agents[range]) {
                force[0] -= friction * agent[2];
                force[1] -= friction * agent[3];
            }
        }
    }

    #[inline(always)]
    fn vjp<R: Real, C: Cotangent<R>>(
        &self,
        model: &GuidanceSystem,
        _inputs: OdeInputs<'_, R>,
        forces_bar: &[C],
        cotangents: Cotangents<'_, C>,
    ) {
        let Some(x_bar) = cotangents.x else { return };
        let (forces_bar, cotangents) =
            (forces_bar.as_chunks::<2>().0, x_bar.as_chunks_mut::<AGENT>().0);
        for (friction, range) in
            [(self.drivers, model.all_drivers()), (self.evaders, model.all_evaders())]
        {
            let friction = R::from(friction);
            for (force_bar, bar) in zip(forces_bar[range.clone()].iter(), &mut cotangents[range]) {
                bar[2] -= force_bar[0] * friction;
                bar[3] -= force_bar[1] * friction;
            }
        }
    }
}
