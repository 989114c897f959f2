//! Learning curves: the loss of one run, and the losses of several methods against effort.

use super::log_figure::{Panel, XScale, log_figure};
use super::quantile::{quantile, sorted};
use super::series::{cleaned, thinned};
use super::{Dash, Drawing, Series, YScale};

/// Summaries exclude runs that end before this share of the epochs of the longest run.
const MIN_SHARE: f64 = 0.95;
/// Smallest number of seeds with a band of quartiles. Two or three seeds have a band of their
/// range. The number includes seeds that summaries exclude.
const MIN_QUARTILES: usize = 4;

/// Runs of one method, one per seed.
#[derive(Clone, Debug)]
pub struct Curve {
    /// Legend label.
    pub label: String,
    /// CSS colour, for example from [`field_color`].
    pub color: &'static str,
    /// Pattern of the line.
    pub dash: Dash,
    /// Points of each run, one run per seed.
    pub runs: Vec<Vec<Point>>,
}

/// Measured value at one time of a training run.
#[derive(Clone, Copy, Debug)]
pub struct Point {
    /// Epochs completed.
    pub epoch: f64,
    /// Wall time since the start of training, s.
    pub seconds: f64,
    /// Loss or another quantity.
    pub value: f64,
}

/// Colours of lines without a colour of their own: the palette of Okabe and Ito without yellow.
pub const PALETTE: [&str; 7] =
    ["#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00", "#56B4E9", "#000000"];

/// Colour and dash of line number `i`: the dash differs where colours of [`PALETTE`] repeat.
pub fn line_style(i: usize) -> (&'static str, Dash) {
    (PALETTE[i % PALETTE.len()], Dash::ALL[i / PALETTE.len() % Dash::ALL.len()])
}

/// Colour of a vector field by its letters; grey for unknown letters.
///
/// The colours of R, M, S, C, N and P are from [`PALETTE`], which is safe for colour-blind readers.
pub fn field_color(letter: &str) -> &'static str {
    match letter {
        "R" => PALETTE[0],
        "M" => PALETTE[1],
        "S" => PALETTE[2],
        "C" => PALETTE[3],
        "N" => PALETTE[4],
        "P" => PALETTE[5],
        "F" => "#999933",
        "MR" => "#882255",
        "RM" => "#6A51A3",
        _ => "#666666",
    }
}

/// Draws the training and test loss of one run as lines through points (epoch, loss).
///
/// The axis is linear if a loss is 0 or negative, otherwise logarithmic. Omits losses that the axis
/// cannot show: see [`YScale`]. An empty list yields no line.
pub fn learning_curve(title: &str, train: &[(f64, f64)], test: &[(f64, f64)]) -> Drawing {
    let scale = YScale::of(train.iter().chain(test).map(|&(_, loss)| loss));
    let series = |label, color, points: &[(f64, f64)]| {
        let shown = cleaned(points.to_vec(), &|y| scale.shows(y));
        Series::new(label, color, thinned(shown, |p| p.1))
    };
    let series = vec![series("train", "#0072B2", train), series("test", "#D55E00", test)];
    let panel = Panel {
        title: String::new(),
        x_label: "epoch".into(),
        x_scale: XScale::Linear,
        y_label: "loss".into(),
        y_axis: 0,
        series,
    };
    log_figure(title, &[vec![panel]])
}

/// Draws the test losses of several methods against epochs and against wall time.
///
/// - Bold line: median over the seeds, which is robust to single outliers.
/// - Band: first to third quartile of four or more seeds, or the range of two or three seeds.
/// - Thin lines: single seeds. One seed has a bold line only.
///
/// The axis is linear if a loss is 0 or negative, otherwise logarithmic. Valid losses are those that
/// the axis can show: see [`YScale`]. Medians and bands exclude runs without valid losses.
/// They also exclude runs whose valid losses end before 95 % of the epochs of the longest run, for
/// instance after divergence. The figure then states how many of the seeds remain. The choice
/// between quartiles and range depends on the number of all seeds. A single remaining seed has no
/// band.
///
/// Medians and bands use all epochs of the remaining runs, within the range that all of them cover.
/// Between the points of a run, the wall time and the loss on its axis are linear functions of the
/// epoch. The wall time of an epoch is the median over the remaining seeds. With several seeds,
/// the title ends with the name of the statistic.
pub fn comparison(title: &str, curves: &[Curve]) -> Drawing {
    let case = |x| Case {
        title: String::new(),
        y_label: "test loss".into(),
        y_axis: 0,
        x,
        curves: curves.to_vec(),
    };
    study(title, &[[Abscissa::Epoch, Abscissa::Seconds].map(case).into()])
}

