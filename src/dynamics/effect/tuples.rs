//! Effects known at compile time: none, or several in order.

use super::Effect;
use crate::numbers::scalar::{Cotangent, Float, Real, Scalar};

/// No effect.
impl<B> Effect<B> for () {
    #[inline(always)]
    fn add_forces<T: Scalar>(&self, _model: &B, _x: &[T], _forces: &mut [T]) {}
    #[inline(always)]
    fn vjp<R: Real, C: Cotangent<R>>(&self, _model: &B, _x: &[R], _forces_bar: &[C], _x_bar: &mut [C]) {}
    #[inline(always)]
    fn state_dependent(&self) -> bool {
        false
    }
    fn diagnose<F: Float>(&self, _model: &B, _x: &[F], _forces: usize) -> Option<&'static str> {
        None
    }
}

/// Returns the later of two latest start times, if any.
#[inline(always)]
pub(super) fn later(a: Option<f64>, b: Option<f64>) -> Option<f64> {
    match (a, b) {
        (Some(a), Some(b)) => Some(a.max(b)),
        (a, b) => a.or(b),
    }
}

macro_rules! both {
    ($($effect:ident $i:tt),+) => {
        /// Applies all effects in order.
        impl<B, $($effect: Effect<B>),+> Effect<B> for ($($effect,)+) {
            #[inline(always)]
            fn add_forces<T: Scalar>(&self, model: &B, x: &[T], forces: &mut [T]) {
                $(self.$i.add_forces(model, x, forces);)+
            }
            #[inline(always)]
            fn vjp<R: Real, C: Cotangent<R>>(&self, model: &B, x: &[R], forces_bar: &[C], x_bar: &mut [C]) {
                $(self.$i.vjp(model, x, forces_bar, x_bar);)+
            }
            #[inline(always)]
            fn state_dependent(&self) -> bool {
                false $(|| self.$i.state_dependent())+
            }
            fn diagnose<F: Float>(&self, model: &B, x: &[F], forces: usize) -> Option<&'static str> {
                None$(.or_else(|| self.$i.diagnose(model, x, forces)))+
            }
            #[inline(always)]
            fn clock(&self) -> Option<f64> {
                let clock = None;
                $(let clock = later(clock, self.$i.clock());)+
                clock
            }
        }
    };
}
both!(E0 0);
both!(E0 0, E1 1);
both!(E0 0, E1 1, E2 2);
both!(E0 0, E1 1, E2 2, E3 3);
both!(E0 0, E1 1, E2 2, E3 3, E4 4);
both!(E0 0, E1 1, E2 2, E3 3, E4 4, E5 5);
