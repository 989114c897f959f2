//! Scalar types for simulators. Start with [`Scalar`].
//!
//! - [`Scalar`]: the trait over which simulators are generic.
//! - [`Real`]: a scalar without derivatives. [`Float`]: `f32` or `f64`.
//! - [`Lanes`]: several samples in one SIMD number.
//! - [`Dual`]: forward-mode derivatives, the default derivatives of small systems. Checks compare
//!   them with those of the crate num-dual.
//! - `Reverse`: reverse-mode derivatives, the default derivatives of large systems.
//! - [`Counted`]: an `f64` that counts its operations.
//! - `DoubleDouble`: a number with 31 digits, for references (feature `double-double`).
//! - [`Cotangent`]: the adjoint quantity of a reverse pass. [`CotangentPack`]: several of them.

mod counted;
mod double;
#[cfg(feature = "double-double")]
mod double_double;
mod dual;
mod float;
mod lanes;
pub(crate) mod num_dual;
mod reverse;

pub use counted::{Counted, Ops};
#[cfg(feature = "double-double")]
pub use double_double::DoubleDouble;
pub use dual::Dual;
pub use float::Float;
pub use lanes::{Lanes, Single};
pub(crate) use reverse::Reverse;

use crate::numbers::tape::Tape;

use std::cell::RefCell;
use std::fmt::Debug;
use std::iter::Sum;
use std::ops::{Add, AddAssign, Div, DivAssign, Mul, MulAssign, Neg, Sub, SubAssign};