/// Quantity along the x axis of a learning curve.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Abscissa {
    /// Completed epochs.
    Epoch,
    /// Wall time since the start of training, s.
    Seconds,
}

impl Abscissa {
    /// Label of the axis.
    pub fn label(self) -> &'static str {
        match self {
            Self::Epoch => "epoch",
            Self::Seconds => "wall time (s)",
        }
    }

    /// Value at a point.
    pub fn of(self, point: &Point) -> f64 {
        match self {
            Self::Epoch => point.epoch,
            Self::Seconds => point.seconds,
        }
    }
}

/// Curves of one panel of a [`study`].
pub struct Case {
    /// Title above the panel; may be empty.
    pub title: String,
    /// Label of the y axis; may also name a property shared by the row.
    pub y_label: String,
    /// Cases with the same number share the range of their y axes.
    pub y_axis: usize,
    /// Quantity along the x axis.
    pub x: Abscissa,
    /// One curve per method.
    pub curves: Vec<Curve>,
}

/// Draws a grid of cases, one panel each. Lines, bands and title are as in [`comparison`].
pub fn study(title: &str, rows: &[Vec<Case>]) -> Drawing {
    let scale = |y_axis: usize| {
        let cases = rows.iter().flatten().filter(|case| case.y_axis == y_axis);
        YScale::of(cases.flat_map(|case| &case.curves).flat_map(Curve::values))
    };
    let panel = |case: &Case| Panel {
        title: case.title.clone(),
        x_label: case.x.label().into(),
        x_scale: XScale::Linear,
        y_label: case.y_label.clone(),
        y_axis: case.y_axis,
        series: case.curves.iter().flat_map(|c| c.series(case.x, scale(case.y_axis))).collect(),
    };
    let statistic = statistic(
        rows.iter().flatten().flat_map(|case| &case.curves).map(|curve| curve.runs.len()),
    );
    let title = if statistic.is_empty() { title.into() } else { format!("{title}: {statistic}") };
    log_figure(&title, &rows.iter().map(|row| row.iter().map(panel).collect()).collect::<Vec<_>>())
}

/// Name of the statistic of curves with these numbers of seeds. Empty if no curve has several
/// seeds.
pub fn statistic(seeds: impl Iterator<Item = usize>) -> &'static str {
    let (mut range, mut quartiles) = (false, false);
    for seeds in seeds {
        range |= (2..MIN_QUARTILES).contains(&seeds);
        quartiles |= seeds >= MIN_QUARTILES;
    }
    match (range, quartiles) {
        (false, false) => "",
        (true, false) => "median, range and single seeds",
        (false, true) => "median, quartiles and single seeds",
        (true, true) => "median, quartiles (range below 4 seeds) and single seeds",
    }
}

impl Curve {
    /// Values of all points of all runs.
    pub fn values(&self) -> impl Iterator<Item = f64> {
        self.runs.iter().flatten().map(|point| point.value)
    }

    /// Lines of the single seeds, if there are several, and the [`summary`](Curve::summary).
    pub fn series(&self, x: Abscissa, scale: YScale) -> Vec<Series> {
        let shown = |y: f64| scale.shows(y);
        let seed = |(i, run): (usize, &Vec<Point>)| {
            let line = cleaned(run.iter().map(|p| (x.of(p), p.value)).collect(), &shown);
            let label = format!("{}, run {}", self.label, i + 1);
            Series {
                thin: true,
                ..Series::new(label, self.color, thinned(line, |p| p.1)).dash(self.dash)
            }
        };
        let seeds = self.runs.iter().enumerate().map(seed).filter(|_| self.runs.len() > 1);
        seeds.chain([self.summary(x, scale)]).collect()
    }

