//! [`Renormalized`]: a system whose wave has norm 1 after each step.

use super::QuantumSystem;
use super::system::Wave;
use crate::dynamics::cause::Cause;
use crate::dynamics::effect::HasModel;
use crate::dynamics::forward::{forward, forward_model};
use crate::dynamics::inputs::{Cotangents, Inputs};
use crate::dynamics::system::System;
use crate::numbers::scalar::{Cotangent, Real, Scalar};
use smallvec::smallvec;

/// After each step, normalizes the wave of a system that contains a [`QuantumSystem`]:
/// `ψ ← ψ / |ψ|`.
///
/// Steps of every [`QuantumScheme`](super::QuantumScheme) are unitary except for rounding. Rounding
/// errors accumulate if every step rounds alike, as in long rollouts without control in single
/// precision. For a `system` of [`Substeps`](crate::Substeps), the normalization acts once per
/// outer step.
///
/// The reverse step projects the component along ψ' out of the cotangent, because the norm is
/// constant. With the wave y before the normalization:
///
/// ```text
/// ψ' = y / |y|,   ȳ = (ψ̄' - ψ' ⟨ψ', ψ̄'⟩) / |y|
/// ```
///
/// A wave that is 0 everywhere becomes NaN.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Renormalized<S = QuantumSystem> {
    /// System that steps before the normalization.
    pub system: S,
}

/// Returns `1 / |ψ|`.
#[inline(always)]
fn per_norm<T: Scalar>(psi: &[T]) -> T {
    let mut square = T::zero();
    for &psi in psi {
        square += psi * psi;
    }
    T::one() / square.sqrt()
}

impl<S: HasModel<QuantumSystem>> Renormalized<S> {
    /// Returns the number of state components of the wave.
    fn wave(&self) -> usize {
        2 * self.system.model().grid
    }

    /// Returns the cotangent before the normalization.
    #[inline(always)]
    fn reverse<R: Real, C: Cotangent<R>>(&self, inputs: Inputs<'_, R>, next_bar: &[C]) -> Wave<C> {
        let n = self.wave();
        let mut y: Wave<R> = smallvec![R::zero(); inputs.x.len()];
        self.system.step(inputs, &mut y);
        let per_norm = per_norm(&y[..n]);
        let mut along = C::null();
        for i in 0..n {
            y[i] *= per_norm;
            along += next_bar[i] * y[i];
        }
        let mut bar: Wave<C> = Wave::from_slice(next_bar);
        for i in 0..n {
            bar[i] = (next_bar[i] - along * y[i]) * per_norm;
        }
        bar
    }
}

impl<S: HasModel<QuantumSystem>> System for Renormalized<S> {
    forward!(System of system: state_dim, control_dim, param_dim, varied);

    #[inline(always)]
    fn step<T: Scalar>(&self, inputs: Inputs<'_, T>, next: &mut [T]) {
        self.system.step(inputs, next);
        let psi = &mut next[..self.wave()];
        let per_norm = per_norm(psi);
        for psi in psi {
            *psi *= per_norm;
        }
    }

    #[inline(always)]
    fn vjp<R: Real, C: Cotangent<R>>(
        &self,
        inputs: Inputs<'_, R>,
        next_bar: &[C],
        cotangents: Cotangents<'_, C>,
    ) {
        self.system.vjp(inputs, &self.reverse(inputs, next_bar), cotangents);
    }

    fn diagnose<R: Real>(&self, inputs: Inputs<'_, R>) -> Option<Cause> {
        self.system.diagnose(inputs)
    }
}

impl<S: HasModel<QuantumSystem>> HasModel<QuantumSystem> for Renormalized<S> {
    forward_model!(system, QuantumSystem);
}
