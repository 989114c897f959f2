//! [`Drive`]: attraction of drivers to evaders.

use super::GuidanceSystem;
use super::gap::Law;
use super::pairs::{from_to, from_to_vjp};
use crate::dynamics::effect::Effect;
use crate::dynamics::inputs::{Cotangents, OdeInputs};
use crate::numbers::scalar::{Cotangent, Real, Scalar};
use serde::{Deserialize, Serialize};

/// Attraction of drivers to evaders, without reaction on the evaders. With `r = E_k - D_j` and
/// `d = softening + |r|`:
///
/// ```text
/// driver j : v̇ += strength Σ_k r / d²
/// ```
///
/// The authors' code (tum-pbs/StableBPTT) contains this force but multiplies it by 0, so the paper
/// does not use it.
///
/// Near an evader, the force is a spring of stiffness `κ = strength / softening²`. Explicit Euler
/// steps of length dt damp its oscillation if `κ dt` is less than the friction coefficient of
/// drivers. With all defaults, κ is 20/s² and the limit is 15/s².
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(deny_unknown_fields, default)]
pub struct Drive {
    /// Strength, m²/s². Negative values repel drivers from evaders.
    pub strength: f64,
}

impl Default for Drive {
    fn default() -> Self {
        Self { strength: 0.2 }
    }
}

impl Drive {
    fn law(&self) -> Law {
        Law { far: 0.0, near: -self.strength }
    }
}

impl Effect<GuidanceSystem> for Drive {
    #[inline(always)]
    fn add_forces<T: Scalar>(
        &self,
        model: &GuidanceSystem,
        OdeInputs { x, .. }: OdeInputs<'_, T>,
        forces: &mut [T],
    ) {
        from_to(model, self.law(), model.all_evaders(), model.all_drivers(), x, forces);
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
            model.all_evaders(),
            model.all_drivers(),
            x,
            forces_bar,
            x_bar,
        );
    }
}