/// Number type over which simulators are generic. Among the types are `f64`, [`Lanes`], [`Dual`],
/// [`Counted`] and `DoubleDouble`.
///
/// Constants are plain `f64` on the right of an operator: `x[0].sin() * (9.81 / self.length)`.
/// Operators round constants to the precision of the simulation.
///
/// A scalar has no ordering and permits no branches on values, since lanes hold several values.
/// Write branches with [`select_lt`](Scalar::select_lt), [`min`](Scalar::min),
/// [`max`](Scalar::max), [`clamp`](Scalar::clamp) and [`abs`](Scalar::abs).
///
/// The forms on the left do not compile. The compiler suggests further bounds on `T`, which do not
/// help. Write the forms on the right:
///
/// | instead of | write |
/// |---|---|
/// | `2.0 * x[0]` | `x[0] * 2.0` |
/// | `1.0 - x[0]` | `-x[0] + 1.0` or `T::from(1.0) - x[0]` |
/// | `if x[0] > 0.0 { a } else { b }` | `T::select_lt(T::zero(), x[0], a, b)` |
/// | `x[0] % 6.28`, an angle | `x[0].wrap_angle()` |
///
/// `f32` itself is not a scalar, because it has no product with `f64`. A single number in f32 is
/// [`Single<f32>`](Single).
#[diagnostic::on_unimplemented(
    message = "`{Self}` is not a scalar of simulators",
    note = "simulators run on `f64`, `Lanes<f32, N>`, `Lanes<f64, N>` and dual numbers; a single f32 is `Single<f32>`"
)]
pub trait Scalar:
    Copy
    + Debug
    + Send
    + Sync
    + 'static
    + Add<Output = Self>
    + Sub<Output = Self>
    + Mul<Output = Self>
    + Div<Output = Self>
    + Neg<Output = Self>
    + AddAssign
    + SubAssign
    + MulAssign
    + DivAssign
    + Add<f64, Output = Self>
    + Sub<f64, Output = Self>
    + Mul<f64, Output = Self>
    + Div<f64, Output = Self>
    + AddAssign<f64>
    + SubAssign<f64>
    + MulAssign<f64>
    + DivAssign<f64>
    + From<f64>
    + Sum
{
    /// Underlying floating-point type, `f32` or `f64`.
    type Real: Float;
    /// True if code for this type is compiled for wide vector registers: the lanes of rollouts.
    #[doc(hidden)]
    const VECTORIZED: bool = false;

    /// Drops the derivative and returns the value ("stop gradient").
    fn detach(self) -> Self;

    /// Square root. The derivative at 0 is infinite.
    fn sqrt(self) -> Self;
    /// Exponential, `e^self`.
    fn exp(self) -> Self;
    /// Natural logarithm.
    fn ln(self) -> Self;
    /// Sine and cosine, angle in radians.
    fn sin_cos(self) -> (Self, Self);
    /// Hyperbolic tangent. Saturated values have derivative 0, never NaN.
    fn tanh(self) -> Self;
    /// Angle of the point with coordinates `x` and `y = self`, in radians.
    fn atan2(self, x: Self) -> Self;

    /// Selects `yes` where `a < b`, else `no`: value and derivative.
    ///
    /// Non-finite numbers in the other branch do not propagate.
    fn select_lt(a: Self, b: Self, yes: Self, no: Self) -> Self;

    /// Returns whether `a < b` in any lane, for loops that run until all lanes finish.
    ///
    /// The loop must not change finished lanes. Otherwise they differ from the scalar computation.
    fn any_lt(a: Self, b: Self) -> bool;

    /// The constant 0.
    #[inline(always)]
    fn zero() -> Self {
        Self::from(0.0)
    }
    /// The constant 1.
    #[inline(always)]
    fn one() -> Self {
        Self::from(1.0)
    }
    /// Sine, angle in radians. [`sin_cos`](Scalar::sin_cos) computes both at the same cost.
    #[inline(always)]
    fn sin(self) -> Self {
        self.sin_cos().0
    }
    /// Cosine, angle in radians.
    #[inline(always)]
    fn cos(self) -> Self {
        self.sin_cos().1
    }
    /// Tangent, angle in radians.
    #[inline(always)]
    fn tan(self) -> Self {
        let (sin, cos) = self.sin_cos();
        sin / cos
    }
    /// Arcsine in radians. The derivative at ±1 is infinite.
    #[inline(always)]
    fn asin(self) -> Self {
        self.atan2(((Self::one() - self) * (self + 1.0)).sqrt())
    }
    /// Arccosine in radians. The derivative at ±1 is infinite.
    #[inline(always)]
    fn acos(self) -> Self {
        ((Self::one() - self) * (self + 1.0)).sqrt().atan2(self)
    }
    /// Integer power by repeated multiplication; the reciprocal for a negative exponent.
    #[inline(always)]
    fn powi(self, exponent: i32) -> Self {
        let power = (0..exponent.unsigned_abs()).fold(Self::one(), |product, _| product * self);
        if exponent < 0 { power.recip() } else { power }
    }
    /// Power of a positive number, `exp(exponent ln self)`. NaN for a negative one.
    #[inline(always)]
    fn powf(self, exponent: f64) -> Self {
        (self.ln() * exponent).exp()
    }
    /// Reciprocal.
    #[inline(always)]
    fn recip(self) -> Self {
        Self::one() / self
    }
    /// Angle in radians between -π and π, with the derivative of the identity.
    #[inline(always)]
    fn wrap_angle(self) -> Self {
        let (sin, cos) = self.sin_cos();
        sin.atan2(cos)
    }
    /// Absolute value. The derivative at 0 is the one-sided derivative from the right.
    #[inline(always)]
    fn abs(self) -> Self {
        Self::select_lt(self, Self::zero(), -self, self)
    }
    /// Minimum with a scalar or a constant. Returns `other` if both are equal or one is NaN.
    #[inline(always)]
    fn min(self, other: impl Into<Self>) -> Self {
        let other = other.into();
        Self::select_lt(self, other, self, other)
    }
    /// Maximum with a scalar or a constant. Returns `other` if both are equal or one is NaN.
    #[inline(always)]
    fn max(self, other: impl Into<Self>) -> Self {
        let other = other.into();
        Self::select_lt(other, self, self, other)
    }
    /// Limits the number to the range from `low` to `high`. The derivative outside is 0. NaN stays
    /// NaN.
    #[inline(always)]
    fn clamp(self, low: f64, high: f64) -> Self {
        Self::from(low).max(Self::from(high).min(self))
    }
}

/// A [`Scalar`] without derivatives: `f64`, [`Counted`], and [`Lanes`].
pub trait Real: Scalar {
    /// Number of lanes; 1 except for [`Lanes`].
    const LANES: usize;
    /// Returns the number in lane `lane`.
    fn lane(&self, lane: usize) -> Self::Real;
    /// Replaces the number in lane `lane`.
    fn set_lane(&mut self, lane: usize, value: Self::Real);
    /// Returns whether all lanes are finite.
    fn is_finite(&self) -> bool {
        (0..Self::LANES).all(|lane| self.lane(lane).to_f64().is_finite())
    }
    /// Broadcasts a number to all lanes.
    #[inline(always)]
    fn splat(value: Self::Real) -> Self {
        let mut all = Self::zero();
        for lane in 0..Self::LANES {
            all.set_lane(lane, value);
        }
        all
    }
    /// Active tape of the current thread for this type.
    #[doc(hidden)]
    fn tape() -> &'static RefCell<Tape<Self>>;
}

/// A [`Scalar`] with derivatives, over the scalar `R`.
pub(crate) trait Over<R>: Scalar {
    /// A number with derivative 0.
    fn constant(value: R) -> Self;
}

