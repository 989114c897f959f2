//! Statistics over runs with several seeds: tables and learning curves.

use physgrad::Field;
use physgrad::rng::{Purpose, stream};
use physgrad::text::short;
use physgrad::train::Record;
use physgrad_plot::quantile::{quantile, sorted};
use physgrad_plot::{Curve, Dash, PALETTE, Point, field_color};
use rand::RngExt;
use std::fmt;

/// Method of a run, by which tables and pictures group runs.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Method<'a> {
    Field(Field),
    /// Index and name in a plan.
    Named(usize, &'a str),
}

impl Method<'_> {
    /// Name in tables.
    pub fn name(self) -> String {
        match self {
            Self::Field(field) => field.to_string(),
            Self::Named(_, name) => name.into(),
        }
    }

    /// Legend entry.
    pub fn label(self) -> String {
        match self {
            Self::Field(field) => field_label(field),
            Self::Named(_, name) => name.into(),
        }
    }

    pub fn color(self) -> &'static str {
        match self {
            Self::Field(field) => field_color(field.letter()),
            Self::Named(i, _) => PALETTE[i % PALETTE.len()],
        }
    }

    /// Ratios refer to the method of the lowest rank.
    fn rank(self) -> Option<usize> {
        match self {
            Self::Field(field) => position(field.letter()),
            Self::Named(i, _) => Some(i),
        }
    }
}

/// Method, field, seed and records of one run.
#[derive(Clone, Copy)]
pub struct Outcome<'a> {
    pub method: Method<'a>,
    pub field: Field,
    pub seed: u64,
    pub records: &'a [Record],
    /// Test loss of the initial policy. NaN if it has no trained numbers.
    pub untrained: f64,
    /// True if a non-finite number ended the training. Such a run has no final losses.
    pub diverged: bool,
}

impl Outcome<'_> {
    /// Loss of the last epoch. NaN for a run that diverged, and for a run without an epoch.
    pub fn last(&self, loss: fn(&Record) -> f64) -> f64 {
        self.records.last().filter(|_| !self.diverged).map_or(f64::NAN, loss)
    }

    /// Final test loss.
    pub fn loss(&self) -> f64 {
        self.last(|r| r.test_loss)
    }

    /// Returns whether the final test loss is NaN or not below the loss of the untrained policy. A
    /// NaN loss of the untrained policy counts as infinite.
    pub fn has_failed(&self) -> bool {
        let untrained = if self.untrained.is_nan() { f64::INFINITY } else { self.untrained };
        self.loss().is_nan() || self.loss() >= untrained
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

/// Groups runs by method. Runs of a method must be consecutive.
pub fn by_method<'a, 'r>(
    runs: &'a [Outcome<'r>],
) -> impl Iterator<Item = (Method<'r>, &'a [Outcome<'r>])> {
    runs.chunk_by(|a, b| a.method == b.method).map(|runs| (runs[0].method, runs))
}

/// Final test losses in ascending order, with NaN last.
pub fn losses(runs: &[Outcome]) -> Vec<f64> {
    sorted(runs.iter().map(Outcome::loss))
}

/// Median of the final test loss. NaN ranks above every number.
pub fn median_loss(runs: &[Outcome]) -> f64 {
    quantile(&losses(runs), 0.5)
}

/// Median of a number of each run. NaN ranks above every number.
pub fn median<'a>(runs: &[Outcome<'a>], value: impl Fn(&Outcome<'a>) -> f64) -> f64 {
    quantile(&sorted(runs.iter().map(value)), 0.5)
}

/// Position of a field in tables and legends, by its letters.
pub fn position(letter: &str) -> Option<usize> {
    ["R", "M", "S", "C", "N", "P", "F", "MR", "RM"].iter().position(|other| *other == letter)
}

/// Legend entry of a field.
pub fn field_label(field: Field) -> String {
    format!("{} ({field})", field.letter())
}

/// One curve per method: the loss, or another positive quantity per epoch.
pub fn curves(runs: &[Outcome], loss: fn(&Record) -> f64) -> Vec<Curve> {
    let curve = |(method, runs): (Method, &[Outcome])| Curve {
        label: method.label(),
        color: method.color(),
        dash: Dash::Solid,
        runs: runs.iter().map(|run| run.points(loss)).collect(),
    };
    by_method(runs).map(curve).collect()
}

/// Runs of one case of a comparison: a scene, or a task at a point of a grid.
pub struct InScene<'a> {
    /// Name of the case. Empty if the comparison has only one.
    pub name: &'a str,
    /// Runs, grouped by method.
    pub runs: Vec<Outcome<'a>>,
    /// Chosen values of each method, with one cell for each column of chosen values.
    pub chosen: Vec<Vec<String>>,
}

