//! [`Named`]: an effect with a name for messages.

use super::Effect;
use crate::numbers::scalar::{Cotangent, Float, Real, Scalar};

/// Effect with a name for messages, such as its key in a scene. Results are bitwise equal to
/// those of the unnamed effect.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Named<E> {
    /// Name in messages.
    pub name: &'static str,
    /// Named effect.
    pub effect: E,
}

impl<B, E: Effect<B>> Effect<B> for Named<E> {
    #[inline(always)]
    fn add_forces<T: Scalar>(&self, model: &B, x: &[T], forces: &mut [T]) {
        self.effect.add_forces(model, x, forces);
    }

    #[inline(always)]
    fn vjp<R: Real, C: Cotangent<R>>(&self, model: &B, x: &[R], forces_bar: &[C], x_bar: &mut [C]) {
        self.effect.vjp(model, x, forces_bar, x_bar);
    }

    #[inline(always)]
    fn state_dependent(&self) -> bool {
        self.effect.state_dependent()
    }

    fn diagnose<F: Float>(&self, model: &B, x: &[F], forces: usize) -> Option<&'static str> {
        self.effect.diagnose(model, x, forces).map(|_| self.name)
    }

    #[inline(always)]
    fn clock(&self) -> Option<f64> {
        self.effect.clock()
    }
}
