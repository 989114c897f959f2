//! [`Named`]: an effect with a name for messages.

use super::Effect;
use crate::numbers::scalar::{Cotangent, Float, Real, Scalar};

/// Effect with a name for messages, such as its key in a scene. Results are those of the effect
/// alone, bit for bit.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Named<E> {
    /// Name in messages.
    pub name: &'static str,
    /// Effect that is named.
    pub effect: E,
}

impl<B, E: Effect<B>> Effect<B> for Named<E> {
    const LOCAL: bool = E::LOCAL;

    #[inline(always)]
    fn act<T: Scalar>(&self, body: &B, x: &[T], forces: &mut [T]) {
        self.effect.act(body, x, forces);
    }

    #[inline(always)]
    fn vjp<R: Real, C: Cotangent<R>>(&self, body: &B, x: &[R], forces_bar: &[C], x_bar: &mut [C]) {
        self.effect.vjp(body, x, forces_bar, x_bar);
    }

    #[inline(always)]
    fn act_knowing<T: Scalar>(&self, body: &B, x: &[T], known: &[T], forces: &mut [T]) {
        self.effect.act_knowing(body, x, known, forces);
    }

    #[inline(always)]
    fn vjp_knowing<R: Real, C: Cotangent<R>>(&self, body: &B, x: &[R], known: &[R], forces_bar: &[C], x_bar: &mut [C]) {
        self.effect.vjp_knowing(body, x, known, forces_bar, x_bar);
    }

    #[inline(always)]
    fn act_at<T: Scalar>(&self, body: &B, x: &[T], i: usize, force: T) -> T {
        self.effect.act_at(body, x, i, force)
    }

    #[inline(always)]
    fn vjp_at<R: Real, C: Cotangent<R>>(&self, body: &B, x: &[R], i: usize, force_bar: C, x_bar: &mut [C]) {
        self.effect.vjp_at(body, x, i, force_bar, x_bar);
    }

    #[inline(always)]
    fn reads_state(&self) -> bool {
        self.effect.reads_state()
    }

    fn faulty<F: Float>(&self, body: &B, x: &[F], forces: usize) -> Option<&'static str> {
        self.effect.faulty(body, x, forces).map(|_| self.name)
    }

    #[inline(always)]
    fn clock(&self) -> Option<f64> {
        self.effect.clock()
    }
}