/// Largest number of scenes in one chart, with different dashes.
pub const MAX_DASHED: usize = 3;

/// Curves of all scenes, one per scene and method: colours of the methods, dashes of the scenes.
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

/// Columns of every table, after those of names and of chosen values.
const NUMBERS: [&str; 8] =
    ["seeds", "failed", "test loss", "ratio", "lowest", "highest", "best", "seconds"];

/// Header of [`table_of_scenes`], with a column for each key of chosen values.
pub fn table_header<'a>(scenes: &[InScene], chosen: &[&'a str]) -> Vec<&'a str> {
    let is_named = |run: &Outcome| matches!(run.method, Method::Named(..));
    let named = scenes.iter().flat_map(|scene| scene.runs.first()).any(is_named);
    let method = if named { "method" } else { "field" };
    let case = (scenes.len() > 1).then_some("scene");
    case.into_iter().chain([method]).chain(chosen.iter().copied()).chain(NUMBERS).collect()
}

/// One row per scene and method, with medians over the seeds and their ratio to R, or to the first
/// method of a plan. Without R, the first field in the order of [`position`] replaces it. NaN ranks
/// above every number.
pub fn table_of_scenes(scenes: &[InScene]) -> Vec<Vec<String>> {
    let mut rows = Vec::new();
    for scene in scenes {
        for (i, (method, runs)) in by_method(&scene.runs).enumerate() {
            // Replaces `+` with a space, so that a table can break the name of a case between its
            // settings.
            let case = (scenes.len() > 1).then(|| scene.name.replace('+', " "));
            let chosen = scene.chosen.get(i).into_iter().flatten().cloned();
            let last = losses(runs);
            let numbers = [
                runs.len().to_string(),
                runs.iter().filter(|run| run.has_failed()).count().to_string(),
                short(quantile(&last, 0.5)),
                relation(&scene.runs, method).to_string(),
                short(last[0]),
                short(last[last.len() - 1]),
                short(median(runs, |run| best(run.records))),
                format!("{:.1}", median(runs, Outcome::seconds)),
            ];
            let names = case.into_iter().chain([method.name()]);
            rows.push(names.chain(chosen).chain(numbers).collect());
        }
    }
    rows
}

/// Columns that a narrow terminal omits, the most important first.
pub const OPTIONAL: [&str; 7] =
    ["ratio", "best", "seeds", "failed", "highest", "lowest", "seconds"];

/// Explanation of the table.
pub fn table_note(scenes: &[InScene], is_named: bool) -> String {
    let reference = if is_named { "the first method" } else { "R (otherwise M, S or C)" };
    let interval = interval_note(scenes);
    format!(
        "test loss of the last epoch: median, lowest and highest over the seeds; medians of best loss and seconds\n\
         ratio of the median to that of {reference}, with {interval}\n\
         failed: runs whose test loss is not a number or not below that of the untrained policy"
    )
}

/// What the intervals of the ratios mean, as the end of a sentence without a point.
pub fn interval_note(scenes: &[InScene]) -> String {
    let seeds = |scene: &InScene| {
        let (first, others) = reference(&scene.runs)?;
        let methods = by_method(&scene.runs).filter(|(method, _)| *method != first);
        methods.map(|(_, runs)| pairs(runs, others).len()).min()
    };
    let has_difference = scenes.iter().any(|scene| {
        let mut relations = by_method(&scene.runs).map(|(method, _)| relation(&scene.runs, method));
        relations.any(|relation| matches!(relation, Relation::Difference(_)))
    });
    let interval = match scenes.iter().filter_map(seeds).min() {
        Some(seeds) if seeds < SEEDS_OF_INTERVAL => format!(
            "a bootstrap interval over the seeds. It is no confidence interval and decides nothing, because fewer than \
             {SEEDS_OF_INTERVAL} seeds do not support 95 %"
        ),
        _ => "a 95 % interval (bootstrap over the seeds); undecided if it contains 1".into(),
    };
    if has_difference { interval + "; negative losses have no ratio" } else { interval }
}

/// Relation of the median loss of a method to that of the method of the lowest rank.
pub fn relation(runs: &[Outcome], method: Method) -> Relation {
    let Some((_, others)) = reference(runs).filter(|(first, _)| *first != method) else {
        return Relation::Reference;
    };
    let own = by_method(runs).find(|(other, _)| *other == method);
    let pairs = pairs(own.map_or(&[], |(_, runs)| runs), others);
    if pairs.iter().any(|(own, other)| *own < 0.0 || *other < 0.0) {
        return Relation::Difference(of_medians(&pairs, |own, other| own - other));
    }
    Relation::Ratio(of_medians(&pairs, |own, other| own / other))
}

