//! [`Chart`]: a chart with its axis geometry, so that a page can locate the data.

use super::log_figure::{plain, theme};
use super::marks::widths;
use super::series::{cleaned, thinned, tick_step, x_range};
use super::y_axis::YAxis;
use super::{Drawing, Series, YScale};
use kuva::prelude::{Layout, LinePlot, render_multiple};
use kuva::render::color::Color;
use kuva::render::render::{PathData, Primitive};

/// Width and height, in pixels; small enough to keep labels legible on phones.
const SIZE: [f64; 2] = [460.0, 270.0];
/// Margins around the plotted area, in pixels: left, top, right, bottom.
const MARGINS: [f64; 4] = [58.0, 12.0, 16.0, 44.0];

/// Chart without title, legend, y label and notes, which the surrounding page supplies. Does not
/// draw the horizontal bars of a [`Series`].
pub struct Chart {
    x_label: &'static str,
    y_label: &'static str,
    x: [f64; 2],
    y: YAxis,
    series: Vec<Series>,
}

/// Axis geometry of a [`Chart`], linear between the ends.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Frame {
    /// Width and height of the picture.
    pub size: [f64; 2],
    /// Left and right edge of the plotted area, in picture coordinates.
    pub across: [f64; 2],
    /// Lower and upper edge of the plotted area, in picture coordinates, where y points down.
    pub up: [f64; 2],
    /// Data x at the left and right edge.
    pub x: [f64; 2],
    /// Data y at the lower and upper edge, or its decimal logarithm.
    pub y: [f64; 2],
    /// True if `y` holds decimal logarithms.
    pub log: bool,
}

impl Chart {
    /// Creates a chart with a logarithmic y axis. Omits points with a non-finite x, and points with
    /// a y or a band edge outside 1e-100 to 1e100.
    pub fn log(x_label: &'static str, y_label: &'static str, series: Vec<Series>) -> Self {
        Self::scaled(x_label, y_label, YScale::Log, series)
    }

    /// Creates a chart whose y axis is linear if a loss is 0 or negative, otherwise logarithmic.
    /// Omits points with a non-finite x, and points that the axis cannot show.
    pub fn losses(x_label: &'static str, y_label: &'static str, series: Vec<Series>) -> Self {
        let scale = YScale::of(series.iter().flat_map(Series::values));
        Self::scaled(x_label, y_label, scale, series)
    }

    fn scaled(
        x_label: &'static str,
        y_label: &'static str,
        scale: YScale,
        series: Vec<Series>,
    ) -> Self {
        let series = shown(series, |y| scale.shows(y));
        Self { x_label, y_label, x: x_range(&series), y: YAxis::of(series.iter()), series }
    }

    /// Creates a chart with a y axis from `range[0]` to `range[1]`. Omits points with a non-finite
    /// x, and points with a y or a band edge outside that range.
    pub fn linear(
        x_label: &'static str,
        y_label: &'static str,
        range: [f64; 2],
        series: Vec<Series>,
    ) -> Self {
        // Tolerates rounding errors, for instance a cosine slightly above 1.
        let slack = 1e-9 * (range[1] - range[0]);
        let series = shown(series, |y| range[0] - slack <= y && y <= range[1] + slack);
        Self { x_label, y_label, x: x_range(&series), y: YAxis::Linear(range), series }
    }

