//! Vertical axis: logarithmic for positive values, otherwise linear.

use super::Series;
use super::axes::{decimal, number};
use super::log_axis::LogAxis;
use super::series::drawable;
use kuva::prelude::*;

/// Scale of a y axis, which decides which values can be drawn.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum YScale {
    /// Shows values between 1e-100 and 1e100.
    Log,
    /// Shows values of either sign, and 0, with an absolute value below 1e100.
    Linear,
}

impl YScale {
    /// Scale for these values: linear if one of them is 0 or negative, otherwise logarithmic.
    /// Values that a linear axis cannot show do not count.
    pub fn of(values: impl IntoIterator<Item = f64>) -> Self {
        let is_linear = |y: f64| Self::Linear.shows(y) && y <= 0.0;
        if values.into_iter().any(is_linear) { Self::Linear } else { Self::Log }
    }

    /// True for values that the axis can show.
    pub(super) fn shows(self, y: f64) -> bool {
        match self {
            Self::Log => drawable(y),
            Self::Linear => y.abs() < 1e100,
        }
    }

    /// Value at this share of the straight line from `a` to `b` on the axis.
    pub(super) fn between(self, a: f64, b: f64, share: f64) -> f64 {
        match self {
            Self::Log => a * (b / a).powf(share),
            Self::Linear => a + (b - a) * share,
        }
    }
}

/// Y axis with its range.
pub enum YAxis {
    Log(LogAxis),
    /// Lower and upper end.
    Linear([f64; 2]),
}

impl YAxis {
    /// Creates the axis for lines, bands and single dots, with the scale of their values. A linear
    /// axis extends beyond the data by 5 % at both ends.
    pub fn of<'a>(series: impl Iterator<Item = &'a Series> + Clone) -> Self {
        let values = || series.clone().flat_map(Series::values);
        if YScale::of(values()) == YScale::Log {
            return Self::Log(LogAxis::of(series));
        }
        let (low, high) = (values().fold(f64::MAX, f64::min), values().fold(f64::MIN, f64::max));
        let margin = match (low < high, low == 0.0) {
            (true, _) => 0.05 * (high - low),
            (false, true) => 1.0,
            (false, false) => 0.1 * low.abs(),
        };
        Self::Linear([low - margin, high + margin])
    }

    /// Axis unit in units of the data.
    pub fn unit(&self) -> f64 {
        match self {
            Self::Log(axis) => axis.unit(),
            Self::Linear(_) => 1.0,
        }
    }

    /// Lower and upper end, in axis units.
    pub fn ends(&self) -> [f64; 2] {
        match self {
            Self::Log(axis) => [axis.low, axis.high],
            Self::Linear(ends) => *ends,
        }
    }

    /// Value at this share of the height, in axis units.
    pub fn at(&self, share: f64) -> f64 {
        let ([low, high], between) = (self.ends(), |from: f64, to: f64| from + share * (to - from));
        match self {
            Self::Log(_) => between(low.ln(), high.ln()).exp(),
            Self::Linear(_) => between(low, high),
        }
    }

    /// Layout with the range and the ticks of the axis.
    pub fn on(&self, layout: Layout) -> Layout {
        let [low, high] = self.ends();
        let layout = layout.with_y_axis_min(low).with_y_axis_max(high);
        match self {
            Self::Log(axis) => layout.with_log_y().with_y_tick_format(axis.tick_format()),
            Self::Linear(_) => layout.with_y_tick_format(linear_ticks(high - low)),
        }
    }
}

/// Formats ticks of a linear axis of this length. Numbers from 1e-3 to 1e5 have the decimals that
/// distinguish neighbouring ticks.
fn linear_ticks(length: f64) -> TickFormat {
    let decimals = (2.0 - length.log10().floor()).clamp(0.0, 9.0) as usize;
    TickFormat::Custom(std::sync::Arc::new(move |tick: f64| match tick.abs() {
        // The rounding error of a tick at 0.
        size if size < 1e-9 * length => number(0.0),
        size if (1e-3..1e5).contains(&size) => decimal(tick, decimals),
        _ => number(tick),
    }))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn axis(values: &[f64]) -> YAxis {
        YAxis::of([Series::new("", "", values.iter().map(|&y| (0.0, y)).collect())].iter())
    }

    #[test]
    fn a_scale_is_linear_if_a_finite_value_is_not_positive() {
        for values in [[1.0, -1e-9], [1.0, 0.0], [-1.0, f64::NAN]] {
            assert_eq!(YScale::of(values), YScale::Linear, "{values:?}");
        }
        for values in [[1.0, 1e-9], [1.0, f64::NEG_INFINITY], [f64::NAN; 2]] {
            assert_eq!(YScale::of(values), YScale::Log, "{values:?}");
        }
        assert!([-1.0, 0.0, 1e-200].into_iter().all(|y| YScale::Linear.shows(y)));
        let hidden = [f64::NAN, f64::INFINITY, f64::NEG_INFINITY, -1e200];
        assert!(!hidden.into_iter().any(|y| YScale::Linear.shows(y)));
    }

    #[test]
    fn a_linear_axis_extends_beyond_its_values() {
        for values in [&[-3.0, 5.0][..], &[0.0], &[-2e-7], &[-1e99, 1e99], &[-1e-120]] {
            let [low, high] = axis(values).ends();
            let inside = |&y: &f64| low < y && y < high;
            assert!(values.iter().all(inside) && (high - low).is_finite(), "{low} to {high}");
        }
        let axis = axis(&[-4.0, 6.0]);
        assert_eq!([0.0, 0.5, 1.0].map(|share| axis.at(share)), [-4.5, 1.0, 6.5]);
    }

    #[test]
    fn neighbouring_ticks_of_a_linear_axis_have_different_labels() {
        for values in [[-1.0005, -1.0], [-0.021, -0.02], [-3.0, 900.0], [-2e-6, 1e-6], [-4e7, 1.0]]
        {
            let [low, high] = axis(&values).ends();
            let format = linear_ticks(high - low);
            let ticks = kuva::render::render_utils::generate_ticks(low, high, 5);
            let labels: Vec<String> = ticks.into_iter().map(|tick| format.format(tick)).collect();
            let differ = |i: usize| !labels[..i].contains(&labels[i]);
            assert!(labels.len() > 2 && (0..labels.len()).all(differ), "{values:?}: {labels:?}");
        }
    }
}
