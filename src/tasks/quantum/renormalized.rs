//! [`Renormalized`]: a system whose wave has norm 1 after each step.

use super::QuantumSystem;
use super::system::Wave;
use crate::dynamics::cause::Cause;
use crate::dynamics::effect::HasModel;
use crate::dynamics::system::System;
use crate::numbers::rng::Rng;
use crate::numbers::scalar::{Cotangent, Float, Real, Scalar};
use smallvec::smallvec;

/// System around a [`QuantumSystem`] that normalizes the wave after each step: `ψ ← ψ / |ψ|`.
///
/// Steps of every [`QuantumScheme`](super::QuantumScheme) are unitary except for rounding. Rounding
/// errors accumulate where every step rounds alike, as in long rollouts without control in single
/// precision. Around [`Substeps`](crate::Substeps) of `system`, the normalization acts once per
/// outer step.
///
/// The reverse step projects the component along ψ' out of the cotangent, because the norm is
/// constant:
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
    fn reverse<R: Real, C: Cotangent<R>>(&self, x: &[R], u: &[R], next_bar: &[C]) -> Wave<C> {
        let n = self.wave();
        let mut y: Wave<R> = smallvec![R::zero(); x.len()];
        self.system.step(x, u, &mut y);
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
    fn state_dim(&self) -> usize {
        self.system.state_dim()
    }

    fn control_dim(&self) -> usize {
        self.system.control_dim()
    }

    #[inline(always)]
    fn step<T: Scalar>(&self, x: &[T], u: &[T], next: &mut [T]) {
        self.system.step(x, u, next);
        let psi = &mut next[..self.wave()];
        let per_norm = per_norm(psi);
        for psi in psi {
            *psi *= per_norm;
        }
    }

    fn diagnose<F: Float>(&self, x: &[F], u: &[F]) -> Option<Cause> {
        self.system.diagnose(x, u)
    }

    #[inline(always)]
    fn vjp<R: Real, C: Cotangent<R>>(&self, x: &[R], u: &[R], next_bar: &[C], x_bar: &mut [C], u_bar: &mut [C]) {
        self.system.vjp(x, u, &self.reverse(x, u, next_bar), x_bar, u_bar);
    }

    #[inline(always)]
    fn vjp_state<R: Real, C: Cotangent<R>>(&self, x: &[R], u: &[R], next_bar: &[C], x_bar: &mut [C]) {
        self.system.vjp_state(x, u, &self.reverse(x, u, next_bar), x_bar);
    }

    #[inline(always)]
    fn vjp_control<R: Real, C: Cotangent<R>>(&self, x: &[R], u: &[R], next_bar: &[C], u_bar: &mut [C]) {
        self.system.vjp_control(x, u, &self.reverse(x, u, next_bar), u_bar);
    }
}

impl<S: HasModel<QuantumSystem>> HasModel<QuantumSystem> for Renormalized<S> {
    #[inline(always)]
    fn model(&self) -> &QuantumSystem {
        self.system.model()
    }

    fn start_extra(&self, rng: &mut Rng, x: &mut [f64]) {
        self.system.start_extra(rng, x);
    }
}
