//! Lists of effects chosen at run time.

use super::Effect;
use super::tuples::later;
use crate::dynamics::outline::outline;
use crate::numbers::kernels::Vectorized;
use crate::numbers::scalar::{Cotangent, Float, Real, Scalar};

/// Applies all effects in order, for combinations unknown at compile time. Results equal those of a
/// tuple of the same effects, bit for bit.
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
    fn act_knowing<T: Scalar>(&self, model: &B, x: &[T], known: &[T], forces: &mut [T]) {
        for effect in self {
            effect.act_knowing(model, x, known, forces);
        }
    }

    #[inline(always)]
    fn vjp_knowing<R: Real, C: Cotangent<R>>(&self, model: &B, x: &[R], known: &[R], forces_bar: &[C], x_bar: &mut [C]) {
        for effect in self {
            effect.vjp_knowing(model, x, known, forces_bar, x_bar);
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

/// One effect at one state, compiled apart from the system: a list of many effects is in every loop of every system that
/// takes one, and with all of them inlined such a loop takes minutes to compile.
pub(crate) struct Act<'a, B, E, T, const KNOWING: bool> {
    pub effect: &'a E,
    pub model: &'a B,
    pub x: &'a [T],
    pub known: &'a [T],
    pub forces: &'a mut [T],
}

impl<B, E: Effect<B>, T: Scalar, const KNOWING: bool> Act<'_, B, E, T, KNOWING> {
    #[inline(always)]
    pub(crate) fn outline(self) {
        outline::<T>(self);
    }
}

impl<B, E: Effect<B>, T: Scalar, const KNOWING: bool> Vectorized for Act<'_, B, E, T, KNOWING> {
    #[inline(always)]
    fn run<const FMA: bool>(self) {
        let Self { effect, model, x, known, forces } = self;
        if KNOWING {
            effect.act_knowing(model, x, known, forces);
        } else {
            effect.add_forces(model, x, forces);
        }
    }
}

/// The reverse of [`Act`].
pub(crate) struct ActBack<'a, B, E, R, C, const KNOWING: bool> {
    pub effect: &'a E,
    pub model: &'a B,
    pub x: &'a [R],
    pub known: &'a [R],
    pub forces_bar: &'a [C],
    pub x_bar: &'a mut [C],
}

impl<B, E: Effect<B>, R: Real, C: Cotangent<R>, const KNOWING: bool> ActBack<'_, B, E, R, C, KNOWING> {
    #[inline(always)]
    pub(crate) fn outline(self) {
        outline::<R>(self);
    }
}

impl<B, E: Effect<B>, R: Real, C: Cotangent<R>, const KNOWING: bool> Vectorized for ActBack<'_, B, E, R, C, KNOWING> {
    #[inline(always)]
    fn run<const FMA: bool>(self) {
        let Self { effect, model, x, known, forces_bar, x_bar } = self;
        if KNOWING {
            effect.vjp_knowing(model, x, known, forces_bar, x_bar);
        } else {
            effect.vjp(model, x, forces_bar, x_bar);
        }
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
                    $(Self::$effect(effect) => crate::dynamics::effect::Act::<_, _, _, false> { effect, model, x, known: &[], forces }.outline()),+
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
                    $(Self::$effect(effect) => crate::dynamics::effect::ActBack::<_, _, _, _, false> { effect, model, x, known: &[], forces_bar, x_bar }.outline()),+
                }
            }

            #[inline(always)]
            fn act_knowing<T: crate::numbers::scalar::Scalar>(&self, model: &$model, x: &[T], known: &[T], forces: &mut [T]) {
                match self {
                    $(Self::$effect(effect) => crate::dynamics::effect::Act::<_, _, _, true> { effect, model, x, known, forces }.outline()),+
                }
            }

            #[inline(always)]
            fn vjp_knowing<R: crate::numbers::scalar::Real, C: crate::numbers::scalar::Cotangent<R>>(
                &self,
                model: &$model,
                x: &[R],
                known: &[R],
                forces_bar: &[C],
                x_bar: &mut [C],
            ) {
                match self {
                    $(Self::$effect(effect) => crate::dynamics::effect::ActBack::<_, _, _, _, true> { effect, model, x, known, forces_bar, x_bar }.outline()),+
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
