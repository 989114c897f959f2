//! [`DynEffect`]: any effect behind a pointer.

use super::list::{AddForces, Vjp};
use super::{Effect, default_effect_vjp};
use crate::dynamics::inputs::{Cotangents, OdeInputs};
use crate::dynamics::number::{Numbers, Varied};
use crate::dynamics::outline::outline;
use crate::numbers::instances::{
    CotangentFunction, EFFECT_SCALARS, RealFunction, SCALARS, ScalarFunction, cotangent_pointer,
    diagnosis_pointer, scalar_pointer_of_effect,
};
use crate::numbers::rng::Rng;
use crate::numbers::scalar::{Cotangent, Real, Scalar};
use std::any::{Any, type_name};
use std::fmt::{self, Debug};
use std::marker::PhantomData;
use std::sync::Arc;

/// Any effect of the model `B`, chosen at run time. Rollouts and their gradients are bitwise equal
/// to those with the wrapped effect.
///
/// ```
/// use physgrad::tasks::{CartDamping, CartPoleSystem};
/// use physgrad::{Forced, check, effect::DynEffect};
///
/// let effects: Vec<DynEffect<CartPoleSystem>> = vec![DynEffect::new(CartDamping::default())];
/// check::system(&Forced { system: CartPoleSystem::default(), effects }).unwrap();
/// ```
pub struct DynEffect<B>(Arc<dyn AnyEffect<B>>);

impl<B: 'static> DynEffect<B> {
    /// Wraps an effect.
    pub fn new<E: Effect<B> + 'static>(effect: E) -> Self {
        Self(Arc::new(effect))
    }
}

impl<B> Clone for DynEffect<B> {
    fn clone(&self) -> Self {
        Self(self.0.clone())
    }
}

impl<B> Debug for DynEffect<B> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        self.0.fmt(f)
    }
}

/// Compares pointers: effects are equal if they are one object.
impl<B> PartialEq for DynEffect<B> {
    fn eq(&self, other: &Self) -> bool {
        Arc::ptr_eq(&self.0, &other.0)
    }
}

/// Object-safe [`Effect`].
trait AnyEffect<B>: Debug + Send + Sync {
    fn as_any(&self) -> &dyn Any;
    fn param_dim(&self) -> usize;
    fn numbers(&self) -> Numbers<'_>;
    fn varied(&self, first: usize) -> Vec<Varied>;
    fn draw_params(&self, rng: &mut Rng, p: &mut [f64]);
    fn state_dependent(&self) -> bool;
    /// Writes the pointer of [`Forces`] for the scalar of `slot`.
    fn add_forces(&self, slot: &mut dyn Any);
    /// Writes the pointer of [`EffectVjp`] for the scalar and the cotangent of `slot`.
    fn vjp(&self, slot: &mut dyn Any);
    /// Writes the pointer of [`Diagnose`] for the scalar of `slot`.
    fn diagnose(&self, slot: &mut dyn Any);
}

impl<B: 'static, E: Effect<B> + 'static> AnyEffect<B> for E {
    fn as_any(&self) -> &dyn Any {
        self
    }
    fn param_dim(&self) -> usize {
        Effect::param_dim(self)
    }
    fn numbers(&self) -> Numbers<'_> {
        Effect::numbers(self)
    }
    fn varied(&self, first: usize) -> Vec<Varied> {
        Effect::varied(self, first)
    }
    fn draw_params(&self, rng: &mut Rng, p: &mut [f64]) {
        Effect::draw_params(self, rng, p);
    }
    fn state_dependent(&self) -> bool {
        Effect::state_dependent(self)
    }
    fn add_forces(&self, slot: &mut dyn Any) {
        scalar_pointer_of_effect::<Forces<E, B>>(slot);
    }
    fn vjp(&self, slot: &mut dyn Any) {
        cotangent_pointer::<EffectVjp<E, B>>(slot);
    }
    fn diagnose(&self, slot: &mut dyn Any) {
        diagnosis_pointer::<Diagnose<E, B>>(slot);
    }
}

