//! What several runs of the same training say together: medians and curves, from plain records.

use super::train::best;
use physgrad::report::{Curve, Point, field_color};
use physgrad::{Field, Record};

/// One field and seed, and what came of it.
#[derive(Clone, Copy)]
pub struct Outcome<'a> {
    pub field: Field,
    pub seed: u64,
    pub records: &'a [Record],
    /// It stopped because a number was not finite, and has no final losses.
    pub broken: bool,
}

impl Outcome<'_> {
    /// The loss at the end; NaN for a run that broke off.
    pub fn last(&self, loss: fn(&Record) -> f64) -> f64 {
        self.records.last().filter(|_| !self.broken).map_or(f64::NAN, loss)
    }

    pub fn seconds(&self) -> f64 {
        self.records.iter().map(|r| r.seconds).sum()
    }

    /// A loss of every epoch, against epochs and against the time since the start.
    pub fn points(&self, loss: fn(&Record) -> f64) -> Vec<Point> {
        let elapsed = self.records.iter().scan(0.0, |sum, r| {
            *sum += r.seconds;
            Some(*sum)
        });
        self.records.iter().zip(elapsed).map(|(r, seconds)| Point { epoch: r.epoch as f64, seconds, loss: loss(r) }).collect()
    }
}

/// The runs of one field after the other; those of a field must be neighbours.
pub fn by_field<'a, 'r>(runs: &'a [Outcome<'r>]) -> impl Iterator<Item = (Field, &'a [Outcome<'r>])> {
    runs.chunk_by(|a, b| a.field == b.field).map(|runs| (runs[0].field, runs))
}

/// A field in a legend.
pub fn field_label(field: Field) -> String {
    format!("{} ({field})", field.letter())
}

/// The losses of every field, or another positive number of each epoch.
pub fn curves(runs: &[Outcome], loss: fn(&Record) -> f64) -> Vec<Curve> {
    let curve = |(field, runs): (Field, &[Outcome])| Curve {
        label: field_label(field),
        color: field_color(field.letter()),
        runs: runs.iter().map(|run| run.points(loss)).collect(),
    };
    by_field(runs).map(curve).collect()
}

pub const TABLE_HEADER: [&str; 8] =
    ["field", "seeds", "broke off", "median final test loss", "lowest", "highest", "median best", "median seconds"];

/// A row a field: medians over the seeds. A loss that is not there is worse than any that is.
pub fn table(runs: &[Outcome]) -> Vec<[String; 8]> {
    let row = |(field, runs): (Field, &[Outcome])| {
        let sorted = |value: &dyn Fn(&Outcome) -> f64| {
            let mut values: Vec<f64> = runs.iter().map(|run| value(run).abs()).collect();
            values.sort_by(f64::total_cmp);
            values
        };
        let last = sorted(&|r| r.last(|r| r.test_loss));
        [
            field.to_string(),
            runs.len().to_string(),
            runs.iter().filter(|run| run.broken).count().to_string(),
            format!("{:.3e}", median(&last)),
            format!("{:.3e}", last[0]),
            format!("{:.3e}", last[last.len() - 1]),
            format!("{:.3e}", median(&sorted(&|r| best(r.records)))),
            format!("{:.1}", median(&sorted(&|r| r.seconds()))),
        ]
    };
    by_field(runs).map(row).collect()
}

fn median(sorted: &[f64]) -> f64 {
    let n = sorted.len();
    if n % 2 == 1 { sorted[n / 2] } else { 0.5 * (sorted[n / 2 - 1] + sorted[n / 2]) }
}
