//! Potentials that stand still. `ξ = x - length/2` is the place from the middle of the box.
//!
//! In a scene there is at most one of them; as types they may be combined, and then add up.

use super::QuantumSystem;
use crate::effect::Effect;
use crate::scalar::{Cotangent, Real, Scalar};
use serde::{Deserialize, Serialize};

/// Adds a function of ξ to the potential.
#[inline(always)]
fn add<T: Scalar>(body: &QuantumSystem, potential: &mut [T], at: impl Fn(f64) -> f64) {
    for (v, xi) in potential.iter_mut().zip(body.centered_points()) {
        *v += T::lift(at(xi));
    }
}

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

impl Effect<QuantumSystem> for Harmonic {
    #[inline(always)]
    fn act<T: Scalar>(&self, body: &QuantumSystem, _x: &[T], potential: &mut [T]) {
        add(body, potential, |xi| self.stiffness * (xi - self.center) * (xi - self.center));
    }

    #[inline(always)]
    fn vjp<R: Real, C: Cotangent<R>>(&self, _body: &QuantumSystem, _x: &[R], _potential_bar: &[C], _x_bar: &mut [C]) {}

    #[inline(always)]
    fn reads_state(&self) -> bool {
        false
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

impl Effect<QuantumSystem> for Barrier {
    #[inline(always)]
    fn act<T: Scalar>(&self, body: &QuantumSystem, _x: &[T], potential: &mut [T]) {
        let per_width = 1.0 / self.width;
        add(body, potential, |xi| {
            let t = Scalar::tanh((xi - self.center) * per_width);
            self.height * (1.0 - t * t)
        });
    }

    #[inline(always)]
    fn vjp<R: Real, C: Cotangent<R>>(&self, _body: &QuantumSystem, _x: &[R], _potential_bar: &[C], _x_bar: &mut [C]) {}

    #[inline(always)]
    fn reads_state(&self) -> bool {
        false
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

impl Effect<QuantumSystem> for DoubleWell {
    #[inline(always)]
    fn act<T: Scalar>(&self, body: &QuantumSystem, _x: &[T], potential: &mut [T]) {
        let per_half = 2.0 / self.separation;
        add(body, potential, |xi| {
            let ratio = xi * per_half;
            let depth = ratio * ratio - 1.0;
            self.height * depth * depth
        });
    }

    #[inline(always)]
    fn vjp<R: Real, C: Cotangent<R>>(&self, _body: &QuantumSystem, _x: &[R], _potential_bar: &[C], _x_bar: &mut [C]) {}

    #[inline(always)]
    fn reads_state(&self) -> bool {
        false
    }
}
