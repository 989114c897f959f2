//! Distributions of losses.

use super::log_figure::{Panel, log_figure};
use super::series::{drawable, thinned_to};
use super::{Drawing, Series};

/// Draws ascending losses against the share of rollouts with at most this loss, in %. Omits losses
/// that a logarithmic axis cannot show, as those of diverged rollouts: their line ends early.
pub fn distribution(title: &str, policies: Vec<(String, &'static str, Vec<f64>)>) -> Drawing {
    /// Largest number of points of a line.
    const POINTS: usize = 250;
    let series = |(label, color, sorted): (String, &'static str, Vec<f64>)| {
        let total = sorted.len() as f64;
        let points = sorted.into_iter().enumerate().map(|(i, loss)| ((i + 1) as f64 / total * 100.0, loss));
        Series::new(label, color, thinned_to(POINTS, points.filter(|&(_, loss)| drawable(loss)).collect()))
    };
    let panel = Panel {
        title: String::new(),
        x_label: "share of rollouts (%)".into(),
        log_x: false,
        y_label: "loss".into(),
        y_axis: 0,
        series: policies.into_iter().map(series).collect(),
    };
    log_figure(title, &[vec![panel]])
}
