//! Measured and simulated trajectories, with residuals.

use super::log_figure::{Panel, XScale, legend, plain, theme};
use super::marks::marks;
use super::series::{thinned, x_range};
use super::{Drawing, Series};
use kuva::prelude::*;

/// Width of a panel, and height without column title and x label, in pixels.
const SIZE: [f64; 2] = [330.0, 170.0];

/// Title of a column, and its panels from top to bottom: label of the y axis, and lines.
pub type FittedColumn = (String, Vec<(String, Vec<Series>)>);

/// Draws a grid of panels over time in s: one column per title, one row per label. All columns have
/// the same labels.
pub fn fitted(title: &str, columns: Vec<FittedColumn>) -> Drawing {
    let rows = columns.first().map_or(0, |(_, rows)| rows.len());
    let mut panels = Vec::new();
    for row in 0..rows {
        for (name, column) in &columns {
            let (label, series) = &column[row];
            panels.push(Panel {
                title: if row == 0 { name.clone() } else { String::new() },
                x_label: if row + 1 == rows { "time (s)".into() } else { String::new() },
                x_scale: XScale::Linear,
                y_label: label.clone(),
                y_axis: 0,
                series: series.iter().map(drawn).collect(),
            });
        }
    }
    let figure = Figure::new(rows.max(1), columns.len().max(1))
        .with_title(title)
        .with_title_size(17)
        .with_padding(12.0)
        .with_spacing(8.0)
        .with_layouts(panels.iter().map(layout).collect())
        .with_plots(panels.iter().map(|panel| marks(&panel.series, [1.0, 1.0])).collect())
        .with_shared_legend_right_top()
        .with_shared_legend_entries(legend(panels.iter()));
    let figure =
        (0..columns.len()).fold(figure, |figure, column| figure.with_col_width(column, SIZE[0]));
    let figure = (0..rows).fold(figure, |figure, row| {
        let extra = if row == 0 { 24.0 } else { 0.0 } + if row + 1 == rows { 18.0 } else { 0.0 };
        figure.with_row_height(row, SIZE[1] + extra)
    });
    Drawing::of(figure.render())
}

fn drawn(series: &Series) -> Series {
    Series { line: thinned(series.line.clone(), |p| p.1), ..series.clone() }
}

fn layout(panel: &Panel) -> Layout {
    let values = panel.series.iter().flat_map(|series| &series.line).map(|&(_, y)| y);
    let (low, high) =
        values.fold((f64::INFINITY, f64::NEG_INFINITY), |(low, high), y| (low.min(y), high.max(y)));
    let (low, high) = match low < high {
        true => (low, high),
        false if low.is_finite() => {
            let half = (1e-3 * low.abs()).max(1.0);
            (low - half, low + half)
        }
        false => (-1.0, 1.0),
    };
    let margin = 0.05 * (high - low);
    let [x_min, x_max] = x_range(&panel.series);
    let mut layout = Layout::new((x_min, x_max), (low - margin, high + margin))
        .with_x_axis_min(x_min)
        .with_x_axis_max(x_max)
        .with_y_axis_min(low - margin)
        .with_y_axis_max(high + margin)
        .with_x_tick_format(plain())
        .with_y_tick_format(plain())
        .with_tick_size(11)
        .with_label_size(12)
        .with_title_size(14)
        .with_y_label(&*panel.y_label)
        .with_theme(theme());
    if !panel.title.is_empty() {
        layout = layout.with_title(&*panel.title);
    }
    if !panel.x_label.is_empty() {
        layout = layout.with_x_label(&*panel.x_label);
    }
    layout
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_single_extreme_value_of_a_long_line_is_drawn() {
        let line = |i: i32| (f64::from(i), if i == 3331 { 9.0 } else { f64::from(i % 2) });
        let series = Series::new("a", "red", (0..10_000).map(line).collect());
        assert!(drawn(&series).line.contains(&(3331.0, 9.0)));
        let picture =
            fitted("title", vec![("column".into(), vec![("row".into(), vec![series])])]).to_svg();
        assert!(picture.len() < 50_000, "{} bytes", picture.len());
    }
}
