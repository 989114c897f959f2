//! A logarithmic axis: where it begins and ends, and what its ticks are called.

use kuva::prelude::*;

/// A logarithmic axis in units of 10^exponent: kuva draws nothing below 1e-10, so `low` is brought into [1, 10).
pub struct LogAxis {
    pub exponent: i32,
    pub low: f64,
    pub high: f64,
}

impl LogAxis {
    /// The axis around the values, rounded outward to 1, 2 or 5 times a power of ten so that ticks end it.
    /// It spans at least a factor of four, so that there are three of them.
    pub fn around(values: impl Iterator<Item = f64>) -> Self {
        let (min, max) = values.fold((f64::INFINITY, 0.0), |(min, max), y| (y.min(min), y.max(max)));
        let (min, max) = if max > 0.0 { (min, max) } else { (0.1, 1.0) };
        let exponent = min.log10().floor() as i32;
        let unit = 10f64.powi(exponent);
        let round_numbers = || (-1..=200).flat_map(|e| [1.0, 2.0, 5.0].map(|m| m * 10f64.powi(e)));
        // The tolerance keeps a rounding error in the division from adding a whole tick.
        let low = round_numbers().take_while(|&y| y <= min / unit * (1.0 + 1e-9)).last().unwrap_or(1.0);
        let high = round_numbers().find(|&y| y > low * 3.9 && y >= max / unit * (1.0 - 1e-9)).unwrap_or(1e200);
        Self { exponent, low, high }
    }

    /// One unit of the axis.
    pub fn unit(&self) -> f64 {
        10f64.powi(self.exponent)
    }

    /// Ticks as powers of ten; those at 2 and 5 are named only where powers alone would be too few.
    pub fn tick_format(&self) -> TickFormat {
        let (shift, decades) = (self.exponent, (self.high / self.low).log10());
        let every = (decades / 12.0).ceil().max(1.0) as i32;
        TickFormat::Custom(std::sync::Arc::new(move |tick: f64| {
            let power = (tick.log10() + 1e-9).floor() as i32;
            let mantissa = (tick / 10f64.powi(power)).round();
            match (power + shift, mantissa as i32) {
                (exponent, 1) if exponent % every == 0 => format!("10{}", superscript(exponent)),
                (exponent, 2 | 5) if decades <= 2.0 => format!("{mantissa}·10{}", superscript(exponent)),
                _ => String::new(),
            }
        }))
    }
}

/// The exponent in raised digits.
fn superscript(exponent: i32) -> String {
    let raise = |c: char| match c.to_digit(10) {
        Some(digit) => ['⁰', '¹', '²', '³', '⁴', '⁵', '⁶', '⁷', '⁸', '⁹'][digit as usize],
        None => '⁻',
    };
    exponent.to_string().chars().map(raise).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn labels(values: &[f64]) -> Vec<String> {
        let axis = LogAxis::around(values.iter().copied());
        let format = axis.tick_format();
        [1.0, 2.0, 5.0, 10.0].iter().map(|&tick| format.format(tick)).collect()
    }

    #[test]
    fn axis_is_rounded_outward_to_ticks() {
        let axis = LogAxis::around([0.03, 4.0].into_iter());
        assert_eq!((axis.exponent, axis.low, axis.high), (-2, 2.0, 500.0));
        let flat = LogAxis::around([1.0, 1.0].into_iter());
        assert!(flat.low <= 1.0 && flat.high >= 4.0);
        let tiny = LogAxis::around([1e-99, 1e99].into_iter());
        assert!((1.0..10.0).contains(&tiny.low) && tiny.high.is_finite());
    }

    #[test]
    fn ticks_are_named_in_the_units_of_the_data() {
        assert_eq!(labels(&[1e-13, 1e-5]), ["10⁻¹³", "", "", "10⁻¹²"]);
        assert_eq!(labels(&[0.1, 1.0]), ["10⁻¹", "2·10⁻¹", "5·10⁻¹", "10⁰"]);
    }
}
