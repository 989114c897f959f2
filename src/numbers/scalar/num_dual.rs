//! num-dual's numbers as [`Scalar`]s: what every derivative is checked with.
//!
//! Arithmetic is num-dual's. The elementary functions are chain rules over the plain number's own function, so that a
//! dual's value has that number's bits; num-dual's `tanh` would overflow (sinh/cosh), and its `sqrt` and `ln` would make
//! a NaN of the zero tangent of a constant 0.

use super::Scalar;
use num_dual::Dual64;

/// Chain rule with a known value and slope. A zero tangent stays zero even where the slope is infinite: a constant has
/// no derivative to blow up.
#[inline]
fn chain(dual: Dual64, value: f64, slope: f64) -> Dual64 {
    Dual64::new(value, if dual.eps == 0.0 { 0.0 } else { dual.eps * slope })
}

impl Scalar for Dual64 {
    type Real = f64;
    #[inline]
    fn lift(value: f64) -> Self {
        Self::from_re(value)
    }
    #[inline]
    fn detach(self) -> Self {
        Self::from_re(self.re)
    }
    #[inline]
    fn sqrt(self) -> Self {
        let root = Scalar::sqrt(self.re);
        chain(self, root, 0.5 / root)
    }
    #[inline]
    fn exp(self) -> Self {
        let e = Scalar::exp(self.re);
        chain(self, e, e)
    }
    #[inline]
    fn ln(self) -> Self {
        chain(self, Scalar::ln(self.re), 1.0 / self.re)
    }
    #[inline]
    fn sin_cos(self) -> (Self, Self) {
        let (sin, cos) = Scalar::sin_cos(self.re);
        (chain(self, sin, cos), chain(self, cos, -sin))
    }
    #[inline]
    fn tanh(self) -> Self {
        let t = Scalar::tanh(self.re);
        chain(self, t, 1.0 - t * t)
    }
    #[inline]
    fn atan2(self, x: Self) -> Self {
        let square = self.re * self.re + x.re * x.re;
        chain(self, Scalar::atan2(self.re, x.re), x.re / square) + chain(x, 0.0, -self.re / square)
    }
    #[inline]
    fn select_lt(a: Self, b: Self, yes: Self, no: Self) -> Self {
        if a.re < b.re { yes } else { no }
    }
    #[inline]
    fn any_lt(a: Self, b: Self) -> bool {
        a.re < b.re
    }
}
