//! [`Scalar`] for the dual numbers of the crate num-dual, used by checks of derivatives.
//!
//! Arithmetic is that of num-dual. Elementary functions apply the chain rule to the function of the
//! plain number, so their values equal those of `f64`. In num-dual, `tanh` overflows (sinh/cosh),
//! and `sqrt` and `ln` return NaN tangents for a constant 0. Unlike a quotient of
//! [`Dual`](super::Dual) numbers, a quotient by infinity has NaN tangents if the tangent of the
//! divisor is infinite.

use super::Scalar;
use num_dual::Dual64;

/// Chain rule with a known value and slope. Zero tangents stay 0 even if the slope is infinite.
#[inline]
fn chain(dual: Dual64, value: f64, slope: f64) -> Dual64 {
    Dual64::new(value, if dual.eps == 0.0 { 0.0 } else { dual.eps * slope })
}

impl Scalar for Dual64 {
    const DIFFERENTIATES: bool = true;
    type Real = f64;
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
        // The sine and cosine of the angle are accurate at any distance from the origin.
        let (angle, distance) = (Scalar::atan2(self.re, x.re), f64::hypot(self.re, x.re));
        let (sin, cos) = (self.re / distance, x.re / distance);
        chain(self, angle, cos / distance) + chain(x, 0.0, -sin / distance)
    }
    #[inline]
    fn powf(self, exponent: f64) -> Self {
        let slope = if exponent == 0.0 { 0.0 } else { exponent * self.re.powf(exponent - 1.0) };
        chain(self, self.re.powf(exponent), slope)
    }
    #[inline]
    fn powi(self, exponent: i32) -> Self {
        let slope =
            if exponent == 0 { 0.0 } else { f64::from(exponent) * self.re.powi(exponent - 1) };
        chain(self, Scalar::powi(self.re, exponent), slope)
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
