//! Work-precision diagrams: error against work, on logarithmic axes.

use super::log_figure::{Panel, XScale, entry, legend, log_figure_with};
use super::series::drawable;
use super::{Dash, Drawing, Series};

/// One panel of [`work_precision`].
pub struct Work {
    /// Label of the x axis.
    pub x_label: &'static str,
    /// Label of the y axis. Panels with the same label share the range of their y axes.
    pub y_label: &'static str,
    /// One line per method, with points (work, error) in drawing order.
    pub series: Vec<Series>,
}

/// Colour of the legend entries of dashes.
const INK: &str = "#444444";

/// Draws panels of error against work side by side. Omits points that a logarithmic axis cannot
/// show.
///
/// With `dashes`, the legend shows colours and dashes separately: one solid entry per label of the
/// series, and one entry per name in `dashes`.
pub fn work_precision(title: &str, dashes: &[(&str, Dash)], diagrams: Vec<Work>) -> Drawing {
    let labels: Vec<&str> = diagrams.iter().map(|diagram| diagram.y_label).collect();
    let panel = |Work { x_label, y_label, mut series }: Work| {
        series.iter_mut().for_each(omit);
        let y_axis = labels.iter().position(|label| *label == y_label).unwrap_or(0);
        Panel {
            title: String::new(),
            x_label: x_label.into(),
            x_scale: XScale::Log,
            y_label: y_label.into(),
            y_axis,
            series,
        }
    };
    let row: Vec<Panel> = diagrams.into_iter().map(panel).collect();
    let mut entries = legend(row.iter());
    if !dashes.is_empty() {
        entries.iter_mut().for_each(|entry| entry.dasharray = None);
        entries.extend(
            dashes
                .iter()
                .map(|&(name, dash)| entry(&Series::new(name, INK, Vec::new()).dash(dash))),
        );
    }
    log_figure_with(title, &[row], entries)
}

/// Removes the points that a logarithmic axis cannot show, with their bars. A bar with an end that
/// the axis cannot show shrinks to its point.
fn omit(series: &mut Series) {
    let shown: Vec<bool> = series.line.iter().map(|&(x, y)| drawable(x) && drawable(y)).collect();
    let (mut points, mut bars) = (shown.iter(), shown.iter());
    series.line.retain(|_| points.next() == Some(&true));
    series.spread.retain(|_| bars.next() == Some(&true));
    for (bar, &(x, _)) in series.spread.iter_mut().zip(&series.line) {
        if !(drawable(bar.0) && drawable(bar.1)) {
            *bar = (x, x);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_bar_extends_from_the_lowest_to_the_highest_time() {
        let spread = vec![(0.0, 1.0), (0.0, 7.0), (1.0, 4.0)];
        let series = Series {
            spread,
            ..Series::new("a", "#123456", vec![(3.0, f64::NAN), (5.0, 1e-2), (2.0, 1e-3)])
        };
        let mut shown = series.clone();
        omit(&mut shown);
        assert_eq!(
            (&shown.line[..], &shown.spread[..]),
            (&[(5.0, 1e-2), (2.0, 1e-3)][..], &[(5.0, 5.0), (1.0, 4.0)][..])
        );
        let picture = work_precision(
            "a",
            &[],
            vec![Work { x_label: "x", y_label: "y", series: vec![series] }],
        )
        .to_svg();
        let document = roxmltree::Document::parse(&picture).expect("an SVG is XML");
        let bars = document.descendants().filter(|node| {
            node.has_tag_name("path") && node.attribute("stroke") == Some("#123456")
        });
        assert_eq!(bars.count(), 2, "the line and one bar");
    }

    #[test]
    fn the_legend_shows_every_method_and_every_dash_once() {
        let series = [Dash::Solid, Dash::Dashed]
            .map(|dash| Series::new("a", "#123456", vec![(1.0, 1.0), (2.0, 2.0)]).dash(dash));
        let dashes = [("f32", Dash::Dashed), ("f64", Dash::Solid)];
        let work = Work { x_label: "x", y_label: "y", series: series.into() };
        let picture = work_precision("title", &dashes, vec![work]).to_svg();
        for label in [">a<", ">f32<", ">f64<"] {
            assert_eq!(picture.matches(label).count(), 1, "{label}");
        }
    }
}
