//! Maps of a plane: values as colours on a logarithmic scale, with arrows, lines and paths.

use super::log_axis::superscript;
use super::log_figure::{Panel, Shows, XScale, legend, panel_layout};
use super::marks::marks;
use super::series::{cleaned, drawable, thinned, thinned_to};
use super::y_axis::YAxis;
use super::{Drawing, Series};
use kuva::plot::QuiverPivot;
use kuva::prelude::*;
use std::sync::Arc;

/// Approximate number of colours. Few colours are easy to distinguish, and adjacent cells of equal
/// colour share a rectangle.
const STEPS: i32 = 18;
/// Colour stops from the smallest to the largest value, light enough for dark arrows.
const COLORS: [[f64; 3]; 5] = [
    [255.0, 252.0, 235.0],
    [253.0, 217.0, 158.0],
    [247.0, 156.0, 110.0],
    [224.0, 100.0, 115.0],
    [172.0, 66.0, 138.0],
];
const INK: &str = "#1c1c24";
const LINE: &str = "#0a4f8f";
/// Colour and width of the casing of a line and of the line itself, for contrast on every
/// background.
const CASED: [(&str, f64); 2] = [("#ffffff", 3.4), (LINE, 1.6)];
/// Length of an arrow, relative to the spacing of arrows.
const ARROW: f64 = 0.72;
/// Number of points beyond which a path is thinned.
const MAX_POINTS: usize = 700;

/// Common settings of all maps of a figure.
pub struct Plane {
    /// Labels of the x and y axes.
    pub labels: [&'static str; 2],
    /// Half-width of the maps: both axes run from `-half_width` to `half_width`.
    pub half_width: f64,
    /// Decimal exponents at the ends of the colour scale; values beyond are clamped.
    pub decades: [i32; 2],
    /// Label of the colour scale.
    pub values: &'static str,
}

/// One map.
///
/// Grid cells are equal squares over the whole plane, row by row from the lower left corner. Empty
/// lists are not drawn.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Map {
    /// Title above the map.
    pub title: String,
    /// Values in the cells of a grid, shown as colours. Non-positive values and NaN have the lowest
    /// colour.
    pub values: Vec<f64>,
    /// Directions in the cells of another grid, shown as arrows of equal length. Zero and
    /// non-finite vectors are omitted.
    pub arrows: Vec<[f64; 2]>,
    /// Values in the cells of a grid; a line shows their zero level set.
    pub signs: Vec<f64>,
    /// Path, with a dot at its start. Non-finite points are omitted.
    pub path: Vec<[f64; 2]>,
    /// Position marked with a cross.
    pub mark: Option<[f64; 2]>,
}

