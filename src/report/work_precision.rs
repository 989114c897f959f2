//! What accuracy costs: errors against work, both on logarithmic axes.

use super::log_figure::{Panel, log_figure};
use super::series::drawable;
use super::{Drawing, Series};

/// One diagram of [`work_precision`].
pub struct Work {
    /// Name of the x axis.
    pub x_label: &'static str,
    /// Name of the y axis; diagrams with the same name share its range.
    pub y_label: &'static str,
    /// A line for every method, its points (work, error) in the order in which they are to be joined.
    pub series: Vec<Series>,
}

/// Diagrams of errors against work side by side. Points that a logarithmic axis cannot show are left out.
pub fn work_precision(title: &str, diagrams: Vec<Work>) -> Drawing {
    let labels: Vec<&str> = diagrams.iter().map(|diagram| diagram.y_label).collect();
    let panel = |Work { x_label, y_label, mut series }: Work| {
        for series in &mut series {
            series.line.retain(|&(x, y)| drawable(x) && drawable(y));
        }
        let y_axis = labels.iter().position(|label| *label == y_label).unwrap_or(0);
        Panel { title: String::new(), x_label, log_x: true, y_label: y_label.into(), y_axis, series }
    };
    log_figure(title, &[diagrams.into_iter().map(panel).collect()])
}
