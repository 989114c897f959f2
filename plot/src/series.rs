//! [`Series`]: a line in a chart, cleaned and thinned for drawing.

use super::YScale;
use super::axes::round_up;

/// Number of points beyond which a line is thinned, which keeps files small.
const MAX_POINTS: usize = 250;

/// Pattern of a line.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Dash {
    /// Without gaps.
    #[default]
    Solid,
    /// Long dashes.
    Dashed,
    /// Dots.
    Dotted,
    /// Dashes and dots in turn.
    DashDot,
}

impl Dash {
    /// All patterns.
    pub const ALL: [Self; 4] = [Self::Solid, Self::Dashed, Self::Dotted, Self::DashDot];

    /// Value of the SVG attribute `stroke-dasharray`, in pixels. `None` for a solid line.
    pub fn array(self) -> Option<&'static str> {
        match self {
            Self::Solid => None,
            Self::Dashed => Some("7 4"),
            Self::Dotted => Some("2 3"),
            Self::DashDot => Some("8 3 2 3"),
        }
    }
}

/// Line with an optional band around it and optional horizontal bars.
///
/// On a log axis every y must be positive; charts omit other points.
#[derive(Clone, Debug, PartialEq)]
pub struct Series {
    /// Legend label.
    pub label: String,
    /// Note shown in the chart; may be empty.
    pub note: String,
    /// CSS colour of line, band and bars.
    pub color: &'static str,
    /// Pattern of the line.
    pub dash: Dash,
    /// True for a thin, pale line without a legend entry, such as a single seed beside a median.
    pub thin: bool,
    /// Points (x, y) in drawing order: by increasing x, except in work-precision diagrams. Charts
    /// draw a single point as a dot.
    pub line: Vec<(f64, f64)>,
    /// Lower and upper edge of the band at each point of the line; empty for no band.
    pub band: Vec<(f64, f64)>,
    /// Lowest and highest x at each point of the line, drawn as horizontal bars; empty for no bars.
    pub spread: Vec<(f64, f64)>,
}

impl Series {
    /// Creates a solid line without a band.
    pub fn new(label: impl Into<String>, color: &'static str, line: Vec<(f64, f64)>) -> Self {
        let (note, dash, band, spread) = (String::new(), Dash::Solid, Vec::new(), Vec::new());
        Self { label: label.into(), note, color, dash, thin: false, line, band, spread }
    }

    /// Sets the pattern of the line.
    pub fn dash(self, dash: Dash) -> Self {
        Self { dash, ..self }
    }

    /// Every y of the line and of the edges of the band.
    pub(super) fn values(&self) -> impl Iterator<Item = f64> {
        let edges = self.band.iter().flat_map(|&(low, high)| [low, high]);
        self.line.iter().map(|&(_, y)| y).chain(edges)
    }

    /// Omits points without a band, and points that an axis of this scale cannot show.
    fn with_drawable_band(mut self, scale: YScale) -> Self {
        let points = self.line.into_iter().zip(self.band);
        let is_shown = |y: f64| scale.shows(y);
        let points =
            points.filter(|((_, y), (low, high))| [*y, *low, *high].into_iter().all(is_shown));
        (self.line, self.band) = points.unzip();
        self
    }

    /// True if the lines coincide in at least half of the points of the shorter line, up to a
    /// relative difference of 0.1 %. Compares points with equal indices. False if either line has
    /// fewer than two points.
    pub(super) fn coincides(&self, other: &Self) -> bool {
        let near = |a: f64, b: f64| (a - b).abs() <= 1e-3 * a.abs().max(b.abs());
        let pairs = self.line.iter().zip(&other.line);
        let equal = pairs.filter(|(a, b)| near(a.0, b.0) && near(a.1, b.1)).count();
        let points = self.line.len().min(other.line.len());
        points > 1 && 2 * equal >= points
    }
}

/// Panels of series with bands, without points that their common axis cannot show.
pub fn drawable_bands(panels: Vec<(String, Vec<Series>)>) -> Vec<(String, Vec<Series>)> {
    let scale = YScale::of(panels.iter().flat_map(|(_, series)| series).flat_map(Series::values));
    let shown = |series: Vec<Series>| {
        series.into_iter().map(|series| series.with_drawable_band(scale)).collect()
    };
    panels.into_iter().map(|(title, series)| (title, shown(series))).collect()
}

/// True for values between 1e-100 and 1e100, which a log axis can show.
pub fn drawable(y: f64) -> bool {
    y > 1e-100 && y < 1e100
}

