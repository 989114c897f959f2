//! Potentials that stand still. `ξ = x - length/2` is the place from the middle of the box.
//!
//! In a scene there is at most one of them; as types they may be combined, and then add up.

use super::QuantumSystem;
use crate::dynamics::effect::Effect;
use crate::numbers::scalar::{Cotangent, Real, Scalar};
use crate::numbers::zip::zip;
use serde::{Deserialize, Serialize};

/// Makes effects of functions of ξ: types with `fn potential(&self, xi: f64) -> f64`.
macro_rules! stand_still {
    ($($effect:ty),+) => {$(
        impl Effect<QuantumSystem> for $effect {
            #[inline(always)]
            fn add_forces<T: Scalar>(&self, model: &QuantumSystem, _x: &[T], potential: &mut [T]) {
                for (v, xi) in zip(potential.iter_mut(), model.centered_points()) {
                    *v += T::lift(self.potential(xi));
                }
            }

            #[inline(always)]
            fn vjp<R: Real, C: Cotangent<R>>(&self, _model: &QuantumSystem, _x: &[R], _v_bar: &[C], _x_bar: &mut [C]) {}

            #[inline(always)]
            fn state_dependent(&self) -> bool {
                false
            }
        }
    )+};
}
stand_still!(Harmonic, Barrier, DoubleWell);

/// A parabola: `V = stiffness (ξ - center)²`, the harmonic oscillator.
///
/// As ħ = 1 and m = 1/2, its angular frequency is `ω = 2 sqrt(stiffness)` and its levels are `ω (n + 1/2)`, where the
/// walls are far: the ground state is `exp(-sqrt(stiffness) (ξ - center)² / 2)`, up to its norm.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(deny_unknown_fields, default)]
pub struct Harmonic {
    /// Energy per length squared. The default's ground state has 10 of energy and is a third of the default box wide.
    pub stiffness: f64,
    /// Where it is 0, from the middle of the box.
    pub center: f64,
}

impl Default for Harmonic {
    fn default() -> Self {
        Self { stiffness: 100.0, center: 0.0 }
    }
}

impl Harmonic {
    /// V at the distance ξ from the middle of the box.
    #[inline(always)]
    pub fn potential(&self, xi: f64) -> f64 {
        self.stiffness * (xi - self.center) * (xi - self.center)
    }
}

/// A smooth barrier to tunnel through: `V = height / cosh²((ξ - center) / width)`.
///
/// Eckart 1930 (doi:10.1103/PhysRev.35.1303), whose transmission is known. With m = 1/2, a particle of energy k² gets
/// through with the probability
///
/// ```text
/// T = sinh²(π k width) / (sinh²(π k width) + cosh²(π/2 sqrt(4 height width² - 1)))
/// ```
///
/// A negative height makes a well.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(deny_unknown_fields, default)]
pub struct Barrier {
    /// Energy at its top. The default is above the third eigenstate of the default box, which has 22.
    pub height: f64,
    /// Length, positive: at this distance from its top it has 42 % of its height, at twice the distance 7 %.
    pub width: f64,
    /// Where its top is, from the middle of the box.
    pub center: f64,
}

impl Default for Barrier {
    fn default() -> Self {
        Self { height: 30.0, width: 0.1, center: 0.0 }
    }
}

impl Barrier {
    /// V at the distance ξ from the middle of the box.
    #[inline(always)]
    pub fn potential(&self, xi: f64) -> f64 {
        let t = Scalar::tanh((xi - self.center) * (1.0 / self.width));
        self.height * (1.0 - t * t)
    }
}

/// Two valleys side by side, in the middle of the box: `V = height ((2 ξ / separation)² - 1)²`.
///
/// It is 0 at the bottoms, `ξ = ±separation/2`, and `height` between them. Small oscillations in either valley have the
/// angular frequency `8 sqrt(height) / separation`; below the top, the particle tunnels from one to the other.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(deny_unknown_fields, default)]
pub struct DoubleWell {
    /// Energy in the middle, above the bottoms.
    pub height: f64,
    /// Length from bottom to bottom, positive.
    pub separation: f64,
}

impl Default for DoubleWell {
    fn default() -> Self {
        Self { height: 30.0, separation: 1.2 }
    }
}

impl DoubleWell {
    /// V at the distance ξ from the middle of the box.
    #[inline(always)]
    pub fn potential(&self, xi: f64) -> f64 {
        let ratio = xi * (2.0 / self.separation);
        let depth = ratio * ratio - 1.0;
        self.height * depth * depth
    }
}

/// A potential given by its value at every grid point: any other, or what other effects add up to, worked out once rather
/// than in every step.
#[derive(Clone, Debug, PartialEq)]
pub struct Tabulated {
    /// V at the grid points.
    pub values: Vec<f64>,
}

impl Tabulated {
    /// What these effects add to the potential. Of one effect, the numbers of a step are the same, bit for bit; of several, they are
    /// added up before the control's.
    ///
    /// # Panics
    /// If an effect depends on the state.
    pub fn of<E: Effect<QuantumSystem>>(model: &QuantumSystem, effects: &E) -> Self {
        assert!(!effects.state_dependent(), "an effect that depends on the state has no table: {effects:?}");
        let mut values = vec![0.0; model.grid];
        effects.add_forces(model, &[], &mut values);
        Self { values }
    }
}

impl Effect<QuantumSystem> for Tabulated {
    #[inline(always)]
    fn add_forces<T: Scalar>(&self, _model: &QuantumSystem, _x: &[T], potential: &mut [T]) {
        for (v, &value) in zip(potential.iter_mut(), &self.values) {
            *v += T::lift(value);
        }
    }

    #[inline(always)]
    fn vjp<R: Real, C: Cotangent<R>>(&self, _model: &QuantumSystem, _x: &[R], _v_bar: &[C], _x_bar: &mut [C]) {}

    #[inline(always)]
    fn state_dependent(&self) -> bool {
        false
    }
}
