//! Losses over the values of a setting.

use super::log_figure::{Panel, XScale, log_figure};
use super::series::drawable_bands;
use super::{Drawing, Series};

/// Draws losses against a setting: one panel per title, one line with a band per policy. Omits
/// points without a band, and points that the axis cannot show. The axis is linear if a loss is 0
/// or negative, otherwise logarithmic.
pub fn robustness(title: &str, setting: &str, panels: Vec<(String, Vec<Series>)>) -> Drawing {
    let panel = |(title, series): (String, Vec<Series>)| Panel {
        title,
        x_label: setting.into(),
        x_scale: XScale::FromSmallest,
        y_label: "loss".into(),
        y_axis: 0,
        series,
    };
    log_figure(title, &[drawable_bands(panels).into_iter().map(panel).collect()])
}

#[cfg(test)]
mod tests {
    use super::super::settings;
    use super::*;

    #[test]
    fn bands_of_negative_losses_are_drawn_over_one_setting_and_several() {
        let series = Series {
            band: vec![(-2.0, 1.0), (-9.0, -4.0)],
            ..Series::new("a", "#123456", vec![(1.0, -1.0), (2.0, -5.0)])
        };
        let panels = vec![("b".to_owned(), vec![series])];
        let pictures = [robustness("a", "mass", panels.clone()), settings("a", panels)];
        for picture in pictures.map(|picture| picture.to_svg()) {
            assert!(!picture.contains("no positive data") && picture.contains(">−4<"), "{picture}");
        }
    }
}