/// Pointer to [`Effect::add_forces`]. The first argument is the effect.
type AddForcesOf<B, T> = fn(&dyn Any, &B, OdeInputs<'_, T>, &mut [T]);
/// Pointer to [`Effect::vjp`]. The first argument is the effect.
type VjpOf<B, R, C> = fn(&dyn Any, &B, OdeInputs<'_, R>, &[C], Cotangents<'_, C>);
/// Pointer to [`Effect::diagnose`]. The first argument is the effect.
type DiagnoseOf<B, R> = fn(&dyn Any, &B, OdeInputs<'_, R>, usize) -> Option<&'static str>;

/// Outlined [`Effect::add_forces`] of the effect `E`.
struct Forces<E, B>(PhantomData<(E, B)>);

impl<B: 'static, E: Effect<B> + 'static> ScalarFunction for Forces<E, B> {
    type Pointer<T: Scalar> = AddForcesOf<B, T>;

    fn pointer<T: Scalar>() -> Self::Pointer<T> {
        |effect, model, inputs, forces| {
            let effect = effect
                .downcast_ref::<E>()
                .expect("the argument is the effect that wrote the pointer");
            outline::<T>(AddForces { effect, model, inputs, forces });
        }
    }
}

/// Outlined [`Effect::vjp`] of the effect `E`.
struct EffectVjp<E, B>(PhantomData<(E, B)>);

impl<B: 'static, E: Effect<B> + 'static> CotangentFunction for EffectVjp<E, B> {
    type Pointer<R: Real, C: Cotangent<R>> = VjpOf<B, R, C>;

    fn pointer<R: Real, C: Cotangent<R>>() -> Self::Pointer<R, C> {
        |effect, model, inputs, forces_bar, cotangents| {
            let effect = effect
                .downcast_ref::<E>()
                .expect("the argument is the effect that wrote the pointer");
            outline::<R>(Vjp { effect, model, inputs, forces_bar, cotangents });
        }
    }
}

/// [`Effect::diagnose`] of the effect `E`.
struct Diagnose<E, B>(PhantomData<(E, B)>);

impl<B: 'static, E: Effect<B> + 'static> RealFunction for Diagnose<E, B> {
    type Pointer<R: Real> = DiagnoseOf<B, R>;

    fn pointer<R: Real>() -> Self::Pointer<R> {
        |effect, model, inputs, forces| {
            let effect = effect
                .downcast_ref::<E>()
                .expect("the argument is the effect that wrote the pointer");
            effect.diagnose(model, inputs, forces)
        }
    }
}

impl<B: 'static> Effect<B> for DynEffect<B> {
    fn param_dim(&self) -> usize {
        self.0.param_dim()
    }

    fn numbers(&self) -> Numbers<'_> {
        self.0.numbers()
    }

    fn varied(&self, first: usize) -> Vec<Varied> {
        self.0.varied(first)
    }

    fn draw_params(&self, rng: &mut Rng, p: &mut [f64]) {
        self.0.draw_params(rng, p);
    }

    fn state_dependent(&self) -> bool {
        self.0.state_dependent()
    }

    /// # Panics
    /// If `T` is not a scalar of rollouts, checks, counts, diagnoses, default derivatives or
    /// references.
    fn add_forces<T: Scalar>(&self, model: &B, inputs: OdeInputs<'_, T>, forces: &mut [T]) {
        let mut slot: Option<AddForcesOf<B, T>> = None;
        self.0.add_forces(&mut slot);
        let Some(add_forces) = slot else {
            panic!(
                "`DynEffect` of {:?}: `add_forces` has no instance for {}. Instances: {SCALARS}; {EFFECT_SCALARS}. Use one of \
                 these, or the effect without `DynEffect`",
                self.0,
                type_name::<T>()
            )
        };
        add_forces(self.0.as_any(), model, inputs, forces);
    }

    fn vjp<R: Real, C: Cotangent<R>>(
        &self,
        model: &B,
        inputs: OdeInputs<'_, R>,
        forces_bar: &[C],
        cotangents: Cotangents<'_, C>,
    ) {
        let mut slot: Option<VjpOf<B, R, C>> = None;
        self.0.vjp(&mut slot);
        match slot {
            Some(vjp) => vjp(self.0.as_any(), model, inputs, forces_bar, cotangents),
            None => default_effect_vjp(self, model, inputs, forces_bar, cotangents),
        }
    }

    fn diagnose<R: Real>(
        &self,
        model: &B,
        inputs: OdeInputs<'_, R>,
        forces: usize,
    ) -> Option<&'static str> {
        let mut slot: Option<DiagnoseOf<B, R>> = None;
        self.0.diagnose(&mut slot);
        slot.and_then(|diagnose| diagnose(self.0.as_any(), model, inputs, forces))
    }
}
