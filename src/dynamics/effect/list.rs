//! Lists of effects chosen at run time.

use super::Effect;
use super::tuples::later;
use crate::numbers::kernels::Vectorized;
use crate::numbers::scalar::{Cotangent, Float, Real, Scalar};

/// Applies all effects in order, for combinations unknown at compile time. Results are bitwise
/// equal to those of a tuple.
impl<B, E: Effect<B>> Effect<B> for Vec<E> {
    #[inline(always)]
    fn add_forces<T: Scalar>(&self, model: &B, x: &[T], forces: &mut [T]) {
        for effect in self {
            effect.add_forces(model, x, forces);
        }
    }

    #[inline(always)]
    fn vjp<R: Real, C: Cotangent<R>>(&self, model: &B, x: &[R], forces_bar: &[C], x_bar: &mut [C]) {
        for effect in self {
            effect.vjp(model, x, forces_bar, x_bar);
        }
    }

    #[inline(always)]
    fn state_dependent(&self) -> bool {
        self.iter().any(Effect::state_dependent)
    }

    fn diagnose<F: Float>(&self, model: &B, x: &[F], forces: usize) -> Option<&'static str> {
        self.iter().find_map(|effect| effect.diagnose(model, x, forces))
    }

    #[inline(always)]
    fn clock(&self) -> Option<f64> {
        self.iter().fold(None, |clock, effect| later(clock, effect.clock()))
    }
}

/// Outlined [`Effect::add_forces`]. Inlining every effect of a list into every loop slows
/// compilation.
pub(crate) struct AddForces<'a, B, E, T> {
    pub effect: &'a E,
    pub model: &'a B,
    pub x: &'a [T],
    pub forces: &'a mut [T],
}

impl<B, E: Effect<B>, T: Scalar> Vectorized for AddForces<'_, B, E, T> {
    #[inline(always)]
    fn run<const FMA: bool>(self) {
        self.effect.add_forces(self.model, self.x, self.forces);
    }
}

/// Outlined [`Effect::vjp`].
pub(crate) struct Vjp<'a, B, E, R, C> {
    pub effect: &'a E,
    pub model: &'a B,
    pub x: &'a [R],
    pub forces_bar: &'a [C],
    pub x_bar: &'a mut [C],
}

impl<B, E: Effect<B>, R: Real, C: Cotangent<R>> Vectorized for Vjp<'_, B, E, R, C> {
    #[inline(always)]
    fn run<const FMA: bool>(self) {
        self.effect.vjp(self.model, self.x, self.forces_bar, self.x_bar);
    }
}

/// Defines an enum with one variant per effect of a model, each named like its effect.
macro_rules! any_effect {
    ($(#[$doc:meta])* $name:ident of $model:ty: $($effect:ident),+ $(,)?) => {
        $(#[$doc])*
        #[derive(Clone, Debug, PartialEq)]
        pub enum $name {
            $(#[doc = concat!("[`", stringify!($effect), "`].")] $effect($effect)),+
        }

        impl crate::dynamics::effect::Effect<$model> for $name {
            #[inline(always)]
            fn add_forces<T: crate::numbers::scalar::Scalar>(&self, model: &$model, x: &[T], forces: &mut [T]) {
                match self {
                    $(Self::$effect(effect) => crate::dynamics::outline::outline::<T>(crate::dynamics::effect::AddForces { effect, model, x, forces })),+
                }
            }

            #[inline(always)]
            fn vjp<R: crate::numbers::scalar::Real, C: crate::numbers::scalar::Cotangent<R>>(
                &self,
                model: &$model,
                x: &[R],
                forces_bar: &[C],
                x_bar: &mut [C],
            ) {
                match self {
                    $(Self::$effect(effect) => crate::dynamics::outline::outline::<R>(crate::dynamics::effect::Vjp { effect, model, x, forces_bar, x_bar })),+
                }
            }

            #[inline(always)]
            fn state_dependent(&self) -> bool {
                match self {
                    $(Self::$effect(effect) => crate::dynamics::effect::Effect::<$model>::state_dependent(effect)),+
                }
            }

            fn diagnose<F: crate::numbers::scalar::Float>(&self, model: &$model, x: &[F], forces: usize) -> Option<&'static str> {
                let name = match self {
                    $(Self::$effect(_) => stringify!($effect)),+
                };
                if crate::dynamics::effect::is_finite(self, model, x, forces) { None } else { Some(name) }
            }

            #[inline(always)]
            fn clock(&self) -> Option<f64> {
                match self {
                    $(Self::$effect(effect) => crate::dynamics::effect::Effect::<$model>::clock(effect)),+
                }
            }
        }

        $(impl From<$effect> for $name {
            fn from(effect: $effect) -> Self {
                Self::$effect(effect)
            }
        })+
    };
}
pub(crate) use any_effect;
