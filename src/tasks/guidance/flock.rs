//! Evaders keep together, or apart.

use super::GuidanceSystem;
use super::gap::Law;
use super::pairs::{among, among_vjp};
use crate::dynamics::effect::Effect;
use crate::numbers::scalar::{Cotangent, Real, Scalar};
use serde::{Deserialize, Serialize};

/// Evaders nearer than `distance` attract each other, farther ones repel. With `r = E_i - E_k` and
/// `d = softening + |r|`:
///
/// ```text
/// evader k : v̇ += strength Σ_{i≠k} (distance / d - 1) r / d
/// ```
///
/// The sign is that of the authors' code (tum-pbs/StableBPTT), whose comment says the reverse; a negative strength is a
/// flock that keeps its distance and does not scatter. Evaders at one place are springs of the stiffness
/// `strength (distance / softening - 1) / softening` to each other; explicit steps of length dt damp them if the number
/// of evaders times this, times dt, is less than their friction.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(deny_unknown_fields, default)]
pub struct Flock {
    /// m/s².
    pub strength: f64,
    /// The softened distance d at which evaders neither attract nor repel each other, m.
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
    fn add_forces<T: Scalar>(&self, model: &GuidanceSystem, x: &[T], forces: &mut [T]) {
        among(model, self.law(), model.all_evaders(), x, forces);
    }

    #[inline(always)]
    fn vjp<R: Real, C: Cotangent<R>>(&self, model: &GuidanceSystem, x: &[R], forces_bar: &[C], x_bar: &mut [C]) {
        among_vjp(model, self.law(), model.all_evaders(), x, forces_bar, x_bar);
    }
}
