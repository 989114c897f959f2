//! Losses over the values of a setting.

use super::log_figure::{Panel, XScale, log_figure};
use super::{Drawing, Series};

/// Draws losses against a setting: one panel per title, one line with a band per policy. Omits
/// points without a band, and points that a logarithmic axis cannot show.
pub fn robustness(title: &str, setting: &str, panels: Vec<(String, Vec<Series>)>) -> Drawing {
    let panel = |(title, series): (String, Vec<Series>)| Panel {
        title,
        x_label: setting.into(),
        x_scale: XScale::FromSmallest,
        y_label: "loss".into(),
        y_axis: 0,
        series: series.into_iter().map(Series::with_drawable_band).collect(),
    };
    log_figure(title, &[panels.into_iter().map(panel).collect()])
}
