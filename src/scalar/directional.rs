//! Forward mode over any scalar, in one direction.
//!
//! Its operations are calls: of double-doubles, each has a hundred instructions, and a step has hundreds of operations.

use super::Scalar;
use std::ops::{Add, AddAssign, Div, DivAssign, Mul, MulAssign, Neg, Sub, SubAssign};

/// A number and its derivative in one direction. num-dual's numbers do the same, with several directions at once, for
/// `f32` and `f64`; this is for scalars that they cannot be made of.
#[derive(Clone, Copy, Debug)]
pub struct Directional<T> {
    /// The number.
    pub value: T,
    /// Its derivative.
    pub slope: T,
}

impl<T: Scalar> Directional<T> {
    /// `f(self)`, where f has this value and derivative. A constant has no slope to blow up where f has an infinite one.
    fn chain(self, value: T, derivative: T) -> Self {
        let moves = T::select_lt(T::zero(), self.slope.abs(), self.slope * derivative, self.slope);
        Self { value, slope: moves }
    }
}

impl<T: Scalar> Add for Directional<T> {
    type Output = Self;
    #[inline(never)]
    fn add(self, other: Self) -> Self {
        Self { value: self.value + other.value, slope: self.slope + other.slope }
    }
}

impl<T: Scalar> Sub for Directional<T> {
    type Output = Self;
    #[inline(never)]
    fn sub(self, other: Self) -> Self {
        Self { value: self.value - other.value, slope: self.slope - other.slope }
    }
}

impl<T: Scalar> Mul for Directional<T> {
    type Output = Self;
    #[inline(never)]
    fn mul(self, other: Self) -> Self {
        Self { value: self.value * other.value, slope: self.slope * other.value + self.value * other.slope }
    }
}

impl<T: Scalar> Div for Directional<T> {
    type Output = Self;
    #[inline(never)]
    fn div(self, other: Self) -> Self {
        let value = self.value / other.value;
        Self { value, slope: (self.slope - value * other.slope) / other.value }
    }
}

impl<T: Scalar> Neg for Directional<T> {
    type Output = Self;
    fn neg(self) -> Self {
        Self { value: -self.value, slope: -self.slope }
    }
}

macro_rules! assign {
    ($($trait:ident $method:ident $operator:tt),+) => {$(
        impl<T: Scalar> $trait for Directional<T> {
            fn $method(&mut self, other: Self) {
                *self = *self $operator other;
            }
        }
    )+};
}
assign!(AddAssign add_assign +, SubAssign sub_assign -, MulAssign mul_assign *, DivAssign div_assign /);

impl<T: Scalar> Scalar for Directional<T> {
    type Real = T::Real;

    fn lift(value: f64) -> Self {
        Self { value: T::lift(value), slope: T::zero() }
    }

    fn detach(self) -> Self {
        Self { value: self.value.detach(), slope: T::zero() }
    }

    #[inline(never)]
    fn sqrt(self) -> Self {
        let root = self.value.sqrt();
        self.chain(root, T::lift(0.5) / root)
    }

    #[inline(never)]
    fn exp(self) -> Self {
        let e = self.value.exp();
        self.chain(e, e)
    }

    #[inline(never)]
    fn ln(self) -> Self {
        self.chain(self.value.ln(), T::one() / self.value)
    }

    #[inline(never)]
    fn sin_cos(self) -> (Self, Self) {
        let (sin, cos) = self.value.sin_cos();
        (self.chain(sin, cos), self.chain(cos, -sin))
    }

    #[inline(never)]
    fn tanh(self) -> Self {
        let t = self.value.tanh();
        self.chain(t, T::one() - t * t)
    }

    #[inline(never)]
    fn atan2(self, x: Self) -> Self {
        let square = self.value * self.value + x.value * x.value;
        self.chain(self.value.atan2(x.value), x.value / square) + x.chain(T::zero(), -self.value / square)
    }

    fn select_lt(a: Self, b: Self, yes: Self, no: Self) -> Self {
        let select = |yes, no| T::select_lt(a.value, b.value, yes, no);
        Self { value: select(yes.value, no.value), slope: select(yes.slope, no.slope) }
    }

    fn any_lt(a: Self, b: Self) -> bool {
        T::any_lt(a.value, b.value)
    }
}
