//! Several samples in one number, so that a simulator written for one sample runs on a vector register of them.

use super::{Float, Real, Scalar};
use crate::kernels::trig;
use std::ops::{Add, AddAssign, Div, DivAssign, Mul, MulAssign, Neg, Sub, SubAssign};

/// `W` numbers that go through the same operations.
///
/// Every lane has the bits that the same computation on a plain `F` would have: no operation is fused, reordered or
/// approximated differently. They are the same on every processor, but for `exp`, `ln`, `atan2` and angles beyond 1e6,
/// which the platform's library computes.
#[derive(Clone, Copy, Debug, PartialEq)]
#[repr(align(32))]
pub struct Lanes<F, const W: usize>(pub [F; W]);

impl<F: Float, const W: usize> Lanes<F, W> {
    #[inline(always)]
    fn map(mut self, f: impl Fn(F) -> F) -> Self {
        for lane in &mut self.0 {
            *lane = f(*lane);
        }
        self
    }
}

macro_rules! operator {
    ($trait:ident, $method:ident, $assign_trait:ident, $assign:ident) => {
        impl<F: Float, const W: usize> $trait for Lanes<F, W> {
            type Output = Self;
            #[inline(always)]
            fn $method(mut self, other: Self) -> Self {
                for i in 0..W {
                    self.0[i] = self.0[i].$method(other.0[i]);
                }
                self
            }
        }
        impl<F: Float, const W: usize> $assign_trait for Lanes<F, W> {
            #[inline(always)]
            fn $assign(&mut self, other: Self) {
                *self = self.$method(other);
            }
        }
    };
}
operator!(Add, add, AddAssign, add_assign);
operator!(Sub, sub, SubAssign, sub_assign);
operator!(Mul, mul, MulAssign, mul_assign);
operator!(Div, div, DivAssign, div_assign);

impl<F: Float, const W: usize> Neg for Lanes<F, W> {
    type Output = Self;
    #[inline(always)]
    fn neg(self) -> Self {
        self.map(|x| -x)
    }
}

impl<F: Float, const W: usize> Scalar for Lanes<F, W> {
    type Real = F;
    const WIDE: bool = W >= 8;
    #[inline(always)]
    fn lift(value: f64) -> Self {
        Self([F::lift(value); W])
    }
    #[inline(always)]
    fn detach(self) -> Self {
        self
    }
    #[inline(always)]
    fn sqrt(self) -> Self {
        self.map(Scalar::sqrt)
    }
    #[inline(always)]
    fn exp(self) -> Self {
        self.map(Scalar::exp)
    }
    #[inline(always)]
    fn ln(self) -> Self {
        self.map(Scalar::ln)
    }
    #[inline(always)]
    fn sin_cos(self) -> (Self, Self) {
        let reach = F::lift(trig::REACH);
        let mut far = false;
        for x in self.0 {
            far |= Scalar::abs(x) > reach;
        }
        let (mut sin, mut cos) = (self, self);
        if far {
            for i in 0..W {
                (sin.0[i], cos.0[i]) = Scalar::sin_cos(self.0[i]);
            }
        } else {
            for i in 0..W {
                (sin.0[i], cos.0[i]) = F::sin_cos_near(self.0[i]);
            }
        }
        (sin, cos)
    }
    #[inline(always)]
    fn tanh(self) -> Self {
        self.map(Scalar::tanh)
    }
    #[inline(always)]
    fn atan2(mut self, x: Self) -> Self {
        for i in 0..W {
            self.0[i] = Scalar::atan2(self.0[i], x.0[i]);
        }
        self
    }
    #[inline(always)]
    fn select_lt(a: Self, b: Self, yes: Self, no: Self) -> Self {
        let mut chosen = no;
        for i in 0..W {
            chosen.0[i] = if a.0[i] < b.0[i] { yes.0[i] } else { no.0[i] };
        }
        chosen
    }
}

impl<F: Float, const W: usize> Real for Lanes<F, W> {
    type Dual = <F as Real>::Dual;
    const LANES: usize = W;
    #[inline(always)]
    fn lane(&self, lane: usize) -> F {
        self.0[lane]
    }
    #[inline(always)]
    fn set_lane(&mut self, lane: usize, value: F) {
        self.0[lane] = value;
    }
}
