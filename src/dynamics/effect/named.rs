//! [`Named`]: an effect with a name for messages.

use super::Effect;
use crate::dynamics::inputs::{Cotangents, OdeInputs};
use crate::dynamics::number::{Numbers, Varied};
use crate::numbers::rng::Rng;
use crate::numbers::scalar::{Cotangent, Real, Scalar};

/// Effect with a name for messages, such as its key in a scene. Results are bitwise equal to those
/// of the unnamed effect. In [`Varied`], the name of a number follows the name of the effect:
/// `wind.speed`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Named<E> {
    /// Name in messages, and prefix of the names in [`Varied`].
    pub name: &'static str,
    /// Named effect.
    pub effect: E,
}

impl<B, E: Effect<B>> Effect<B> for Named<E> {
    #[inline(always)]
    fn param_dim(&self) -> usize {
        self.effect.param_dim()
    }

    #[inline(always)]
    fn numbers(&self) -> Numbers<'_> {
        self.effect.numbers()
    }

    fn varied(&self, first: usize) -> Vec<Varied> {
        let named =
            |varied: Varied| Varied { name: format!("{}.{}", self.name, varied.name), ..varied };
        self.effect.varied(first).into_iter().map(named).collect()
    }

    fn draw_params(&self, rng: &mut Rng, p: &mut [f64]) {
        self.effect.draw_params(rng, p);
    }

    #[inline(always)]
    fn add_forces<T: Scalar>(&self, model: &B, inputs: OdeInputs<'_, T>, forces: &mut [T]) {
        self.effect.add_forces(model, inputs, forces);
    }

    #[inline(always)]
    fn vjp<R: Real, C: Cotangent<R>>(
        &self,
        model: &B,
        inputs: OdeInputs<'_, R>,
        forces_bar: &[C],
        cotangents: Cotangents<'_, C>,
    ) {
        self.effect.vjp(model, inputs, forces_bar, cotangents);
    }

    #[inline(always)]
    fn state_dependent(&self) -> bool {
        self.effect.state_dependent()
    }

    fn diagnose<R: Real>(
        &self,
        model: &B,
        inputs: OdeInputs<'_, R>,
        forces: usize,
    ) -> Option<&'static str> {
        self.effect.diagnose(model, inputs, forces).map(|_| self.name)
    }
}
