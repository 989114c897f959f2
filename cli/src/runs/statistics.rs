//! Statistics over runs with several seeds: tables and learning curves.

use physgrad::Field;
use physgrad::rng::{Purpose, stream};
use physgrad::text::short;
use physgrad::train::Record;
use physgrad_plot::quantile::{quantile, sorted};
use physgrad_plot::{Curve, Dash, Point, field_color};
use rand::RngExt;
use std::fmt;

/// Field, seed and records of one run.
#[derive(Clone, Copy)]
pub struct Outcome<'a> {
    pub field: Field,
    pub seed: u64,
    pub records: &'a [Record],
    /// True if the training failed. A failed run has no final losses.
    pub failed: bool,
}

impl Outcome<'_> {
    /// Loss of the last epoch. NaN for a failed run, and for a run without an epoch.
    pub fn last(&self, loss: fn(&Record) -> f64) -> f64 {
        self.records.last().filter(|_| !self.failed).map_or(f64::NAN, loss)
    }

    /// Training time of all epochs, s.
    pub fn seconds(&self) -> f64 {
        // Avoids `sum`, which returns -0 for no records.
        self.records.iter().fold(0.0, |sum, r| sum + r.seconds)
    }

    /// One value per epoch, with the epoch and the elapsed time in seconds.
    pub fn points(&self, value: fn(&Record) -> f64) -> Vec<Point> {
        let elapsed = self.records.iter().scan(0.0, |sum, r| {
            *sum += r.seconds;
            Some(*sum)
        });
        self.records
            .iter()
            .zip(elapsed)
            .map(|(r, seconds)| Point { epoch: r.epoch as f64, seconds, value: value(r) })
            .collect()
    }
}

/// Groups runs by field. Runs of a field must be consecutive.
pub fn by_field<'a, 'r>(
    runs: &'a [Outcome<'r>],
) -> impl Iterator<Item = (Field, &'a [Outcome<'r>])> {
    runs.chunk_by(|a, b| a.field == b.field).map(|runs| (runs[0].field, runs))
}

/// Position of a field in tables and legends, by its letters.
pub fn position(letter: &str) -> Option<usize> {
    ["R", "M", "S", "C", "N", "P", "F", "MR", "RM"].iter().position(|other| *other == letter)
}

/// Legend entry of a field.
pub fn field_label(field: Field) -> String {
    format!("{} ({field})", field.letter())
}

/// One curve per field: the loss, or another positive quantity per epoch.
pub fn curves(runs: &[Outcome], loss: fn(&Record) -> f64) -> Vec<Curve> {
    let curve = |(field, runs): (Field, &[Outcome])| Curve {
        label: field_label(field),
        color: field_color(field.letter()),
        dash: Dash::Solid,
        runs: runs.iter().map(|run| run.points(loss)).collect(),
    };
    by_field(runs).map(curve).collect()
}

/// Runs of one scene of a comparison.
pub struct InScene<'a> {
    /// Name of the scene. Empty if the comparison has only one scene.
    pub name: &'a str,
    /// Runs, grouped by field.
    pub runs: Vec<Outcome<'a>>,
}

/// Largest number of scenes in one chart, with different dashes.
pub const MAX_DASHED: usize = 3;

/// Curves of all scenes, one per scene and field: colours of the fields, and dashes of the scenes.
pub fn curves_of_scenes(scenes: &[InScene], loss: fn(&Record) -> f64) -> Vec<Curve> {
    let of_scene = |(scene, &dash): (&InScene, &Dash)| {
        let named = |curve: Curve| match scene.name {
            "" => curve,
            name => Curve { label: format!("{name}: {}", curve.label), dash, ..curve },
        };
        curves(&scene.runs, loss).into_iter().map(named).collect::<Vec<_>>()
    };
    scenes.iter().zip(Dash::ALL.iter().cycle()).flat_map(of_scene).collect()
}

/// Header of [`table_of_scenes`].
pub fn table_header(scenes: &[InScene]) -> Vec<&'static str> {
    ["scene"].into_iter().chain(TABLE_HEADER).skip(usize::from(scenes.len() < 2)).collect()
}

