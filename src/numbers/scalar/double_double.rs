//! [`DoubleDouble`]: double-double numbers for reference solutions.

use super::Scalar;
use qd::Quad;
use std::iter::Sum;
use std::ops::{Add, AddAssign, Div, DivAssign, Mul, MulAssign, Neg, Sub, SubAssign};

/// A number with 31 digits, stored as the sum of two `f64`s (Dekker 1971, doi:10.1007/BF01397083).
///
/// A [`Scalar`] for reference solutions, much slower than `f64`. The crate `qd` provides the
/// arithmetic. The error of an arithmetic operation is about 1e-31, relative to the result. For
/// sums and differences, it is relative to the larger operand. Generic code converts its constants
/// from `f64`, so they equal those of an `f64` computation. The range is that of `f64`.
#[derive(Clone, Copy, Debug, PartialEq, PartialOrd)]
pub struct DoubleDouble(Quad);

impl DoubleDouble {
    /// π.
    pub const PI: Self = Self(Quad::PI);

    /// Rounds to `f64`.
    pub fn to_f64(self) -> f64 {
        self.0.0
    }

    /// The two `f64`s whose sum is the number, the larger first.
    pub fn parts(self) -> [f64; 2] {
        [self.0.0, self.0.1]
    }

    /// Integer part.
    pub fn trunc(self) -> Self {
        Self(self.0.trunc())
    }
}

impl From<f64> for DoubleDouble {
    fn from(value: f64) -> Self {
        Self(Quad(value, 0.0))
    }
}

impl Neg for DoubleDouble {
    type Output = Self;
    fn neg(self) -> Self {
        Self(-self.0)
    }
}

impl Sum for DoubleDouble {
    fn sum<I: Iterator<Item = Self>>(values: I) -> Self {
        values.fold(Self::from(-0.0), |sum, value| sum + value)
    }
}

macro_rules! operators {
    ($($trait:ident $method:ident $assign_trait:ident $assign:ident),+) => {$(
        impl $trait for DoubleDouble {
            type Output = Self;
            fn $method(self, other: Self) -> Self {
                let result = self.0.$method(other.0);
                // The corrections of `qd` are NaN beside infinities and zero divisors.
                let is_finite = result.0.is_finite() && result.1.is_finite();
                if is_finite { Self(result) } else { Self::from(self.0.0.$method(other.0.0)) }
            }
        }
        impl $trait<f64> for DoubleDouble {
            type Output = Self;
            fn $method(self, other: f64) -> Self {
                self.$method(Self::from(other))
            }
        }
        impl $assign_trait for DoubleDouble {
            fn $assign(&mut self, other: Self) {
                *self = self.$method(other);
            }
        }
        impl $assign_trait<f64> for DoubleDouble {
            fn $assign(&mut self, other: f64) {
                *self = self.$method(other);
            }
        }
    )+};
}
operators!(Add add AddAssign add_assign, Sub sub SubAssign sub_assign, Mul mul MulAssign mul_assign, Div div DivAssign div_assign);

/// Largest exponent whose power is a product of the number with itself.
const WHOLE: f64 = 64.0;

/// `1/n!` for n from 0 to 29.
const INVERSE_FACTORIALS: [Quad; 30] = {
    let mut all = [Quad::ONE; 30];
    let mut n = 2;
    while n < all.len() {
        all[n] = all[n - 1].const_div(Quad(n as f64, 0.0));
        n += 1;
    }
    all
};

/// `Σ_k sign^k x^(2k) / (first + 2k)!`, with factorials up to 29!.
fn series(x_squared: Quad, first: usize, sign: f64) -> Quad {
    let signed = x_squared * Quad(sign, 0.0);
    let terms = INVERSE_FACTORIALS[first..].iter().step_by(2);
    terms.rev().fold(Quad::ZERO, |sum, &term| sum * signed + term)
}

