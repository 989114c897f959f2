//! [`Dual`]: forward-mode differentiation over any scalar, used by the default derivatives.
//!
//! Checks use the independent dual numbers of the crate num-dual.

use super::{Over, Scalar, Scaled, arcsine_slope};
use std::iter::Sum;
use std::ops::{Add, AddAssign, Div, DivAssign, Mul, MulAssign, Neg, Sub, SubAssign};

/// A dual number: a value with its derivatives in `N` directions.
///
/// Generic over the scalar: [`Lanes`](super::Lanes) differentiate several samples at once,
/// [`Counted`](super::Counted) counts operations.
///
/// Values are bit-identical to those of the scalar `T`. Dual constants have zero tangents and cost
/// as much as variables: there is no branch on tangents.
///
/// ```
/// use physgrad::{Scalar, scalar::Dual};
///
/// let x: Dual<f64, 1> = Dual::variable(3.0, 0);
/// let y = x * x + Dual::constant(1.0);
/// assert_eq!((y.value, y.tangents), (10.0, [6.0]));
/// ```
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Dual<T, const N: usize> {
    /// Value.
    pub value: T,
    /// Derivatives of the value, one per direction.
    pub tangents: [T; N],
}

impl<T: Scalar, const N: usize> Dual<T, N> {
    /// A constant: all tangents are 0.
    #[inline(always)]
    pub fn constant(value: T) -> Self {
        Self { value, tangents: [T::zero(); N] }
    }

    /// A variable: tangent `index` is 1, the others are 0.
    #[inline(always)]
    pub fn variable(value: T, index: usize) -> Self {
        let mut variable = Self::constant(value);
        variable.tangents[index] = T::one();
        variable
    }

    /// Applies a unary rule: sets the value and maps each tangent.
    #[inline(always)]
    fn unary(mut self, value: T, rule: impl Fn(T) -> T) -> Self {
        self.value = value;
        for k in 0..N {
            self.tangents[k] = rule(self.tangents[k]);
        }
        self
    }

    /// Applies a binary rule: sets the value and combines the tangents of both numbers.
    #[inline(always)]
    fn binary(mut self, other: Self, value: T, rule: impl Fn(T, T) -> T) -> Self {
        self.value = value;
        for k in 0..N {
            self.tangents[k] = rule(self.tangents[k], other.tangents[k]);
        }
        self
    }

    /// Chain rule for a slope that may be infinite or NaN: tangents of 0 then stay 0 instead of
    /// NaN.
    ///
    /// A tangent whose value is 0 may itself have tangents, in second derivatives. A finite slope
    /// therefore multiplies every tangent. Beside an infinite slope, they are 0 too.
    #[inline(always)]
    fn unary_if_nonzero(self, value: T, slope: T) -> Self {
        let (size, infinity) = (slope.abs(), T::from(f64::INFINITY));
        self.unary(value, |tangent| {
            let product = tangent * slope;
            let nonzero = T::select_lt(T::zero(), tangent.abs(), product, tangent.detach());
            T::select_lt(size, infinity, product, nonzero)
        })
    }
}

impl<T: Scalar, const N: usize> Over<T> for Dual<T, N> {
    #[inline(always)]
    fn constant(value: T) -> Self {
        Dual::constant(value)
    }
}

impl<T: Scalar, const N: usize> Add for Dual<T, N> {
    type Output = Self;
    #[inline(always)]
    fn add(self, other: Self) -> Self {
        self.binary(other, self.value + other.value, |a, b| a + b)
    }
}

impl<T: Scalar, const N: usize> Sub for Dual<T, N> {
    type Output = Self;
    #[inline(always)]
    fn sub(self, other: Self) -> Self {
        self.binary(other, self.value - other.value, |a, b| a - b)
    }
}

impl<T: Scalar, const N: usize> Mul for Dual<T, N> {
    type Output = Self;
    #[inline(always)]
    #[allow(clippy::suspicious_arithmetic_impl, reason = "the product rule is a sum")]
    fn mul(self, other: Self) -> Self {
        self.binary(other, self.value * other.value, |a, b| a * other.value + self.value * b)
    }
}

impl<T: Scalar, const N: usize> Div for Dual<T, N> {
    type Output = Self;
    /// Tangents of a quotient by infinity are 0, also if the divisor has an infinite tangent. The
    /// logistic function `1 / (1 + exp(-x))` of a large negative number is such a quotient.
    #[inline(always)]
    fn div(self, other: Self) -> Self {
        let (value, inverse) = (self.value / other.value, T::one() / other.value);
        let size = inverse.abs();
        self.binary(other, value, |a, b| {
            T::select_lt(T::zero(), size, (a - value * b) * inverse, inverse)
        })
    }
}

impl<T: Scalar, const N: usize> Neg for Dual<T, N> {
    type Output = Self;
    #[inline(always)]
    fn neg(self) -> Self {
        self.unary(-self.value, |tangent| -tangent)
    }
}

impl<T: Scalar, const N: usize> From<f64> for Dual<T, N> {
    #[inline(always)]
    fn from(value: f64) -> Self {
        Self::constant(T::from(value))
    }
}

