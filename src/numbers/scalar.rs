//! The numbers a simulator computes with.
//!
//! A system is written once against [`Scalar`] and then runs on `f32` and `f64`, on SIMD lanes, on [`Dual`] numbers, which
//! by default compute its derivatives, and on num-dual's, which check them. [`Real`] is a scalar without derivative;
//! [`Float`] is one number of one precision; [`Counted`] is an `f64` that counts its operations; a [`Cotangent`] is what
//! a reverse pass carries.

mod counted;
#[cfg(feature = "double-double")]
mod double_double;
mod dual;
mod float;
mod lanes;
pub(crate) mod num_dual;

pub use counted::{Counted, Counts};
#[cfg(feature = "double-double")]
pub use double_double::DoubleDouble;
pub use dual::Dual;
pub use float::Float;
pub use lanes::Lanes;

use std::fmt::Debug;
use std::ops::{Add, AddAssign, Div, DivAssign, Mul, MulAssign, Neg, Sub, SubAssign};

/// A number a simulator computes with: `f32`, `f64`, their lanes, and duals of all of them.
///
/// There is no ordering and no `if` on values: lanes and duals have several values at once. Branches are written with
/// [`Scalar::select_lt`], or with [`min`](Scalar::min), [`max`](Scalar::max) and [`abs`](Scalar::abs), which use it.
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
{
    /// The floating point number underneath, `f32` or `f64`.
    type Real: Float;
    /// Whether it is worth compiling loops over it for the widest registers: numbers that rollouts run on.
    #[doc(hidden)]
    const WIDE: bool = false;

    /// A constant, rounded to the precision underneath.
    fn lift(value: f64) -> Self;
    /// The same value with its derivative dropped ("stop gradient").
    fn detach(self) -> Self;

    /// Square root. Its derivative at 0 is infinite.
    fn sqrt(self) -> Self;
    /// e to the power of `self`.
    fn exp(self) -> Self;
    /// Natural logarithm.
    fn ln(self) -> Self;
    /// Sine and cosine, angle in radians.
    fn sin_cos(self) -> (Self, Self);
    /// Hyperbolic tangent. Saturated values have derivative 0, never NaN.
    fn tanh(self) -> Self;
    /// The angle of the point (`x` = other, `y` = self), in radians.
    fn atan2(self, x: Self) -> Self;

    /// `yes` where `a < b`, else `no`, value and derivative; the branch not taken does not matter, NaN or not.
    fn select_lt(a: Self, b: Self, yes: Self, no: Self) -> Self;

    /// Whether `a < b` in any lane: for loops that end when every lane is done. Lanes that are done before must not be
    /// changed any more, or a lane would not have the bits it has alone.
    fn any_lt(a: Self, b: Self) -> bool;

    /// The constant 0.
    #[inline(always)]
    fn zero() -> Self {
        Self::lift(0.0)
    }
    /// The constant 1.
    #[inline(always)]
    fn one() -> Self {
        Self::lift(1.0)
    }
    /// Sine, angle in radians. When the cosine is needed too, [`sin_cos`](Scalar::sin_cos) costs the same.
    #[inline(always)]
    fn sin(self) -> Self {
        self.sin_cos().0
    }
    /// Cosine, angle in radians.
    #[inline(always)]
    fn cos(self) -> Self {
        self.sin_cos().1
    }
    /// `self` to an integer power, by repeated multiplication.
    #[inline(always)]
    fn powi(self, exponent: u32) -> Self {
        (0..exponent).fold(Self::one(), |product, _| product * self)
    }
    /// Absolute value; the derivative at 0 is that of the right side.
    #[inline(always)]
    fn abs(self) -> Self {
        Self::select_lt(self, Self::zero(), -self, self)
    }
    /// The smaller of the two; `other` where they are equal.
    #[inline(always)]
    fn min(self, other: Self) -> Self {
        Self::select_lt(self, other, self, other)
    }
    /// The larger of the two; `other` where they are equal.
    #[inline(always)]
    fn max(self, other: Self) -> Self {
        Self::select_lt(other, self, self, other)
    }
}

/// A [`Scalar`] without derivative: `f32`, `f64`, [`Counted`] ([`LANES`](Real::LANES) = 1), and [`Lanes`] of floats.
pub trait Real: Scalar {
    /// How many numbers it holds.
    const LANES: usize;
    /// The number in lane `lane`.
    fn lane(&self, lane: usize) -> Self::Real;
    /// Replaces the number in lane `lane`.
    fn set_lane(&mut self, lane: usize, value: Self::Real);
    /// The same number in every lane.
    #[inline(always)]
    fn splat(value: Self::Real) -> Self {
        let mut all = Self::zero();
        for lane in 0..Self::LANES {
            all.set_lane(lane, value);
        }
        all
    }
}

/// What a reverse pass carries: a vector space over `R`, and nothing more.
///
/// A hand-written [`System::vjp`](crate::System::vjp) may add cotangents and multiply them by numbers; it cannot
/// multiply two of them or take their sine. So it is linear because it compiles, and the same code carries one adjoint
/// or, as [`Columns`], several through one linearization.
pub trait Cotangent<R>:
    Copy + Debug + Add<Output = Self> + Sub<Output = Self> + Neg<Output = Self> + Mul<R, Output = Self> + AddAssign + SubAssign
{
    /// The null vector.
    fn null() -> Self;
}

impl<R: Real> Cotangent<R> for R {
    #[inline(always)]
    fn null() -> Self {
        R::zero()
    }
}

/// `K` cotangents that go through one linearization together.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Columns<R, const K: usize>(pub [R; K]);

/// Every column in turn; the one or two of a rollout without a loop, of which there would be hundreds to compile.
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

impl<R: Real, const K: usize> Cotangent<R> for Columns<R, K> {
    #[inline(always)]
    fn null() -> Self {
        Self([R::zero(); K])
    }
}

impl<R: Real, const K: usize> Columns<R, K> {
    /// Absolute values.
    #[inline(always)]
    pub(crate) fn abs(mut self) -> Self {
        each::<K>(|k| self.0[k] = self.0[k].abs());
        self
    }
}

impl<R: Real, const K: usize> Add for Columns<R, K> {
    type Output = Self;
    #[inline(always)]
    fn add(mut self, other: Self) -> Self {
        self += other;
        self
    }
}

impl<R: Real, const K: usize> Sub for Columns<R, K> {
    type Output = Self;
    #[inline(always)]
    fn sub(mut self, other: Self) -> Self {
        self -= other;
        self
    }
}

impl<R: Real, const K: usize> AddAssign for Columns<R, K> {
    #[inline(always)]
    fn add_assign(&mut self, other: Self) {
        each::<K>(|k| self.0[k] += other.0[k]);
    }
}

impl<R: Real, const K: usize> SubAssign for Columns<R, K> {
    #[inline(always)]
    fn sub_assign(&mut self, other: Self) {
        each::<K>(|k| self.0[k] -= other.0[k]);
    }
}

impl<R: Real, const K: usize> Neg for Columns<R, K> {
    type Output = Self;
    #[inline(always)]
    fn neg(mut self) -> Self {
        each::<K>(|k| self.0[k] = -self.0[k]);
        self
    }
}

impl<R: Real, const K: usize> Mul<R> for Columns<R, K> {
    type Output = Self;
    #[inline(always)]
    fn mul(mut self, factor: R) -> Self {
        each::<K>(|k| self.0[k] *= factor);
        self
    }
}