/// Method to which ratios refer, with its runs.
fn reference<'a, 'r>(runs: &'a [Outcome<'r>]) -> Option<(Method<'r>, &'a [Outcome<'r>])> {
    by_method(runs).min_by_key(|(method, _)| method.rank())
}

/// Lowest test loss. NaN if no loss is a number.
pub fn best(records: &[Record]) -> f64 {
    best_record(records).map_or(f64::NAN, |record| record.test_loss)
}

/// The first epoch with the lowest test loss. None if no loss is a number.
pub fn best_record(records: &[Record]) -> Option<&Record> {
    let known = records.iter().filter(|record| !record.test_loss.is_nan());
    known.min_by(|a, b| a.test_loss.total_cmp(&b.test_loss))
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

/// Least number of seeds of a 95 % interval. All of n seeds lie on one side of the median with the
/// probability 2^(1 - n), 6 % for 5: of fewer than 6 seeds, not even the range from the lowest to
/// the highest one covers a median with 95 %.
const SEEDS_OF_INTERVAL: usize = 6;

/// How the losses of a method relate to those of the reference.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Relation {
    /// The method is the reference.
    Reference,
    /// Ratio of the medians.
    Ratio(Estimate),
    /// Difference of the medians, if a loss is negative: a ratio then has no meaning.
    Difference(Estimate),
}

impl Relation {
    /// Ratio and the ends of its interval. None for a difference.
    pub fn ratio(&self) -> Option<[f64; 3]> {
        match self {
            Self::Reference => Some([1.0; 3]),
            Self::Ratio(Estimate { value, interval: [low, high], .. }) => {
                Some([*value, *low, *high])
            }
            Self::Difference(_) => None,
        }
    }

    /// What the interval decides about the method.
    pub fn verdict(&self) -> String {
        match self {
            Self::Reference => "reference".into(),
            Self::Ratio(ratio) => ratio.verdict(1.0),
            Self::Difference(difference) => difference.verdict(0.0),
        }
    }
}

/// The ratio, and nothing for a difference.
impl fmt::Display for Relation {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Reference => f.write_str("1"),
            Self::Ratio(ratio) => ratio.fmt(f),
            Self::Difference(_) => Ok(()),
        }
    }
}

/// Ratio or difference of two medians with its bootstrap interval.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Estimate {
    /// Median of the first numbers divided by the median of the second ones, or their difference.
    pub value: f64,
    /// Lower and upper end of the 95 % interval. NaN for fewer than two pairs.
    pub interval: [f64; 2],
    /// Number of seeds that both groups contain.
    pub seeds: usize,
}

impl Estimate {
    /// What the interval decides about the first numbers. Equal medians have the value `equal`.
    fn verdict(&self, equal: f64) -> String {
        let [low, high] = self.interval;
        match () {
            () if self.seeds < SEEDS_OF_INTERVAL => format!("fewer than {SEEDS_OF_INTERVAL} seeds"),
            () if high < equal => "lower".into(),
            () if low > equal => "higher".into(),
            () => "undecided".into(),
        }
    }
}

