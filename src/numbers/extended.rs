//! [`ExtendedF64`]: a number with extended exponent range, and scaling by powers of two.

use crate::numbers::scalar::Float;
use serde::{Deserialize, Serialize};
use std::fmt;
use std::ops::{Add, Div, Mul};

/// A number with extended range, `mantissa · 2^exponent`.
///
/// Represents norms of gradients that explode or vanish beyond the range of `f64`.
///
/// ```
/// use physgrad::scalar::ExtendedF64;
///
/// let long = ExtendedF64::new(1.5, 5849);
/// assert_eq!(long.to_string(), "7.95309e1760");
/// assert_eq!((long.get(), ExtendedF64::new(0.25, 3).to_string()), (f64::INFINITY, "2".to_owned()));
/// ```
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct ExtendedF64 {
    mantissa: f64,
    /// 0 unless the number is outside, or near the ends of, the range of `f64`.
    exponent: i32,
}

impl ExtendedF64 {
    /// `mantissa · 2^exponent`.
    pub fn new(mantissa: f64, exponent: i32) -> Self {
        /// Largest absolute exponent of numbers that are stored as a plain `f64`.
        const PLAIN: u32 = 960;
        if mantissa == 0.0 || !mantissa.is_finite() {
            return Self { mantissa, exponent: 0 };
        }
        let own = exponent_of(mantissa);
        let whole = own.saturating_add(exponent);
        if whole.unsigned_abs() <= PLAIN {
            return Self { mantissa: times_power_of_two(mantissa, exponent), exponent: 0 };
        }
        Self { mantissa: times_power_of_two(mantissa, -own), exponent: whole }
    }

    /// Converts to `f64`: infinite on overflow, rounded to a subnormal number or 0 on underflow.
    pub fn get(self) -> f64 {
        times_power_of_two(self.mantissa, self.exponent)
    }

    /// False for NaN and infinities.
    pub(crate) fn is_finite(self) -> bool {
        self.mantissa.is_finite()
    }

    /// Decimal logarithm of the absolute value; `-∞` for 0.
    pub fn log10(self) -> f64 {
        self.mantissa.abs().log10() + f64::from(self.exponent) * std::f64::consts::LOG10_2
    }

    /// Sign: -1, 0 or 1; NaN for NaN.
    pub fn signum(self) -> f64 {
        if self.mantissa == 0.0 { 0.0 } else { self.mantissa.signum() }
    }

    /// `self / 2^exponent` as an `f64`.
    pub(crate) fn over_power_of_two(self, exponent: i32) -> f64 {
        times_power_of_two(self.mantissa, self.exponent.saturating_sub(exponent))
    }
}

impl From<f64> for ExtendedF64 {
    fn from(number: f64) -> Self {
        Self::new(number, 0)
    }
}

impl Add for ExtendedF64 {
    type Output = Self;

    fn add(self, other: Self) -> Self {
        let exponent = if self.mantissa == 0.0 {
            other.exponent
        } else if other.mantissa == 0.0 {
            self.exponent
        } else {
            self.exponent.max(other.exponent)
        };
        let part =
            |part: Self| times_power_of_two(part.mantissa, part.exponent.saturating_sub(exponent));
        Self::new(part(self) + part(other), exponent)
    }
}

impl Mul<f64> for ExtendedF64 {
    type Output = Self;

    fn mul(self, factor: f64) -> Self {
        let [(a, i), (b, j)] = [self.mantissa, factor].map(split);
        Self::new(a * b, self.exponent.saturating_add(i + j))
    }
}

impl Div<f64> for ExtendedF64 {
    type Output = Self;

    fn div(self, divisor: f64) -> Self {
        let [(a, i), (b, j)] = [self.mantissa, divisor].map(split);
        Self::new(a / b, self.exponent.saturating_add(i - j))
    }
}

impl fmt::Display for ExtendedF64 {
    /// Formats like an `f64` if `exponent` is 0, otherwise with six digits and a decimal exponent.
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        if self.exponent == 0 {
            return self.mantissa.fmt(f);
        }
        let log = self.log10();
        let sign = if self.mantissa < 0.0 { "-" } else { "" };
        let rounded = (1e5 * 10f64.powf(log - log.floor())).round() / 1e5;
        let (digits, exponent) =
            if rounded < 10.0 { (rounded, log.floor()) } else { (1.0, log.floor() + 1.0) };
        write!(f, "{sign}{digits:.5}e{exponent}")
    }
}

/// Splits a number into a mantissa, of absolute value 1 to 2, and a binary exponent. Zero and
/// non-finite numbers have exponent 0.
fn split(x: f64) -> (f64, i32) {
    if x == 0.0 || !x.is_finite() {
        return (x, 0);
    }
    let exponent = exponent_of(x);
    (times_power_of_two(x, -exponent), exponent)
}

/// Binary exponent of a finite, nonzero number: `⌊log2 |x|⌋`.
pub(crate) fn exponent_of(x: f64) -> i32 {
    let bits = |x: f64| ((x.to_bits() >> 52) & 0x7ff) as i32;
    match bits(x) {
        // Subnormal numbers.
        0 => bits(x * power_of_two(200)) - 1023 - 200,
        exponent => exponent - 1023,
    }
}

