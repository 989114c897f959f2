//! [`Reverse`]: reverse-mode differentiation over any real scalar, by a tape.

use super::{Over, Real, Scalar, Scaled, arcsine_slope};
use crate::numbers::tape::Zero;
use std::iter::Sum;
use std::ops::{Add, AddAssign, Div, DivAssign, Mul, MulAssign, Neg, Sub, SubAssign};

/// Index of a number that does not depend on a variable.
const CONSTANT: u32 = u32::MAX;

/// A value and its index on the tape of the current thread ([`Real::tape`]).
///
/// Values are bit-identical to those of the scalar `R`. An operation whose operands are all
/// constants has no entry. A number plus or minus a constant has the cotangent of the number, and
/// therefore the index of the number.
///
/// Slopes equal those of [`Dual`](super::Dual) up to rounding.
#[derive(Clone, Copy, Debug)]
pub struct Reverse<R> {
    value: R,
    index: u32,
}

impl<R: Real> Reverse<R> {
    /// The variable `index` of the recorded function.
    #[inline(always)]
    pub(crate) fn variable(value: R, index: usize) -> Self {
        Self { value, index: index as u32 }
    }

    /// Index on the tape; `None` for a constant.
    #[inline(always)]
    pub(crate) fn index(&self) -> Option<usize> {
        (!self.is_constant()).then_some(self.index as usize)
    }

    #[inline(always)]
    fn is_constant(&self) -> bool {
        self.index == CONSTANT
    }

    /// Result of a function of one number.
    #[inline(always)]
    fn one(self, value: R, slope: R) -> Self {
        self.one_with(Zero::Slope, value, slope)
    }

    #[inline(always)]
    fn one_with(self, zero: Zero, value: R, slope: R) -> Self {
        if self.is_constant() {
            return Self::constant(value);
        }
        Self { value, index: R::tape().borrow_mut().one(zero, self.index, slope) }
    }

    /// Result of a function of two numbers.
    #[inline(always)]
    fn two(self, other: Self, value: R, slopes: [R; 2]) -> Self {
        self.two_with(Zero::Slope, other, value, slopes)
    }

    #[inline(always)]
    fn two_with(self, zero: Zero, other: Self, value: R, slopes: [R; 2]) -> Self {
        if other.is_constant() {
            return self.one_with(zero, value, slopes[0]);
        }
        if self.is_constant() {
            return other.one_with(zero, value, slopes[1]);
        }
        Self { value, index: R::tape().borrow_mut().two(zero, [self.index, other.index], slopes) }
    }
}

impl<R: Real> Over<R> for Reverse<R> {
    #[inline(always)]
    fn constant(value: R) -> Self {
        Self { value, index: CONSTANT }
    }
}

impl<R: Real> Add for Reverse<R> {
    type Output = Self;
    #[inline(always)]
    fn add(self, other: Self) -> Self {
        let value = self.value + other.value;
        if other.is_constant() {
            return Self { value, ..self };
        }
        if self.is_constant() {
            return Self { value, ..other };
        }
        Self { value, index: R::tape().borrow_mut().sum([self.index, other.index]) }
    }
}

impl<R: Real> Sub for Reverse<R> {
    type Output = Self;
    #[inline(always)]
    fn sub(self, other: Self) -> Self {
        let value = self.value - other.value;
        if other.is_constant() {
            return Self { value, ..self };
        }
        if self.is_constant() {
            return other.one(value, R::from(-1.0));
        }
        Self { value, index: R::tape().borrow_mut().difference([self.index, other.index]) }
    }
}

impl<R: Real> Mul for Reverse<R> {
    type Output = Self;
    #[inline(always)]
    fn mul(self, other: Self) -> Self {
        self.two(other, self.value * other.value, [other.value, self.value])
    }
}

impl<R: Real> Div for Reverse<R> {
    type Output = Self;
    #[inline(always)]
    fn div(self, other: Self) -> Self {
        let (value, inverse) = (self.value / other.value, R::one() / other.value);
        self.two_with(Zero::Quotient, other, value, [inverse, -(value * inverse)])
    }
}

impl<R: Real> Neg for Reverse<R> {
    type Output = Self;
    #[inline(always)]
    fn neg(self) -> Self {
        self.one(-self.value, R::from(-1.0))
    }
}

impl<R: Real> From<f64> for Reverse<R> {
    #[inline(always)]
    fn from(value: f64) -> Self {
        Self::constant(R::from(value))
    }
}

