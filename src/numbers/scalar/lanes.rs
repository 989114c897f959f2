//! [`Lanes`]: several samples in one number, so that simulators use SIMD registers.

use super::{Float, Real, Scalar};
use crate::numbers::kernels::trig;
use crate::numbers::tape::Tape;
use std::cell::RefCell;
use std::iter::Sum;
use std::ops::{Add, AddAssign, Div, DivAssign, Mul, MulAssign, Neg, Sub, SubAssign};

/// Number of samples that one call of the physics steps, and of columns in a block of a policy.
pub(crate) const LANES: usize = 8;

/// One number of each of [`LANES`] samples.
pub(crate) type Lane<F> = Lanes<F, LANES>;

/// `W` numbers with elementwise operations, where `W` is 1, 2, 4 or 8.
///
/// Every lane is bit-identical to the computation on a plain `F`: no operation is fused, reordered
/// or approximated differently. Results are equal on all processors, except for `exp`, `ln`,
/// `powf`, `atan2` and the sine and cosine of angles beyond 1e6, which the platform's library
/// computes.
#[derive(Clone, Copy, Debug, PartialEq)]
#[repr(align(32))]
pub struct Lanes<F, const W: usize>(pub [F; W]);

/// One number of the precision `F`, as a [`Scalar`].
pub type Single<F> = Lanes<F, 1>;

macro_rules! operator {
    ($width:literal, [$($i:tt)+], $trait:ident, $method:ident, $assign_trait:ident, $assign:ident) => {
        impl<F: Float> $trait for Lanes<F, $width> {
            type Output = Self;
            #[inline(always)]
            fn $method(self, other: Self) -> Self {
                Self([$(self.0[$i].$method(other.0[$i])),+])
            }
        }
        impl<F: Float> $assign_trait for Lanes<F, $width> {
            #[inline(always)]
            fn $assign(&mut self, other: Self) {
                *self = self.$method(other);
            }
        }
        impl<F: Float> $trait<f64> for Lanes<F, $width> {
            type Output = Self;
            #[inline(always)]
            fn $method(self, other: f64) -> Self {
                self.$method(Self::from(other))
            }
        }
        impl<F: Float> $assign_trait<f64> for Lanes<F, $width> {
            #[inline(always)]
            fn $assign(&mut self, other: f64) {
                *self = self.$method(other);
            }
        }
    };
}

// Unrolled by the macro: loops over lanes slow compilation.
macro_rules! lanes {
    ($width:literal $tape:ident: $($i:tt)+) => {
        operator!($width, [$($i)+], Add, add, AddAssign, add_assign);
        operator!($width, [$($i)+], Sub, sub, SubAssign, sub_assign);
        operator!($width, [$($i)+], Mul, mul, MulAssign, mul_assign);
        operator!($width, [$($i)+], Div, div, DivAssign, div_assign);

        impl<F: Float> From<f64> for Lanes<F, $width> {
            #[inline(always)]
            fn from(value: f64) -> Self {
                Self([F::from_f64(value); $width])
            }
        }

        impl<F: Float> Sum for Lanes<F, $width> {
            #[inline(always)]
            fn sum<I: Iterator<Item = Self>>(values: I) -> Self {
                values.fold(Self([-F::zero(); $width]), |sum, value| sum + value)
            }
        }

        impl<F: Float> Neg for Lanes<F, $width> {
            type Output = Self;
            #[inline(always)]
            fn neg(self) -> Self {
                Self([$(-self.0[$i]),+])
            }
        }

        impl<F: Float> Scalar for Lanes<F, $width> {
            type Real = F;
            const VECTORIZED: bool = $width >= 8;
            #[inline(always)]
            fn detach(self) -> Self {
                self
            }
            #[inline(always)]
            fn sqrt(self) -> Self {
                Self([$(Float::sqrt(self.0[$i])),+])
            }
            #[inline(always)]
            fn exp(self) -> Self {
                Self([$(Float::exp(self.0[$i])),+])
            }
            #[inline(always)]
            fn ln(self) -> Self {
                Self([$(Float::ln(self.0[$i])),+])
            }
            #[inline(always)]
            fn sin_cos(self) -> (Self, Self) {
                let reach = F::from_f64(trig::REACH);
                let far = false $(| (Float::abs(self.0[$i]) > reach))+;
                let pairs = if far { [$(Float::sin_cos(self.0[$i])),+] } else { [$(F::sin_cos_near(self.0[$i])),+] };
                (Self([$(pairs[$i].0),+]), Self([$(pairs[$i].1),+]))
            }
            #[inline(always)]
            fn tanh(self) -> Self {
                Self([$(Float::tanh(self.0[$i])),+])
            }
            #[inline(always)]
            fn atan2(self, x: Self) -> Self {
                Self([$(Float::atan2(self.0[$i], x.0[$i])),+])
            }
            #[inline(always)]
            fn powf(self, exponent: f64) -> Self {
                Self([$(Float::powf(self.0[$i], exponent)),+])
            }
            #[inline(always)]
            fn select_lt(a: Self, b: Self, yes: Self, no: Self) -> Self {
                Self([$(if a.0[$i] < b.0[$i] { yes.0[$i] } else { no.0[$i] }),+])
            }
            #[inline(always)]
            fn any_lt(a: Self, b: Self) -> bool {
                $(a.0[$i] < b.0[$i])||+
            }
            #[inline(always)]
            fn abs(self) -> Self {
                Self([$(Float::abs(self.0[$i])),+])
            }
        }

        impl<F: Float> Real for Lanes<F, $width> {
            const LANES: usize = $width;
            #[inline(always)]
            fn lane(&self, lane: usize) -> F {
                self.0[lane]
            }
            #[inline(always)]
            fn set_lane(&mut self, lane: usize, value: F) {
                self.0[lane] = value;
            }
            #[inline(always)]
            fn is_finite(&self) -> bool {
                $(Float::abs(self.0[$i]) <= F::from_f64(F::MAX))&&+
            }
            #[inline(always)]
            fn tape() -> &'static RefCell<Tape<Self>> {
                &F::tapes().$tape
            }
        }
    };
}
lanes!(1 one: 0);
lanes!(2 two: 0 1);
lanes!(4 four: 0 1 2 3);
lanes!(8 eight: 0 1 2 3 4 5 6 7);
