//! Statistics over runs with several seeds: medians, quantiles and learning curves.

use crate::numbers::text::short;
use crate::report::{Curve, Point, field_color};
use crate::{Field, Record};

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
    /// Loss of the last epoch. NaN for a failed run.
    pub fn last(&self, loss: fn(&Record) -> f64) -> f64 {
        self.records.last().filter(|_| !self.failed).map_or(f64::NAN, loss)
    }

    /// Training time of all epochs.
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
        self.records.iter().zip(elapsed).map(|(r, seconds)| Point { epoch: r.epoch as f64, seconds, value: value(r) }).collect()
    }
}

/// Groups runs by field. Runs of a field must be consecutive.
pub fn by_field<'a, 'r>(runs: &'a [Outcome<'r>]) -> impl Iterator<Item = (Field, &'a [Outcome<'r>])> {
    runs.chunk_by(|a, b| a.field == b.field).map(|runs| (runs[0].field, runs))
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
        runs: runs.iter().map(|run| run.points(loss)).collect(),
    };
    by_field(runs).map(curve).collect()
}

/// Header of [`table`].
pub const TABLE_HEADER: [&str; 8] = ["field", "seeds", "failed", "test loss", "lowest", "highest", "best", "seconds"];

/// Columns that a narrow terminal omits.
pub const OPTIONAL: [&str; 6] = ["best", "seeds", "failed", "highest", "lowest", "seconds"];

/// Explanation of the table.
pub const TABLE_NOTE: &str =
    "test loss of the last epoch: median, lowest and highest over the seeds; medians of best loss and seconds";

/// One row per field, with medians over the seeds. NaN ranks above every number.
pub fn table(runs: &[Outcome]) -> Vec<[String; 8]> {
    let row = |(field, runs): (Field, &[Outcome])| {
        let median = |value: &dyn Fn(&Outcome) -> f64| quantile(&sorted(runs.iter().map(value)), 0.5);
        let last = sorted(runs.iter().map(|run| run.last(|r| r.test_loss)));
        [
            field.to_string(),
            runs.len().to_string(),
            runs.iter().filter(|run| run.failed).count().to_string(),
            short(quantile(&last, 0.5)),
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

/// Quantile `q` in [0, 1] of ascending numbers, by linear interpolation (Hyndman and Fan, type 7).
///
/// NaN stands for the loss of a failed run and ranks above every number, as [`sorted`] orders it.
pub fn quantile(sorted: &[f64], q: f64) -> f64 {
    let at = q * (sorted.len() - 1) as f64;
    let (below, above) = (sorted[at.floor() as usize], sorted[at.ceil() as usize]);
    // The difference of equal infinities is NaN.
    if at.fract() == 0.0 || below == above { below } else { below + at.fract() * (above - below) }
}

/// Sorts in ascending order. NaN of either sign comes last.
pub fn sorted(values: impl Iterator<Item = f64>) -> Vec<f64> {
    let mut values: Vec<f64> = values.map(|x| if x.is_nan() { f64::NAN } else { x }).collect();
    values.sort_by(f64::total_cmp);
    values
}

/// Mean over each value and up to `window - 1` values before it.
///
/// Non-finite values stay unchanged and do not enter the means of other values.
pub fn trailing_mean(values: &[f64], window: usize) -> Vec<f64> {
    let mean = |end: usize| {
        let finite = || values[(end + 1).saturating_sub(window)..=end].iter().filter(|value| value.is_finite());
        if values[end].is_finite() { finite().sum::<f64>() / finite().count() as f64 } else { values[end] }
    };
    (0..values.len()).map(mean).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn quantiles_interpolate_linearly() {
        let numbers = sorted([4.0, 1.0, 2.0].into_iter());
        assert_eq!([0.0, 0.25, 0.5, 0.75, 1.0].map(|q| quantile(&numbers, q)), [1.0, 1.5, 2.0, 3.0, 4.0]);
        assert_eq!(quantile(&[1.0, f64::INFINITY, f64::INFINITY], 0.75), f64::INFINITY);
        assert_eq!(quantile(&[7.0], 0.75), 7.0);
        assert_eq!(quantile(&sorted([1.0, 2.0].into_iter()), 0.5), 1.5);
    }

    #[test]
    fn nan_of_either_sign_ranks_above_every_number() {
        let numbers = sorted([-f64::NAN, 1.0, 2.0].into_iter());
        assert_eq!(quantile(&numbers, 0.5), 2.0);
        assert!(quantile(&numbers, 0.75).is_nan());
    }

    #[test]
    fn a_trailing_mean_uses_earlier_values_only() {
        assert_eq!(trailing_mean(&[1.0, 3.0, 5.0, 7.0], 2), [1.0, 2.0, 4.0, 6.0]);
        assert_eq!(trailing_mean(&[1.0, 3.0], 30), [1.0, 2.0]);
        let with_a_gap = trailing_mean(&[1.0, f64::NAN, 3.0], 2);
        assert!(with_a_gap[0] == 1.0 && with_a_gap[1].is_nan() && with_a_gap[2] == 3.0);
    }
}
