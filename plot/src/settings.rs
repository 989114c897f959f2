//! Final losses over settings.

use super::log_figure::{Panel, XScale, log_figure};
use super::series::drawable_bands;
use super::{Drawing, Series};

/// Smallest ratio of the largest to the smallest value of a setting with a logarithmic axis.
const LOG_RATIO: f64 = 10.0;

/// Draws final losses against settings: one panel per setting, one line with a band per method.
/// Omits points without a band, and points that the axis of losses cannot show. This axis is linear
/// if a loss is 0 or negative, otherwise logarithmic. The axis of a setting is logarithmic if its
/// values are positive and span at least a factor of ten.
pub fn settings(title: &str, panels: Vec<(String, Vec<Series>)>) -> Drawing {
    let panel = |(setting, series): (String, Vec<Series>)| {
        let values = || series.iter().flat_map(|series| &series.line).map(|&(x, _)| x);
        let (low, high) = (values().fold(f64::INFINITY, f64::min), values().fold(0.0, f64::max));
        Panel {
            title: String::new(),
            x_label: setting,
            x_scale: if low > 0.0 && high >= LOG_RATIO * low {
                XScale::Log
            } else {
                XScale::Linear
            },
            y_label: "final test loss".into(),
            y_axis: 0,
            series,
        }
    };
    log_figure(title, &[drawable_bands(panels).into_iter().map(panel).collect()])
}
