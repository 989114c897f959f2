//! Marks of a chart: lines, dots, bands and error bars.

use super::Series;
use kuva::prelude::*;

/// Width of a line, and of a thin line, in pixels.
const WIDTHS: [f64; 2] = [1.8, 0.8];
/// Additional width of a line for each later line that coincides with it, in pixels. Thin lines
/// neither gain width nor count.
const CASING: f64 = 2.4;
/// Share of white in the colour of a thin line.
const PALE: f64 = 0.45;

/// Creates the marks of the series in the given x and y units. From back to front: bands, thin
/// lines, other lines, error bars.
pub fn marks(series: &[Series], unit: [f64; 2]) -> Vec<Plot> {
    let bands = series.iter().filter(|s| !s.band.is_empty()).map(|s| band(s, unit));
    let widths = widths(series);
    let lines = |thin: bool| series.iter().zip(&widths).filter(move |(s, _)| s.thin == thin);
    let bars = series.iter().flat_map(|s| bars(s, unit));
    bands
        .chain(lines(true).chain(lines(false)).map(|(s, &width)| line(s, width, unit)))
        .chain(bars)
        .collect()
}

/// Widths of the lines. Each later line that coincides with an earlier one widens the earlier line,
/// which therefore stays visible at both sides. Thin lines neither gain width nor count.
pub fn widths(series: &[Series]) -> Vec<f64> {
    let covers = |i: usize| {
        series[i + 1..].iter().filter(|other| !other.thin && series[i].coincides(other)).count()
    };
    let width =
        |i: usize| if series[i].thin { WIDTHS[1] } else { WIDTHS[0] + CASING * covers(i) as f64 };
    (0..series.len()).map(width).collect()
}

fn band(series: &Series, unit: [f64; 2]) -> Plot {
    let x = series.line.iter().map(|&(x, _)| x / unit[0]);
    let (low, high) =
        (series.band.iter().map(|b| b.0 / unit[1]), series.band.iter().map(|b| b.1 / unit[1]));
    BandPlot::new(x, low, high).with_color(series.color).with_opacity(0.16).into()
}

fn line(series: &Series, width: f64, unit: [f64; 2]) -> Plot {
    let points: Vec<(f64, f64)> =
        series.line.iter().map(|&(x, y)| (x / unit[0], y / unit[1])).collect();
    let color = if series.thin { pale(series.color) } else { series.color.into() };
    if points.len() == 1 {
        return ScatterPlot::new()
            .with_data(points)
            .with_color(color)
            .with_size(2.2 * width)
            .into();
    }
    // Adds lines without points too: kuva omits a panel without plots, including the axes.
    let line = LinePlot::new().with_data(points).with_color(color).with_stroke_width(width);
    match series.dash.array() {
        Some(dashes) => line.with_line_style(LineStyle::Custom(dashes.into())).into(),
        None => line.into(),
    }
}

/// Horizontal bars from the lowest to the highest x.
fn bars(series: &Series, unit: [f64; 2]) -> impl Iterator<Item = Plot> {
    let wide = |(_, (low, high)): &(&(f64, f64), &(f64, f64))| low < high;
    series.line.iter().zip(&series.spread).filter(wide).map(move |(&(_, y), &(low, high))| {
        let ends = [low, high].map(|x| (x / unit[0], y / unit[1]));
        LinePlot::new().with_data(ends).with_color(series.color).with_stroke_width(WIDTHS[1]).into()
    })
}

/// Mixes a colour in the form `#rrggbb` with white. Other colours stay unchanged.
fn pale(color: &str) -> String {
    let channel = |i: usize| u8::from_str_radix(color.get(i..i + 2)?, 16).ok();
    let mix = |value: f64| (value + PALE * (255.0 - value)).round() as u8;
    let mixed = |i: usize| Some(mix(f64::from(channel(i)?)));
    match (color.starts_with('#'), mixed(1), mixed(3), mixed(5)) {
        (true, Some(red), Some(green), Some(blue)) => format!("#{red:02x}{green:02x}{blue:02x}"),
        _ => color.into(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_covered_line_is_wider_than_the_line_that_covers_it() {
        let line = |y: f64| Series::new("a", "red", vec![(0.0, y), (1.0, y)]);
        let thin = Series { thin: true, ..line(1.0) };
        assert_eq!(
            widths(&[thin, line(1.0), line(2.0), line(1.0), line(1.0)]),
            [0.8, 6.6, 1.8, 4.2, 1.8]
        );
    }

    #[test]
    fn pale_colours_are_mixed_with_white() {
        assert_eq!(
            (&*pale("#000000"), &*pale("#ffffff"), &*pale("red")),
            ("#737373", "#ffffff", "red")
        );
    }
}
