//! Effects known at compile time: none, or several in order.

use super::Effect;
use crate::numbers::scalar::{Cotangent, Float, Real, Scalar};

/// No effect.
impl<B> Effect<B> for () {
    const LOCAL: bool = true;
    #[inline(always)]
    fn add_forces<T: Scalar>(&self, _model: &B, _x: &[T], _forces: &mut [T]) {}
    #[inline(always)]
    fn act_at<T: Scalar>(&self, _model: &B, _x: &[T], _i: usize, force: T) -> T {
        force
    }
    #[inline(always)]
    fn vjp<R: Real, C: Cotangent<R>>(&self, _model: &B, _x: &[R], _forces_bar: &[C], _x_bar: &mut [C]) {}
    #[inline(always)]
    fn vjp_at<R: Real, C: Cotangent<R>>(&self, _model: &B, _x: &[R], _i: usize, _force_bar: C, _x_bar: &mut [C]) {}
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
            const LOCAL: bool = true $(&& $effect::LOCAL)+;
            #[inline(always)]
            fn add_forces<T: Scalar>(&self, model: &B, x: &[T], forces: &mut [T]) {
                $(self.$i.add_forces(model, x, forces);)+
            }
            #[inline(always)]
            fn act_at<T: Scalar>(&self, model: &B, x: &[T], i: usize, force: T) -> T {
                $(let force = self.$i.act_at(model, x, i, force);)+
                force
            }
            #[inline(always)]
            fn vjp<R: Real, C: Cotangent<R>>(&self, model: &B, x: &[R], forces_bar: &[C], x_bar: &mut [C]) {
                $(self.$i.vjp(model, x, forces_bar, x_bar);)+
            }
            #[inline(always)]
            fn vjp_at<R: Real, C: Cotangent<R>>(&self, model: &B, x: &[R], i: usize, force_bar: C, x_bar: &mut [C]) {
                $(self.$i.vjp_at(model, x, i, force_bar, x_bar);)+
            }
            #[inline(always)]
            fn act_knowing<T: Scalar>(&self, model: &B, x: &[T], known: &[T], forces: &mut [T]) {
                $(self.$i.act_knowing(model, x, known, forces);)+
            }
            #[inline(always)]
            fn vjp_knowing<R: Real, C: Cotangent<R>>(
                &self,
                model: &B,
                x: &[R],
                known: &[R],
                forces_bar: &[C],
                x_bar: &mut [C],
            ) {
                $(self.$i.vjp_knowing(model, x, known, forces_bar, x_bar);)+
            }
            #[inline(always)]
            fn act_first_at<T: Scalar>(&self, model: &B, x: &[T], i: usize, force: T) -> T {
                let first = true;
                $(let first = first && $effect::LOCAL;
                let force = if first { self.$i.act_at(model, x, i, force) } else { force };)+
                let _ = first;
                force
            }
            #[inline(always)]
            fn act_rest<T: Scalar>(&self, model: &B, x: &[T], known: &[T], forces: &mut [T]) {
                let first = true;
                $(let first = first && $effect::LOCAL;
                if !first {
                    self.$i.act_knowing(model, x, known, forces);
                })+
            }
            #[inline(always)]
            fn vjp_first_at<R: Real, C: Cotangent<R>>(&self, model: &B, x: &[R], i: usize, force_bar: C, x_bar: &mut [C]) {
                let first = true;
                $(let first = first && $effect::LOCAL;
                if first {
                    self.$i.vjp_at(model, x, i, force_bar, x_bar);
                })+
            }
            #[inline(always)]
            fn vjp_rest<R: Real, C: Cotangent<R>>(&self, model: &B, x: &[R], known: &[R], forces_bar: &[C], x_bar: &mut [C]) {
                let first = true;
                $(let first = first && $effect::LOCAL;
                if !first {
                    self.$i.vjp_knowing(model, x, known, forces_bar, x_bar);
                })+
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