/// Removes points with a non-finite x or a y that `shown` rejects, and sorts the others by x.
pub fn cleaned(mut points: Vec<(f64, f64)>, shown: &dyn Fn(f64) -> bool) -> Vec<(f64, f64)> {
    points.retain(|&(x, y)| x.is_finite() && shown(y));
    points.sort_by(|a, b| a.0.total_cmp(&b.0));
    points
}

/// Range of x: from 0, or the smallest x if negative, to the largest x. A range of width 0 becomes
/// 1 wide.
pub fn x_range(series: &[Series]) -> [f64; 2] {
    let xs = || series.iter().flat_map(|s| &s.line).map(|&(x, _)| x);
    let low = xs().fold(0.0, f64::min);
    let high = xs().fold(low, f64::max);
    [low, if high > low { high } else { low + 1.0 }]
}

/// Tick step: 1, 2 or 5 times a power of ten, for at most seven ticks. An integer if all x are
/// integers.
pub fn tick_step([low, high]: [f64; 2], series: &[Series]) -> f64 {
    let step = round_up((high - low) / 6.5);
    let whole = series.iter().flat_map(|s| &s.line).all(|&(x, _)| x.fract() == 0.0);
    if whole { step.max(1.0) } else { step }
}

/// At most [`MAX_POINTS`] items: the first, the last, and up to two from each of several equal bins
/// between them. These two have the lowest and the highest y of the bin.
pub fn thinned<T: Copy>(items: Vec<T>, y: impl Fn(&T) -> f64) -> Vec<T> {
    if items.len() <= MAX_POINTS {
        return items;
    }
    let bins = MAX_POINTS / 2 - 1;
    let (inner, last) = (1..items.len() - 1, items[items.len() - 1]);
    let mut kept = vec![items[0]];
    for bin in 0..bins {
        let bin =
            inner.start + bin * inner.len() / bins..inner.start + (bin + 1) * inner.len() / bins;
        let by_y = |a: &usize, b: &usize| y(&items[*a]).total_cmp(&y(&items[*b]));
        let ends =
            [bin.clone().min_by(by_y), bin.max_by(by_y)].map(|i| i.expect("more items than bins"));
        let [first, second] = [ends[0].min(ends[1]), ends[0].max(ends[1])];
        kept.push(items[first]);
        if second > first {
            kept.push(items[second]);
        }
    }
    kept.push(last);
    kept
}

/// At most `most` evenly spaced items, including the first and the last.
pub fn thinned_to<T: Copy>(most: usize, items: Vec<T>) -> Vec<T> {
    if items.len() <= most {
        return items;
    }
    (0..most).map(|i| items[i * (items.len() - 1) / (most - 1)]).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn zero_negative_non_finite_and_subnormal_values_are_not_drawable() {
        assert!(drawable(1e-12));
        assert!(![0.0, -1.0, f64::NAN, f64::INFINITY, 1e-320].into_iter().any(drawable));
    }

    #[test]
    fn tick_steps_are_round_and_integers_for_integer_x() {
        let step =
            |high: f64, x: f64| tick_step([0.0, high], &[Series::new("a", "red", vec![(x, 1.0)])]);
        assert_eq!(
            [step(3.0, 1.0), step(15.0, 1.0), step(60.0, 1.0), step(1000.0, 1.0)],
            [1.0, 5.0, 10.0, 200.0]
        );
        assert_eq!([step(3.0, 0.5), step(0.3, 0.1)], [0.5, 0.05]);
    }

    #[test]
    fn lines_coincide_if_half_of_their_points_do() {
        let line = |ys: &[f64]| {
            Series::new("a", "red", ys.iter().enumerate().map(|(i, &y)| (i as f64, y)).collect())
        };
        let base = line(&[1.0, 2.0, 3.0, 4.0]);
        assert!(base.coincides(&line(&[1.0, 2.0005, 9.0, 9.0])));
        assert!(!base.coincides(&line(&[1.0, 9.0, 9.0, 9.0])));
        assert!(!line(&[1.0]).coincides(&line(&[1.0])), "dots have no width to tell them apart");
    }

    #[test]
    fn thinning_keeps_both_ends_and_extreme_values() {
        let many: Vec<(f64, f64)> = (0..1001)
            .map(|i| (f64::from(i), if i == 333 { -5.0 } else { f64::from(i % 7) }))
            .collect();
        let kept = thinned(many.clone(), |p| p.1);
        assert!(kept.len() <= MAX_POINTS && kept.is_sorted_by(|a, b| a.0 < b.0), "{}", kept.len());
        assert_eq!((kept[0], kept[kept.len() - 1]), (many[0], many[1000]));
        assert!(kept.contains(&(333.0, -5.0)), "the lowest value remains");
        assert_eq!(thinned(many[..2].to_vec(), |p| p.1), many[..2]);
    }
}
