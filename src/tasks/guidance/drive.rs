//! Drivers are drawn to evaders.

use super::GuidanceSystem;
use super::gap::Law;
use super::pairs::{from_to, from_to_vjp};
use crate::dynamics::effect::Effect;
use crate::numbers::scalar::{Cotangent, Real, Scalar};
use serde::{Deserialize, Serialize};

/// Drivers are drawn to evaders; evaders do not feel them. With `r = E_k - D_j` and `d = softening + |r|`:
///
/// ```text
/// driver j : v̇ += strength Σ_k r / d²
/// ```
///
/// The authors' code (tum-pbs/StableBPTT) writes this force down and multiplies it by 0, so it is not among those of the
/// paper. Near an evader it is a spring of the stiffness `strength / softening²`; explicit steps of length dt damp it if
/// this times dt is less than the drivers' friction. The default is a little beyond that within a few centimetres.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(deny_unknown_fields, default)]
pub struct Drive {
    /// m²/s²; negative keeps drivers away from evaders.
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
    fn add_forces<T: Scalar>(&self, model: &GuidanceSystem, x: &[T], forces: &mut [T]) {
        from_to(model, self.law(), model.all_evaders(), model.all_drivers(), x, forces);
    }

    #[inline(always)]
    fn vjp<R: Real, C: Cotangent<R>>(&self, model: &GuidanceSystem, x: &[R], forces_bar: &[C], x_bar: &mut [C]) {
        from_to_vjp(model, self.law(), model.all_evaders(), model.all_drivers(), x, forces_bar, x_bar);
    }
}
