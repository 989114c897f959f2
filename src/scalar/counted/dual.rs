//! [`CountedDual`]: what the derivatives of a [`Counted`](super::Counted) run on.

use super::{Counts, FUNCTION, operator};
use crate::forward_mode::CHUNK;
use crate::scalar::{Real, Scalar, Tangents};
use std::ops::{Add, AddAssign, Div, DivAssign, Mul, MulAssign, Neg, Sub, SubAssign};

/// What the derivatives of an `f64` run on.
type Dual = <f64 as Real>::Dual;

/// The dual number of an `f64`, and it counts the plain operations it does: num-dual's for arithmetic, the chain rules of
/// [`dual`](crate::scalar::dual) for the functions.
#[derive(Clone, Copy, Debug)]
pub struct CountedDual(Dual);

impl CountedDual {
    /// Tangents it carries; a constant has none, and then nothing is done with them.
    fn carried(&self) -> u64 {
        if self.0.eps.0.is_some() { CHUNK as u64 } else { 0 }
    }

    /// Counts a function of `self`: one of `value`'s kind, what the slope costs, and the slope times each tangent, for
    /// so many `results`.
    fn note(&self, results: u64, function: Counts) {
        (function + Counts { multiply: results * self.carried(), ..Counts::NONE }).note();
    }
}

operator!(CountedDual, Add, add, AddAssign, add_assign, |a, b| {
    Counts { add: 1 + a.carried().min(b.carried()), ..Counts::NONE }
});
operator!(CountedDual, Sub, sub, SubAssign, sub_assign, |a, b| {
    let (a, b) = (a.carried(), b.carried());
    // From a constant, the tangents only change their sign.
    Counts { add: 1 + a.min(b), negate: b - a.min(b), ..Counts::NONE }
});
// (a b)' = a' b + b' a.
operator!(CountedDual, Mul, mul, MulAssign, mul_assign, |a, b| {
    let (a, b) = (a.carried(), b.carried());
    Counts { multiply: 1 + a + b, add: a.min(b), ..Counts::NONE }
});
// i = 1 / b; a / b = a i; (a / b)' = (a' b - b' a) i i.
operator!(CountedDual, Div, div, DivAssign, div_assign, |a, b| {
    let (a, b) = (a.carried(), b.carried());
    Counts { divide: 1, multiply: 1 + a + b + 2 * a.max(b), add: a.min(b), negate: b - a.min(b), ..Counts::NONE }
});

impl Neg for CountedDual {
    type Output = Self;
    #[inline(never)]
    fn neg(self) -> Self {
        Counts { negate: 1 + self.carried(), ..Counts::NONE }.note();
        Self(-self.0)
    }
}

impl Scalar for CountedDual {
    type Real = f64;
    #[inline]
    fn lift(value: f64) -> Self {
        Self(Dual::lift(value))
    }
    #[inline]
    fn detach(self) -> Self {
        Self(self.0.detach())
    }
    #[inline(never)]
    fn sqrt(self) -> Self {
        // Slope: 0.5 / root.
        self.note(1, Counts { sqrt: 1, divide: 1, ..Counts::NONE });
        Self(Scalar::sqrt(self.0))
    }
    #[inline(never)]
    fn exp(self) -> Self {
        self.note(1, FUNCTION);
        Self(Scalar::exp(self.0))
    }
    #[inline(never)]
    fn ln(self) -> Self {
        // Slope: 1 / value.
        self.note(1, Counts { divide: 1, ..FUNCTION });
        Self(Scalar::ln(self.0))
    }
    #[inline(never)]
    fn sin_cos(self) -> (Self, Self) {
        // Slopes: cos and -sin.
        self.note(2, Counts { negate: 1, ..FUNCTION });
        let (sin, cos) = Scalar::sin_cos(self.0);
        (Self(sin), Self(cos))
    }
    #[inline(never)]
    fn tanh(self) -> Self {
        // Slope: 1 - t t.
        self.note(1, Counts { add: 1, multiply: 1, ..FUNCTION });
        Self(Scalar::tanh(self.0))
    }
    #[inline(never)]
    fn atan2(self, x: Self) -> Self {
        // Slopes: x / (y y + x x) and -y / (y y + x x); the two chains are added, values too.
        let both = self.carried().min(x.carried());
        x.note(1, Counts { add: 2 + both, negate: 1, multiply: 2, divide: 2, ..FUNCTION });
        self.note(1, Counts::NONE);
        Self(Scalar::atan2(self.0, x.0))
    }
    #[inline(never)]
    fn select_lt(a: Self, b: Self, yes: Self, no: Self) -> Self {
        Counts { compare: 1, ..Counts::NONE }.note();
        Self(Scalar::select_lt(a.0, b.0, yes.0, no.0))
    }
    #[inline(never)]
    fn any_lt(a: Self, b: Self) -> bool {
        Counts { compare: 1, ..Counts::NONE }.note();
        Scalar::any_lt(a.0, b.0)
    }
}

impl Tangents<CHUNK> for CountedDual {
    #[inline]
    fn seeded(value: f64, tangents: [f64; CHUNK]) -> Self {
        Self(Dual::seeded(value, tangents))
    }
    #[inline]
    fn constant(value: f64) -> Self {
        Self(Dual::constant(value))
    }
    #[inline]
    fn value(&self) -> f64 {
        self.0.value()
    }
    #[inline]
    fn tangents(&self) -> [f64; CHUNK] {
        self.0.tangents()
    }
}