/// One row per scene and field, with medians over the seeds. NaN ranks above every number.
pub fn table_of_scenes(scenes: &[InScene]) -> Vec<Vec<String>> {
    // Replaces `+` with a space, so that a table can break the name of a sweep point between its
    // settings.
    let row = |name: &str, row: [String; 9]| {
        [name.replace('+', " ")]
            .into_iter()
            .chain(row)
            .skip(usize::from(scenes.len() < 2))
            .collect::<Vec<_>>()
    };
    scenes
        .iter()
        .flat_map(|scene| table(&scene.runs).into_iter().map(|cells| row(scene.name, cells)))
        .collect()
}

const TABLE_HEADER: [&str; 9] =
    ["field", "seeds", "failed", "test loss", "ratio", "lowest", "highest", "best", "seconds"];

/// Columns that a narrow terminal omits, the most important first.
pub const OPTIONAL: [&str; 7] =
    ["ratio", "best", "seeds", "failed", "highest", "lowest", "seconds"];

/// Explanation of the table.
pub const TABLE_NOTE: &str = "test loss of the last epoch: median, lowest and highest over the seeds; medians of best loss and seconds\n\
     ratio of the median to that of R (otherwise M, S or C), with a 95 % interval (bootstrap over the seeds); undecided if it contains 1";

/// One row per field, with medians over the seeds and their ratio to R. Without R, the first
/// field in the order of [`position`] replaces it. NaN ranks above every number.
fn table(runs: &[Outcome]) -> Vec<[String; 9]> {
    let reference = by_field(runs).min_by_key(|(field, _)| position(field.letter()));
    let row = |(field, of_field): (Field, &[Outcome])| {
        let median =
            |value: &dyn Fn(&Outcome) -> f64| quantile(&sorted(of_field.iter().map(value)), 0.5);
        let last = sorted(of_field.iter().map(|run| run.last(|r| r.test_loss)));
        [
            field.to_string(),
            of_field.len().to_string(),
            of_field.iter().filter(|run| run.failed).count().to_string(),
            short(quantile(&last, 0.5)),
            match reference {
                Some((first, others)) if first != field => {
                    loss_ratio(of_field.iter().copied(), others.iter().copied()).to_string()
                }
                _ => "1".into(),
            },
            short(last[0]),
            short(last[last.len() - 1]),
            short(median(&|run| best(run.records))),
            format!("{:.1}", median(&|run| run.seconds())),
        ]
    };
    by_field(runs).map(row).collect()
}

/// Lowest test loss. NaN if no loss is a number.
pub fn best(records: &[Record]) -> f64 {
    records.iter().map(|r| r.test_loss).fold(f64::NAN, f64::min)
}

/// Mean over each value and up to `window - 1` values before it.
///
/// Non-finite values stay unchanged and do not enter the means of other values.
pub fn trailing_mean(values: &[f64], window: usize) -> Vec<f64> {
    let mean = |end: usize| {
        let finite = || {
            values[(end + 1).saturating_sub(window)..=end].iter().filter(|value| value.is_finite())
        };
        if values[end].is_finite() {
            finite().sum::<f64>() / finite().count() as f64
        } else {
            values[end]
        }
    };
    (0..values.len()).map(mean).collect()
}

/// Number of resamples of a bootstrap interval.
const RESAMPLES: u64 = 10_000;

/// Ratio of two medians with its bootstrap interval.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Ratio {
    /// Median of the first numbers divided by the median of the second ones.
    pub value: f64,
    /// Lower and upper end of the 95 % interval. NaN for fewer than two pairs.
    pub interval: [f64; 2],
}

impl fmt::Display for Ratio {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let [low, high] = self.interval;
        f.write_str(&short(self.value))?;
        if low.is_nan() && high.is_nan() {
            Ok(())
        } else {
            write!(f, " ({} to {})", short(low), short(high))
        }
    }
}