/// Functions that the crate `qd` lacks.
trait Functions: Sized {
    fn sin_cos(self) -> (Self, Self);
    fn tanh(self) -> Self;
    fn atan2(self, x: Self) -> Self;
}

impl Functions for Quad {
    /// The absolute error grows by up to 1e-31 per revolution of the angle.
    fn sin_cos(self) -> (Self, Self) {
        // π/2 in three parts: the product of `quarter` and the first is exact in double-double.
        const HALF_PI: [f64; 3] =
            [std::f64::consts::FRAC_PI_2, 6.123_233_995_736_766e-17, -1.497_384_904_859_169_8e-33];
        let quarter = (self.0 / HALF_PI[0]).round();
        let rest =
            HALF_PI.iter().fold(self, |rest, &part| rest - Quad(quarter, 0.0) * Quad(part, 0.0));
        let square = rest * rest;
        let (sin, cos) = (rest * series(square, 1, -1.0), series(square, 0, -1.0));
        match quarter.rem_euclid(4.0) {
            0.0 => (sin, cos),
            1.0 => (cos, -sin),
            2.0 => (-sin, -cos),
            // 3, and NaN for a non-finite angle, where sine and cosine are NaN.
            _ => (-cos, sin),
        }
    }

    fn tanh(self) -> Self {
        let size = if self.0 < 0.0 { -self } else { self };
        let positive = if size.0 < 0.5 {
            // Avoids cancellation in the quotient of exponentials.
            let sinh = size * series(size * size, 1, 1.0);
            sinh / Quad::sqrt(Quad::ONE + sinh * sinh)
        } else {
            let decayed = Quad::exp(size * Quad(-2.0, 0.0));
            (Quad::ONE - decayed) / (Quad::ONE + decayed)
        };
        if self.0 < 0.0 { -positive } else { positive }
    }

    fn atan2(self, x: Self) -> Self {
        let near = Quad(self.0.atan2(x.0), 0.0);
        // The remaining angle equals its tangent to double-double precision.
        let (sin, cos) = near.sin_cos();
        let (across, along) = (self * cos - x * sin, x * cos + self * sin);
        if along.0 == 0.0 { near } else { near + across / along }
    }
}

impl Scalar for DoubleDouble {
    type Real = f64;

    fn detach(self) -> Self {
        self
    }

    fn sqrt(self) -> Self {
        Self(Quad::sqrt(self.0))
    }

    fn exp(self) -> Self {
        Self(Quad::exp(self.0))
    }

    fn ln(self) -> Self {
        Self(Quad::ln(self.0))
    }

    fn sin_cos(self) -> (Self, Self) {
        let (sin, cos) = Functions::sin_cos(self.0);
        (Self(sin), Self(cos))
    }

    fn tanh(self) -> Self {
        Self(Functions::tanh(self.0))
    }

    fn atan2(self, x: Self) -> Self {
        Self(Functions::atan2(self.0, x.0))
    }

    fn powf(self, exponent: f64) -> Self {
        let size = self.abs();
        let whole = exponent == exponent.trunc();
        if whole && exponent.abs() <= WHOLE {
            return self.powi(exponent as i32);
        }
        let inner = size.0.0 > 0.0 && size.0.0 < f64::INFINITY;
        // Zeros, infinities and NaN.
        if !inner || (self.0.0 < 0.0 && !whole) {
            return Self::from(self.0.0.powf(exponent));
        }
        let power = (size.ln() * exponent).exp();
        if self.0.0.powf(exponent) < 0.0 { -power } else { power }
    }

    fn select_lt(a: Self, b: Self, yes: Self, no: Self) -> Self {
        if a < b { yes } else { no }
    }

