//! Learning curves: the loss of one run, and the losses of several methods against effort.

use super::log_figure::{Panel, log_figure};
use super::series::{cleaned, drawable, thinned};
use super::{Drawing, Series};

/// Summaries exclude runs that end before this share of the epochs of the longest run.
const MIN_SHARE: f64 = 0.95;

/// Runs of one method, one per seed.
pub struct Curve {
    /// Legend label.
    pub label: String,
    /// CSS colour, for example from [`field_color`].
    pub color: &'static str,
    /// Points of each run, one run per seed.
    pub runs: Vec<Vec<Point>>,
}

/// Measured value at one time of a training run.
pub struct Point {
    /// Epochs completed.
    pub epoch: f64,
    /// Wall time since the start of training, s.
    pub seconds: f64,
    /// Loss or any other positive quantity.
    pub value: f64,
}

/// Colour of a vector field by its letter; grey for an unknown letter.
///
/// The colours are from the colour-blind safe palette of Okabe and Ito.
pub fn field_color(letter: &str) -> &'static str {
    match letter {
        "R" => "#0072B2",
        "M" => "#D55E00",
        "S" => "#009E73",
        "C" => "#CC79A7",
        "N" => "#E69F00",
        _ => "#666666",
    }
}

/// Draws the training and test loss of one run, as points (epoch, loss).
///
/// Omits losses outside 1e-100 to 1e100, and non-finite ones. An empty list yields no line.
pub fn learning_curve(title: &str, train: &[(f64, f64)], test: &[(f64, f64)]) -> Drawing {
    let series =
        |label, color, points: &[(f64, f64)]| Series::new(label, color, thinned(cleaned(points.to_vec(), &drawable), |p| p.1));
    let series = vec![series("train", "#0072B2", train), series("test", "#D55E00", test)];
    let panel = Panel { title: String::new(), x_label: "epoch".into(), log_x: false, y_label: "loss".into(), y_axis: 0, series };
    log_figure(title, &[vec![panel]])
}

/// Draws the test losses of several methods against epochs and against wall time.
///
/// - Line: geometric mean over the seeds, which is the arithmetic mean on a log axis. A single bad
///   seed does not dominate this mean.
/// - Band: range from the best to the worst seed, always positive. A single seed has no band.
///
/// Values are interpolated at common epochs, over the range that all runs cover. The wall time of
/// an epoch is the mean over the seeds. Runs without valid points, and runs that failed or diverged
/// early, are excluded; the figure states how many remain.
pub fn comparison(title: &str, curves: &[Curve]) -> Drawing {
    let panel = |x_label: &str, x: fn(&Point) -> f64| {
        let series = curves.iter().map(|c| c.summary(x)).collect();
        Panel { title: String::new(), x_label: x_label.into(), log_x: false, y_label: "test loss".into(), y_axis: 0, series }
    };
    log_figure(title, &[vec![panel("epoch", |p| p.epoch), panel("wall time (s)", |p| p.seconds)]])
}

/// Curves of one panel of a [`study`].
pub struct Case {
    /// Title above the panel; may be empty.
    pub title: String,
    /// Label of the y axis; may also name a property shared by the row.
    pub y_label: String,
    /// Cases with the same number share the range of their y axes.
    pub y_axis: usize,
    /// One curve per method.
    pub curves: Vec<Curve>,
}

/// Draws a grid of cases, one panel each, against epochs. Lines and bands are as in [`comparison`].
pub fn study(title: &str, rows: &[Vec<Case>]) -> Drawing {
    let panel = |case: &Case| Panel {
        title: case.title.clone(),
        x_label: "epoch".into(),
        log_x: false,
        y_label: case.y_label.clone(),
        y_axis: case.y_axis,
        series: case.curves.iter().map(|c| c.summary(|p| p.epoch)).collect(),
    };
    log_figure(title, &rows.iter().map(|row| row.iter().map(panel).collect()).collect::<Vec<_>>())
}

impl Curve {
    /// Geometric mean and band of the runs against `x`, as in [`comparison`].
    pub fn summary(&self, x: fn(&Point) -> f64) -> Series {
        let points_of = |run: &Vec<Point>| cleaned(run.iter().map(|p| (p.epoch, p.value)).collect(), &drawable);
        let all: Vec<_> = self.runs.iter().map(|run| (run, points_of(run))).filter(|(_, points)| !points.is_empty()).collect();
        let end = |points: &[(f64, f64)]| points[points.len() - 1].0;
        let last = all.iter().map(|(_, points)| end(points)).fold(f64::NEG_INFINITY, f64::max);
        let (measured, runs): (Vec<_>, Vec<_>) = all.into_iter().filter(|(_, points)| end(points) >= MIN_SHARE * last).unzip();
        let note = match self.runs.len() - runs.len() {
            0 => String::new(),
            _ => format!("{} of {} seeds", runs.len(), self.runs.len()),
        };
        // Seeds reach the same epoch at different times.
        let xs: Vec<Vec<(f64, f64)>> = measured.into_iter().map(|run| run.iter().map(|p| (p.epoch, x(p))).collect()).collect();
        // Points of the line, with the edges of the band.
        let mut summaries = Vec::new();
        for epoch in common_grid(&runs) {
            let losses: Vec<f64> = runs.iter().map(|run| interpolated(run, epoch, log_between)).collect();
            let mean_log = losses.iter().map(|loss| loss.ln()).sum::<f64>() / losses.len() as f64;
            let mean_x = xs.iter().map(|run| interpolated(run, epoch, between)).sum::<f64>() / xs.len() as f64;
            let range = (losses.iter().copied().fold(f64::INFINITY, f64::min), losses.iter().copied().fold(0.0, f64::max));
            summaries.push(((mean_x, mean_log.exp()), range));
        }
        let (line, mut band): (Vec<_>, Vec<_>) = thinned(summaries, |(point, _)| point.1).into_iter().unzip();
        if runs.len() < 2 {
            band.clear();
        }
        Series { band, note, ..Series::new(&*self.label, self.color, line) }
    }
}

