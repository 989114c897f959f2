//! Draws panels with logarithmic y axes, in rows and columns.

use super::Drawing;
use kuva::prelude::*;

/// One panel of a figure.
pub struct Panel {
    /// Stands above it; may be empty.
    pub title: String,
    /// Name of the x axis.
    pub x_label: &'static str,
    /// Name of the y axis.
    pub y_label: String,
    /// Panels with the same number share the range of their y axes.
    pub y_axis: usize,
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

/// Plotted area of a panel in a figure of one or two, and of many.
const SIZES: [[f64; 2]; 2] = [[380.0, 350.0], [250.0, 240.0]];
/// Room at the left for the numbers and the name of a y axis, or for nothing.
const LABELLED: f64 = 116.0;
const BARE: f64 = 62.0;

/// Renders rows of panels, all of the same length. The legend stands to the right of them all, where it can cover no
/// data. A panel shows the numbers of its y axis unless its left neighbour has the same axis.
pub fn log_figure(title: &str, rows: &[Vec<Panel>]) -> Drawing {
    let panels = || rows.iter().flatten();
    let columns = rows.iter().map(Vec::len).max().unwrap_or(0).max(1);
    let axes: Vec<LogAxis> = (0..=panels().map(|panel| panel.y_axis).max().unwrap_or(0))
        .map(|axis| LogAxis::of(panels().filter(|panel| panel.y_axis == axis)))
        .collect();
    let labelled = |row: &[Panel], column: usize| column == 0 || row[column - 1].y_axis != row[column].y_axis;
    let layouts = rows.iter().enumerate().flat_map(|(i, row)| {
        let last = i + 1 == rows.len();
        let axes = &axes;
        row.iter().enumerate().map(move |(j, panel)| panel_layout(panel, &axes[panel.y_axis], labelled(row, j), last))
    });
    let [width, height] = SIZES[usize::from(rows.len() > 1 || columns > 2)];
    let figure = Figure::new(rows.len().max(1), columns)
        .with_title(title)
        .with_title_size(17)
        .with_padding(12.0)
        .with_spacing(8.0)
        .with_layouts(layouts.collect())
        .with_plots(panels().map(|panel| axes[panel.y_axis].plots(panel)).collect())
        .with_shared_legend_right_top()
        .with_shared_legend_entries(legend(panels()));
    // A panel is wider by what it shows of its y axis, so that the plotted areas come out equally wide.
    let room = |column: usize| if rows.iter().any(|row| labelled(row, column)) { LABELLED } else { BARE };
    let figure = (0..columns).fold(figure, |figure, column| figure.with_col_width(column, width + room(column)));
    // So are the names of the x axes under the last row, and the titles above the first.
    let figure = (0..rows.len()).fold(figure, |figure, row| {
        let title = if rows[row].iter().any(|panel| !panel.title.is_empty()) { 24.0 } else { 0.0 };
        figure.with_row_height(row, height + title + if row + 1 == rows.len() { 18.0 } else { 0.0 })
    });
    Drawing::of(figure)
}

impl Panel {
    /// All that must be within its y axis.
    fn values(&self) -> impl Iterator<Item = f64> {
        self.series.iter().flat_map(|s| {
            let edges = s.band.iter().flat_map(|&(low, high)| [low, high]);
            s.line.iter().map(|&(_, y)| y).chain(edges)
        })
    }
}

/// One entry a label, also if several panels show it; a series without points is not named.
pub(super) fn legend<'a>(panels: impl Iterator<Item = &'a Panel>) -> Vec<LegendEntry> {
    let mut entries: Vec<LegendEntry> = Vec::new();
    for s in panels.flat_map(|panel| &panel.series).filter(|s| !s.line.is_empty()) {
        if entries.iter().all(|entry| entry.label != s.label) {
            let (label, color) = (s.label.clone(), s.color.into());
            entries.push(LegendEntry { label, color, shape: LegendShape::Line, dasharray: None });
        }
    }
    entries
}

/// The axes of one panel, with the names and numbers that are to be shown.
pub(super) fn panel_layout(panel: &Panel, axis: &LogAxis, y_labelled: bool, x_labelled: bool) -> Layout {
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
        .with_tick_size(11)
        .with_label_size(13)
        .with_title_size(14)
        .with_theme(theme);
    if !panel.title.is_empty() {
        layout = layout.with_title(&*panel.title);
    }
    if x_labelled {
        layout = layout.with_x_label(panel.x_label);
    }
    if y_labelled {
        // kuva reserves room for its own, shorter names of the ticks.
        layout = layout.with_y_label(&*panel.y_label).with_y_label_offset(-6.0, 0.0);
    } else {
        layout.suppress_y_ticks = true;
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
    pub(super) fn of<'a>(panels: impl Iterator<Item = &'a Panel>) -> Self {
        Self::around(panels.flat_map(Panel::values))
    }

    /// The axis around the values, rounded outward to one digit. It spans at least a factor of four, so that it has two
    /// or three ticks, which are at 1, 2 and 5 times the powers of ten.
    fn around(values: impl Iterator<Item = f64>) -> Self {
        let (min, max) = values.fold((f64::INFINITY, 0.0), |(min, max), y| (y.min(min), y.max(max)));
        let (min, max) = if max > 0.0 { (min, max) } else { (0.1, 1.0) };
        let exponent = min.log10().floor() as i32;
        let unit = 10f64.powi(exponent);
        let round_numbers = || (-1..=200).flat_map(|e| (1..10).map(move |m| f64::from(m) * 10f64.powi(e)));
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
                (exponent, digit @ (1 | 2 | 5)) if decades <= 2.0 && exponent.abs() <= 3 => {
                    let places = usize::try_from(-exponent).unwrap_or(0);
                    format!("{:.places$}", f64::from(digit) * 10f64.powi(exponent))
                }
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
    fn axis_is_rounded_outward_to_one_digit() {
        let axis = LogAxis::around([0.03, 4.0].into_iter());
        assert_eq!((axis.exponent, axis.low, axis.high), (-2, 3.0, 400.0));
        let flat = LogAxis::around([1.0, 1.0].into_iter());
        assert!(flat.low <= 1.0 && flat.high >= 4.0);
        let tiny = LogAxis::around([1e-99, 1e99].into_iter());
        assert!((1.0..10.0).contains(&tiny.low) && tiny.high.is_finite());
    }

    #[test]
    fn ticks_are_named_in_the_units_of_the_data() {
        assert_eq!(labels(&[1e-13, 1e-5]), ["10⁻¹³", "", "", "10⁻¹²"]);
        assert_eq!(labels(&[0.1, 1.0]), ["0.1", "0.2", "0.5", "1"]);
        assert_eq!(labels(&[1e-5, 1e-4]), ["10⁻⁵", "2·10⁻⁵", "5·10⁻⁵", "10⁻⁴"]);
    }

    #[test]
    fn only_drawable_values_pass() {
        assert!(drawable(1e-12));
        assert!(![0.0, -1.0, f64::NAN, f64::INFINITY, 1e-320].into_iter().any(drawable));
    }
}