impl<R: Real> Sum for Reverse<R> {
    #[inline(always)]
    fn sum<I: Iterator<Item = Self>>(values: I) -> Self {
        values.fold(Self::from(-0.0), |sum, value| sum + value)
    }
}

impl<R: Real> Add<f64> for Reverse<R> {
    type Output = Self;
    #[inline(always)]
    fn add(self, other: f64) -> Self {
        Self { value: self.value + other, ..self }
    }
}

impl<R: Real> Sub<f64> for Reverse<R> {
    type Output = Self;
    #[inline(always)]
    fn sub(self, other: f64) -> Self {
        Self { value: self.value - other, ..self }
    }
}

impl<R: Real> Mul<f64> for Reverse<R> {
    type Output = Self;
    #[inline(always)]
    fn mul(self, other: f64) -> Self {
        self.one(self.value * other, R::from(other))
    }
}

impl<R: Real> Div<f64> for Reverse<R> {
    type Output = Self;
    #[inline(always)]
    fn div(self, other: f64) -> Self {
        self.one(self.value / other, R::from(1.0 / other))
    }
}

macro_rules! assign {
    ($($trait:ident $method:ident $operator:tt),+) => {$(
        impl<R: Real> $trait for Reverse<R> {
            #[inline(always)]
            fn $method(&mut self, other: Self) {
                *self = *self $operator other;
            }
        }
        impl<R: Real> $trait<f64> for Reverse<R> {
            #[inline(always)]
            fn $method(&mut self, other: f64) {
                *self = *self $operator other;
            }
        }
    )+};
}
assign!(AddAssign add_assign +, SubAssign sub_assign -, MulAssign mul_assign *, DivAssign div_assign /);

impl<R: Real> Scalar for Reverse<R> {
    const DIFFERENTIATES: bool = true;
    type Real = R::Real;

    #[inline(always)]
    fn detach(self) -> Self {
        Self::constant(self.value)
    }

    #[inline(always)]
    fn sqrt(self) -> Self {
        let root = self.value.sqrt();
        self.one(root, R::from(0.5) / root)
    }

    #[inline(always)]
    fn exp(self) -> Self {
        let e = self.value.exp();
        self.one(e, e)
    }

    #[inline(always)]
    fn ln(self) -> Self {
        self.one(self.value.ln(), R::one() / self.value)
    }

    #[inline(always)]
    fn sin_cos(self) -> (Self, Self) {
        let (sin, cos) = self.value.sin_cos();
        (self.one(sin, cos), self.one(cos, -sin))
    }

    #[inline(always)]
    fn tanh(self) -> Self {
        let t = self.value.tanh();
        self.one(t, R::one() - t * t)
    }

    #[inline(always)]
    fn atan2(self, x: Self) -> Self {
        let [by_x, by_y] = Scaled::new(self.value, x.value).per_square();
        self.two(x, self.value.atan2(x.value), [by_y, -by_x])
    }

    #[inline(always)]
    fn hypot(self, other: Self) -> Self {
        self.two(
            other,
            self.value.hypot(other.value),
            Scaled::new(self.value, other.value).direction(),
        )
    }

    #[inline(always)]
    fn asin(self) -> Self {
        self.one(self.value.asin(), arcsine_slope(self.value))
    }

    #[inline(always)]
    fn acos(self) -> Self {
        self.one(self.value.acos(), -arcsine_slope(self.value))
    }

    #[inline(always)]
    fn powf(self, exponent: f64) -> Self {
        let power = self.value.powf(exponent);
        if exponent == 0.0 {
            return Self::constant(power);
        }
        self.one(power, self.value.powf(exponent - 1.0) * exponent)
    }

    #[inline(always)]
    fn powi(self, exponent: i32) -> Self {
        let power = self.value.powi(exponent);
        if exponent == 0 {
            return Self::constant(power);
        }
        self.one(power, self.value.powi(exponent.saturating_sub(1)) * f64::from(exponent))
    }

    #[inline(always)]
    fn abs(self) -> Self {
        self.one(self.value.abs(), R::select_lt(self.value, R::zero(), R::from(-1.0), R::one()))
    }

    #[inline(always)]
    fn select_lt(a: Self, b: Self, yes: Self, no: Self) -> Self {
        let select = |yes, no| R::select_lt(a.value, b.value, yes, no);
        let slopes = [select(R::one(), R::zero()), select(R::zero(), R::one())];
        yes.two_with(Zero::Unselected, no, select(yes.value, no.value), slopes)
    }

    #[inline(always)]
    fn any_lt(a: Self, b: Self) -> bool {
        R::any_lt(a.value, b.value)
    }
}
