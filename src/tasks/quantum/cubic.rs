//! [`Cubic`]: interaction of many particles in one wave.

use super::QuantumSystem;
use crate::dynamics::effect::Effect;
use crate::dynamics::inputs::{Cotangents, OdeInputs};
use crate::numbers::scalar::{Cotangent, Real, Scalar};
use crate::numbers::zip::zip;
use serde::{Deserialize, Serialize};

/// Interaction of particles in one wave, a Bose-Einstein condensate: `V_j = strength |ψ_j|² / dx`.
///
/// The equation is `i ∂ψ/∂t = -∂²ψ/∂x² + V ψ + strength |ψ|² ψ` (Gross 1961,
/// doi:10.1007/BF02731494; Pitaevskii 1961, Sov. Phys. JETP 13, 451). In this equation, ψ satisfies
/// `∫ |ψ|² dx = 1`. A state has `Σ_j |ψ_j|² = 1`, so the probability density is `|ψ_j|² / dx`.
///
/// The schemes of Crank and Nicolson and [`Pade`](super::Pade) use the density at the beginning of
/// the step. Steps therefore remain unitary, need no iteration, and are of first order in dt.
/// [`Strang`](super::Strang) computes a density per half step and is of second order.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(deny_unknown_fields, default)]
pub struct Cubic {
    /// Strength, energy times length. Positive values repel, negative values attract.
    pub strength: f64,
}

impl Default for Cubic {
    fn default() -> Self {
        Self { strength: 5.0 }
    }
}

impl Cubic {
    /// Returns the energy per probability at a grid point, `strength / dx`.
    #[inline(always)]
    fn per_probability(&self, model: &QuantumSystem) -> f64 {
        self.strength * (1.0 / model.spacing())
    }
}

impl Effect<QuantumSystem> for Cubic {
    #[inline(always)]
    fn add_forces<T: Scalar>(
        &self,
        model: &QuantumSystem,
        OdeInputs { x, .. }: OdeInputs<'_, T>,
        potential: &mut [T],
    ) {
        let strength = T::from(self.per_probability(model));
        // Indexing with bounds checks deliberately prevents vectorization over grid points. Lanes
        // fill the registers already.
        for (j, v) in potential.iter_mut().enumerate() {
            let [re, im] = x.as_chunks().0[j];
            *v += strength * (re * re + im * im);
        }
    }

    #[inline(always)]
    fn vjp<R: Real, C: Cotangent<R>>(
        &self,
        model: &QuantumSystem,
        OdeInputs { x, .. }: OdeInputs<'_, R>,
        potential_bar: &[C],
        cotangents: Cotangents<'_, C>,
    ) {
        let Some(x_bar) = cotangents.x else { return };
        let slope = R::from(2.0 * self.per_probability(model));
        for ((&v_bar, [re, im]), bar) in
            zip(zip(potential_bar.iter(), x.as_chunks().0), x_bar.as_chunks_mut::<2>().0)
        {
            let v_bar = v_bar * slope;
            bar[0] += v_bar * *re;
            bar[1] += v_bar * *im;
        }
    }
}