    fn any_lt(a: Self, b: Self) -> bool {
        a < b
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::numbers::rng::{Purpose, stream};
    use rand::RngExt;

    fn close(what: &str, at: Quad, found: Quad, expected: Quad, allowed: f64) {
        let error = (found - expected).0.abs();
        assert!(
            error <= allowed * expected.0.abs().max(1.0),
            "{what} at {at:?}: {found:?}, expected {expected:?}, error {error:e}"
        );
    }

    /// 2000 numbers between `-size` and `size`, with random high and low parts.
    fn numbers(size: f64) -> impl Iterator<Item = Quad> {
        let mut rng = stream(0, Purpose::Check, 0);
        (0..2000).map(move |_| {
            let first = size * rng.random_range(-1.0..1.0_f64);
            let second = rng.random_range(-0.49..0.49) * f64::EPSILON * first.abs();
            Quad(first, 0.0) + Quad(second, 0.0)
        })
    }

    #[test]
    fn exp_and_atan2_equal_tabulated_values_to_1e_31_and_sin_to_2e_30() {
        // Tabulated values (Abramowitz and Stegun, 1.1 and 4), split into high and low parts.
        let one = Quad::ONE;
        let e = Quad(std::f64::consts::E, 1.4456468917292502e-16);
        let sin_1 = Quad(0.8414709848078965, 1.776845092935536e-18);
        close("exp", one, Quad::exp(one), e, 1e-31);
        close("sin", one, one.sin_cos().0, sin_1, 2e-30);
        close("atan2", one, Functions::atan2(one, one) * Quad(4.0, 0.0), Quad::PI, 1e-31);
        close(
            "atan2",
            one,
            Functions::atan2(one, -one) * Quad(4.0, 0.0),
            Quad::PI * Quad(3.0, 0.0),
            1e-31,
        );
    }

    #[test]
    fn identities_of_elementary_functions_hold_to_1e_30() {
        for x in numbers(20.0) {
            let (sin, cos) = x.sin_cos();
            close("sin² + cos²", x, sin * sin + cos * cos, Quad::ONE, 1e-31);
            let (sin_2, cos_2) = (x + x).sin_cos();
            close("sin 2x", x, sin_2, sin * cos + sin * cos, 1e-30);
            close("cos 2x", x, cos_2, cos * cos - sin * sin, 1e-30);
            let (sin_there, cos_there) = (x + Quad::ONE).sin_cos();
            let (sin_1, cos_1) = Quad::ONE.sin_cos();
            close("sin (x + 1)", x, sin_there, sin * cos_1 + cos * sin_1, 1e-30);
            close("cos (x + 1)", x, cos_there, cos * cos_1 - sin * sin_1, 1e-30);
            close("atan2", x, Functions::atan2(sin, cos).sin_cos().0, sin, 1e-31);
        }
        for x in numbers(3.0) {
            let (e, t) = (Quad::exp(x), Functions::tanh(x));
            close("exp x exp -x", x, e * Quad::exp(-x), Quad::ONE, 1e-30);
            close("ln exp x", x, Quad::ln(e), x, 1e-30);
            // Divides by x: the allowed error is relative to x.
            let t_2 = Functions::tanh(x + x);
            close("tanh 2x", x, t_2 / x, (t + t) / ((Quad::ONE + t * t) * x), 1e-30);
            let (up, down) = (e, Quad::exp(-x));
            close("tanh", x, t, (up - down) / (up + down), 1e-30);
        }
    }

    #[test]
    fn saturated_and_non_finite_values_equal_those_of_f64() {
        let quad = |value: f64| Quad(value, 0.0);
        assert_eq!(Functions::tanh(quad(1e3)), Quad::ONE);
        assert_eq!(Functions::tanh(quad(-1e3)), -Quad::ONE);
        assert_eq!(Functions::tanh(Quad::ZERO), Quad::ZERO);
        assert_eq!(Quad::sqrt(Quad::ZERO), Quad::ZERO);
        assert!(Functions::tanh(Quad::NAN).0.is_nan());
        assert!(quad(f64::INFINITY).sin_cos().0.0.is_nan());
        assert_eq!(Functions::atan2(Quad::ZERO, Quad::ZERO), Quad::ZERO);
    }
}
