//! [`Spread`]: repulsion among drivers.

use super::GuidanceSystem;
use super::gap::Law;
use super::pairs::{among, among_vjp};
use crate::dynamics::effect::Effect;
use crate::dynamics::inputs::{Cotangents, OdeInputs};
use crate::numbers::scalar::{Cotangent, Real, Scalar};
use serde::{Deserialize, Serialize};

/// Repulsion among drivers. With `r = D_j - D_i` and `d = softening + |r|`:
///
/// ```text
/// driver j : v̇ += strength Σ_{i≠j} r / d²
/// ```
///
/// Source: Ko and Zuazua 2020 (doi:10.1142/S0218202520400047). The force is that of the code of the
/// ICLR 2024 paper (tum-pbs/StableBPTT).
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(deny_unknown_fields, default)]
pub struct Spread {
    /// Strength, m²/s². Negative values attract drivers to each other.
    pub strength: f64,
}

impl Default for Spread {
    fn default() -> Self {
        Self { strength: 0.2 }
    }
}

impl Spread {
    fn law(&self) -> Law {
        Law { far: 0.0, near: self.strength }
    }
}

impl Effect<GuidanceSystem> for Spread {
    #[inline(always)]
    fn add_forces<T: Scalar>(
        &self,
        model: &GuidanceSystem,
        OdeInputs { x, .. }: OdeInputs<'_, T>,
        forces: &mut [T],
    ) {
        among(model, self.law(), model.all_drivers(), x, forces);
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
        among_vjp(model, self.law(), model.all_drivers(), x, forces_bar, x_bar);
    }
}
