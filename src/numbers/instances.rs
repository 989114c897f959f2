//! Generic functions behind trait objects: one instance per scalar type.
//!
//! A method that is generic in the scalar cannot be called on a trait object. The object returns a
//! function pointer for the scalar type of the caller instead, from a fixed set of types.

use super::forward_mode::CHUNK;
#[cfg(feature = "double-double")]
use super::scalar::DoubleDouble;
use super::scalar::{Cotangent, CotangentPack, Counted, Dual, Lanes, Real, Reverse, Scalar, Single};
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

/// Writes the pointer to `slot` if this is an `Option` of its type.
fn fill<P: 'static>(slot: &mut dyn Any, pointer: fn() -> P) -> bool {
    slot.downcast_mut::<Option<P>>().map(|slot| *slot = Some(pointer())).is_some()
}

/// Writes the pointer that `slot` has room for: `slot` is an `Option<G::Pointer<T>>`. It stays
/// `None` for scalars outside the fixed set.
///
/// Lanes come first, because rollouts look them up in every step.
pub(crate) fn scalar_pointer<G: ScalarFunction>(slot: &mut dyn Any) {
    macro_rules! among {
        ($($scalar:ty),+) => { $(fill(slot, G::pointer::<$scalar>))||+ };
    }
    let _found = among!(Lanes<f32, 8>, Lanes<f64, 8>, f64, Dual64, Counted, Single<f32>, Single<f64>)
        || among!(Dual<Lanes<f32, 8>, CHUNK>, Dual<Lanes<f64, 8>, CHUNK>, Dual<f64, CHUNK>, Dual<Counted, CHUNK>)
        || among!(Dual<Single<f32>, CHUNK>, Dual<Single<f64>, CHUNK>)
        || among!(Reverse<Lanes<f32, 8>>, Reverse<Lanes<f64, 8>>, Reverse<f64>, Reverse<Counted>)
        || among!(Reverse<Single<f32>>, Reverse<Single<f64>>)
        || among!(Dual<f64, 1>, Dual<Dual<f64, CHUNK>, CHUNK>);
    #[cfg(feature = "double-double")]
    let _found = _found || among!(DoubleDouble, Dual<DoubleDouble, 1>);
}

/// Writes the pointer that `slot` has room for: `slot` is an `Option<G::Pointer<R, C>>`. It stays
/// `None` for types outside the fixed set.
pub(crate) fn cotangent_pointer<G: CotangentFunction>(slot: &mut dyn Any) {
    macro_rules! among {
        ($($real:ty: $cotangent:ty),+) => { $(fill(slot, G::pointer::<$real, $cotangent>))||+ };
    }
    type Pack<R, const K: usize> = CotangentPack<R, K>;
    let _found = among!(Lanes<f32, 8>: Pack<Lanes<f32, 8>, 2>, Lanes<f64, 8>: Pack<Lanes<f64, 8>, 2>)
        || among!(Lanes<f32, 8>: Pack<Lanes<f32, 8>, 1>, Lanes<f64, 8>: Pack<Lanes<f64, 8>, 1>)
        || among!(f64: Pack<f64, 1>, Single<f32>: Pack<Single<f32>, 1>, Single<f64>: Pack<Single<f64>, 1>, Counted: Counted);
}

/// Writes the pointer that `slot` has room for: `slot` is an `Option<G::Pointer<R>>`. It stays `None`
/// for scalars outside the fixed set.
pub(crate) fn real_pointer<G: RealFunction>(slot: &mut dyn Any) {
    macro_rules! among {
        ($($real:ty),+) => { $(fill(slot, G::pointer::<$real>))||+ };
    }
    let _found = among!(Lanes<f32, 8>, Lanes<f64, 8>, f64, Counted, Single<f32>, Single<f64>);
}
