//! Distributions of losses.

use super::log_figure::{Panel, XScale, log_figure};
use super::series::thinned_to;
use super::{Drawing, Series, YScale, line_style};

/// Draws each loss against the share of rollouts, in %, that have at most this loss. Each policy
/// has a label and its losses in ascending order.
///
/// Omits losses that the axis cannot show, for example those of diverged rollouts. A line with
/// diverged rollouts therefore ends before 100 %. The axis is linear if a loss is 0 or negative,
/// otherwise logarithmic.
pub fn distribution(title: &str, policies: Vec<(String, Vec<f64>)>) -> Drawing {
    /// Largest number of points of a line.
    const POINTS: usize = 250;
    let scale = YScale::of(policies.iter().flat_map(|(_, losses)| losses).copied());
    let series = |(i, (label, sorted)): (usize, (String, Vec<f64>))| {
        let (color, dash) = line_style(i);
        let total = sorted.len() as f64;
        let points =
            sorted.into_iter().enumerate().map(|(i, loss)| ((i + 1) as f64 / total * 100.0, loss));
        Series::new(
            label,
            color,
            thinned_to(POINTS, points.filter(|&(_, loss)| scale.shows(loss)).collect()),
        )
        .dash(dash)
    };
    let panel = Panel {
        title: String::new(),
        x_label: "share of rollouts (%)".into(),
        x_scale: XScale::Linear,
        y_label: "loss".into(),
        y_axis: 0,
        series: policies.into_iter().enumerate().map(series).collect(),
    };
    log_figure(title, &[vec![panel]])
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn negative_losses_are_drawn() {
        let picture = distribution("a", vec![("b".into(), vec![-9.0, -1.0, 2.0])]).to_svg();
        assert!(!picture.contains("no positive data") && picture.contains(">−5<"), "{picture}");
    }
}
