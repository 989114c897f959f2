//! Grids of panels with logarithmic or linear y axes.

use super::axes::number;
use super::log_axis::LogAxis;
use super::marks::marks;
use super::series::{tick_step, x_range};
use super::y_axis::YAxis;
use super::{Drawing, Series};
use kuva::prelude::*;

/// Scale of an x axis.
#[derive(Clone, Copy, PartialEq, Eq)]
pub enum XScale {
    /// Linear, from 0, or from the smallest x if negative.
    Linear,
    /// Linear, from the smallest x.
    FromSmallest,
    /// Logarithmic. Every x must be positive.
    Log,
    /// Ticks at the whole numbers from 1 to this number.
    Numbers(usize),
}

/// One panel of a figure.
pub struct Panel {
    /// Title above the panel; may be empty.
    pub title: String,
    /// Label of the x axis.
    pub x_label: String,
    /// Scale of the x axis.
    pub x_scale: XScale,
    /// Label of the y axis.
    pub y_label: String,
    /// Panels with the same number share the range of their y axes.
    pub y_axis: usize,
    /// Lines of the panel. Lines with equal labels share a legend entry, across all panels.
    pub series: Vec<Series>,
}

impl Panel {
    /// Logarithmic x axis, if the panel has one.
    fn x_axis(&self) -> Option<LogAxis> {
        let bars =
            |s: &Series| s.spread.iter().flat_map(|&(low, high)| [low, high]).collect::<Vec<_>>();
        let xs = self.series.iter().flat_map(|s| s.line.iter().map(|&(x, _)| x).chain(bars(s)));
        (self.x_scale == XScale::Log).then(|| LogAxis::covering(xs))
    }

    /// Unit of the x axis: a power of ten on a logarithmic axis, otherwise 1.
    pub fn x_unit(&self) -> f64 {
        self.x_axis().map_or(1.0, |axis| axis.unit())
    }
}

/// Width and height of a plotted area, in pixels: first in figures of one row with at most two
/// panels, then in larger figures.
const SIZES: [[f64; 2]; 2] = [[380.0, 350.0], [250.0, 240.0]];
/// Margins of a panel without labels, in pixels: left, right, top, bottom.
const MARGINS: [f64; 4] = [14.0, 16.0, 10.0, 32.0];
/// Width of the y tick labels, in pixels.
const TICK_LABELS: f64 = 44.0;
/// Height of the title and of the x label, and width of the y label, in pixels.
const LABEL: f64 = 22.0;

/// Mean width of a letter of a note, in pixels.
const LETTER: f64 = 6.2;

/// Renders rows of panels. All rows have the same number of panels.
///
/// The legend is to the right of all panels, so it covers no data. A panel omits its y tick labels
/// if its left neighbour has an equal `y_axis`. A panel omits its y label if the left neighbour has
/// an equal one. A panel omits its x label if the panel below has an equal one.
pub fn log_figure(title: &str, rows: &[Vec<Panel>]) -> Drawing {
    log_figure_with(title, rows, legend(rows.iter().flatten()))
}