    /// Median and band of the runs against `x`, as in [`comparison`], on an axis of this scale.
    pub fn summary(&self, x: Abscissa, scale: YScale) -> Series {
        let shown = |y: f64| scale.shows(y);
        let points_of =
            |run: &Vec<Point>| cleaned(run.iter().map(|p| (p.epoch, p.value)).collect(), &shown);
        let all: Vec<_> = self
            .runs
            .iter()
            .map(|run| (run, points_of(run)))
            .filter(|(_, points)| !points.is_empty())
            .collect();
        let end = |points: &[(f64, f64)]| points[points.len() - 1].0;
        let last = all.iter().map(|(_, points)| end(points)).fold(f64::NEG_INFINITY, f64::max);
        let (measured, runs): (Vec<_>, Vec<_>) =
            all.into_iter().filter(|(_, points)| end(points) >= MIN_SHARE * last).unzip();
        let note = match self.runs.len() - runs.len() {
            0 => String::new(),
            _ => format!("{} of {} seeds", runs.len(), self.runs.len()),
        };
        // Seeds reach the same epoch at different times.
        let xs: Vec<Vec<(f64, f64)>> = measured
            .into_iter()
            .map(|run| run.iter().map(|p| (p.epoch, x.of(p))).collect())
            .collect();
        let [low, high] = if self.runs.len() < MIN_QUARTILES { [0.0, 1.0] } else { [0.25, 0.75] };
        // Points of the line, with the edges of the band.
        let mut summaries = Vec::new();
        for epoch in common_grid(&runs) {
            let losses = sorted(runs.iter().map(|run| interpolated(run, epoch, scale)));
            let xs = sorted(xs.iter().map(|run| interpolated(run, epoch, YScale::Linear)));
            let point = (quantile(&xs, 0.5), quantile(&losses, 0.5));
            summaries.push((point, (quantile(&losses, low), quantile(&losses, high))));
        }
        let (line, mut band): (Vec<_>, Vec<_>) =
            thinned(summaries, |(point, _)| point.1).into_iter().unzip();
        if runs.len() < 2 {
            band.clear();
        }
        Series { band, note, ..Series::new(&*self.label, self.color, line).dash(self.dash) }
    }
}

/// All epochs of all runs within the range that every run covers.
fn common_grid(runs: &[Vec<(f64, f64)>]) -> Vec<f64> {
    let start = runs.iter().map(|run| run[0].0).fold(f64::NEG_INFINITY, f64::max);
    let end = runs.iter().map(|run| run[run.len() - 1].0).fold(f64::INFINITY, f64::min);
    let mut grid: Vec<f64> =
        runs.iter().flatten().map(|&(x, _)| x).filter(|&x| start <= x && x <= end).collect();
    grid.sort_by(f64::total_cmp);
    grid.dedup();
    grid
}

