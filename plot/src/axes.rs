//! [`Axes`]: a chart within an animation.

use super::animation::Shape;

const INK: &str = "#4A4F57";
/// Font size, in pixels.
const LETTERS: f64 = 12.0;

/// Rectangle in picture coordinates, in pixels, with a linear scale along each side.
pub(super) struct Axes {
    /// Left edge.
    pub left: f64,
    /// Right edge.
    pub right: f64,
    /// Lower edge.
    pub bottom: f64,
    /// Upper edge.
    pub top: f64,
    /// Data x at the left and right edge.
    pub x: [f64; 2],
    /// Data y at the lower and upper edge.
    pub y: [f64; 2],
}

impl Axes {
    /// Maps a data point to picture coordinates.
    pub fn at(&self, x: f64, y: f64) -> [f64; 2] {
        let share = |value: f64, [from, to]: [f64; 2]| (value - from) / (to - from);
        [
            self.left + (self.right - self.left) * share(x, self.x),
            self.bottom + (self.top - self.bottom) * share(y, self.y),
        ]
    }

    /// Maps the rectangle between two data points to its center and size in picture coordinates.
    pub fn area(&self, low: [f64; 2], high: [f64; 2]) -> ([f64; 2], [f64; 2]) {
        let (low, high) = (self.at(low[0], low[1]), self.at(high[0], high[1]));
        ([(low[0] + high[0]) / 2.0, (low[1] + high[1]) / 2.0], [high[0] - low[0], high[1] - low[1]])
    }

    /// Polyline through data points.
    pub fn curve(
        &self,
        points: impl IntoIterator<Item = [f64; 2]>,
        width: f64,
        color: &'static str,
    ) -> Shape {
        Shape::Curve {
            points: points.into_iter().map(|[x, y]| self.at(x, y)).collect(),
            width,
            color,
        }
    }

    /// Outline of the rectangle.
    pub fn frame(&self) -> Shape {
        let ([left, right], [low, high]) = (self.x, self.y);
        self.curve([[left, low], [right, low], [right, high], [left, high], [left, low]], 1.0, INK)
    }

    /// Labelled ticks below the lower edge.
    pub fn ticks_below(&self, values: &[f64]) -> Vec<Shape> {
        let tick = |&value: &f64| {
            let [x, y] = self.at(value, self.y[0]);
            [
                Shape::Line { from: [x, y], to: [x, y - 4.0], width: 1.0, color: INK },
                text([x, y - 6.0 - LETTERS], number(value)),
            ]
        };
        values.iter().flat_map(tick).collect()
    }

    /// Labelled ticks at the upper edge, with the labels above it.
    pub fn ticks_above(&self, values: &[f64]) -> Vec<Shape> {
        let tick = |&value: &f64| {
            let [x, y] = self.at(value, self.y[1]);
            [
                Shape::Line { from: [x, y], to: [x, y - 4.0], width: 1.0, color: INK },
                text([x, y + 2.0], number(value)),
            ]
        };
        values.iter().flat_map(tick).collect()
    }

    /// Labelled ticks left of the left edge.
    pub fn ticks_left(&self, values: &[f64]) -> Vec<Shape> {
        let tick = |&value: &f64| {
            let ([x, y], label) = (self.at(self.x[0], value), number(value));
            // Texts are centered; digits are about 0.6 of the font size wide.
            let middle = x - 8.0 - 0.3 * LETTERS * label.chars().count() as f64;
            [
                Shape::Line { from: [x, y], to: [x - 4.0, y], width: 1.0, color: INK },
                text([middle, y - 0.35 * LETTERS], label),
            ]
        };
        values.iter().flat_map(tick).collect()
    }
}

/// Text, positioned by the center of its baseline.
pub(super) fn text(at: [f64; 2], text: impl Into<String>) -> Shape {
    Shape::Text { at, size: LETTERS, text: text.into(), color: INK }
}

/// Evenly spaced round numbers in a range, at most `count + 1`; empty for a degenerate range.
pub(super) fn ticks(from: f64, to: f64, count: f64) -> Vec<f64> {
    let step = round_up((to - from) / count);
    if !step.is_normal() {
        return Vec::new();
    }
    ((from / step).ceil() as i64..=(to / step).floor() as i64).map(|i| i as f64 * step).collect()
}

/// Rounds up to 1, 2 or 5 times a power of ten.
pub(super) fn round_up(value: f64) -> f64 {
    let power = 10f64.powf(value.log10().floor());
    [1.0, 2.0, 5.0]
        .into_iter()
        .map(|m| m * power)
        .find(|&round| round >= value * (1.0 - 1e-9))
        .unwrap_or(10.0 * power)
}

/// Formats a number with a typographic minus. Numbers with an absolute value below 1e-3, or of 1e5
/// or more, have an exponent and two significant digits. Others have three significant digits, or
/// the whole integer part from 1000 on, without trailing decimal zeros. 0 is `0`.
pub(super) fn number(value: f64) -> String {
    let text = match value.abs() {
        0.0 => "0".into(),
        size if !(1e-3..1e5).contains(&size) => format!("{value:.1e}"),
        size => {
            let decimals = (2 - size.log10().floor() as i32).max(0) as usize;
            return decimal(value, decimals);
        }
    };
    text.replace('-', "−")
}

/// Formats a number with a typographic minus and at most this many decimals, without trailing
/// zeros.
pub(super) fn decimal(value: f64, decimals: usize) -> String {
    let text = format!("{value:.decimals$}").replace('-', "−");
    match text.contains('.') {
        true => text.trim_end_matches('0').trim_end_matches('.').into(),
        false => text,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn ticks_are_multiples_of_1_2_or_5_times_a_power_of_ten() {
        assert_eq!(ticks(-0.03, 8.03, 5.0), [0.0, 2.0, 4.0, 6.0, 8.0]);
        assert_eq!(ticks(0.0, 2.0, 4.0), [0.0, 0.5, 1.0, 1.5, 2.0]);
        assert_eq!(ticks(-0.5, 0.5, 5.0), [-0.4, -0.2, 0.0, 0.2, 0.4]);
    }

    #[test]
    fn numbers_have_about_three_digits_and_a_typographic_minus() {
        for (value, text) in [
            (0.0, "0"),
            (2.0, "2"),
            (-12.345, "−12.3"),
            (0.05, "0.05"),
            (1234.0, "1234"),
            (2e-7, "2.0e−7"),
        ] {
            assert_eq!(number(value), text);
        }
    }
}
