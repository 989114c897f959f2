//! [`Dual`]: forward mode over any scalar, which the default derivatives run on.
//!
//! The checks run on num-dual's numbers instead, which share nothing with these.

use super::Scalar;
use std::ops::{Add, AddAssign, Div, DivAssign, Mul, MulAssign, Neg, Sub, SubAssign};

/// A number with its derivatives in `N` directions, over any [`Scalar`]: over [`Lanes`](super::Lanes), of several samples at once,
/// over [`Counted`](super::Counted), one whose operations count.
///
/// Its value goes through the operations that the plain number does, and has its bits. There is no branch on what the
/// directions are: a constant has derivatives that are 0, and costs what any other number does.
///
/// ```
/// use physgrad::{Dual, Scalar};
///
/// let x: Dual<f64, 1> = Dual::variable(3.0, 0);
/// let y = x * x + Dual::constant(1.0);
/// assert_eq!((y.value, y.tangents), (10.0, [6.0]));
/// ```
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Dual<T, const N: usize> {
    /// The number.
    pub value: T,
    /// Its derivatives.
    pub tangents: [T; N],
}

impl<T: Scalar, const N: usize> Dual<T, N> {
    /// A constant.
    #[inline(always)]
    pub fn constant(value: T) -> Self {
        Self { value, tangents: [T::zero(); N] }
    }

    /// `value`, as the `index`-th variable.
    #[inline(always)]
    pub fn variable(value: T, index: usize) -> Self {
        let mut variable = Self::constant(value);
        variable.tangents[index] = T::one();
        variable
    }

    /// With this value, and each derivative by this rule.
    #[inline(always)]
    fn with(mut self, value: T, rule: impl Fn(T) -> T) -> Self {
        self.value = value;
        for k in 0..N {
            self.tangents[k] = rule(self.tangents[k]);
        }
        self
    }

    /// Of both numbers, with this value, and each derivative by this rule.
    #[inline(always)]
    fn join(mut self, other: Self, value: T, rule: impl Fn(T, T) -> T) -> Self {
        self.value = value;
        for k in 0..N {
            self.tangents[k] = rule(self.tangents[k], other.tangents[k]);
        }
        self
    }

    /// The chain rule for a slope that may be infinite: a constant has no derivative to blow up.
    #[inline(always)]
    fn steep(self, value: T, slope: T) -> Self {
        self.with(value, |tangent| T::select_lt(T::zero(), tangent.abs(), tangent * slope, tangent))
    }
}

impl<T: Scalar, const N: usize> Add for Dual<T, N> {
    type Output = Self;
    #[inline(always)]
    fn add(self, other: Self) -> Self {
        self.join(other, self.value + other.value, |a, b| a + b)
    }
}

impl<T: Scalar, const N: usize> Sub for Dual<T, N> {
    type Output = Self;
    #[inline(always)]
    fn sub(self, other: Self) -> Self {
        self.join(other, self.value - other.value, |a, b| a - b)
    }
}

impl<T: Scalar, const N: usize> Mul for Dual<T, N> {
    type Output = Self;
    #[inline(always)]
    #[allow(clippy::suspicious_arithmetic_impl, reason = "the product rule is a sum")]
    fn mul(self, other: Self) -> Self {
        self.join(other, self.value * other.value, |a, b| a * other.value + self.value * b)
    }
}

impl<T: Scalar, const N: usize> Div for Dual<T, N> {
    type Output = Self;
    #[inline(always)]
    fn div(self, other: Self) -> Self {
        let (value, inverse) = (self.value / other.value, T::one() / other.value);
        self.join(other, value, |a, b| (a - value * b) * inverse)
    }
}

impl<T: Scalar, const N: usize> Neg for Dual<T, N> {
    type Output = Self;
    #[inline(always)]
    fn neg(self) -> Self {
        self.with(-self.value, |tangent| -tangent)
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
    )+};
}
assign!(AddAssign add_assign +, SubAssign sub_assign -, MulAssign mul_assign *, DivAssign div_assign /);

impl<T: Scalar, const N: usize> Scalar for Dual<T, N> {
    type Real = T::Real;

    #[inline(always)]
    fn lift(value: f64) -> Self {
        Self::constant(T::lift(value))
    }

    #[inline(always)]
    fn detach(self) -> Self {
        Self::constant(self.value.detach())
    }

    #[inline(always)]
    fn sqrt(self) -> Self {
        let root = self.value.sqrt();
        self.steep(root, T::lift(0.5) / root)
    }

    #[inline(always)]
    fn exp(self) -> Self {
        let e = self.value.exp();
        self.with(e, |tangent| tangent * e)
    }

    #[inline(always)]
    fn ln(self) -> Self {
        self.steep(self.value.ln(), T::one() / self.value)
    }

    #[inline(always)]
    fn sin_cos(self) -> (Self, Self) {
        let (sin, cos) = self.value.sin_cos();
        let down = -sin;
        (self.with(sin, |tangent| tangent * cos), self.with(cos, |tangent| tangent * down))
    }

    #[inline(always)]
    fn tanh(self) -> Self {
        let t = self.value.tanh();
        let slope = T::one() - t * t;
        self.with(t, |tangent| tangent * slope)
    }

    #[inline(always)]
    fn atan2(self, x: Self) -> Self {
        let square = self.value * self.value + x.value * x.value;
        let (across, along) = (self.steep(T::zero(), x.value / square), x.steep(T::zero(), self.value / square));
        across.join(along, self.value.atan2(x.value), |a, b| a - b)
    }

    #[inline(always)]
    fn abs(self) -> Self {
        self.with(self.value.abs(), |tangent| T::select_lt(self.value, T::zero(), -tangent, tangent))
    }

    #[inline(always)]
    fn select_lt(a: Self, b: Self, yes: Self, no: Self) -> Self {
        let select = |yes, no| T::select_lt(a.value, b.value, yes, no);
        yes.join(no, select(yes.value, no.value), select)
    }

    #[inline(always)]
    fn any_lt(a: Self, b: Self) -> bool {
        T::any_lt(a.value, b.value)
    }
}
