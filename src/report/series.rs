//! [`Series`]: a line in a diagram, made of what can be drawn of some numbers.

/// A line of more points than this is thinned: no screen shows more, and the files stay small.
const MAX_POINTS: usize = 250;

/// One line, with an optional band around it.
///
/// On a log axis every y must be positive; [`Chart`](super::Chart) leaves out what is not.
#[derive(Clone, Debug, PartialEq)]
pub struct Series {
    /// Its name.
    pub label: String,
    /// What has to be said of it where it is drawn; may be empty.
    pub note: String,
    /// CSS colour of line and band.
    pub color: &'static str,
    /// Whether the line is broken into dashes.
    pub dashed: bool,
    /// The points (x, y) of the line, by increasing x; a single one is drawn as a dot.
    pub line: Vec<(f64, f64)>,
    /// The lower and upper edge of the band at each point of the line, or nothing.
    pub band: Vec<(f64, f64)>,
}

impl Series {
    /// A line without a band.
    pub fn new(label: impl Into<String>, color: &'static str, line: Vec<(f64, f64)>) -> Self {
        Self { label: label.into(), note: String::new(), color, dashed: false, line, band: Vec::new() }
    }

    /// The same, dashed.
    pub fn dashed(self) -> Self {
        Self { dashed: true, ..self }
    }
}

/// Whether a value can be put on a log axis: finite, positive and not absurdly large or small.
pub fn drawable(y: f64) -> bool {
    y > 1e-100 && y < 1e100
}

/// The points whose y a diagram can show, by increasing x.
pub fn cleaned(mut points: Vec<(f64, f64)>, shown: &dyn Fn(f64) -> bool) -> Vec<(f64, f64)> {
    points.retain(|&(x, y)| x.is_finite() && shown(y));
    points.sort_by(|a, b| a.0.total_cmp(&b.0));
    points
}

/// From 0, or the first x if that is less, to the last x; with some room if there is no x but 0.
pub fn x_range(series: &[Series]) -> [f64; 2] {
    let xs = || series.iter().flat_map(|s| &s.line).map(|&(x, _)| x);
    let low = xs().fold(0.0, f64::min);
    let high = xs().fold(low, f64::max);
    [low, if high > low { high } else { low + 1.0 }]
}

/// At most [`MAX_POINTS`] of the items, evenly spread, with the first and the last among them.
pub fn thinned<T: Copy>(items: Vec<T>) -> Vec<T> {
    thinned_to(MAX_POINTS, items)
}

/// At most so many of the items, evenly spread, with the first and the last among them.
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