/// Renders rows of panels as [`log_figure`] does, with these legend entries.
pub fn log_figure_with(title: &str, rows: &[Vec<Panel>], legend: Vec<LegendEntry>) -> Drawing {
    let panels = || rows.iter().flatten();
    let columns = rows.iter().map(Vec::len).max().unwrap_or(0).max(1);
    let axes: Vec<YAxis> = (0..=panels().map(|panel| panel.y_axis).max().unwrap_or(0))
        .map(|axis| {
            YAxis::of(panels().filter(|panel| panel.y_axis == axis).flat_map(|panel| &panel.series))
        })
        .collect();
    // Determines the visible elements of each panel. Panels of a column reserve the same width for
    // labels, panels of a row the same height. All plotted areas therefore have the same size.
    let below =
        |i: usize, j: usize| rows.get(i + 1).and_then(|row| row.get(j)).map(|panel| &panel.x_label);
    let shows = |i: usize, j: usize| {
        let (row, panel) = (&rows[i], &rows[i][j]);
        let left = j.checked_sub(1).map(|j| &row[j]);
        Shows {
            y_numbers: left.is_none_or(|left| left.y_axis != panel.y_axis),
            y_name: left.is_none_or(|left| left.y_label != panel.y_label),
            x_name: below(i, j) != Some(&panel.x_label),
        }
    };
    let extra = |size: f64, visible: bool| if visible { size } else { 0.0 };
    let left_of = |j: usize| {
        let any = |visible: fn(Shows) -> bool| {
            (0..rows.len()).any(|i| j < rows[i].len() && visible(shows(i, j)))
        };
        MARGINS[0]
            + extra(TICK_LABELS, any(|shows| shows.y_numbers))
            + extra(LABEL, any(|shows| shows.y_name))
    };
    let top_of =
        |i: usize| MARGINS[2] + extra(LABEL, rows[i].iter().any(|panel| !panel.title.is_empty()));
    let bottom_of =
        |i: usize| MARGINS[3] + extra(LABEL, (0..rows[i].len()).any(|j| shows(i, j).x_name));
    let layout = |i: usize, j: usize| {
        panel_layout(&rows[i][j], &axes[rows[i][j].y_axis], shows(i, j))
            .with_force_margins(left_of(j), MARGINS[1])
            .with_force_margins_y(top_of(i), bottom_of(i))
    };
    let cells = rows.iter().enumerate().flat_map(|(i, row)| (0..row.len()).map(move |j| (i, j)));
    let [width, height] = SIZES[usize::from(rows.len() > 1 || columns > 2)];
    let figure = Figure::new(rows.len().max(1), columns)
        .with_title(title)
        .with_title_size(17)
        .with_padding(12.0)
        .with_spacing(8.0)
        .with_layouts(cells.map(|(i, j)| layout(i, j)).collect())
        .with_plots(
            panels()
                .map(|panel| marks(&panel.series, [panel.x_unit(), axes[panel.y_axis].unit()]))
                .collect(),
        )
        .with_shared_legend_right_top()
        .with_shared_legend_entries(legend);
    let figure = (0..columns)
        .fold(figure, |figure, j| figure.with_col_width(j, width + left_of(j) + MARGINS[1]));
    let figure = (0..rows.len())
        .fold(figure, |figure, i| figure.with_row_height(i, height + top_of(i) + bottom_of(i)));
    Drawing::of(figure.render())
}

/// Builds one legend entry per label across all panels; omits thin series and series without
/// points.
pub fn legend<'a>(panels: impl Iterator<Item = &'a Panel>) -> Vec<LegendEntry> {
    let mut entries: Vec<LegendEntry> = Vec::new();
    for s in panels.flat_map(|panel| &panel.series).filter(|s| !s.line.is_empty() && !s.thin) {
        if entries.iter().all(|entry| entry.label != s.label) {
            entries.push(entry(s));
        }
    }
    entries
}

/// Legend entry of a series, with its dashes.
pub fn entry(series: &Series) -> LegendEntry {
    let (label, color) = (series.label.clone(), series.color.into());
    LegendEntry {
        label,
        color,
        shape: LegendShape::Line,
        dasharray: series.dash.array().map(String::from),
    }
}

/// Visible axis elements of a panel.
#[derive(Clone, Copy)]
pub struct Shows {
    /// Tick labels of the y axis.
    pub y_numbers: bool,
    /// Label of the y axis.
    pub y_name: bool,
    /// Label of the x axis.
    pub x_name: bool,
}

/// Layout of one panel with its axes.
pub fn panel_layout(panel: &Panel, axis: &YAxis, shows: Shows) -> Layout {
    let x_axis = panel.x_axis();
    let (x_min, x_max) = match (&x_axis, panel.x_scale) {
        (Some(axis), _) => (axis.low, axis.high),
        (None, XScale::Numbers(count)) => (0.5, count as f64 + 0.5),
        (None, _) => {
            let xs = panel.series.iter().flat_map(|series| &series.line).map(|&(x, _)| x);
            let smallest = xs.fold(f64::INFINITY, f64::min);
            let is_cut = panel.x_scale == XScale::FromSmallest && smallest.is_finite();
            let [x_min, x_max] = x_range(&panel.series);
            let x_min = if is_cut && smallest < x_max { smallest } else { x_min };
            // Adds a margin for single dots; lines may start at the axis.
            let margin = if panel.series.iter().any(|s| s.line.len() == 1) {
                0.04 * (x_max - x_min)
            } else {
                0.0
            };
            (x_min - margin, x_max + margin)
        }
    };
    let mut layout = axis
        .on(Layout::new((x_min, x_max), axis.ends().into()))
        .with_x_axis_min(x_min)
        .with_x_axis_max(x_max)
        .with_tick_size(11)
        .with_label_size(13)
        .with_title_size(14)
        .with_theme(theme());
    if let Some(axis) = &x_axis {
        layout = layout.with_log_x().with_x_tick_format(axis.tick_format());
    } else if let XScale::Numbers(_) = panel.x_scale {
        layout = layout.with_x_tick_step(1.0).with_x_tick_format(plain());
    } else {
        layout = layout
            .with_x_tick_step(tick_step([x_min, x_max], &panel.series))
            .with_x_tick_format(plain());
    }
    if !panel.title.is_empty() {
        layout = layout.with_title(&*panel.title);
    }
    if shows.x_name {
        layout = layout.with_x_label(panel.x_label.as_str());
    }
    if shows.y_name {
        layout = layout.with_y_label(&*panel.y_label);
    }
    layout.suppress_y_ticks = !shows.y_numbers;
    for (i, s) in panel.series.iter().filter(|s| !s.note.is_empty()).enumerate() {
        // Stacks notes upwards from the lower left corner. Texts are centered.
        let y = axis.at(0.04 + 0.07 * i as f64);
        let text = format!("{}: {}", s.label, s.note);
        let middle = (8.0 + 0.5 * LETTER * text.chars().count() as f64) / SIZES[1][0];
        let note = TextAnnotation::new(text, x_min + middle.min(0.5) * (x_max - x_min), y);
        layout = layout.with_annotation(note.with_color(s.color).with_font_size(11));
    }
    if panel.series.iter().all(|s| s.line.is_empty()) {
        let text = match axis {
            YAxis::Log(_) => "no positive data",
            YAxis::Linear(_) => "no finite data",
        };
        let x_middle =
            if x_axis.is_some() { (x_min * x_max).sqrt() } else { (x_min + x_max) / 2.0 };
        layout = layout
            .with_annotation(TextAnnotation::new(text, x_middle, axis.at(0.5)).with_color("#777"));
    }
    layout
}

