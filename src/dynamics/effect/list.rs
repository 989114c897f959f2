//! Lists of effects chosen at run time.

use super::Effect;
use crate::dynamics::inputs::{Cotangents, OdeInputs};
use crate::dynamics::number::Varied;
use crate::numbers::kernels::Vectorized;
use crate::numbers::rng::Rng;
use crate::numbers::scalar::{Cotangent, Real, Scalar};

/// Applies all effects in order, for combinations unknown at compile time. Results are bitwise
/// equal to those of a tuple.
impl<B, E: Effect<B>> Effect<B> for Vec<E> {
    fn param_dim(&self) -> usize {
        self.iter().map(Effect::param_dim).sum()
    }

    fn varied(&self, mut first: usize) -> Vec<Varied> {
        let mut all = Vec::new();
        for effect in self {
            all.extend(effect.varied(first));
            first += effect.param_dim();
        }
        all
    }

    fn draw_params(&self, rng: &mut Rng, mut p: &mut [f64]) {
        for effect in self {
            let (own, rest) = p.split_at_mut(effect.param_dim());
            effect.draw_params(rng, own);
            p = rest;
        }
    }

    #[inline(always)]
    fn add_forces<T: Scalar>(&self, model: &B, mut inputs: OdeInputs<'_, T>, forces: &mut [T]) {
        for effect in self {
            effect.add_forces(model, inputs, forces);
            inputs = inputs.skip_params(effect.param_dim());
        }
    }

    #[inline(always)]
    fn vjp<R: Real, C: Cotangent<R>>(
        &self,
        model: &B,
        mut inputs: OdeInputs<'_, R>,
        forces_bar: &[C],
        mut cotangents: Cotangents<'_, C>,
    ) {
        for effect in self {
            effect.vjp(model, inputs, forces_bar, cotangents.reborrow());
            inputs = inputs.skip_params(effect.param_dim());
            cotangents = cotangents.skip_params(effect.param_dim());
        }
    }

    #[inline(always)]
    fn state_dependent(&self) -> bool {
        self.iter().any(Effect::state_dependent)
    }

    fn diagnose<R: Real>(
        &self,
        model: &B,
        mut inputs: OdeInputs<'_, R>,
        forces: usize,
    ) -> Option<&'static str> {
        self.iter().find_map(|effect| {
            let name = effect.diagnose(model, inputs, forces);
            inputs = inputs.skip_params(effect.param_dim());
            name
        })
    }
}

/// Arguments of an outlined call of [`Effect::add_forces`]. Inlining every effect of a list into
/// every loop over samples would slow compilation.
pub(crate) struct AddForces<'a, B, E, T> {
    pub effect: &'a E,
    pub model: &'a B,
    pub inputs: OdeInputs<'a, T>,
    pub forces: &'a mut [T],
}

impl<B, E: Effect<B>, T: Scalar> Vectorized for AddForces<'_, B, E, T> {
    #[inline(always)]
    fn run<const FMA: bool>(self) {
        self.effect.add_forces(self.model, self.inputs, self.forces);
    }
}

/// Arguments of an outlined call of [`Effect::vjp`].
pub(crate) struct Vjp<'a, B, E, R, C> {
    pub effect: &'a E,
    pub model: &'a B,
    pub inputs: OdeInputs<'a, R>,
    pub forces_bar: &'a [C],
    pub cotangents: Cotangents<'a, C>,
}

impl<B, E: Effect<B>, R: Real, C: Cotangent<R>> Vectorized for Vjp<'_, B, E, R, C> {
    #[inline(always)]
    fn run<const FMA: bool>(self) {
        self.effect.vjp(self.model, self.inputs, self.forces_bar, self.cotangents);
    }
}

/// Defines an enum of the effects of a model: one variant per effect, named like the effect, and
/// `Other` for effects of the user.
macro_rules! any_effect {
    ($(#[$doc:meta])* $name:ident of $model:ty: $($effect:ident),+ $(,)?) => {
        $(#[$doc])*
        #[derive(Clone, Debug, PartialEq)]
        pub enum $name {
            $(#[doc = concat!("[`", stringify!($effect), "`].")] $effect($effect),)+
            /// An effect of the user.
            Other(crate::dynamics::effect::DynEffect<$model>),
        }

        impl crate::dynamics::effect::Effect<$model> for $name {
            #[inline(always)]
            fn param_dim(&self) -> usize {
                match self {
                    $(Self::$effect(effect) => crate::dynamics::effect::Effect::<$model>::param_dim(effect),)+
                    Self::Other(effect) => crate::dynamics::effect::Effect::<$model>::param_dim(effect),
                }
            }

            fn varied(&self, first: usize) -> Vec<crate::dynamics::number::Varied> {
                match self {
                    $(Self::$effect(effect) => crate::dynamics::effect::Effect::<$model>::varied(effect, first),)+
                    Self::Other(effect) => crate::dynamics::effect::Effect::<$model>::varied(effect, first),
                }
            }

            fn draw_params(&self, rng: &mut crate::numbers::rng::Rng, p: &mut [f64]) {
                match self {
                    $(Self::$effect(effect) => crate::dynamics::effect::Effect::<$model>::draw_params(effect, rng, p),)+
                    Self::Other(effect) => crate::dynamics::effect::Effect::<$model>::draw_params(effect, rng, p),
                }
            }

            #[inline(always)]
            fn add_forces<T: crate::numbers::scalar::Scalar>(&self, model: &$model, inputs: crate::dynamics::inputs::OdeInputs<'_, T>, forces: &mut [T]) {
                match self {
                    $(Self::$effect(effect) => crate::dynamics::outline::outline::<T>(crate::dynamics::effect::AddForces { effect, model, inputs, forces }),)+
                    Self::Other(effect) => crate::dynamics::effect::Effect::<$model>::add_forces(effect, model, inputs, forces),
                }
            }

            #[inline(always)]
            fn vjp<R: crate::numbers::scalar::Real, C: crate::numbers::scalar::Cotangent<R>>(
                &self,
                model: &$model,
                inputs: crate::dynamics::inputs::OdeInputs<'_, R>,
                forces_bar: &[C],
                cotangents: crate::dynamics::inputs::Cotangents<'_, C>,
            ) {
                match self {
                    $(Self::$effect(effect) => crate::dynamics::outline::outline::<R>(crate::dynamics::effect::Vjp { effect, model, inputs, forces_bar, cotangents }),)+
                    Self::Other(effect) => crate::dynamics::effect::Effect::<$model>::vjp(effect, model, inputs, forces_bar, cotangents),
                }
            }

            #[inline(always)]
            fn state_dependent(&self) -> bool {
                match self {
                    $(Self::$effect(effect) => crate::dynamics::effect::Effect::<$model>::state_dependent(effect),)+
                    Self::Other(effect) => crate::dynamics::effect::Effect::<$model>::state_dependent(effect),
                }
            }

            fn diagnose<R: crate::numbers::scalar::Real>(&self, model: &$model, inputs: crate::dynamics::inputs::OdeInputs<'_, R>, forces: usize) -> Option<&'static str> {
                let name = match self {
                    $(Self::$effect(_) => stringify!($effect),)+
                    Self::Other(effect) => return crate::dynamics::effect::Effect::<$model>::diagnose(effect, model, inputs, forces),
                };
                if crate::dynamics::effect::is_finite(self, model, inputs, forces) { None } else { Some(name) }
            }
        }

        impl From<crate::dynamics::effect::DynEffect<$model>> for $name {
            fn from(effect: crate::dynamics::effect::DynEffect<$model>) -> Self {
                Self::Other(effect)
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