/// The adjoint quantity of a reverse pass: an element of a vector space over `R`.
///
/// An analytic [`System::vjp`](crate::System::vjp) can add cotangents and multiply them by scalars,
/// but not multiply two cotangents. The type system thus enforces linearity. One implementation
/// propagates a single adjoint or, as [`CotangentPack`], several through one linearization.
pub trait Cotangent<R>:
    Copy
    + Debug
    + 'static
    + Add<Output = Self>
    + Sub<Output = Self>
    + Neg<Output = Self>
    + Mul<R, Output = Self>
    + AddAssign
    + SubAssign
{
    /// Neutral element of addition, the initial value of a sum: −0.0 in every lane. 0.0 is not
    /// neutral, since `-0.0 + 0.0` is `0.0`.
    fn null() -> Self;
    /// Returns whether all numbers are finite.
    #[doc(hidden)]
    fn all_finite(&self) -> bool;
    /// `self * slope`, but 0 where this product is non-finite and one factor is 0.
    #[doc(hidden)]
    fn times_or_zero(self, slope: R) -> Self;
}

impl<R: Real> Cotangent<R> for R {
    #[inline(always)]
    fn null() -> Self {
        R::from(-0.0)
    }
    #[inline(always)]
    fn all_finite(&self) -> bool {
        self.is_finite()
    }
    #[inline(always)]
    fn times_or_zero(self, slope: R) -> Self {
        let product = self * slope;
        let infinity = R::from(f64::INFINITY);
        // The outer selection keeps the product for NaN, for which `0 < size` is false too.
        let unless_zero = |number: R, product: R| {
            let size = number.abs();
            R::select_lt(size, infinity, R::select_lt(R::zero(), size, product, R::zero()), product)
        };
        R::select_lt(product.abs(), infinity, product, unless_zero(self, unless_zero(slope, product)))
    }
}

/// `K` cotangents, propagated together through one linearization.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct CotangentPack<R, const K: usize>(pub [R; K]);

/// Calls `column(k)` for `k = 0 .. K`. Unrolled for the `K ≤ 2` of reverse passes, because small
/// loops slow compilation.
#[inline(always)]
fn each<const K: usize>(mut column: impl FnMut(usize)) {
    match K {
        1 => column(0),
        2 => {
            column(0);
            column(1);
        }
        _ => (0..K).for_each(column),
    }
}

impl<R: Real, const K: usize> Cotangent<R> for CotangentPack<R, K> {
    #[inline(always)]
    fn null() -> Self {
        Self([R::from(-0.0); K])
    }
    #[inline(always)]
    fn all_finite(&self) -> bool {
        self.0.iter().all(R::is_finite)
    }
    #[inline(always)]
    fn times_or_zero(mut self, slope: R) -> Self {
        each::<K>(|k| self.0[k] = self.0[k].times_or_zero(slope));
        self
    }
}

impl<R: Real, const K: usize> CotangentPack<R, K> {
    /// Elementwise absolute value.
    #[inline(always)]
    pub(crate) fn abs(mut self) -> Self {
        each::<K>(|k| self.0[k] = self.0[k].abs());
        self
    }
}

impl<R: Real, const K: usize> Add for CotangentPack<R, K> {
    type Output = Self;
    #[inline(always)]
    fn add(mut self, other: Self) -> Self {
        self += other;
        self
    }
}

impl<R: Real, const K: usize> Sub for CotangentPack<R, K> {
    type Output = Self;
    #[inline(always)]
    fn sub(mut self, other: Self) -> Self {
        self -= other;
        self
    }
}

impl<R: Real, const K: usize> AddAssign for CotangentPack<R, K> {
    #[inline(always)]
    fn add_assign(&mut self, other: Self) {
        each::<K>(|k| self.0[k] += other.0[k]);
    }
}

impl<R: Real, const K: usize> SubAssign for CotangentPack<R, K> {
    #[inline(always)]
    fn sub_assign(&mut self, other: Self) {
        each::<K>(|k| self.0[k] -= other.0[k]);
    }
}

impl<R: Real, const K: usize> Neg for CotangentPack<R, K> {
    type Output = Self;
    #[inline(always)]
    fn neg(mut self) -> Self {
        each::<K>(|k| self.0[k] = -self.0[k]);
        self
    }
}

impl<R: Real, const K: usize> Mul<R> for CotangentPack<R, K> {
    type Output = Self;
    #[inline(always)]
    fn mul(mut self, factor: R) -> Self {
        each::<K>(|k| self.0[k] *= factor);
        self
    }
}
