//! Marks of a chart: lines, dots and bands.

use super::Series;
use kuva::prelude::*;

/// Creates the marks of the series in the given x and y units, with all bands below all lines.
pub fn marks(series: &[Series], unit: [f64; 2]) -> Vec<Plot> {
    let bands = series.iter().filter(|s| !s.band.is_empty()).map(|s| band(s, unit));
    bands.chain(series.iter().map(|s| line(s, unit))).collect()
}

fn band(series: &Series, unit: [f64; 2]) -> Plot {
    let x = series.line.iter().map(|&(x, _)| x / unit[0]);
    let (low, high) = (series.band.iter().map(|b| b.0 / unit[1]), series.band.iter().map(|b| b.1 / unit[1]));
    BandPlot::new(x, low, high).with_color(series.color).with_opacity(0.16).into()
}

fn line(series: &Series, unit: [f64; 2]) -> Plot {
    let points: Vec<(f64, f64)> = series.line.iter().map(|&(x, y)| (x / unit[0], y / unit[1])).collect();
    if points.len() == 1 {
        return ScatterPlot::new().with_data(points).with_color(series.color).with_size(4.0).into();
    }
    // Adds lines without points too: kuva omits a panel without plots, including the axes.
    let line = LinePlot::new().with_data(points).with_color(series.color).with_stroke_width(1.8);
    if series.dashed { line.with_dashed().into() } else { line.into() }
}
