//! Work-precision diagrams: error against work, on logarithmic axes.

use super::log_figure::{Panel, log_figure};
use super::series::drawable;
use super::{Drawing, Series};

/// One panel of [`work_precision`].
pub struct Work {
    /// Label of the x axis.
    pub x_label: &'static str,
    /// Label of the y axis. Panels with the same label share the range of their y axes.
    pub y_label: &'static str,
    /// One line per method, with points (work, error) in drawing order.
    pub series: Vec<Series>,
}

/// Draws panels of error against work side by side. Omits points that a logarithmic axis cannot
/// show.
pub fn work_precision(title: &str, diagrams: Vec<Work>) -> Drawing {
    let labels: Vec<&str> = diagrams.iter().map(|diagram| diagram.y_label).collect();
    let panel = |Work { x_label, y_label, mut series }: Work| {
        for series in &mut series {
            series.line.retain(|&(x, y)| drawable(x) && drawable(y));
        }
        let y_axis = labels.iter().position(|label| *label == y_label).unwrap_or(0);
        Panel { title: String::new(), x_label: x_label.into(), log_x: true, y_label: y_label.into(), y_axis, series }
    };
    log_figure(title, &[diagrams.into_iter().map(panel).collect()])
}