/// Value of a run at x, on the straight line between the neighbouring points on an axis of this
/// scale. Constant beyond the ends of the run.
fn interpolated(run: &[(f64, f64)], x: f64, scale: YScale) -> f64 {
    let right = run.partition_point(|&(at, _)| at < x).min(run.len() - 1);
    let ((x0, y0), (x1, y1)) = (run[right.saturating_sub(1)], run[right]);
    if x >= x1 || x1 <= x0 { y1 } else { scale.between(y0, y1, (x - x0) / (x1 - x0)) }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn run(points: &[(f64, f64, f64)]) -> Vec<Point> {
        points.iter().map(|&(epoch, seconds, value)| Point { epoch, seconds, value }).collect()
    }

    fn check(drawing: &Drawing) {
        let svg = drawing.to_svg();
        roxmltree::Document::parse(&svg).expect("an SVG is XML");
        assert!(drawing.to_png().starts_with(b"\x89PNG"));
        assert!(!svg.contains("NaN") && !svg.contains("inf"));
        assert!(svg.len() < 100_000, "{} bytes", svg.len());
    }

    /// Number of points of the longest line.
    fn corners(drawing: &Drawing) -> usize {
        let svg = drawing.to_svg();
        let document = roxmltree::Document::parse(&svg).expect("an SVG is XML");
        let paths = document.descendants().filter_map(|node| node.attribute("d"));
        paths.map(|path| path.matches(['M', 'L']).count()).max().expect("a line")
    }

    fn curve(runs: Vec<Vec<Point>>) -> Curve {
        Curve { label: "a".into(), color: "red", dash: Dash::Dotted, runs }
    }

    /// A curve with one run per pair (seconds, value) at epoch 1.
    fn at_epoch_1(values: &[(f64, f64)]) -> Curve {
        curve(
            values
                .iter()
                .map(|&(seconds, value)| run(&[(0.0, 0.0, 1.0), (1.0, seconds, value)]))
                .collect(),
        )
    }

    #[test]
    fn four_seeds_have_a_median_and_a_band_of_quartiles() {
        let curve = at_epoch_1(&[(10.0, 1.0), (5.0, 2.0), (7.0, 4.0), (8.0, 1e9), (9.0, 3.0)]);
        let by_epoch = curve.summary(Abscissa::Epoch, YScale::Log);
        assert_eq!(
            (by_epoch.line[1], by_epoch.band[1], &*by_epoch.note),
            ((1.0, 3.0), (2.0, 4.0), "")
        );
        let by_time = curve.summary(Abscissa::Seconds, YScale::Log);
        assert_eq!(
            (by_time.line[1], &by_time.band),
            ((8.0, 3.0), &by_epoch.band),
            "the median time of the epoch"
        );
    }

    #[test]
    fn three_seeds_have_a_band_of_their_range_and_one_seed_has_none() {
        let three =
            at_epoch_1(&[(1.0, 1.0), (1.0, 5.0), (1.0, 2.0)]).summary(Abscissa::Epoch, YScale::Log);
        assert_eq!((three.line[1].1, three.band[1]), (2.0, (1.0, 5.0)));
        assert!(at_epoch_1(&[(1.0, 1.0)]).summary(Abscissa::Epoch, YScale::Log).band.is_empty());
    }

    #[test]
    fn single_seeds_are_thin_lines_with_the_pattern_of_the_median() {
        let series = at_epoch_1(&[(1.0, 1.0), (3.0, 5.0)]).series(Abscissa::Seconds, YScale::Log);
        assert_eq!(
            series.iter().map(|s| (s.thin, s.dash)).collect::<Vec<_>>(),
            [true, true, false].map(|t| (t, Dash::Dotted))
        );
        assert_eq!(series[1].line, [(0.0, 1.0), (3.0, 5.0)]);
        assert_eq!(at_epoch_1(&[(1.0, 1.0)]).series(Abscissa::Epoch, YScale::Log).len(), 1);
    }

    #[test]
    fn the_title_names_the_statistic() {
        let title = |seeds: usize| {
            let svg = comparison("A title", &[at_epoch_1(&vec![(1.0, 1.0); seeds])]).to_svg();
            let texts: Vec<String> = svg
                .split("</text>")
                .filter_map(|text| Some(text.rsplit_once('>')?.1.into()))
                .collect();
            texts.into_iter().find(|text| text.starts_with("A title")).expect("a title")
        };
        assert_eq!(title(1), "A title");
        assert_eq!(title(3), "A title: median, range and single seeds");
        assert_eq!(title(4), "A title: median, quartiles and single seeds");
    }

    #[test]
    fn seeds_are_summarized_at_equal_epochs_not_equal_times() {
        let fast = run(&[(1.0, 0.1, 1.0), (3.0, 0.3, 1e-2)]);
        let slow = run(&[(1.0, 1.0, 1.0), (2.0, 2.0, 1.0), (3.0, 3.0, 1.0)]);
        let by_time = curve(vec![fast, slow]).summary(Abscissa::Seconds, YScale::Log);
        assert_eq!(by_time.line.len(), 3);
        assert!(
            (by_time.line[1].0 - 1.1).abs() < 1e-12,
            "half way between the times of epochs 1 and 3"
        );
        assert!(
            (by_time.band[1].0 / 0.1 - 1.0).abs() < 1e-12,
            "half way from 1 to 1e-2 on a log axis"
        );
    }

    #[test]
    fn seeds_without_a_result_are_omitted_and_counted() {
        let long = run(&[(0.0, 0.0, 1.0), (99.0, 9.0, 0.5), (100.0, 10.0, f64::NAN)]);
        let failed = run(&[(0.0, 0.0, 1.0), (5.0, 0.5, 1e9)]);
        let runs = vec![long, run(&[(0.0, 0.0, 1.0), (100.0, 12.0, 1e-4)]), failed];
        let series = curve(runs).summary(Abscissa::Epoch, YScale::Log);
        assert_eq!((&*series.note, series.line.last().expect("a line").0), ("2 of 3 seeds", 99.0));

        let runs = vec![run(&[(0.0, 0.0, 1.0)]), run(&[(0.0, 0.0, f64::NAN)])];
        let series = curve(runs).summary(Abscissa::Epoch, YScale::Log);
        assert!(series.band.is_empty());
        assert_eq!((&*series.label, &*series.note), ("a", "1 of 2 seeds"));
    }

    #[test]
    fn negative_losses_are_valid_and_linear_between_epochs() {
        let fast = run(&[(1.0, 0.1, 1.0), (3.0, 0.3, -3.0)]);
        let slow = run(&[(1.0, 1.0, -5.0), (2.0, 2.0, -5.0), (3.0, 3.0, 0.0)]);
        let curve = curve(vec![fast, slow]);
        let scale = YScale::of(curve.values());
        let summary = curve.summary(Abscissa::Epoch, scale);
        assert_eq!(&*summary.note, "", "both seeds remain");
        assert_eq!(summary.band, [(-5.0, 1.0), (-5.0, -1.0), (-3.0, 0.0)]);
        assert_eq!(summary.line, [(1.0, -2.0), (2.0, -3.0), (3.0, -1.5)]);
        check(&comparison("negative", &[curve]));
    }

    #[test]
    fn a_learning_curve_shows_all_finite_losses_of_either_sign() {
        let loss = |i: i32| (f64::from(i), 0.5 - f64::from(i) / 10.0);
        let picture = learning_curve("a", &(0..60).map(loss).collect::<Vec<_>>(), &[]);
        check(&picture);
        assert_eq!(corners(&picture), 60);
        // The losses -5.4 to 0.5 have ticks of both signs.
        let picture = picture.to_svg();
        assert!([">−4<", ">0<"].into_iter().all(|tick| picture.contains(tick)), "{picture}");
    }

    #[test]
    fn negative_losses_do_not_change_panels_of_other_axes() {
        let fast = run(&[(0.0, 0.0, 1.0), (2.0, 1.0, 1e-4)]);
        let slow = run(&[(0.0, 0.0, 1.0), (1.0, 1.0, 1.0), (2.0, 2.0, 1.0)]);
        let positive = Curve { color: "#123456", ..curve(vec![fast, slow]) };
        let lines = |other: f64| {
            let runs = vec![run(&[(0.0, 0.0, other), (2.0, 1.0, 2.0 * other)])];
            let other = curve(runs);
            let case = |y_axis, curve: &Curve| Case {
                title: String::new(),
                y_label: "loss".into(),
                y_axis,
                x: Abscissa::Epoch,
                curves: vec![curve.clone()],
            };
            let svg = study("a", &[vec![case(0, &positive), case(1, &other)]]).to_svg();
            let document = roxmltree::Document::parse(&svg).expect("an SVG is XML");
            let paths =
                document.descendants().filter(|node| node.attribute("stroke") == Some("#123456"));
            paths.filter_map(|node| node.attribute("d").map(String::from)).collect::<Vec<_>>()
        };
        assert_eq!(lines(-1.0), lines(1.0));
        assert!(!lines(1.0).is_empty());
    }

    #[test]
    fn lines_differ_in_colour_or_dash() {
        let styles: Vec<_> = (0..28).map(line_style).collect();
        assert!((0..28).all(|i| !styles[..i].contains(&styles[i])), "{styles:?}");
        assert!((0..7).all(|i| styles[i] == (PALETTE[i], Dash::Solid)));
    }

    #[test]
    fn empty_invalid_and_long_inputs_yield_valid_drawings() {
        check(&learning_curve("nothing", &[], &[]));
        check(&learning_curve(
            "one <point> & no more",
            &[(0.0, 2.0)],
            &[(0.0, f64::NAN), (1.0, -1.0)],
        ));
        let long: Vec<(f64, f64)> =
            (0..10_000).map(|i| (f64::from(i), 1.0 / f64::from(i))).collect();
        check(&learning_curve("long", &long, &long));
        check(&comparison("nothing", &[]));
        check(&study("nothing", &[]));
        let case = || Case {
            title: "a".into(),
            y_label: "b".into(),
            y_axis: 1,
            x: Abscissa::Epoch,
            curves: Vec::new(),
        };
        check(&study("two empty rows", &[vec![case(), case()], vec![case(), case()]]));
        check(&comparison("no runs", &[curve(vec![vec![]])]));
        let nothing = learning_curve("nothing", &[], &[]).to_svg();
        // The axis extends from 0.1 to 1.
        assert!(
            nothing.contains("no positive data")
                && nothing.contains(">0.1<")
                && nothing.contains(">1<"),
            "{nothing}"
        );
    }
}
