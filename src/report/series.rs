//! [`Series`]: a line in a chart, cleaned and thinned for drawing.

/// Number of points beyond which a line is thinned, which keeps files small.
const MAX_POINTS: usize = 250;

/// Line with an optional band around it.
///
/// On a log axis every y must be positive; [`Chart`](super::Chart) omits other points.
#[derive(Clone, Debug, PartialEq)]
pub struct Series {
    /// Legend label.
    pub label: String,
    /// Note shown in the chart; may be empty.
    pub note: String,
    /// CSS colour of line and band.
    pub color: &'static str,
    /// True for a dashed line.
    pub dashed: bool,
    /// Points (x, y) in order of increasing x; a single point is drawn as a dot.
    pub line: Vec<(f64, f64)>,
    /// Lower and upper edge of the band at each point of the line; empty for no band.
    pub band: Vec<(f64, f64)>,
}

impl Series {
    /// Creates a solid line without a band.
    pub fn new(label: impl Into<String>, color: &'static str, line: Vec<(f64, f64)>) -> Self {
        Self { label: label.into(), note: String::new(), color, dashed: false, line, band: Vec::new() }
    }

    /// Makes the line dashed.
    pub fn dashed(self) -> Self {
        Self { dashed: true, ..self }
    }
}

/// True if a log axis can show the value: between 1e-100 and 1e100.
pub fn drawable(y: f64) -> bool {
    y > 1e-100 && y < 1e100
}

/// Removes points that a chart cannot show and sorts the others by x.
pub fn cleaned(mut points: Vec<(f64, f64)>, shown: &dyn Fn(f64) -> bool) -> Vec<(f64, f64)> {
    points.retain(|&(x, y)| x.is_finite() && shown(y));
    points.sort_by(|a, b| a.0.total_cmp(&b.0));
    points
}

/// Range of x: from 0, or the smallest x if negative, to the largest. An empty range is widened by
/// 1.
pub fn x_range(series: &[Series]) -> [f64; 2] {
    let xs = || series.iter().flat_map(|s| &s.line).map(|&(x, _)| x);
    let low = xs().fold(0.0, f64::min);
    let high = xs().fold(low, f64::max);
    [low, if high > low { high } else { low + 1.0 }]
}

/// At most [`MAX_POINTS`] evenly spaced items, including the first and the last.
pub fn thinned<T: Copy>(items: Vec<T>) -> Vec<T> {
    thinned_to(MAX_POINTS, items)
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
    fn only_drawable_values_pass() {
        assert!(drawable(1e-12));
        assert!(![0.0, -1.0, f64::NAN, f64::INFINITY, 1e-320].into_iter().any(drawable));
    }

    #[test]
    fn thinning_keeps_both_ends() {
        let many = thinned((0..1001).collect());
        assert_eq!((many.len(), many[0], many[MAX_POINTS - 1]), (MAX_POINTS, 0, 1000));
        assert_eq!(thinned(vec![1, 2]), [1, 2]);
    }
}
