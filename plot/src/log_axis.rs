//! Logarithmic axis: range, unit and tick labels.

use super::Series;
use kuva::prelude::*;

/// Logarithmic axis in units of 10^exponent. The plotting library kuva raises values below 1e-10 to
/// 1e-10, so the unit is such that `low` is between 1 and 10.
pub struct LogAxis {
    /// Decimal exponent of the axis unit.
    pub exponent: i32,
    /// Lower end of the range, in axis units.
    pub low: f64,
    /// Upper end of the range, in axis units.
    pub high: f64,
}

impl LogAxis {
    /// Creates the axis for lines, bands and single dots. With dots, the range extends beyond the
    /// data at both ends, by at least 2 % of the data's logarithmic length. The edge of the panel
    /// then cuts no dot.
    pub fn of<'a>(series: impl Iterator<Item = &'a Series>) -> Self {
        let (mut dots, mut low, mut high) = (false, f64::INFINITY, 0.0);
        for s in series {
            dots |= s.line.len() == 1;
            let edges = s.band.iter().flat_map(|&(low, high)| [low, high]);
            for y in s.line.iter().map(|&(_, y)| y).chain(edges) {
                (low, high) = (y.min(low), y.max(high));
            }
        }
        if high == 0.0 {
            return Self::covering(std::iter::empty());
        }
        let margin = if dots { (high / low).powf(0.02).max(1.02) } else { 1.0 };
        Self::covering([low / margin, high * margin].into_iter())
    }

    /// Creates the axis for positive values, rounded outward to one digit.
    ///
    /// The range contains at least two ticks at 1, 2 or 5 times a power of ten.
    pub fn covering(values: impl Iterator<Item = f64>) -> Self {
        let (min, max) =
            values.fold((f64::INFINITY, 0.0), |(min, max), y| (y.min(min), y.max(max)));
        let (min, max) = if max > 0.0 { (min, max) } else { (0.1, 1.0) };
        let exponent = min.log10().floor() as i32;
        let unit = 10f64.powi(exponent);
        let round_numbers =
            || (-1..=200).flat_map(|e| (1..10).map(move |m| f64::from(m) * 10f64.powi(e)));
        // The tolerance prevents a rounding error of the division from extending the range to the
        // next round number.
        let low =
            round_numbers().take_while(|&y| y <= min / unit * (1.0 + 1e-9)).last().unwrap_or(1.0);
        let high = round_numbers().find(|&y| y >= max / unit * (1.0 - 1e-9)).unwrap_or(1e200);
        let ticks = || (-1..=200).flat_map(|e| [1.0, 2.0, 5.0].map(|m| m * 10f64.powi(e)));
        // Extends the end that is closer to its next tick, but never the lower end below 1.
        let (mut low, mut high) = (low, high);
        while ticks().filter(|&tick| low <= tick && tick <= high).count() < 2 {
            let below = ticks().take_while(|&tick| tick < low).last().unwrap_or(low);
            let above = ticks().find(|&tick| tick > high).unwrap_or(high);
            if below >= 1.0 && low / below < above / high { low = below } else { high = above }
        }
        Self { exponent, low, high }
    }

    /// Axis unit in units of the data.
    pub fn unit(&self) -> f64 {
        10f64.powi(self.exponent)
    }

    /// Formats ticks as powers of ten. Axes of at most two decades also label 2 and 5 times these
    /// powers. These axes show numbers with exponents from -3 to 3 as decimals. Axes of more than
    /// 12 decades omit some powers.
    pub fn tick_format(&self) -> TickFormat {
        let (shift, decades) = (self.exponent, (self.high / self.low).log10());
        let every = (decades / 12.0).ceil().max(1.0) as i32;
        TickFormat::Custom(std::sync::Arc::new(move |tick: f64| {
            let power = (tick.log10() + 1e-9).floor() as i32;
            let mantissa = (tick / 10f64.powi(power)).round();
            match (power + shift, mantissa as i32) {
                (exponent, digit @ (1 | 2 | 5)) if decades <= 2.0 && exponent.abs() <= 3 => {
                    let places = usize::try_from(-exponent).unwrap_or(0);
                    format!("{:.places$}", f64::from(digit) * 10f64.powi(exponent))
                }
                (exponent, 1) if exponent % every == 0 => format!("10{}", superscript(exponent)),
                (exponent, 2 | 5) if decades <= 2.0 => {
                    format!("{mantissa}·10{}", superscript(exponent))
                }
                _ => String::new(),
            }
        }))
    }
}

