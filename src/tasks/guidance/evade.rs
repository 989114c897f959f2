//! [`Evade`]: repulsion of evaders by drivers.

use super::GuidanceSystem;
use super::gap::Law;
use super::pairs::{from_to, from_to_vjp};
use crate::dynamics::effect::Effect;
use crate::dynamics::inputs::{Cotangents, OdeInputs};
use crate::numbers::scalar::{Cotangent, Real, Scalar};
use serde::{Deserialize, Serialize};

/// Repulsion of evaders by drivers, without reaction on the drivers. With `r = E_k - D_j`,
/// `d = softening + |r|` and the softening of [`GuidanceSystem`]:
///
/// ```text
/// evader k : v̇ += strength Σ_j r / d²
/// ```
///
/// Source: Ko and Zuazua 2020 (doi:10.1142/S0218202520400047). The force is that of the code of the
/// ICLR 2024 paper (tum-pbs/StableBPTT).
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(deny_unknown_fields, default)]
pub struct Evade {
    /// Strength, m²/s². Negative values attract evaders to drivers.
    pub strength: f64,
}

impl Default for Evade {
    fn default() -> Self {
        Self { strength: 15.0 }
    }
}

impl Evade {
    fn law(&self) -> Law {
        Law { far: 0.0, near: self.strength }
    }
}

impl Effect<GuidanceSystem> for Evade {
    #[inline(always)]
    fn add_forces<T: Scalar>(
        &self,
        model: &GuidanceSystem,
        OdeInputs { x, .. }: OdeInputs<'_, T>,
        forces: &mut [T],
    ) {
        from_to(model, self.law(), model.all_drivers(), model.all_evaders(), x, forces);
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
        from_to_vjp(
            model,
            self.law(),
            model.all_drivers(),
            model.all_evaders(),
            x,
            forces_bar,
            x_bar,
        );
    }
}
