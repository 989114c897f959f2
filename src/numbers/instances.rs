//! Generic functions behind trait objects: one instance per scalar type.
//!
//! A trait object has no methods that are generic in the scalar. The object returns a function
//! pointer for the scalar type of the caller instead, from a fixed set of types.

use super::forward_mode::CHUNK;
#[cfg(feature = "double-double")]
use super::scalar::DoubleDouble;
use super::scalar::{Cotangent, CotangentPack, Counted, Dual, Lanes, Real, Reverse, Scalar};
use num_dual::Dual64;
use std::any::Any;

/// A function that is generic in the scalar.
pub(crate) trait ScalarFunction {
    /// Function pointer for the scalar `T`.
    type Pointer<T: Scalar>: 'static;
    /// The function for `T`.
    fn pointer<T: Scalar>() -> Self::Pointer<T>;
}

/// A function that is generic in a scalar and its cotangent.
pub(crate) trait CotangentFunction {
    /// Function pointer for the scalar `R` and the cotangent `C`.
    type Pointer<R: Real, C: Cotangent<R>>: 'static;
    /// The function for `R` and `C`.
    fn pointer<R: Real, C: Cotangent<R>>() -> Self::Pointer<R, C>;
}

/// A function that is generic in a scalar without derivatives.
pub(crate) trait RealFunction {
    /// Function pointer for the scalar `R`.
    type Pointer<R: Real>: 'static;
    /// The function for `R`.
    fn pointer<R: Real>() -> Self::Pointer<R>;
}

/// Writes the pointer if `slot` is an `Option<P>`. Returns whether `slot` is one.
pub(crate) fn fill<P: 'static>(slot: &mut dyn Any, pointer: fn() -> P) -> bool {
    slot.downcast_mut::<Option<P>>().map(|slot| *slot = Some(pointer())).is_some()
}

/// Calls [`fill`] for the listed scalars, in order, until one matches the type of the slot.
macro_rules! fill_scalars {
    ($slot:expr, $function:ty: $($scalar:ty),+) => { $(fill($slot, <$function>::pointer::<$scalar>))||+ };
}

/// Scalars of [`scalar_pointer`], for messages.
pub(crate) const SCALARS: &str = "`Lanes<f32, 8>`, `Lanes<f64, 8>`, `f64`, `Dual64`, `Counted`, `Dual<f64, 4>` and, with the \
                                  feature `double-double`, `Dual<DoubleDouble, 1>`";

/// Writes the function pointer to `slot`, an `Option<G::Pointer<T>>` for the scalar `T` of the
/// caller.
///
/// Returns false and leaves `None` unless `T` is a scalar of rollouts, checks, counts, optimization
/// or references.
///
/// Lanes come first, because rollouts look them up in every step.
pub(crate) fn scalar_pointer<G: ScalarFunction>(slot: &mut dyn Any) -> bool {
    let found = fill_scalars!(slot, G: Lanes<f32, 8>, Lanes<f64, 8>, f64, Dual64, Counted, Dual<f64, CHUNK>);
    #[cfg(feature = "double-double")]
    let found = found || fill_scalars!(slot, G: Dual<DoubleDouble, 1>);
    found
}

/// Scalars of [`scalar_pointer_of_cost`], for messages.
pub(crate) const COST_SCALARS: &str = "the scalars of `observe` and `Dual<Dual<f64, 4>, 4>`";

/// Extends [`scalar_pointer`] by the scalar of second derivatives.
pub(crate) fn scalar_pointer_of_cost<G: ScalarFunction>(slot: &mut dyn Any) -> bool {
    scalar_pointer::<G>(slot) || fill_scalars!(slot, G: Dual<Dual<f64, CHUNK>, CHUNK>)
}

/// Scalars that [`scalar_pointer_of_effect`] adds, for messages.
pub(crate) const EFFECT_SCALARS: &str =
    "`Dual<R, 4>` and `Reverse<R>` for each of these scalars `R` without derivatives";

/// Extends [`scalar_pointer`] by the scalars of default derivatives.
pub(crate) fn scalar_pointer_of_effect<G: ScalarFunction>(slot: &mut dyn Any) -> bool {
    scalar_pointer::<G>(slot)
        || fill_scalars!(slot, G: Dual<Lanes<f32, 8>, CHUNK>, Dual<Lanes<f64, 8>, CHUNK>, Dual<Counted, CHUNK>)
        || fill_scalars!(slot, G: Reverse<f64>, Reverse<Lanes<f32, 8>>, Reverse<Lanes<f64, 8>>, Reverse<Counted>)
}

/// Scalars and cotangents of [`cotangent_pointer`], for messages.
pub(crate) const COTANGENTS: &str = "`Lanes<F, 8>` with `CotangentPack<_, 1>` or `CotangentPack<_, 2>`, `f64` with \
                                     `CotangentPack<f64, 1>`, and `Counted` with `Counted`";

/// [`COTANGENTS`] with those that `observe_vjp` adds, for messages.
pub(crate) const OBSERVED_COTANGENTS: &str = "the types of `vjp`, and `f64` with `f64`";

/// Writes the function pointer to `slot`, an `Option<G::Pointer<R, C>>` for the types `R` and `C`
/// of the caller.
///
/// Leaves `None` unless the types are those of reverse passes, checks or counts.
pub(crate) fn cotangent_pointer<G: CotangentFunction>(slot: &mut dyn Any) {
    macro_rules! among {
        ($($real:ty: $cotangent:ty),+) => { $(fill(slot, G::pointer::<$real, $cotangent>))||+ };
    }
    type Pack<R, const K: usize> = CotangentPack<R, K>;
    let _found = among!(Lanes<f32, 8>: Pack<Lanes<f32, 8>, 2>, Lanes<f64, 8>: Pack<Lanes<f64, 8>, 2>)
        || among!(Lanes<f32, 8>: Pack<Lanes<f32, 8>, 1>, Lanes<f64, 8>: Pack<Lanes<f64, 8>, 1>)
        || among!(f64: Pack<f64, 1>, Counted: Counted);
}

/// Scalars of [`diagnosis_pointer`], for messages.
pub(crate) const DIAGNOSED: &str = "`Lanes<f32, 8>`, `Lanes<f64, 8>` and `f64`";

/// Writes the function pointer to `slot`, an `Option<G::Pointer<R>>` for the scalar `R` of the
/// caller.
///
/// Leaves `None` unless `R` is the scalar of a diagnosis.
pub(crate) fn diagnosis_pointer<G: RealFunction>(slot: &mut dyn Any) {
    let _found = fill(slot, G::pointer::<Lanes<f32, 8>>)
        || fill(slot, G::pointer::<Lanes<f64, 8>>)
        || fill(slot, G::pointer::<f64>);
}

/// Scalars of [`real_pointer`], for messages.
pub(crate) const REALS: &str = "`Lanes<f32, 8>`, `Lanes<f64, 8>`, `f64` and `Counted`";

/// Writes the function pointer to `slot`, an `Option<G::Pointer<R>>` for the scalar `R` of the
/// caller.
///
/// Leaves `None` unless `R` is the scalar of a reverse pass, a count or an optimization.
pub(crate) fn real_pointer<G: RealFunction>(slot: &mut dyn Any) {
    macro_rules! among {
        ($($real:ty),+) => { $(fill(slot, G::pointer::<$real>))||+ };
    }
    let _found = among!(Lanes<f32, 8>, Lanes<f64, 8>, f64, Counted);
}