impl fmt::Display for Estimate {
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

/// Final test losses of two groups of runs, a pair for each seed that both groups contain.
fn pairs(runs: &[Outcome], others: &[Outcome]) -> Vec<(f64, f64)> {
    let pair = |run: &Outcome| {
        let other = others.iter().find(|other| other.seed == run.seed);
        other.map(|other| (run.loss(), other.loss()))
    };
    runs.iter().filter_map(pair).collect()
}

/// Function of the medians of pairs of losses, one pair per seed: their ratio or difference. NaN
/// stands for the loss of a failed run and counts as infinite. The ratio and the difference of two
/// infinite medians are NaN, which ranks above every number.
///
/// The interval extends from the 2.5 % to the 97.5 % quantile of the function over 10,000 resamples
/// of the pairs with replacement. Source: percentile bootstrap, Efron and Tibshirani 1993, section
/// 13.3.
fn of_medians(pairs: &[(f64, f64)], function: fn(f64, f64) -> f64) -> Estimate {
    let value = |pairs: &mut dyn Iterator<Item = (f64, f64)>| {
        let worst = |loss: f64| if loss.is_nan() { f64::INFINITY } else { loss };
        let (first, second): (Vec<f64>, Vec<f64>) =
            pairs.map(|(a, b)| (worst(a), worst(b))).unzip();
        let [first, second] =
            [first, second].map(|losses| quantile(&sorted(losses.into_iter()), 0.5));
        function(first, second)
    };
    let resample = |i: u64| {
        let mut rng = stream(0, Purpose::Bootstrap, i);
        value(&mut (0..pairs.len()).map(|_| pairs[rng.random_range(0..pairs.len())]))
    };
    let values = if pairs.len() < 2 { Vec::new() } else { sorted((0..RESAMPLES).map(resample)) };
    Estimate {
        value: value(&mut pairs.iter().copied()),
        interval: [0.025, 0.975].map(|q| quantile(&values, q)),
        seeds: pairs.len(),
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

    fn outcome(seed: u64, records: &[Record]) -> Outcome<'_> {
        let (field, untrained) = (Field::combined(), 1.0);
        Outcome { method: Method::Field(field), field, seed, records, untrained, diverged: false }
    }

    fn median_ratio(pairs: &[(f64, f64)]) -> Estimate {
        of_medians(pairs, |a, b| a / b)
    }

    #[test]
    fn a_run_fails_unless_it_ends_below_the_untrained_policy() {
        let failed = |test_loss: f64, untrained: f64| {
            let records = [Record { epoch: 1, test_loss, ..Record::default() }];
            Outcome { untrained, ..outcome(0, &records) }.has_failed()
        };
        assert!(failed(1.0, 1.0) && failed(2.0, 1.0));
        assert!(failed(f64::NAN, 1.0) && failed(f64::NAN, f64::NAN));
        assert!(!failed(0.9, 1.0) && !failed(2.0, f64::NAN));
        let records = [Record { epoch: 1, test_loss: 0.1, ..Record::default() }];
        assert!(Outcome { diverged: true, ..outcome(0, &records) }.has_failed());
    }

    #[test]
    fn the_ratio_of_medians_has_an_interval_that_covers_the_resamples() {
        // Medians 2 and 8. Each pair has the ratio 1/4, and so has every resample.
        let ratio = median_ratio(&[(1.0, 4.0), (2.0, 8.0), (3.0, 12.0)]);
        assert_eq!(ratio, Estimate { value: 0.25, interval: [0.25; 2], seeds: 3 });
        // A resample of two seeds is the first one twice, the second one twice, or both. The
        // probabilities are 1/4, 1/4 and 1/2, the ratios 1, 9 and 5.
        let ratio = median_ratio(&[(1.0, 1.0), (9.0, 1.0)]);
        assert_eq!(ratio, Estimate { value: 5.0, interval: [1.0, 9.0], seeds: 2 });
        // One of 9 seeds has the ratio 100. It is the median only if at least 5 of 9 draws choose
        // this seed. The probability is 0.0014.
        let mut pairs = [(2.0, 1.0); 9];
        pairs[4].0 = 100.0;
        assert_eq!(median_ratio(&pairs), Estimate { value: 2.0, interval: [2.0; 2], seeds: 9 });
    }

    #[test]
    fn an_interval_decides_with_six_seeds_but_not_with_five() {
        for (loss, seeds, verdict, note) in [
            (2.0, 6, "higher", "a 95 % interval"),
            (-2.0, 6, "lower", "; negative losses have no ratio"),
            (-2.0, 5, "fewer than 6 seeds", "; negative losses have no ratio"),
            (0.5, 6, "lower", "a 95 % interval"),
            (1.0, 6, "undecided", "a 95 % interval"),
            (2.0, 5, "fewer than 6 seeds", "is no confidence interval and decides nothing"),
            (0.5, 2, "fewer than 6 seeds", "is no confidence interval and decides nothing"),
        ] {
            let of = |loss| [Record { epoch: 1, test_loss: loss, ..Record::default() }];
            let (first, second) = (of(1.0), of(loss));
            let run = |field, seed, records| {
                let method = Method::Field(field);
                Outcome { method, field, ..outcome(seed, records) }
            };
            let modified = Method::Field(Field::modified());
            let runs: Vec<Outcome> = (0..seeds)
                .map(|seed| run(Field::regular(), seed, &first))
                .chain((0..seeds).map(|seed| run(Field::modified(), seed, &second)))
                .collect();
            let relation = relation(&runs, modified);
            assert_eq!(relation.verdict(), verdict, "{loss}, {seeds} seeds");
            assert_eq!(relation.ratio().map(|[value, ..]| value), (loss > 0.0).then_some(loss));
            assert_eq!(relation.to_string().is_empty(), loss < 0.0, "{relation}");
            let found = table_note(&[InScene { name: "", runs, chosen: Vec::new() }], false);
            assert!(found.contains(note), "{loss}, {seeds} seeds: {found}");
        }
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
        let outcome = |field| Outcome { method: Method::Field(field), field, ..outcome(0, &[]) };
        let runs = || vec![outcome(Field::regular()), outcome(Field::modified())];
        let scene = |name| InScene { name, runs: runs(), chosen: Vec::new() };
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