/// Draws maps side by side with their colour scale, and an optional panel of losses.
///
/// Each entry of `runs` holds a name, a CSS colour, and the losses at the start and after every
/// iteration.
pub fn maps(plane: &Plane, maps: &[Map], runs: &[(&str, &'static str, Vec<f64>)]) -> Drawing {
    let mut layouts: Vec<Layout> =
        maps.iter().enumerate().map(|(i, map)| plane.layout(map, i == 0)).collect();
    let mut plots: Vec<Vec<Plot>> = maps.iter().map(|map| plane.plots(map)).collect();
    layouts.push(plane.scale_layout());
    plots.push(vec![plane.colors(&plane.scale(), 1, Some(plane.decades))]);
    if !runs.is_empty() {
        let line = |run: &[f64]| {
            thinned(
                cleaned(
                    run.iter().enumerate().map(|(i, &loss)| (i as f64, loss)).collect(),
                    &drawable,
                ),
                |p| p.1,
            )
        };
        let series =
            runs.iter().map(|(label, color, run)| Series::new(*label, color, line(run))).collect();
        let title = format!("({}) loss", char::from(b'a' + maps.len() as u8));
        let panel = Panel {
            title,
            x_label: "iteration".into(),
            x_scale: XScale::Linear,
            y_label: "loss".into(),
            y_axis: 0,
            series,
        };
        let axis = YAxis::of(panel.series.iter());
        let layout =
            panel_layout(&panel, &axis, Shows { y_numbers: true, y_name: true, x_name: true })
                .with_y_label_offset(10.0, 0.0)
                .with_legend_entries(legend(std::iter::once(&panel)))
                .with_legend_position(LegendPosition::InsideBottomLeft);
        layouts.push(layout);
        plots.push(marks(&panel.series, [1.0, axis.unit()]));
    }
    let columns = plots.len();
    let mut figure = Figure::new(1, columns)
        .with_padding(10.0)
        .with_spacing(12.0)
        // Extra width for the y labels of the first map and extra height for the titles and x
        // labels. The plotted areas are then equal squares.
        .with_cell_size(300.0, 367.0)
        .with_col_width(0, 348.0)
        .with_col_width(maps.len(), 104.0)
        .with_layouts(layouts)
        .with_plots(plots);
    if !runs.is_empty() {
        figure = figure.with_col_width(columns - 1, 400.0);
    }
    Drawing::of(figure.render())
}

impl Plane {
    fn layout(&self, map: &Map, first: bool) -> Layout {
        let [x_label, y_label] = self.labels;
        let mut layout =
            framed((-self.half_width, self.half_width), (-self.half_width, self.half_width))
                .with_x_label(x_label)
                .with_title(map.title.clone());
        match first {
            true => layout = layout.with_y_label(y_label),
            false => layout.suppress_y_ticks = true,
        }
        layout
    }

    fn scale_layout(&self) -> Layout {
        let [low, high] = self.decades.map(f64::from);
        let tick = |power: f64| format!("10{}", superscript(power.round() as i32));
        let mut layout = framed((0.0, 1.0), (low, high))
            // Blank title and label, for the same height as the maps.
            .with_title(" ")
            .with_x_label(" ")
            .with_y_label(self.values)
            .with_y_label_offset(-5.0, 0.0)
            .with_y_tick_format(TickFormat::Custom(Arc::new(tick)))
            .with_y_tick_step(((high - low) / 8.0).ceil());
        layout.suppress_x_ticks = true;
        layout
    }

    /// Values of the colour scale: the middle of each colour step.
    fn scale(&self) -> Vec<f64> {
        let (steps, each) = self.steps();
        (0..steps)
            .map(|step| 10f64.powf(f64::from(self.decades[0]) + (f64::from(step) + 0.5) / each))
            .collect()
    }

    /// Number of colour steps, in total and per decade.
    fn steps(&self) -> (i32, f64) {
        let decades = (self.decades[1] - self.decades[0]).max(1);
        let each = (STEPS / decades).max(1);
        (decades * each, f64::from(each))
    }

    fn plots(&self, map: &Map) -> Vec<Plot> {
        let mut plots = Vec::new();
        if !map.values.is_empty() {
            plots.push(self.colors(&map.values, side(map.values.len()), None));
        }
        if !map.arrows.is_empty() {
            plots.push(self.arrows(&map.arrows));
        }
        if !map.signs.is_empty() {
            plots.extend(CASED.map(|(color, width)| self.line(&map.signs, color, width)));
        }
        let dots = |at: &[[f64; 2]]| ScatterPlot::new().with_data(at.iter().map(|p| (p[0], p[1])));
        let is_finite = |point: &&[f64; 2]| point.iter().all(|x| x.is_finite());
        let path: Vec<[f64; 2]> = map.path.iter().filter(is_finite).copied().collect();
        if !path.is_empty() {
            let points = thinned_to(MAX_POINTS, path.iter().map(|p| (p[0], p[1])).collect());
            let line = |(color, width)| {
                LinePlot::new()
                    .with_data(points.clone())
                    .with_color(color)
                    .with_stroke_width(width)
                    .into()
            };
            plots.extend(CASED.map(line));
            plots.push(dots(&path[..1]).with_color(LINE).with_size(4.0).into());
        }
        if let Some(mark) = map.mark.filter(|mark| is_finite(&mark)) {
            plots.push(
                dots(&[mark]).with_color(INK).with_marker(MarkerShape::Cross).with_size(5.0).into(),
            );
        }
        plots
    }

    /// Coloured cells, over the plane or over the decades of the scale.
    fn colors(&self, values: &[f64], columns: usize, scale: Option<[i32; 2]>) -> Plot {
        let (steps, each) = self.steps();
        let last = f64::from(steps - 1);
        let step = |value: &f64| {
            let position = (value.log10() - f64::from(self.decades[0])) * each;
            // The logarithm of NaN or of a negative value is NaN, which `max` maps to the lowest
            // step.
            position.floor().max(0.0).min(last)
        };
        let cells: Vec<f64> = values.iter().map(step).collect();
        let (low, high) = cells
            .iter()
            .fold((f64::INFINITY, 0.0), |(low, high): (f64, f64), &c| (low.min(c), high.max(c)));
        // Inverts the normalization by kuva, which maps the range of the cells to [0, 1].
        let color = move |share: f64| color((low + share * (high - low)).round() / last);
        let (x_low, x_high) =
            if scale.is_some() { (0.0, 1.0) } else { (-self.half_width, self.half_width) };
        let (y_low, y_high) =
            scale.map_or((x_low, x_high), |[low, high]| (f64::from(low), f64::from(high)));
        Heatmap::new()
            .with_data(cells.chunks(columns).map(<[f64]>::to_vec))
            .with_color_map(ColorMap::Custom(Arc::new(color)))
            .with_x_range(x_low, x_high)
            .with_y_range(y_low, y_high)
            .with_cell_size(1.0)
            .into()
    }

    fn arrows(&self, directions: &[[f64; 2]]) -> Plot {
        let cells = side(directions.len());
        let long = ARROW * 2.0 * self.half_width / cells as f64;
        let arrows = directions.iter().enumerate().filter_map(|(i, d)| {
            let norm = d[0].hypot(d[1]);
            let drawn = norm > 0.0 && norm.is_finite();
            drawn.then(|| {
                (
                    self.middle(i % cells, cells),
                    self.middle(i / cells, cells),
                    d[0] / norm * long,
                    d[1] / norm * long,
                )
            })
        });
        QuiverPlot::new()
            .with_arrows(arrows)
            .with_scale(1.0)
            .with_pivot(QuiverPivot::Middle)
            .with_color(INK)
            .with_shaft_width(0.9)
            .with_head(4.0, 2.0)
            .into()
    }

    /// Zero level set of the cell values, interpolated linearly between cell centers.
    fn line(&self, signs: &[f64], color: &str, width: f64) -> Plot {
        let cells = side(signs.len());
        let middles: Vec<f64> = (0..cells).map(|i| self.middle(i, cells)).collect();
        let rows = signs.chunks(cells).map(<[f64]>::to_vec).collect();
        ContourPlot::new()
            .with_grid(rows, middles.clone(), middles)
            .with_levels(&[0.0])
            .with_line_color(color)
            .with_line_width(width)
            .into()
    }

    fn middle(&self, i: usize, cells: usize) -> f64 {
        self.half_width * ((2 * i + 1) as f64 / cells as f64 - 1.0)
    }
}

/// Layout with a frame and without grid lines.
fn framed(x: (f64, f64), y: (f64, f64)) -> Layout {
    let theme = Theme { axis_color: "#444".into(), legend_border: "none".into(), ..Theme::light() };
    Layout::new(x, y)
        .with_x_axis_min(x.0)
        .with_x_axis_max(x.1)
        .with_y_axis_min(y.0)
        .with_y_axis_max(y.1)
        .with_show_grid(false)
        .with_box_axes()
        .with_tick_size(11)
        .with_label_size(13)
        .with_title_size(14)
        .with_theme(theme)
}

/// Number of cells along a side of a square grid.
fn side(cells: usize) -> usize {
    cells.isqrt().max(1)
}

/// Colour at a position in [0, 1] of the scale.
fn color(share: f64) -> String {
    let position = share.clamp(0.0, 1.0) * (COLORS.len() - 1) as f64;
    let i = (position as usize).min(COLORS.len() - 2);
    let mix = |k: usize| COLORS[i][k] + (position - i as f64) * (COLORS[i + 1][k] - COLORS[i][k]);
    format!("#{:02x}{:02x}{:02x}", mix(0).round() as u8, mix(1).round() as u8, mix(2).round() as u8)
}

#[cfg(test)]
mod tests {
    use super::*;

    const PLANE: Plane =
        Plane { labels: ["a", "b"], half_width: 2.0, decades: [-1, 2], values: "norm" };

    fn rects(drawing: &Drawing) -> usize {
        drawing.to_svg().matches("<rect").count()
    }

    fn map(values: &[f64]) -> Map {
        Map { title: "m".into(), values: values.to_vec(), ..Map::default() }
    }

    #[test]
    fn the_colour_of_a_value_does_not_depend_on_other_values() {
        // Thirteenth of eighteen steps, six per decade.
        let twelve = format!("fill=\"{}\"", color(12.0 / 17.0));
        for others in [[12.0, 12.0, 12.0], [1.0, 0.2, 30.0], [1e9, 1e-9, f64::NAN]] {
            let values = [others[0], others[1], 12.0, others[2]];
            let svg = maps(&PLANE, &[map(&values)], &[]).to_svg();
            // At least once in the map and once in the scale.
            assert!(
                svg.matches(&twelve).count() >= 2,
                "{others:?}: {}",
                svg.matches(&twelve).count()
            );
        }
    }

    #[test]
    fn adjacent_cells_of_equal_colour_share_a_rectangle() {
        let flat = rects(&maps(&PLANE, &[map(&[1.0; 100])], &[]));
        let board: Vec<f64> =
            (0..100).map(|i| if (i + i / 10) % 2 == 0 { 0.2 } else { 50.0 }).collect();
        assert_eq!(rects(&maps(&PLANE, &[map(&board)], &[])) - flat, 100 - 10);
    }

    #[test]
    fn non_finite_points_are_omitted() {
        let odd = Map {
            values: vec![f64::NAN, 0.0, f64::INFINITY, -1.0],
            arrows: vec![[0.0; 2], [f64::NAN, 1.0], [1.0, 0.0], [f64::INFINITY, 0.0]],
            path: vec![[0.0; 2], [f64::NAN, 1.0], [0.5; 2]],
            mark: Some([f64::NAN; 2]),
            ..Map::default()
        };
        let svg = maps(&PLANE, &[odd, Map::default()], &[("x", "red", vec![1.0, 0.0, f64::NAN])])
            .to_svg();
        roxmltree::Document::parse(&svg).expect("an SVG is XML");
        assert!(!svg.contains("NaN") && !svg.contains("inf"));
    }
}