/// `2^exponent` for the exponent of a normal `f64`: -1022 to 1023.
pub(crate) const fn power_of_two(exponent: i32) -> f64 {
    f64::from_bits(((1023 + exponent) as u64) << 52)
}

/// `x · 2^exponent`. Exact within the normal range; infinite on overflow, rounded on underflow.
pub(crate) fn times_power_of_two(x: f64, exponent: i32) -> f64 {
    /// Largest exponent of one multiplication: 2^1000 and 2^-1000 are normal numbers.
    const STEP: i32 = 1000;
    // The clamp changes no result: the ratio of two nonzero `f64`s is below 2^2100.
    let (mut x, mut left) = (x, exponent.clamp(-3 * STEP, 3 * STEP));
    while left > STEP {
        (x, left) = (x * power_of_two(STEP), left - STEP);
    }
    while left < -STEP {
        (x, left) = (x * power_of_two(-STEP), left + STEP);
    }
    x * power_of_two(left)
}

/// [`times_power_of_two`] in the precision `F`.
pub(crate) fn scaled<F: Float>(x: F, exponent: i32) -> F {
    F::from_f64(times_power_of_two(x.as_(), exponent))
}

/// [`scaled`], with underflow to the smallest subnormal number of the sign of `x` instead of 0.
pub(crate) fn scaled_with_sign<F: Float>(x: F, exponent: i32) -> F {
    let smallest =
        if F::EPSILON < 1e-10 { f64::from_bits(1) } else { f64::from(f32::from_bits(1)) };
    let (zero, small) = (F::zero(), scaled(x, exponent));
    if small != zero || x == zero {
        return small;
    }
    F::from_f64(if x < zero { -smallest } else { smallest })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn products_and_quotients_have_the_extended_range() {
        let large = ExtendedF64::from(1e200) * 1e200;
        assert_eq!(large.to_string(), "1.00000e400");
        assert_eq!((ExtendedF64::from(1e-200) / 1e200).to_string(), "1.00000e-400");
        assert!(((large / 1e200).get() / 1e200 - 1.0).abs() < 1e-15);
        for (a, b) in [
            (3.0, 0.0),
            (0.0, 3.0),
            (f64::INFINITY, 2.0),
            (1.5, -f64::INFINITY),
            (0.1, 0.7),
            (-1e-300, 3e290),
        ] {
            assert_eq!((ExtendedF64::from(a) * b).get().to_bits(), (a * b).to_bits(), "{a} {b}");
            assert_eq!((ExtendedF64::from(a) / b).get().to_bits(), (a / b).to_bits(), "{a} {b}");
        }
    }

    #[test]
    fn sums_quotients_and_logarithms_are_right_up_to_2_to_the_power_4001() {
        let sum = ExtendedF64::from(3.0) + ExtendedF64::from(0.5);
        assert_eq!((sum.get(), sum.exponent), (3.5, 0));
        let huge = ExtendedF64::new(1.0, 4000);
        assert_eq!(huge + ExtendedF64::from(1.0), huge);
        assert_eq!(
            (huge + huge, ExtendedF64::from(0.0) + ExtendedF64::new(1.0, -4000)),
            (ExtendedF64::new(1.0, 4001), ExtendedF64::new(1.0, -4000))
        );
        approx::assert_relative_eq!(huge.log10(), 4000.0 * 2f64.log10(), max_relative = 1e-15);
        assert_eq!((huge.get(), ExtendedF64::new(1.0, -4000).get()), (f64::INFINITY, 0.0));
        // A result with a binary exponent from -960 to 960 is a plain `f64`.
        assert_eq!(
            (ExtendedF64::new(1.5, 1100) / power_of_two(1000) / power_of_two(100)).get(),
            1.5
        );
    }

    #[test]
    fn scaling_by_powers_of_two_is_exact_at_the_ends_of_the_range_of_f64() {
        for x in [1.0, -1.75, f64::MIN_POSITIVE, f64::from_bits(1), f64::MAX] {
            let exponent = exponent_of(x);
            let mantissa = times_power_of_two(x, -exponent);
            assert!(
                (1.0..2.0).contains(&mantissa.abs()),
                "the mantissa of {x:e} is {mantissa}, expected 1 to 2"
            );
            assert_eq!(times_power_of_two(mantissa, exponent), x);
        }
        assert_eq!((scaled(1.0f32, -200), scaled(-1.0f32, 200)), (0.0, f32::NEG_INFINITY));
        assert_eq!(
            (scaled_with_sign(-1.0f32, -200), scaled_with_sign(0.0f32, -200)),
            (-f32::from_bits(1), 0.0)
        );
    }

    #[test]
    fn a_mantissa_that_rounds_to_ten_is_printed_as_one() {
        // Powers of two whose decimal mantissa exceeds 9.9999955.
        let rounds_up = |exponent: &i32| {
            (f64::from(*exponent) * std::f64::consts::LOG10_2).fract() > 9.999_995_5f64.log10()
        };
        let exponent = (1000..100_000_000)
            .find(rounds_up)
            .expect("fractions of multiples of log10(2) are dense");
        let decimal = (f64::from(exponent) * std::f64::consts::LOG10_2).ceil();
        assert_eq!(ExtendedF64::new(1.0, exponent).to_string(), format!("1.00000e{decimal}"));
        assert_eq!(ExtendedF64::new(-1.0, exponent).to_string(), format!("-1.00000e{decimal}"));
    }
}