/// [`median_ratio`] of the final test losses of two groups of runs, over the seeds that both groups
/// contain.
pub fn loss_ratio<'a>(
    runs: impl Iterator<Item = Outcome<'a>>,
    others: impl Iterator<Item = Outcome<'a>> + Clone,
) -> Ratio {
    let loss = |run: Outcome| run.last(|r| r.test_loss);
    let pair = |run: Outcome<'a>| {
        others.clone().find(|other| other.seed == run.seed).map(|other| (loss(run), loss(other)))
    };
    median_ratio(&runs.filter_map(pair).collect::<Vec<_>>())
}

/// Ratio of the medians of pairs of losses, one pair per seed. NaN stands for the loss of a failed
/// run and counts as infinite. The ratio of two infinite medians is NaN, which ranks above every
/// number.
///
/// The interval extends from the 2.5 % to the 97.5 % quantile of the ratio over 10,000 resamples of
/// the pairs with replacement. Source: percentile bootstrap, Efron and Tibshirani 1993, section
/// 13.3.
pub fn median_ratio(pairs: &[(f64, f64)]) -> Ratio {
    let ratio = |pairs: &mut dyn Iterator<Item = (f64, f64)>| {
        let worst = |loss: f64| if loss.is_nan() { f64::INFINITY } else { loss };
        let (first, second): (Vec<f64>, Vec<f64>) =
            pairs.map(|(a, b)| (worst(a), worst(b))).unzip();
        let [first, second] =
            [first, second].map(|losses| quantile(&sorted(losses.into_iter()), 0.5));
        first / second
    };
    let resample = |i: u64| {
        let mut rng = stream(0, Purpose::Bootstrap, i);
        ratio(&mut (0..pairs.len()).map(|_| pairs[rng.random_range(0..pairs.len())]))
    };
    let ratios = if pairs.len() < 2 { Vec::new() } else { sorted((0..RESAMPLES).map(resample)) };
    Ratio {
        value: ratio(&mut pairs.iter().copied()),
        interval: [0.025, 0.975].map(|q| quantile(&ratios, q)),
    }
}