/// Formats ticks of a linear axis.
pub fn plain() -> TickFormat {
    TickFormat::Custom(std::sync::Arc::new(number))
}

/// Light theme with faint grid lines.
pub fn theme() -> Theme {
    Theme {
        grid_color: "#e6e6e6".into(),
        axis_color: "#444".into(),
        legend_border: "none".into(),
        ..Theme::light()
    }
}

#[cfg(test)]
mod tests {
    use super::super::Dash;
    use super::*;

    fn series(label: &str, dash: Dash) -> Series {
        Series::new(label, "#0072B2", vec![(1.0, 2.0), (10.0, 3.0)]).dash(dash)
    }

    fn panel(title: &str, y_axis: usize) -> Panel {
        Panel {
            title: title.into(),
            x_label: "epoch".into(),
            x_scale: XScale::Linear,
            y_label: format!("loss {y_axis}"),
            y_axis,
            series: vec![
                series("a", Dash::Solid),
                series("b", Dash::Dotted),
                Series { thin: true, ..series("c", Dash::Solid) },
            ],
        }
    }

    fn picture() -> String {
        let rows = [
            vec![panel("one", 0), panel("two", 1)],
            vec![panel("", 0), panel("", 1)],
            vec![panel("", 0), panel("", 1)],
        ];
        log_figure("title", &rows).to_svg()
    }

    #[test]
    fn all_plotted_areas_have_the_same_size() {
        let picture = picture();
        let document = roxmltree::Document::parse(&picture).expect("an SVG is XML");
        let clips = document.descendants().filter(|node| node.has_tag_name("clipPath"));
        let size = |clip: roxmltree::Node| {
            let rect = clip.first_element_child().expect("a rectangle");
            ["width", "height"].map(|name| {
                rect.attribute(name).expect("a length").parse::<f64>().expect("a number")
            })
        };
        let sizes: Vec<[f64; 2]> = clips.map(size).collect();
        assert_eq!(sizes.len(), 6);
        let near = |size: &[f64; 2]| (0..2).all(|i| (size[i] - sizes[0][i]).abs() < 0.1);
        assert!(sizes.iter().all(near), "{sizes:?}");
    }

    #[test]
    fn the_legend_has_one_entry_with_dashes_per_bold_label() {
        let picture = picture();
        let entry = |label: &str| {
            picture.split_once(&format!(">{label}</text><line ")).expect("an entry").1
        };
        let dashes = |label: &str| {
            entry(label)
                .split("/>")
                .next()
                .is_some_and(|line| line.contains("stroke-dasharray=\"2 3\""))
        };
        assert!(!dashes("a") && dashes("b"));
        assert_eq!(
            ["a", "b", "c"].map(|label| picture.matches(&format!(">{label}</text>")).count()),
            [1, 1, 0]
        );
    }

    #[test]
    fn ticks_of_epochs_are_whole_numbers() {
        let picture = picture();
        let texts =
            picture.split("</text>").filter_map(|text| text.rsplit_once('>')).map(|(_, text)| text);
        let numbers: Vec<f64> = texts.filter_map(|text| text.parse().ok()).collect();
        assert!(numbers.contains(&2.0) && numbers.iter().all(|x| x.fract() == 0.0), "{numbers:?}");
    }
}