/// All epochs of all runs within the range that every run covers.
fn common_grid(runs: &[Vec<(f64, f64)>]) -> Vec<f64> {
    let start = runs.iter().map(|run| run[0].0).fold(f64::NEG_INFINITY, f64::max);
    let end = runs.iter().map(|run| run[run.len() - 1].0).fold(f64::INFINITY, f64::min);
    let mut grid: Vec<f64> = runs.iter().flatten().map(|&(x, _)| x).filter(|&x| start <= x && x <= end).collect();
    grid.sort_by(f64::total_cmp);
    grid.dedup();
    grid
}

/// Value of a run at x, interpolated with `between` from the two nearest points.
fn interpolated(run: &[(f64, f64)], x: f64, between: fn(f64, f64, f64) -> f64) -> f64 {
    let right = run.partition_point(|&(at, _)| at < x).min(run.len() - 1);
    let ((x0, y0), (x1, y1)) = (run[right.saturating_sub(1)], run[right]);
    if x >= x1 || x1 <= x0 { y1 } else { between(y0, y1, (x - x0) / (x1 - x0)) }
}

/// Linear interpolation.
fn between(a: f64, b: f64, share: f64) -> f64 {
    a + (b - a) * share
}

/// Linear interpolation on a log axis.
fn log_between(a: f64, b: f64, share: f64) -> f64 {
    a * (b / a).powf(share)
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

    #[test]
    fn mean_is_geometric_and_band_spans_the_seeds() {
        let runs = vec![
            run(&[(0.0, 0.0, 1.0), (1.0, 10.0, 1e-2), (2.0, 20.0, 1.0)]),
            run(&[(0.0, 0.0, 1.0), (1.0, 5.0, 1e-4), (2.0, 15.0, 1.0)]),
        ];
        let curve = Curve { label: "a".into(), color: "red", runs };
        let by_epoch = curve.summary(|p| p.epoch);
        assert_eq!((by_epoch.line.len(), &*by_epoch.note), (3, ""));
        assert!((by_epoch.line[1].1 / 1e-3 - 1.0).abs() < 1e-12);
        assert_eq!(by_epoch.band[1], (1e-4, 1e-2));
        let by_time = curve.summary(|p| p.seconds);
        assert_eq!(by_time.line.iter().map(|p| p.0).collect::<Vec<_>>(), [0.0, 7.5, 17.5], "mean times of the epochs");
        assert_eq!(by_time.band, by_epoch.band);
    }

    #[test]
    fn seeds_are_averaged_at_equal_epochs_not_equal_times() {
        let fast = run(&[(1.0, 0.1, 1.0), (3.0, 0.3, 1e-2)]);
        let slow = run(&[(1.0, 1.0, 1.0), (2.0, 2.0, 1.0), (3.0, 3.0, 1.0)]);
        let curve = Curve { label: "a".into(), color: "red", runs: vec![fast, slow] };
        let by_time = curve.summary(|p| p.seconds);
        assert_eq!(by_time.line.len(), 3);
        assert!((by_time.line[1].0 - 1.1).abs() < 1e-12, "half way between the times of epochs 1 and 3");
        assert!((by_time.band[1].0 / 0.1 - 1.0).abs() < 1e-12, "half way from 1 to 1e-2 on a log axis");
    }

    #[test]
    fn seeds_without_a_result_are_omitted_and_counted() {
        let long = run(&[(0.0, 0.0, 1.0), (99.0, 9.0, 0.5), (100.0, 10.0, f64::NAN)]);
        let failed = run(&[(0.0, 0.0, 1.0), (5.0, 0.5, 1e9)]);
        let runs = vec![long, run(&[(0.0, 0.0, 1.0), (100.0, 12.0, 1e-4)]), failed];
        let series = Curve { label: "a".into(), color: "red", runs }.summary(|p| p.epoch);
        assert_eq!((&*series.note, series.line.last().expect("a line").0), ("2 of 3 seeds", 99.0));

        let runs = vec![run(&[(0.0, 0.0, 1.0)]), run(&[(0.0, 0.0, f64::NAN)])];
        let series = Curve { label: "a".into(), color: "red", runs }.summary(|p| p.epoch);
        assert!(series.band.is_empty());
        assert_eq!((&*series.label, &*series.note), ("a", "1 of 2 seeds"));
    }

    #[test]
    fn empty_invalid_and_long_inputs_yield_valid_drawings() {
        check(&learning_curve("nothing", &[], &[]));
        check(&learning_curve("one <point> & no more", &[(0.0, 2.0)], &[(0.0, f64::NAN), (1.0, -1.0)]));
        let long: Vec<(f64, f64)> = (0..10_000).map(|i| (f64::from(i), 1.0 / f64::from(i))).collect();
        check(&learning_curve("long", &long, &long));
        check(&comparison("nothing", &[]));
        check(&study("nothing", &[]));
        let case = || Case { title: "a".into(), y_label: "b".into(), y_axis: 1, curves: Vec::new() };
        check(&study("two empty rows", &[vec![case(), case()], vec![case(), case()]]));
        check(&comparison("no runs", &[Curve { label: "a".into(), color: field_color("R"), runs: vec![vec![]] }]));
        assert!(learning_curve("nothing", &[], &[]).to_svg().contains("no data"));
    }
}
