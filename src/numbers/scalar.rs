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
pub(crate) use lanes::{LANES, Lane};
pub use lanes::{Lanes, Single};
pub(crate) use reverse::Reverse;

use crate::numbers::extended::power_of_two;
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
/// # Singular points
///
/// Derivatives at the points where a formula has no finite derivative:
///
/// | function | derivative |
/// |---|---|
/// | `x.abs()`, `x.min(y)`, `x.max(y)` at equality | that of the branch in use: from the right, of `other` |
/// | `x.powf(e)`, `x.powi(e)` at 0 | `e x^(e-1)`: 0 for e > 1, 1 for e = 1, 0 for e = 0, else infinite |
/// | `x.hypot(y)` at the origin | 0; the second derivatives too |
/// | `x.sqrt()`, `x.ln()` at 0; `x.asin()`, `x.acos()` at ±1 | infinite |
/// | `y.atan2(x)` at the origin | NaN |
///
/// One rule applies to 0 times an infinite or undefined slope, in forward and in reverse mode and
/// for every scalar. An argument that does not change contributes 0: the derivative of
/// `(x * x).sqrt()` at 0 is 0. A change that is infinite first and then meets the slope 0 is NaN:
/// the chain rule does not determine it. `x.acos() * x.acos()` at 1 has the derivative -2 and
/// `x.sqrt() * x` at 0 the derivative 0, but both are NaN. A branch that is not selected and the
/// divisor of a quotient by infinity contribute 0.
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

    /// True if values carry derivatives. Iterative solvers then iterate until these converge too.
    const DIFFERENTIATES: bool = false;

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
    /// Angle of the point with coordinates `x` and `y = self`, in radians. The derivative is
    /// accurate at any distance from the origin, and NaN at the origin.
    fn atan2(self, x: Self) -> Self;
    /// Power with a real exponent. NaN for a negative number, unless the exponent is an integer.
    ///
    /// The power with exponent 0 is 1 for every number, with derivative 0. At 0, the derivative is
    /// 0 for exponents above 1, and infinite for exponents below 1.
    fn powf(self, exponent: f64) -> Self;

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
    /// Length of the vector `(self, other)`, without overflow or underflow of the squares.
    ///
    /// The derivative is the unit vector at any length, and 0 at the origin, where the length has
    /// no derivative. For three components, write `x.hypot(y).hypot(z)`.
    #[inline(always)]
    fn hypot(self, other: Self) -> Self {
        let near = Scaled::new(self, other);
        near.where_nonzero(near.root() * near.per_unit)
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

/// A vector in the plane times a power of two that lets squares neither overflow nor underflow.
/// The power is 1 for lengths of usual size, so the numbers then keep their bits.
#[derive(Clone, Copy)]
pub(crate) struct Scaled<T> {
    x: T,
    y: T,
    /// `x² + y²`.
    square: T,
    /// The power of two.
    unit: T,
    /// Its reciprocal.
    per_unit: T,
}

impl<T: Scalar> Scaled<T> {
    #[inline(always)]
    pub(crate) fn new(x: T, y: T) -> Self {
        // Squares of numbers within 2^±range, and their reciprocals, are normal numbers.
        // Multiplication by 2^∓shift brings all other finite, nonzero numbers into this range.
        let (range, shift) = if T::Real::EPSILON < 1e-10 { (500, 600) } else { (60, 90) };
        let (huge, tiny) = (T::from(power_of_two(range)), T::from(power_of_two(-range)));
        let (up, down, one) =
            (T::from(power_of_two(shift)), T::from(power_of_two(-shift)), T::one());
        let largest = x.abs().max(y.abs()).detach();
        let unit = T::select_lt(huge, largest, down, T::select_lt(largest, tiny, up, one));
        let per_unit = T::select_lt(huge, largest, up, T::select_lt(largest, tiny, down, one));
        let (x, y) = (x * unit, y * unit);
        Self { x, y, square: x * x + y * y, unit, per_unit }
    }

    /// Length of the scaled vector; 1 for the zero vector.
    #[inline(always)]
    fn root(&self) -> T {
        T::select_lt(T::zero(), self.square, self.square, T::one()).sqrt()
    }

    /// The given number; the constant 0 for the zero vector. NaN stays NaN.
    #[inline(always)]
    fn where_nonzero(&self, number: T) -> T {
        T::select_lt(T::zero(), self.square, number, self.square * T::zero())
    }

    /// Derivatives of the length with respect to x and y.
    #[inline(always)]
    pub(crate) fn direction(&self) -> [T; 2] {
        let root = self.root();
        [self.where_nonzero(self.x / root), self.where_nonzero(self.y / root)]
    }

    /// `[x, y] / (x² + y²)` of the vector before scaling.
    #[inline(always)]
    pub(crate) fn per_square(&self) -> [T; 2] {
        [self.x / self.square * self.unit, self.y / self.square * self.unit]
    }
}

/// `1 / sqrt(1 - x²)`, the derivative of the arcsine.
#[inline(always)]
fn arcsine_slope<T: Scalar>(x: T) -> T {
    ((T::one() - x) * (x + 1.0)).sqrt().recip()
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
    /// `self * slope`, where a slope of 0 gives 0 also for a non-finite cotangent. Returns -0.0,
    /// the mark of a number that no path reaches, if `self` is -0.0 or `open` is 0, and never
    /// otherwise.
    #[doc(hidden)]
    fn along(self, slope: R, open: R) -> Self;
    /// The number, or `other` where it is not finite.
    #[doc(hidden)]
    fn finite_or(self, other: Self) -> Self;
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
    fn along(self, slope: R, open: R) -> Self {
        // NaN is neither above 0 nor below 1.
        let if_zero = |number: R, yes: R, no: R| {
            let size = number.abs();
            R::select_lt(R::zero(), size, no, R::select_lt(size, R::one(), yes, no))
        };
        // -0.0 + 0.0 is 0.0.
        let product = if_zero(slope, R::zero(), self * slope + 0.0);
        let reached = if_zero(open, R::null(), product);
        // The reciprocal tells the signs of zeros apart.
        if_zero(self, R::select_lt(self.recip(), R::zero(), R::null(), reached), reached)
    }
    #[inline(always)]
    fn finite_or(self, other: Self) -> Self {
        R::select_lt(self.abs(), R::from(f64::INFINITY), self, other)
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
    fn along(mut self, slope: R, open: R) -> Self {
        each::<K>(|k| self.0[k] = self.0[k].along(slope, open));
        self
    }
    #[inline(always)]
    fn finite_or(mut self, other: Self) -> Self {
        each::<K>(|k| self.0[k] = self.0[k].finite_or(other.0[k]));
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
