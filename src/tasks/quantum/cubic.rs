//! Many particles in one wave.

use super::QuantumSystem;
use crate::effect::Effect;
use crate::scalar::{Cotangent, Real, Scalar};
use serde::{Deserialize, Serialize};

/// What particles of one wave, a Bose-Einstein condensate, do to each other: `V_j = strength |ψ_j|² / dx`.
///
/// The equation of Gross 1961 (doi:10.1007/BF02731494) and Pitaevskii 1961 (Sov. Phys. JETP 13, 451),
/// `i ∂ψ/∂t = -∂²ψ/∂x² + V ψ + strength |ψ|² ψ`. Its ψ has `∫ |ψ|² dx = 1`; a state has `Σ_j |ψ_j|² = 1`, so that
/// `|ψ_j|² / dx` is the density of probability.
///
/// The density is that of the state in which the step begins: the step stays unitary and one solve, and is of the first
/// order in dt. By [`Strang`](super::Strang), each half step has its own density, and the step is of the second order.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(deny_unknown_fields, default)]
pub struct Cubic {
    /// Energy times length; positive repels, negative attracts.
    pub strength: f64,
}

impl Default for Cubic {
    fn default() -> Self {
        Self { strength: 5.0 }
    }
}

impl Effect<QuantumSystem> for Cubic {
    const LOCAL: bool = true;

    #[inline(always)]
    fn act<T: Scalar>(&self, body: &QuantumSystem, x: &[T], potential: &mut [T]) {
        for (j, v) in potential.iter_mut().enumerate() {
            *v = self.act_at(body, x, j, *v);
        }
    }

    #[inline(always)]
    fn act_at<T: Scalar>(&self, body: &QuantumSystem, x: &[T], j: usize, v: T) -> T {
        let strength = T::lift(self.strength * (1.0 / body.spacing()));
        let [re, im] = x.as_chunks::<2>().0[j];
        v + strength * (re * re + im * im)
    }

    #[inline(always)]
    fn vjp<R: Real, C: Cotangent<R>>(&self, body: &QuantumSystem, x: &[R], potential_bar: &[C], x_bar: &mut [C]) {
        let (x, x_bar) = (&x[..2 * potential_bar.len()], &mut x_bar[..2 * potential_bar.len()]);
        for (j, &v_bar) in potential_bar.iter().enumerate() {
            self.vjp_at(body, x, j, v_bar, x_bar);
        }
    }

    #[inline(always)]
    fn vjp_at<R: Real, C: Cotangent<R>>(&self, body: &QuantumSystem, x: &[R], j: usize, v_bar: C, x_bar: &mut [C]) {
        let v_bar = v_bar * R::lift(2.0 * self.strength * (1.0 / body.spacing()));
        let ([re, im], [re_bar, im_bar]) = (x.as_chunks::<2>().0[j], &mut x_bar.as_chunks_mut::<2>().0[j]);
        *re_bar += v_bar * re;
        *im_bar += v_bar * im;
    }
}
