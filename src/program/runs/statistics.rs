//! Statistics over runs with several seeds: tables and learning curves.

use crate::numbers::text::short;
use crate::report::quantile::{quantile, sorted};
use crate::report::{Curve, Dash, Point, field_color};
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
    // The name of a point of a sweep breaks between its settings.
    let row = |name: &str, row: [String; 8]| {
        [name.replace('+', " ")].into_iter().chain(row).skip(usize::from(scenes.len() < 2)).collect::<Vec<_>>()
    };
    scenes.iter().flat_map(|scene| table(&scene.runs).into_iter().map(|cells| row(scene.name, cells))).collect()
}

/// Header of [`table`].
const TABLE_HEADER: [&str; 8] = ["field", "seeds", "failed", "test loss", "lowest", "highest", "best", "seconds"];

/// Columns that a narrow terminal omits.
pub const OPTIONAL: [&str; 6] = ["best", "seeds", "failed", "highest", "lowest", "seconds"];

/// Explanation of the table.
pub const TABLE_NOTE: &str =
    "test loss of the last epoch: median, lowest and highest over the seeds; medians of best loss and seconds";

/// One row per field, with medians over the seeds. NaN ranks above every number.
fn table(runs: &[Outcome]) -> Vec<[String; 8]> {
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
    fn curves_of_several_scenes_have_field_colours_and_scene_dashes() {
        let outcome = |field| Outcome { field, seed: 0, records: &[], failed: false };
        let scene = |name| InScene { name, runs: vec![outcome(Field::regular()), outcome(Field::modified())] };
        let curves = curves_of_scenes(&["a", "b"].map(scene), |r| r.test_loss);
        let looks: Vec<_> = curves.iter().map(|curve| (&*curve.label, curve.color, curve.dash)).collect();
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