    /// Label of the x axis.
    pub fn x_label(&self) -> &'static str {
        self.x_label
    }

    /// Label of the y axis.
    pub fn y_label(&self) -> &'static str {
        self.y_label
    }

    /// Drawn series, each with at least one point. Lines have at most 250 points; longer ones are
    /// thinned.
    pub fn series(&self) -> &[Series] {
        &self.series
    }

    /// Axis geometry of the picture.
    pub fn frame(&self) -> Frame {
        let ([width, height], [left, top, right, bottom]) = (SIZE, MARGINS);
        let (y, log) = match &self.y {
            YAxis::Log(axis) => {
                ([axis.low, axis.high].map(|y| y.log10() + f64::from(axis.exponent)), true)
            }
            YAxis::Linear(range) => (*range, false),
        };
        Frame {
            size: SIZE,
            across: [left, width - right],
            up: [height - bottom, top],
            x: self.x,
            y,
            log,
        }
    }

    /// Renders the picture.
    pub fn drawing(&self) -> Drawing {
        let [left, top, right, bottom] = MARGINS;
        let layout = Layout::new(self.x.into(), self.y.ends().into())
            .with_width(SIZE[0])
            .with_height(SIZE[1])
            .with_force_margins(left, right)
            .with_force_margins_y(top, bottom)
            .with_x_axis_min(self.x[0])
            .with_x_axis_max(self.x[1])
            .with_x_label(self.x_label)
            .with_x_tick_step(tick_step(self.x, &self.series))
            .with_x_tick_format(plain())
            .with_tick_size(12)
            .with_label_size(13)
            .with_theme(theme());
        // kuva draws the axes. The series follow in groups, by which a page can hide or move them.
        let mut scene = render_multiple(vec![LinePlot::new().into()], self.y.on(layout));
        // Removes the clip paths, because their identifiers would be equal in all charts of a page.
        // Series need no clipping.
        scene
            .elements
            .retain(|element| !matches!(element, Primitive::ClipStart { .. } | Primitive::ClipEnd));
        scene.defs.clear();
        scene.elements.insert(0, group("class=\"axes\""));
        scene.elements.push(Primitive::GroupEnd);
        scene.elements.extend(self.marks());
        Drawing::of(scene)
    }

    /// Groups of the series, from back to front: bands, thin lines, other lines. Each has the class
    /// `series` and the index of its series.
    fn marks(&self) -> Vec<Primitive> {
        let frame = self.frame();
        let widths = widths(&self.series);
        let mut shapes: Vec<(u8, usize, Primitive)> = Vec::new();
        for (i, series) in self.series.iter().enumerate() {
            let points: Vec<(f64, f64)> =
                series.line.iter().map(|&(x, y)| frame.at(x, y)).collect();
            if !series.band.is_empty() {
                shapes.push((0, i, band(series, &frame)));
            }
            let stroke = Color::from(series.color);
            let line = match points[..] {
                [(cx, cy)] => {
                    let (fill_opacity, stroke_width) = (None, None);
                    Primitive::Circle {
                        cx,
                        cy,
                        r: 2.2 * widths[i],
                        fill: stroke,
                        fill_opacity,
                        stroke: None,
                        stroke_width,
                    }
                }
                _ => {
                    let stroke_dasharray = series.dash.array().map(String::from);
                    Primitive::PolyLine {
                        points,
                        stroke,
                        stroke_width: widths[i],
                        stroke_dasharray,
                    }
                }
            };
            shapes.push((if series.thin { 1 } else { 2 }, i, line));
        }
        shapes.sort_by_key(|(layer, i, _)| (*layer, *i));
        let grouped = |(layer, i, shape): (u8, usize, Primitive)| {
            let opacity = if layer == 1 { " opacity=\"0.55\"" } else { "" };
            [
                group(&format!("class=\"series\" data-series=\"{i}\"{opacity}")),
                shape,
                Primitive::GroupEnd,
            ]
        };
        shapes.into_iter().flat_map(grouped).collect()
    }
}

impl Frame {
    /// Maps a data point to picture coordinates.
    fn at(&self, x: f64, y: f64) -> (f64, f64) {
        let between =
            |[a, b]: [f64; 2], [p, q]: [f64; 2], at: f64| p + (q - p) * (at - a) / (b - a);
        (
            between(self.x, self.across, x),
            between(self.y, self.up, if self.log { y.log10() } else { y }),
        )
    }
}

fn group(attributes: &str) -> Primitive {
    Primitive::GroupStart { transform: None, title: None, extra_attrs: Some(attributes.into()) }
}

/// Area between the lower and the upper edge of the band.
fn band(series: &Series, frame: &Frame) -> Primitive {
    let edge = |pick: fn(&(f64, f64)) -> f64| {
        series.line.iter().zip(&series.band).map(move |(p, band)| frame.at(p.0, pick(band)))
    };
    let points: Vec<(f64, f64)> = edge(|band| band.0).chain(edge(|band| band.1).rev()).collect();
    let corners: Vec<String> = points.iter().map(|(x, y)| format!("{x:.2} {y:.2}")).collect();
    Primitive::Path(Box::new(PathData {
        d: format!("M {} Z", corners.join(" L ")),
        fill: Some(Color::from(series.color)),
        stroke: Color::None,
        stroke_width: 0.0,
        opacity: Some(0.16),
        stroke_dasharray: None,
    }))
}

