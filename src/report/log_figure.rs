//! Draws panels side by side that share one logarithmic y axis.

use super::log_axis::LogAxis;
use super::marks::marks;
use super::{Drawing, Series};
use kuva::prelude::*;

/// What one panel shows under its x axis label.
pub struct Panel {
    /// Name of the x axis.
    pub x_label: &'static str,
    /// The lines of the panel; one with the same label in another panel shares its legend entry.
    pub series: Vec<Series>,
}

/// Renders the panels. The legend stands to the right of them all, where it can cover no data.
pub fn log_figure(title: &str, y_label: &str, panels: &[Panel]) -> Drawing {
    let axis = LogAxis::around(panels.iter().flat_map(|panel| &panel.series).flat_map(|s| {
        let edges = s.band.iter().flat_map(|&(low, high)| [low, high]);
        s.line.iter().map(|&(_, y)| y).chain(edges)
    }));
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
        .with_plots(panels.iter().map(|panel| marks(&panel.series, axis.unit())).collect())
        .with_shared_legend_right_top()
        .with_shared_legend_entries(legend(panels));
    Drawing::of(figure.render())
}

/// One entry a label, also if several panels show it; a series without points is not named.
fn legend(panels: &[Panel]) -> Vec<LegendEntry> {
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
fn panel_layout(panel: &Panel, axis: &LogAxis, y_label: Option<&str>) -> Layout {
    let xs = || panel.series.iter().flat_map(|s| &s.line).map(|&(x, _)| x);
    let x_min = xs().fold(0.0, f64::min);
    let x_max = xs().fold(x_min, f64::max);
    let x_max = if x_max > x_min { x_max } else { x_min + 1.0 };
    // A dot needs room, which a line that starts at the axis does not.
    let room = if panel.series.iter().any(|s| s.line.len() == 1) { 0.04 * (x_max - x_min) } else { 0.0 };
    let (x_min, x_max) = (x_min - room, x_max + room);
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
        .with_theme(theme());
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

/// Quiet lines behind the data.
pub fn theme() -> Theme {
    Theme { grid_color: "#e6e6e6".into(), axis_color: "#444".into(), legend_border: "none".into(), ..Theme::light() }
}
