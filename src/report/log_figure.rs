//! Draws panels side by side that share one logarithmic y axis.

use super::Drawing;
use kuva::prelude::*;

/// What one panel shows under its x axis label.
pub struct Panel {
    /// Name of the x axis.
    pub x_label: &'static str,
    /// The lines of the panel; one with the same label in another panel shares its legend entry.
    pub series: Vec<Series>,
}

/// One line, with an optional band around it. Every y must be [`drawable`] and every x finite.
pub struct Series {
    /// Name in the legend.
    pub label: String,
    /// CSS colour of line and band.
    pub color: &'static str,
    /// The points (x, y) of the line, by increasing x; a single one is drawn as a dot.
    pub line: Vec<(f64, f64)>,
    /// The lower and upper edge of the band at each point of the line, or nothing.
    pub band: Vec<(f64, f64)>,
}

/// Whether a value can be put on a log axis: finite, positive and not absurdly large or small.
pub fn drawable(y: f64) -> bool {
    y > 1e-100 && y < 1e100
}

/// Renders the panels. The legend stands to the right of them all, where it can cover no data.
pub fn log_figure(title: &str, y_label: &str, panels: &[Panel]) -> Drawing {
    let axis = LogAxis::of(panels);
    let layouts = panels.iter().enumerate().map(|(i, panel)| panel_layout(panel, &axis, (i == 0).then_some(y_label)));
    let figure = Figure::new(1, panels.len().max(1))
        .with_title(title)
        .with_title_size(17)
        .with_padding(12.0)
        .with_spacing(20.0)
        .with_cell_size(430.0, 350.0)
        // The first panel is wider by its y labels, so that the plotted areas come out equally wide.
        .with_col_width(0, if panels.len() > 1 { 484.0 } else { 560.0 })
        .with_layouts(layouts.collect())
        .with_plots(panels.iter().map(|panel| axis.plots(panel)).collect())
        .with_shared_legend_right_top()
        .with_shared_legend_entries(legend(panels));
    Drawing::of(figure)
}

/// One entry a label, also if several panels show it; a series without points is not named.
pub(super) fn legend(panels: &[Panel]) -> Vec<LegendEntry> {
    let mut entries: Vec<LegendEntry> = Vec::new();
    for s in panels.iter().flat_map(|panel| &panel.series).filter(|s| !s.line.is_empty()) {
        if entries.iter().all(|entry| entry.label != s.label) {
            let (label, color) = (s.label.clone(), s.color.into());
            entries.push(LegendEntry { label, color, shape: LegendShape::Line, dasharray: None });
        }
    }
    entries
}

/// The axes of one panel; only the panel that is given a y label shows the numbers of the y axis.
pub(super) fn panel_layout(panel: &Panel, axis: &LogAxis, y_label: Option<&str>) -> Layout {
    let xs = || panel.series.iter().flat_map(|s| &s.line).map(|&(x, _)| x);
    let x_min = xs().fold(0.0, f64::min);
    let x_max = xs().fold(x_min, f64::max);
    let x_max = if x_max > x_min { x_max } else { x_min + 1.0 };
    // A dot needs room, which a line that starts at the axis does not.
    let room = if panel.series.iter().any(|s| s.line.len() == 1) { 0.04 * (x_max - x_min) } else { 0.0 };
    let (x_min, x_max) = (x_min - room, x_max + room);
    let theme = Theme { grid_color: "#e6e6e6".into(), axis_color: "#444".into(), legend_border: "none".into(), ..Theme::light() };
    let mut layout = Layout::new((x_min, x_max), (axis.low, axis.high))
        .with_log_y()
        .with_x_axis_min(x_min)
        .with_x_axis_max(x_max)
        .with_y_axis_min(axis.low)
        .with_y_axis_max(axis.high)
        .with_y_tick_format(axis.tick_format())
        .with_x_label(panel.x_label)
        .with_tick_size(11)
        .with_label_size(13)
        .with_theme(theme);
    match y_label {
        // kuva reserves room for its own, shorter names of the ticks.
        Some(label) => layout = layout.with_y_label(label).with_y_label_offset(-6.0, 0.0),
        None => layout.suppress_y_ticks = true,
    }
    if panel.series.iter().all(|s| s.line.is_empty()) {
        let middle = (axis.low * axis.high).sqrt();
        layout = layout.with_annotation(TextAnnotation::new("no data", (x_min + x_max) / 2.0, middle).with_color("#777"));
    }
    layout
}

/// A logarithmic axis in units of 10^exponent: kuva draws nothing below 1e-10, so `low` is brought into [1, 10).
pub(super) struct LogAxis {
    exponent: i32,
    low: f64,
    high: f64,
}

impl LogAxis {
    /// The axis around everything that the panels show.
    pub(super) fn of(panels: &[Panel]) -> Self {
        Self::around(panels.iter().flat_map(|panel| &panel.series).flat_map(|s| {
            let edges = s.band.iter().flat_map(|&(low, high)| [low, high]);
            s.line.iter().map(|&(_, y)| y).chain(edges)
        }))
    }

    /// The axis around the values, rounded outward to 1, 2 or 5 times a power of ten so that ticks end it.
    /// It spans at least a factor of four, so that there are three of them.
    fn around(values: impl Iterator<Item = f64>) -> Self {
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

    /// Ticks as powers of ten; those at 2 and 5 are named only where powers alone would be too few.
    fn tick_format(&self) -> TickFormat {
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

    /// The marks of a panel: all the bands below all the lines.
    pub(super) fn plots(&self, panel: &Panel) -> Vec<Plot> {
        let bands = panel.series.iter().filter(|s| !s.band.is_empty()).map(|s| self.band(s));
        bands.chain(panel.series.iter().map(|s| self.line(s))).collect()
    }

    fn band(&self, series: &Series) -> Plot {
        let unit = 10f64.powi(self.exponent);
        let x = series.line.iter().map(|&(x, _)| x);
        let (low, high) = (series.band.iter().map(|b| b.0 / unit), series.band.iter().map(|b| b.1 / unit));
        BandPlot::new(x, low, high).with_color(series.color).with_opacity(0.16).into()
    }

    fn line(&self, series: &Series) -> Plot {
        let unit = 10f64.powi(self.exponent);
        let points: Vec<(f64, f64)> = series.line.iter().map(|&(x, y)| (x, y / unit)).collect();
        if points.len() == 1 {
            return ScatterPlot::new().with_data(points).with_color(series.color).with_size(4.0).into();
        }
        // A line without points is needed too: kuva leaves out a panel that has no plot, axes and all.
        LinePlot::new().with_data(points).with_color(series.color).with_stroke_width(1.8).into()
    }
}

/// The exponent in raised digits.
pub(super) fn superscript(exponent: i32) -> String {
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

    #[test]
    fn only_drawable_values_pass() {
        assert!(drawable(1e-12));
        assert!(![0.0, -1.0, f64::NAN, f64::INFINITY, 1e-320].into_iter().any(drawable));
    }
}
