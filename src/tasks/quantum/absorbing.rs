//! [`Absorbing`]: a box whose edges absorb the wave.

use super::QuantumSystem;
use super::system::Wave;
use crate::dynamics::cause::Cause;
use crate::dynamics::effect::HasModel;
use crate::dynamics::forward::{forward, forward_model};
use crate::dynamics::inputs::{Cotangents, Inputs};
use crate::dynamics::system::System;
use crate::numbers::scalar::{Cotangent, Real, Scalar};
use serde::{Deserialize, Serialize};
use smallvec::SmallVec;

/// Layers along both walls in which the wave decays, as in an open box. With the distance d to the
/// nearer wall:
///
/// ```text
/// W = strength ((width - d) / width)²   within width of a wall, 0 elsewhere
/// ψ_j ← exp(-dt W(x_j)) ψ_j            after the step
/// ```
///
/// The layers amount to a potential `V - i W`, applied after each step by operator splitting of
/// first order in dt. Probability is lost at the rate `2 W |ψ|²`. Waves much shorter than `width`
/// are absorbed, much longer ones reflected.
///
/// Source: Kosloff and Kosloff 1986 (doi:10.1016/0021-9991(86)90199-3).
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(deny_unknown_fields, default)]
pub struct AbsorbingEdges {
    /// Width of the layer along each wall, length, positive.
    pub width: f64,
    /// W at the walls, energy, not negative. In the default box during 8 units of time, the
    /// defaults absorb 19 % of the ground state and 82 % of the third eigenstate.
    pub strength: f64,
}

impl Default for AbsorbingEdges {
    fn default() -> Self {
        Self { width: 0.2, strength: 10.0 }
    }
}

/// Adds absorbing edges to a system that contains a [`QuantumSystem`].
///
/// The edges act once per step of `system`, for the time step of the [`QuantumSystem`]. Place them
/// inside [`Substeps`](crate::Substeps), not around it.
#[derive(Clone, Debug, PartialEq)]
pub struct Absorbing<S = QuantumSystem> {
    system: S,
    /// Index from 0 of each grid point within the edges, and the factor of the wave there per step.
    factors: Vec<(usize, f64)>,
}

impl<S: HasModel<QuantumSystem>> Absorbing<S> {
    /// Adds absorbing edges to a system. Grid points outside the edges are unaffected.
    pub fn new(system: S, edges: AbsorbingEdges) -> Self {
        let (model, AbsorbingEdges { width, strength }) = (system.model(), edges);
        let factor = |(j, xi): (usize, f64)| {
            let depth = width - (0.5 * model.length - xi.abs());
            let share = depth / width;
            (depth > 0.0).then(|| (j, (-model.dt * strength * share * share).exp()))
        };
        let factors = model.centered_points().enumerate().filter_map(factor).collect();
        Self { system, factors }
    }

    /// Returns the system that steps before the edges act.
    pub fn system(&self) -> &S {
        &self.system
    }

    /// Multiplies the wave at points within the edges by their factors.
    #[inline(always)]
    fn damp<T: Scalar, V: Copy + std::ops::Mul<T, Output = V>>(&self, psi: &mut [V]) {
        for &(j, factor) in &self.factors {
            let (psi, factor) = (&mut psi[2 * j..2 * j + 2], T::from(factor));
            (psi[0], psi[1]) = (psi[0] * factor, psi[1] * factor);
        }
    }
}

impl<S: HasModel<QuantumSystem>> System for Absorbing<S> {
    forward!(System of system: state_dim, control_dim, param_dim, varied);

    #[inline(always)]
    fn step<T: Scalar>(&self, inputs: Inputs<'_, T>, next: &mut [T]) {
        self.system.step(inputs, next);
        self.damp::<T, T>(next);
    }

    #[inline(always)]
    fn vjp<R: Real, C: Cotangent<R>>(
        &self,
        inputs: Inputs<'_, R>,
        next_bar: &[C],
        cotangents: Cotangents<'_, C>,
    ) {
        let mut bar: Wave<C> = SmallVec::from_slice(next_bar);
        self.damp::<R, C>(&mut bar);
        self.system.vjp(inputs, &bar, cotangents);
    }

    fn diagnose<R: Real>(&self, inputs: Inputs<'_, R>) -> Option<Cause> {
        self.system.diagnose(inputs)
    }
}

impl<S: HasModel<QuantumSystem>> HasModel<QuantumSystem> for Absorbing<S> {
    forward_model!(system, QuantumSystem);
}
