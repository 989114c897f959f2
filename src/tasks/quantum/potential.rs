//! Potentials that depend on neither time nor state: functions of `ξ = x - length/2`, and tables.
//!
//! A scene allows at most one of the functions, and no table. In code, several can be combined;
//! their potentials add.

use super::QuantumSystem;
use crate::dynamics::effect::Effect;
use crate::dynamics::inputs::{Cotangents, Inputs, OdeInputs};
use crate::numbers::scalar::{Cotangent, Real, Scalar};
use crate::numbers::zip::zip;
use serde::{Deserialize, Serialize};

/// Implements [`Effect`] for functions of ξ: types with `fn potential(&self, xi: f64) -> f64`.
macro_rules! static_potentials {
    ($($effect:ty),+) => {$(
        impl Effect<QuantumSystem> for $effect {
            #[inline(always)]
            fn add_forces<T: Scalar>(&self, model: &QuantumSystem, _inputs: OdeInputs<'_, T>, potential: &mut [T]) {
                for (v, xi) in zip(potential.iter_mut(), model.centered_points()) {
                    *v += self.potential(xi);
                }
            }

            #[inline(always)]
            fn vjp<R: Real, C: Cotangent<R>>(&self, _model: &QuantumSystem, _inputs: OdeInputs<'_, R>, _v_bar: &[C], _bars: Cotangents<'_, C>) {}

            #[inline(always)]
            fn state_dependent(&self) -> bool {
                false
            }
        }
    )+};
}
static_potentials!(Harmonic, Barrier, DoubleWell);

/// Harmonic oscillator: `V = stiffness (ξ - center)²`.
///
/// With ħ = 1 and m = 1/2, the angular frequency is `ω = 2 sqrt(stiffness)`. Far from the walls,
/// the energy levels are `ω (n + 1/2)`, and the ground state is
/// `exp(-sqrt(stiffness) (ξ - center)² / 2)`, up to its norm.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(deny_unknown_fields, default)]
pub struct Harmonic {
    /// Stiffness, energy per length squared. The ground state of the default has energy 10. At 0.32
    /// from its center, `|ψ|²` falls to 1/e.
    pub stiffness: f64,
    /// Position ξ of the minimum, length.
    pub center: f64,
}

impl Default for Harmonic {
    fn default() -> Self {
        Self { stiffness: 100.0, center: 0.0 }
    }
}

impl Harmonic {
    /// Returns V at the position ξ relative to the middle of the box.
    #[inline(always)]
    pub fn potential(&self, xi: f64) -> f64 {
        self.stiffness * (xi - self.center) * (xi - self.center)
    }
}

/// Smooth barrier for tunneling: `V = height / cosh²((ξ - center) / width)`.
///
/// The transmission is known (Eckart 1930, doi:10.1103/PhysRev.35.1303). With m = 1/2, a particle
/// of energy k² is transmitted with the probability
///
/// ```text
/// T = sinh²(π k width) / (sinh²(π k width) + cosh²(π/2 sqrt(4 height width² - 1)))
/// ```
///
/// A negative height gives a well.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(deny_unknown_fields, default)]
pub struct Barrier {
    /// Energy at the top. The default exceeds the energy 22 of the third eigenstate of the default
    /// box.
    pub height: f64,
    /// Width, length, positive. At this distance from the top, V is 42 % of the height, at twice
    /// the distance 7 %.
    pub width: f64,
    /// Position ξ of the top, length.
    pub center: f64,
}

impl Default for Barrier {
    fn default() -> Self {
        Self { height: 30.0, width: 0.1, center: 0.0 }
    }
}

impl Barrier {
    /// Returns V at the position ξ relative to the middle of the box.
    #[inline(always)]
    pub fn potential(&self, xi: f64) -> f64 {
        let t = Scalar::tanh((xi - self.center) * (1.0 / self.width));
        self.height * (1.0 - t * t)
    }
}

/// Double well in the middle of the box: `V = height ((2 ξ / separation)² - 1)²`.
///
/// V is 0 at the minima, `ξ = ±separation/2`, and `height` between them. Small oscillations in
/// either well have the angular frequency `8 sqrt(height) / separation`. Below the top, the
/// particle tunnels between the wells.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(deny_unknown_fields, default)]
pub struct DoubleWell {
    /// Energy in the middle of the box, above the minima.
    pub height: f64,
    /// Distance between the minima, length, positive.
    pub separation: f64,
}

impl Default for DoubleWell {
    fn default() -> Self {
        Self { height: 30.0, separation: 1.2 }
    }
}

impl DoubleWell {
    /// Returns V at the position ξ relative to the middle of the box.
    #[inline(always)]
    pub fn potential(&self, xi: f64) -> f64 {
        let ratio = xi * (2.0 / self.separation);
        let depth = ratio * ratio - 1.0;
        self.height * depth * depth
    }
}

/// Potential given by its values at the grid points.
///
/// Represents arbitrary potentials, or a sum of effects that is computed once instead of in every
/// step.
#[derive(Clone, Debug, PartialEq)]
pub struct Tabulated {
    /// V at each grid point, energy.
    pub values: Vec<f64>,
}

impl Tabulated {
    /// Tabulates the sum of the given effects at time 0.
    ///
    /// Steps with the table of one potential of this module equal steps with the potential bit for
    /// bit. For several potentials, they differ by rounding errors of the sum.
    ///
    /// # Panics
    /// If an effect depends on state, control or parameters.
    pub fn of<E: Effect<QuantumSystem>>(model: &QuantumSystem, effects: &E) -> Self {
        assert!(
            !effects.state_dependent(),
            "an effect that depends on state, control or parameters has no table; use it without `Tabulated`: {effects:?}"
        );
        let mut values = vec![0.0; model.grid];
        effects.add_forces(model, Inputs { x: &[], u: &[], p: &[], t: 0.0 }, &mut values);
        Self { values }
    }
}

impl Effect<QuantumSystem> for Tabulated {
    #[inline(always)]
    fn add_forces<T: Scalar>(
        &self,
        _model: &QuantumSystem,
        _inputs: OdeInputs<'_, T>,
        potential: &mut [T],
    ) {
        assert_eq!(
            self.values.len(),
            potential.len(),
            "a tabulated potential needs one value per grid point"
        );
        for (v, &value) in zip(potential.iter_mut(), &self.values) {
            *v += value;
        }
    }

    #[inline(always)]
    fn vjp<R: Real, C: Cotangent<R>>(
        &self,
        _model: &QuantumSystem,
        _inputs: OdeInputs<'_, R>,
        _v_bar: &[C],
        _bars: Cotangents<'_, C>,
    ) {
    }

    #[inline(always)]
    fn state_dependent(&self) -> bool {
        false
    }
}