impl<T: Scalar, const N: usize> Sum for Dual<T, N> {
    #[inline(always)]
    fn sum<I: Iterator<Item = Self>>(values: I) -> Self {
        values.fold(Self::from(-0.0), |sum, value| sum + value)
    }
}

impl<T: Scalar, const N: usize> Add<f64> for Dual<T, N> {
    type Output = Self;
    #[inline(always)]
    fn add(self, other: f64) -> Self {
        Self { value: self.value + other, ..self }
    }
}

impl<T: Scalar, const N: usize> Sub<f64> for Dual<T, N> {
    type Output = Self;
    #[inline(always)]
    fn sub(self, other: f64) -> Self {
        Self { value: self.value - other, ..self }
    }
}

impl<T: Scalar, const N: usize> Mul<f64> for Dual<T, N> {
    type Output = Self;
    #[inline(always)]
    fn mul(self, other: f64) -> Self {
        self.unary(self.value * other, |tangent| tangent * other)
    }
}

impl<T: Scalar, const N: usize> Div<f64> for Dual<T, N> {
    type Output = Self;
    #[inline(always)]
    fn div(self, other: f64) -> Self {
        self.unary(self.value / other, |tangent| tangent / other)
    }
}

macro_rules! assign {
    ($($trait:ident $method:ident $operator:tt),+) => {$(
        impl<T: Scalar, const N: usize> $trait for Dual<T, N> {
            #[inline(always)]
            fn $method(&mut self, other: Self) {
                *self = *self $operator other;
            }
        }
        impl<T: Scalar, const N: usize> $trait<f64> for Dual<T, N> {
            #[inline(always)]
            fn $method(&mut self, other: f64) {
                *self = *self $operator other;
            }
        }
    )+};
}
assign!(AddAssign add_assign +, SubAssign sub_assign -, MulAssign mul_assign *, DivAssign div_assign /);

impl<T: Scalar, const N: usize> Scalar for Dual<T, N> {
    const DIFFERENTIATES: bool = true;
    type Real = T::Real;

    #[inline(always)]
    fn detach(self) -> Self {
        Self::constant(self.value.detach())
    }

    #[inline(always)]
    fn sqrt(self) -> Self {
        let root = self.value.sqrt();
        self.unary_if_nonzero(root, T::from(0.5) / root)
    }

    #[inline(always)]
    fn exp(self) -> Self {
        let e = self.value.exp();
        self.unary(e, |tangent| tangent * e)
    }

    #[inline(always)]
    fn ln(self) -> Self {
        self.unary_if_nonzero(self.value.ln(), T::one() / self.value)
    }

    #[inline(always)]
    fn sin_cos(self) -> (Self, Self) {
        let (sin, cos) = self.value.sin_cos();
        let down = -sin;
        (self.unary(sin, |tangent| tangent * cos), self.unary(cos, |tangent| tangent * down))
    }

    #[inline(always)]
    fn tanh(self) -> Self {
        let t = self.value.tanh();
        let slope = T::one() - t * t;
        self.unary(t, |tangent| tangent * slope)
    }

    #[inline(always)]
    fn atan2(self, x: Self) -> Self {
        let [by_x, by_y] = Scaled::new(self.value, x.value).per_square();
        let (across, along) =
            (self.unary_if_nonzero(T::zero(), by_y), x.unary_if_nonzero(T::zero(), by_x));
        across.binary(along, self.value.atan2(x.value), |a, b| a - b)
    }

    #[inline(always)]
    fn hypot(self, other: Self) -> Self {
        let [x, y] = Scaled::new(self.value, other.value).direction();
        self.binary(other, self.value.hypot(other.value), |a, b| a * x + b * y)
    }

    #[inline(always)]
    fn asin(self) -> Self {
        self.unary_if_nonzero(self.value.asin(), arcsine_slope(self.value))
    }

    #[inline(always)]
    fn acos(self) -> Self {
        self.unary_if_nonzero(self.value.acos(), -arcsine_slope(self.value))
    }

    #[inline(always)]
    fn powf(self, exponent: f64) -> Self {
        let power = self.value.powf(exponent);
        if exponent == 0.0 {
            return Self::constant(power);
        }
        self.unary_if_nonzero(power, self.value.powf(exponent - 1.0) * exponent)
    }

    #[inline(always)]
    fn powi(self, exponent: i32) -> Self {
        let power = self.value.powi(exponent);
        if exponent == 0 {
            return Self::constant(power);
        }
        let slope = self.value.powi(exponent.saturating_sub(1)) * f64::from(exponent);
        if exponent < 0 {
            self.unary_if_nonzero(power, slope)
        } else {
            self.unary(power, |tangent| tangent * slope)
        }
    }

    #[inline(always)]
    fn abs(self) -> Self {
        self.unary(self.value.abs(), |tangent| {
            T::select_lt(self.value, T::zero(), -tangent, tangent)
        })
    }

    #[inline(always)]
    fn select_lt(a: Self, b: Self, yes: Self, no: Self) -> Self {
        let select = |yes, no| T::select_lt(a.value, b.value, yes, no);
        yes.binary(no, select(yes.value, no.value), select)
    }

    #[inline(always)]
    fn any_lt(a: Self, b: Self) -> bool {
        T::any_lt(a.value, b.value)
    }
}