/// Cleans and thins the series. Removes empty series.
fn shown(series: Vec<Series>, is_drawable: impl Fn(f64) -> bool) -> Vec<Series> {
    let clean = |mut s: Series| {
        if s.band.is_empty() {
            s.line = thinned(cleaned(s.line, &is_drawable), |p| p.1);
        } else {
            let pairs = s.line.into_iter().zip(s.band);
            let seen = pairs.filter(|&((x, y), (low, high))| {
                x.is_finite() && [y, low, high].into_iter().all(&is_drawable)
            });
            (s.line, s.band) = thinned(seen.collect(), |(point, _)| point.1).into_iter().unzip();
        }
        s
    };
    series.into_iter().map(clean).filter(|s| !s.line.is_empty()).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Vertices of the first line with the colour `#123456`.
    fn drawn(chart: &Chart) -> Vec<[f64; 2]> {
        let svg = chart.drawing().to_svg();
        let document = roxmltree::Document::parse(&svg).expect("an SVG is XML");
        let is_line = |node: &roxmltree::Node| {
            node.has_tag_name("path") && node.attribute("stroke") == Some("#123456")
        };
        let path =
            document.descendants().find(is_line).expect("a line").attribute("d").expect("corners");
        let numbers: Vec<f64> = path
            .split([' ', 'M', 'L', ','])
            .filter(|n| !n.is_empty())
            .map(|n| n.parse().expect("a number"))
            .collect();
        numbers.chunks(2).map(|xy| [xy[0], xy[1]]).collect()
    }

    fn check(chart: &Chart, points: &[(f64, f64)]) {
        let Frame { across, up, x, y, log, .. } = chart.frame();
        let between =
            |[a, b]: [f64; 2], [p, q]: [f64; 2], at: f64| p + (q - p) * (at - a) / (b - a);
        let corners = drawn(chart);
        assert_eq!(corners.len(), points.len());
        for (corner, point) in corners.iter().zip(points) {
            let expected = [
                between(x, across, point.0),
                between(y, up, if log { point.1.log10() } else { point.1 }),
            ];
            for (found, expected) in corner.iter().zip(expected) {
                assert!((found - expected).abs() < 0.02, "{corner:?} instead of {expected:?}");
            }
        }
    }

    #[test]
    fn losses_of_both_signs_have_a_linear_axis() {
        let points = [(1.0, 1.0), (2.0, 0.0), (4.0, -4.0)];
        let series = || vec![Series::new("loss", "#123456", points.to_vec())];
        let chart = Chart::losses("epoch", "loss", series());
        assert!(!chart.frame().log);
        check(&chart, &points);
        assert!(Chart::log("epoch", "norm", series()).frame().log);
    }

    #[test]
    fn the_frame_maps_data_to_the_drawn_vertices() {
        // The values of the first chart are below 1e-10. kuva cannot draw them without a change of
        // unit.
        for points in [
            [(0.0, 3e-14), (2.0, 4e-11), (7.0, 2e-12)],
            [(10.0, 0.3), (2000.0, 4e3), (4000.0, 1.0)],
        ] {
            check(
                &Chart::log("x", "y", vec![Series::new("a", "#123456", points.to_vec())]),
                &points,
            );
        }
        let points = [(1.0, -0.7), (2.0, 0.1), (5.0, 1.0)];
        check(
            &Chart::linear(
                "x",
                "y",
                [-1.0, 1.0],
                vec![Series::new("a", "#123456", points.to_vec())],
            ),
            &points,
        );
    }

    #[test]
    fn points_that_cannot_be_shown_are_omitted() {
        let series = |points: &[(f64, f64)]| Series::new("a", "#123456", points.to_vec());
        let chart = Chart::log(
            "x",
            "y",
            vec![
                series(&[(0.0, f64::NAN), (1.0, 0.0)]),
                series(&[(0.0, f64::INFINITY), (1.0, 2.0)]),
            ],
        );
        assert_eq!(chart.series(), [series(&[(1.0, 2.0)])]);
        let band = vec![(1.0, f64::NAN), (0.0, 3.0), (1.0, 3.0)];
        let banded = Chart::log(
            "x",
            "y",
            vec![Series { band, ..series(&[(0.0, 2.0), (1.0, 2.0), (2.0, 2.0)]) }],
        );
        assert_eq!(
            (&banded.series()[0].line[..], &banded.series()[0].band[..]),
            (&[(2.0, 2.0)][..], &[(1.0, 3.0)][..])
        );
        let linear = Chart::linear(
            "x",
            "y",
            [-1.0, 1.0],
            vec![series(&[(0.0, 1.0 + 1e-15), (1.0, 1.1), (2.0, f64::NAN)])],
        );
        assert_eq!(linear.series()[0].line.len(), 1);
        assert!(chart.drawing().to_svg().contains("<circle"), "a single point is a dot");
        roxmltree::Document::parse(&Chart::log("x", "y", vec![]).drawing().to_svg())
            .expect("an SVG is XML");
    }
}