/// Formats the exponent in superscript digits.
pub fn superscript(exponent: i32) -> String {
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
        let axis = LogAxis::covering(values.iter().copied());
        let format = axis.tick_format();
        [1.0, 2.0, 5.0, 10.0].iter().map(|&tick| format.format(tick)).collect()
    }

    #[test]
    fn axis_is_rounded_outward_to_one_digit() {
        let axis = LogAxis::covering([0.03, 4.0].into_iter());
        assert_eq!((axis.exponent, axis.low, axis.high), (-2, 3.0, 400.0));
        let flat = LogAxis::covering([1.0, 1.0].into_iter());
        assert!(flat.low <= 1.0 && flat.high >= 2.0);
        let tiny = LogAxis::covering([1e-99, 1e99].into_iter());
        assert!((1.0..10.0).contains(&tiny.low) && tiny.high.is_finite());
    }

    #[test]
    fn dots_have_a_margin_and_lines_have_none() {
        let series = |line: &[(f64, f64)]| Series::new("", "", line.to_vec());
        let ends = |series: &[Series]| {
            let axis = LogAxis::of(series.iter());
            [axis.low, axis.high].map(|y| y * axis.unit())
        };
        assert_eq!(ends(&[series(&[(0.0, 1.0), (1.0, 100.0)])]), [1.0, 100.0]);
        for values in [[1.0, 100.0], [1e-9, 1e3], [1.0, 1.0]] {
            let [low, high] = ends(&values.map(|y| series(&[(0.0, y)])));
            let margin = 0.02 * (high / low).log10();
            assert!(
                (values[0] / low).log10() > 0.5 * margin
                    && (high / values[1]).log10() > 0.5 * margin,
                "{low} to {high}"
            );
        }
    }

    #[test]
    fn every_axis_has_two_labelled_ticks() {
        for digit in 10..100 {
            for factor in [1.0, 1.3, 2.0, 3.0, 9.0, 30.0, 99.0, 101.0, 5e3, 1e9, 1e20] {
                let value = f64::from(digit) * 1e-4;
                let axis = LogAxis::covering([value, factor * value].into_iter());
                let format = axis.tick_format();
                let ticks = kuva::render::render_utils::generate_ticks_log(axis.low, axis.high);
                let labels: Vec<String> = ticks
                    .into_iter()
                    .map(|tick| format.format(tick))
                    .filter(|t| !t.is_empty())
                    .collect();
                assert!(
                    labels.len() >= 2,
                    "{value} to {}: {labels:?} on {} to {}",
                    value * factor,
                    axis.low,
                    axis.high
                );
                assert!(
                    axis.low * axis.unit() <= value * 1.0001
                        && axis.high * axis.unit() >= factor * value * 0.9999
                );
            }
        }
    }

    #[test]
    fn tick_labels_state_data_values_not_axis_units() {
        assert_eq!(labels(&[1e-13, 1e-5]), ["10⁻¹³", "", "", "10⁻¹²"]);
        assert_eq!(labels(&[0.1, 1.0]), ["0.1", "0.2", "0.5", "1"]);
        assert_eq!(labels(&[1e-5, 1e-4]), ["10⁻⁵", "2·10⁻⁵", "5·10⁻⁵", "10⁻⁴"]);
    }
}
