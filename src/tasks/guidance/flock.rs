//! [`Flock`]: attraction and repulsion among evaders.

use super::GuidanceSystem;
use super::gap::Law;
use super::pairs::{among, among_vjp};
use crate::dynamics::effect::Effect;
use crate::dynamics::inputs::{Cotangents, OdeInputs};
use crate::numbers::scalar::{Cotangent, Real, Scalar};
use serde::{Deserialize, Serialize};

/// Attraction or repulsion among evaders. With `r = E_i - E_k` and `d = softening + |r|`, evaders
/// with `d < distance` attract each other, and evaders with `d > distance` repel each other:
///
/// ```text
/// evader k : v̇ += strength Σ_{i≠k} (distance / d - 1) r / d
/// ```
///
/// The sign is that of the authors' code (tum-pbs/StableBPTT). A comment in that code states the
/// opposite sign. With a negative strength, near evaders repel each other, and distant evaders
/// attract each other.
///
/// Springs of stiffness `κ = strength (distance / softening - 1) / softening` couple coincident
/// evaders. Explicit Euler steps of length dt damp the oscillation of n evaders if `n κ dt` is less
/// than their friction coefficient.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(deny_unknown_fields, default)]
pub struct Flock {
    /// Strength, m/s².
    pub strength: f64,
    /// Softened distance d at which the force between evaders is zero, m.
    pub distance: f64,
}

impl Default for Flock {
    fn default() -> Self {
        Self { strength: 0.2, distance: 0.5 }
    }
}

impl Flock {
    fn law(&self) -> Law {
        Law { far: self.strength, near: -self.strength * self.distance }
    }
}

impl Effect<GuidanceSystem> for Flock {
    #[inline(always)]
    fn add_forces<T: Scalar>(
        &self,
        model: &GuidanceSystem,
        OdeInputs { x, .. }: OdeInputs<'_, T>,
        forces: &mut [T],
    ) {
        among(model, self.law(), model.all_evaders(), x, forces);
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
        among_vjp(model, self.law(), model.all_evaders(), x, forces_bar, x_bar);
    }
}