/// Mean of the logarithm to base 10 of the test loss over the first `duration` seconds of a
/// training. It is the area under the learning curve on a logarithmic axis, divided by the
/// duration.
///
/// The curve starts at the loss `initial` and connects the losses after each epoch by straight
/// lines on the logarithmic axis. It starts at the loss of the first epoch if `initial` is not
/// finite and positive. The mean is NaN if the training ends before `duration`. It is also NaN if a
/// later loss, up to the first epoch that ends at or after `duration`, is not finite and positive.
pub fn mean_log_loss(points: &[Point], initial: f64, duration: f64) -> f64 {
    let log = |loss: f64| if loss > 0.0 && loss.is_finite() { loss.log10() } else { f64::NAN };
    let Some(first) = points.first() else { return f64::NAN };
    let mut last = (0.0, if log(initial).is_nan() { log(first.value) } else { log(initial) });
    let mut area = 0.0;
    for point in points {
        let (seconds, value) = (point.seconds, log(point.value));
        // Cuts the last interval at the duration.
        let end = seconds.min(duration);
        let share = if seconds > last.0 { (end - last.0) / (seconds - last.0) } else { 1.0 };
        area += (end - last.0) * (last.1 + 0.5 * share * (value - last.1));
        if seconds >= duration {
            return area / duration;
        }
        last = (seconds, value);
    }
    f64::NAN
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_ratio_of_medians_has_an_interval_that_covers_the_resamples() {
        // Medians 2 and 8. Each pair has the ratio 1/4, and so has every resample.
        let ratio = median_ratio(&[(1.0, 4.0), (2.0, 8.0), (3.0, 12.0)]);
        assert_eq!(ratio, Ratio { value: 0.25, interval: [0.25; 2] });
        // A resample of two seeds is the first one twice, the second one twice, or both. The
        // probabilities are 1/4, 1/4 and 1/2, the ratios 1, 9 and 5.
        let ratio = median_ratio(&[(1.0, 1.0), (9.0, 1.0)]);
        assert_eq!(ratio, Ratio { value: 5.0, interval: [1.0, 9.0] });
        // One of 9 seeds has the ratio 100. It is the median only if at least 5 of 9 draws choose
        // this seed. The probability is 0.0014.
        let mut pairs = [(2.0, 1.0); 9];
        pairs[4].0 = 100.0;
        assert_eq!(median_ratio(&pairs), Ratio { value: 2.0, interval: [2.0; 2] });
    }

    #[test]
    fn failed_seeds_count_as_infinite_losses_and_one_seed_has_no_interval() {
        let failed = median_ratio(&[(f64::NAN, 1.0), (f64::NAN, 2.0), (1.0, 3.0)]);
        assert_eq!((failed.value, failed.interval[1]), (f64::INFINITY, f64::INFINITY));
        assert_eq!(median_ratio(&[(1.0, f64::NAN), (2.0, f64::NAN), (3.0, 1.0)]).value, 0.0);
        let one = median_ratio(&[(1.0, 2.0)]);
        assert!(one.value == 0.5 && one.interval.iter().all(|end| end.is_nan()));
        assert!(median_ratio(&[]).value.is_nan());
    }

    #[test]
    fn the_mean_log_loss_is_the_area_under_straight_lines_on_a_log_axis() {
        let point = |seconds: f64, value: f64| Point { epoch: 0.0, seconds, value };
        // From 10^0 to 10^-2 within 2 s, then constant for 2 s: (2 · -1 + 2 · -2) / 4.
        let points = [point(2.0, 1e-2), point(4.0, 1e-2)];
        let near = |found: f64, expected: f64| {
            assert!((found - expected).abs() < 1e-12, "{found}, expected {expected}")
        };
        near(mean_log_loss(&points, 1.0, 4.0), -1.5);
        // The first second ends at 10^-1, and the first three seconds have the area -2 - 2.
        near(mean_log_loss(&points, 1.0, 1.0), -0.5);
        near(mean_log_loss(&points, 1.0, 3.0), -4.0 / 3.0);
        near(mean_log_loss(&points, f64::NAN, 4.0), -2.0);
        for (initial, duration) in [(1.0, 5.0), (f64::NAN, 5.0)] {
            assert!(
                mean_log_loss(&points, initial, duration).is_nan(),
                "the training ends before {duration} s"
            );
        }
        assert!(mean_log_loss(&[point(1.0, f64::NAN), point(2.0, 1.0)], 1.0, 2.0).is_nan());
        near(mean_log_loss(&[point(1.0, 0.1), point(2.0, f64::NAN)], 1.0, 1.0), -0.5);
    }

    #[test]
    fn curves_of_several_scenes_have_field_colours_and_scene_dashes() {
        let outcome = |field| Outcome { field, seed: 0, records: &[], failed: false };
        let scene = |name| InScene {
            name,
            runs: vec![outcome(Field::regular()), outcome(Field::modified())],
        };
        let curves = curves_of_scenes(&["a", "b"].map(scene), |r| r.test_loss);
        let looks: Vec<_> =
            curves.iter().map(|curve| (&*curve.label, curve.color, curve.dash)).collect();
        let [r, m] = ["R", "M"].map(field_color);
        let (solid, dashed) = (Dash::Solid, Dash::Dashed);
        let expected = [("a: R (regular)", r, solid), ("a: M (modified)", m, solid)];
        assert_eq!(looks[..2], expected);
        assert_eq!(looks[2..], [("b: R (regular)", r, dashed), ("b: M (modified)", m, dashed)]);
    }

    #[test]
    fn a_trailing_mean_uses_earlier_values_only() {
        assert_eq!(trailing_mean(&[1.0, 3.0, 5.0, 7.0], 2), [1.0, 2.0, 4.0, 6.0]);
        assert_eq!(trailing_mean(&[1.0, 3.0], 30), [1.0, 2.0]);
        let with_a_gap = trailing_mean(&[1.0, f64::NAN, 3.0], 2);
        assert!(with_a_gap[0] == 1.0 && with_a_gap[1].is_nan() && with_a_gap[2] == 3.0);
    }
}
