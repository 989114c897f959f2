//! Results of a study: the best learning rate of each method, and statistics over the seeds.

use crate::platform::csv::csv;
use crate::platform::parallel;
use crate::platform::table::Table;
use crate::runs::comparison::Comparison;
use crate::runs::statistics::{Outcome, Ratio, best, loss_ratio, mean_log_loss};
use crate::scenes::plan::Cell;
use anyhow::Result;
use physgrad::text::short;
use physgrad_plot::quantile::{quantile, sorted};
use physgrad_plot::{Drawing, TaskLosses, final_losses};

/// Explanation of the table.
pub const NOTE: &str = "test loss of the last epoch at the learning rate with the lowest median: median, lowest and highest over the \
                        seeds; ratio to the first method with a 95 % bootstrap interval; failed: not below the loss of the \
                        untrained policy; (end): the smallest or largest learning rate, add rates beyond it to the plan";

/// Titles of the columns with measured times.
const TIMED: [&str; 2] = ["loss over time", "seconds"];

/// All cells of a study, and the best cell of each task and method.
pub struct Results<'a> {
    /// All cells of the plan.
    cells: Vec<Measured<'a>>,
    /// Index of the best cell of each task and method, in the order of the plan.
    best: Vec<usize>,
}

/// Runs of a cell.
struct Measured<'a> {
    names: Names<'a>,
    runs: Vec<Run<'a>>,
}

/// Names of a cell.
#[derive(Clone, Copy)]
struct Names<'a> {
    task: &'a str,
    method: &'a str,
    learning_rate: f64,
}

/// Run with one seed.
struct Run<'a> {
    outcome: Outcome<'a>,
    /// Test loss of the untrained policy.
    initial: f64,
}

impl Run<'_> {
    /// Final test loss. NaN if the training failed.
    fn loss(&self) -> f64 {
        self.outcome.last(|r| r.test_loss)
    }

    /// Returns whether the final loss is not below the loss of the untrained policy. True for a
    /// final loss of NaN. A NaN loss of the untrained policy counts as infinite.
    fn has_failed(&self) -> bool {
        let initial = if self.initial.is_nan() { f64::INFINITY } else { self.initial };
        self.loss().is_nan() || self.loss() >= initial
    }
}

impl Measured<'_> {
    /// Final test losses in ascending order, with NaN last.
    fn losses(&self) -> Vec<f64> {
        sorted(self.runs.iter().map(Run::loss))
    }

    fn failed(&self) -> usize {
        self.runs.iter().filter(|run| run.has_failed()).count()
    }

    /// Ratio of the median loss to that of another method, over the seeds of both.
    fn ratio_to(&self, other: &Self) -> Ratio {
        if std::ptr::eq(self, other) {
            return Ratio { value: 1.0, interval: [1.0; 2] };
        }
        loss_ratio(
            self.runs.iter().map(|run| run.outcome),
            other.runs.iter().map(|run| run.outcome),
        )
    }

    fn seconds(&self) -> f64 {
        quantile(&sorted(self.runs.iter().map(|run| run.outcome.seconds())), 0.5)
    }

    /// Median of [`mean_log_loss`] over the seeds.
    fn mean_log_loss(&self, duration: f64) -> f64 {
        let mean =
            |run: &Run| mean_log_loss(&run.outcome.points(|r| r.test_loss), run.initial, duration);
        quantile(&sorted(self.runs.iter().map(mean)), 0.5)
    }
}

impl<'a> Results<'a> {
    /// Evaluates the untrained policies, and chooses the learning rates.
    pub fn of(cells: &'a [Cell], comparisons: &'a [Comparison]) -> Result<Self> {
        let initial = parallel::map(comparisons, Comparison::initial_losses);
        let measured =
            |((cell, comparison), initial): ((&'a Cell, &'a Comparison), Result<Vec<f64>>)| {
                let runs = comparison
                    .outcomes()
                    .into_iter()
                    .zip(initial?)
                    .map(|(outcome, initial)| Run { outcome, initial });
                let names = Names {
                    task: &cell.task,
                    method: &cell.method,
                    learning_rate: cell.learning_rate,
                };
                Ok(Measured { names, runs: runs.collect() })
            };
        Ok(Self::new(
            cells.iter().zip(comparisons).zip(initial).map(measured).collect::<Result<_>>()?,
        ))
    }

    fn new(cells: Vec<Measured<'a>>) -> Self {
        let mut best: Vec<usize> = Vec::new();
        for (i, cell) in cells.iter().enumerate() {
            let median = |i: usize| quantile(&cells[i].losses(), 0.5);
            let is_same =
                |other: &Names| (other.task, other.method) == (cell.names.task, cell.names.method);
            match best.last_mut().filter(|best| is_same(&cells[**best].names)) {
                None => best.push(i),
                // NaN ranks above every number. The first of equal medians stays.
                Some(best)
                    if median(i) < median(*best)
                        || (median(*best).is_nan() && !median(i).is_nan()) =>
                {
                    *best = i
                }
                Some(_) => {}
            }
        }
        Self { cells, best }
    }

    /// Best cells with at least one run, each with the best cell of the first method of its task.
    fn rows(&self) -> impl Iterator<Item = (&Measured<'a>, &Measured<'a>)> {
        let first = |cell: &Measured| {
            self.best
                .iter()
                .map(|&i| &self.cells[i])
                .find(|first| first.names.task == cell.names.task)
        };
        let best = self.best.iter().map(|&i| &self.cells[i]).filter(|cell| !cell.runs.is_empty());
        best.filter_map(move |cell| Some((cell, first(cell)?)))
    }

    /// Shortest training time of a run of the task that reached its last epoch, at the best
    /// learning rates, in s. Infinite without such a run.
    fn duration(&self, task: &str) -> f64 {
        let runs = self
            .rows()
            .filter(|(cell, _)| cell.names.task == task)
            .flat_map(|(cell, _)| &cell.runs);
        runs.filter(|run| !run.outcome.failed)
            .map(|run| run.outcome.seconds())
            .fold(f64::INFINITY, f64::min)
    }

    /// Table with one row per task and method; with measured times if `timed`.
    pub fn table(&self, timed: bool) -> Table {
        let columns = [
            "task",
            "method",
            "learning rate",
            "test loss",
            "lowest",
            "highest",
            "ratio",
            "failed",
        ];
        let timed_columns = TIMED.iter().filter(|_| timed);
        let optional =
            ["learning rate", "failed", "loss over time", "seconds", "highest", "lowest"];
        let mut table =
            Table::new(columns.iter().chain(timed_columns).copied()).optional(&optional);
        for (cell, first) in self.rows() {
            let losses = cell.losses();
            let end = if self.is_at_end(cell.names) { " (end)" } else { "" };
            let ratio = if std::ptr::eq(cell, first) {
                "1".to_owned()
            } else {
                cell.ratio_to(first).to_string()
            };
            let mut row = vec![
                cell.names.task.to_owned(),
                cell.names.method.to_owned(),
                format!("{}{end}", cell.names.learning_rate),
                short(quantile(&losses, 0.5)),
                short(losses[0]),
                short(losses[losses.len() - 1]),
                ratio,
                format!("{} of {}", cell.failed(), cell.runs.len()),
            ];
            if timed {
                row.push(short(10f64.powf(cell.mean_log_loss(self.duration(cell.names.task)))));
                row.push(format!("{:.1}", cell.seconds()));
            }
            table.row(row);
        }
        table
    }

    /// `study.csv`: one row per task and method.
    pub fn methods_csv(&self) -> Result<Vec<u8>> {
        let header = [
            "task",
            "method",
            "learning_rate",
            "seeds",
            "failed",
            "failed_share",
            "median_test_loss",
            "lowest_test_loss",
            "highest_test_loss",
            "ratio",
            "ratio_low",
            "ratio_high",
        ];
        let row = |(cell, first): (&Measured, &Measured)| {
            let (losses, seeds, failed) = (cell.losses(), cell.runs.len(), cell.failed());
            let Ratio { value, interval: [low, high] } = cell.ratio_to(first);
            let names = [
                cell.names.task.to_owned(),
                cell.names.method.to_owned(),
                cell.names.learning_rate.to_string(),
            ];
            let counts = [seeds.to_string(), failed.to_string()];
            let share = failed as f64 / seeds as f64;
            let numbers = [
                share,
                quantile(&losses, 0.5),
                losses[0],
                losses[losses.len() - 1],
                value,
                low,
                high,
            ];
            names.into_iter().chain(counts).chain(numbers.map(|x| x.to_string()))
        };
        csv(header, self.rows().map(row))
    }

    /// `summary.csv`: one row per run, also at other learning rates.
    pub fn runs_csv(&self) -> Result<Vec<u8>> {
        let header = [
            "task",
            "method",
            "learning_rate",
            "best",
            "field",
            "seed",
            "untrained_test_loss",
            "final_train_loss",
            "final_test_loss",
            "best_test_loss",
            "failed",
            "seconds",
        ];
        let runs = self
            .cells
            .iter()
            .enumerate()
            .flat_map(|(i, cell)| cell.runs.iter().map(move |run| (i, cell.names, run)));
        let rows = runs.map(|(i, names, run)| {
            let outcome = &run.outcome;
            let cell =
                [names.task.to_owned(), names.method.to_owned(), names.learning_rate.to_string()];
            let run_names = [
                self.best.contains(&i).to_string(),
                outcome.field.letter().to_owned(),
                outcome.seed.to_string(),
            ];
            let losses =
                [run.initial, outcome.last(|r| r.train_loss), run.loss(), best(outcome.records)];
            let ends = [run.has_failed().to_string(), outcome.seconds().to_string()];
            cell.into_iter().chain(run_names).chain(losses.map(|x| x.to_string())).chain(ends)
        });
        csv(header, rows)
    }

    /// `times.csv`: measured times, one row per task and method.
    pub fn times_csv(&self) -> Result<Vec<u8>> {
        let rows = self.rows().map(|(cell, _)| {
            let duration = self.duration(cell.names.task);
            let numbers = [cell.seconds(), duration, cell.mean_log_loss(duration)];
            [cell.names.task.to_owned(), cell.names.method.to_owned()]
                .into_iter()
                .chain(numbers.map(|x| x.to_string()))
        });
        csv(["task", "method", "seconds", "duration", "mean_log10_loss"], rows)
    }

    /// One panel per task.
    pub fn picture(&self, title: &str) -> Drawing {
        let best: Vec<&Measured> = self.best.iter().map(|&i| &self.cells[i]).collect();
        let panel = |cells: &[&Measured]| TaskLosses {
            task: cells[0].names.task.to_owned(),
            methods: cells
                .iter()
                .map(|cell| {
                    (cell.names.method.to_owned(), cell.runs.iter().map(Run::loss).collect())
                })
                .collect(),
            untrained: quantile(
                &sorted(cells.iter().flat_map(|cell| &cell.runs).map(|run| run.initial)),
                0.5,
            ),
        };
        final_losses(title, best.chunk_by(|a, b| a.names.task == b.names.task).map(panel).collect())
    }

    /// Returns whether the learning rate is the smallest or largest one of several rates of its
    /// task and method.
    fn is_at_end(&self, Names { task, method, learning_rate }: Names) -> bool {
        let others = self
            .cells
            .iter()
            .map(|cell| cell.names)
            .filter(|other| (other.task, other.method) == (task, method));
        let rates = sorted(others.map(|names| names.learning_rate));
        rates.len() > 1 && [rates[0], rates[rates.len() - 1]].contains(&learning_rate)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use physgrad::Field;
    use physgrad::train::Record;

    /// Records of epochs of 1 s each, with these test losses.
    fn records(losses: &[f64]) -> Vec<Record> {
        let record = |(i, &test_loss): (usize, &f64)| Record {
            epoch: i + 1,
            test_loss,
            seconds: 1.0,
            ..Record::default()
        };
        losses.iter().enumerate().map(record).collect()
    }

    fn measured<'a>(
        method: &'a str,
        learning_rate: f64,
        runs: &'a [Vec<Record>],
        failed: bool,
    ) -> Measured<'a> {
        let outcome = |(i, records): (usize, &'a Vec<Record>)| {
            // The training of the last seed failed.
            let failed = failed && i + 1 == runs.len();
            Outcome { field: Field::combined(), seed: i as u64, records, failed }
        };
        let run = |outcome| Run { outcome, initial: 1.0 };
        let names = Names { task: "task", method, learning_rate };
        Measured { names, runs: runs.iter().enumerate().map(outcome).map(run).collect() }
    }

    #[test]
    fn a_small_table_has_the_numbers_computed_by_hand() {
        let slow = [[0.1, 0.4], [0.1, 0.8], [0.1, 0.9]].map(|losses| records(&losses));
        let fast = [[0.1, 0.1], [0.1, 0.2], [0.1, 1.5]].map(|losses| records(&losses));
        let other = [[0.1, 0.4], [0.1, 0.8], [0.01, 0.01]].map(|losses| records(&losses));
        // Method A has the medians 0.8 and 0.2. Method B has the losses 0.4 and 0.8, and a failed
        // run, so its median is 0.8.
        let cells = vec![
            measured("A", 0.001, &slow, false),
            measured("A", 0.01, &fast, false),
            measured("B", 0.01, &other, true),
        ];
        let results = Results::new(cells);
        let text = |csv: Vec<u8>| String::from_utf8(csv).expect("text");
        let methods = text(results.methods_csv().expect("CSV"));
        let rows: Vec<&str> = methods.lines().skip(1).collect();
        // One seed of three fails with either method. The seed of A ends above the loss 1 of the
        // untrained policy. The seed of B has no final loss. The ratio of the medians of B and A is
        // 0.8 / 0.2. Resamples have medians of A among 0.1, 0.2 and 1.5, and of B among 0.4, 0.8
        // and infinity. At the same seeds, the ratios are 4, 4 and infinity.
        assert_eq!(rows[0], "task,A,0.01,3,1,0.3333333333333333,0.2,0.1,1.5,1,1,1");
        assert_eq!(rows[1], "task,B,0.01,3,1,0.3333333333333333,0.8,0.4,NaN,4,4,inf");
        let runs = text(results.runs_csv().expect("CSV"));
        assert_eq!(runs.lines().count(), 1 + 9, "also the runs with another learning rate");
        assert_eq!(runs.lines().filter(|row| row.contains(",true,C,")).count(), 6);
        assert!(runs.contains("task,A,0.01,true,C,2,1,0,1.5,0.1,true,2\n"), "{runs}");
        // The logarithm falls from 0 to -1 in the first second, with the mean -1/2. In the second
        // one, the median seed of A continues to log 0.2, with the mean (-1 + log 0.2) / 2.
        let times = text(results.times_csv().expect("CSV"));
        let row = times.lines().nth(1).expect("a row");
        let mean: f64 =
            row.strip_prefix("task,A,2,2,").and_then(|mean| mean.parse().ok()).expect("the mean");
        let expected = (-0.5 + (-1.0 + 0.2f64.log10()) / 2.0) / 2.0;
        assert!((mean - expected).abs() < 1e-12, "{times}, expected {expected}");
        let table = results.table(true).markdown();
        assert!(table.contains("4.000 (4.000 to inf)") && table.contains("1 of 3"), "{table}");
        assert!(
            table.contains("| task | A      |    0.01 (end) |")
                && table.contains("| task | B      |          0.01 |"),
            "{table}"
        );
    }

    #[test]
    fn the_best_rate_has_the_lowest_median_and_nan_ranks_above_every_number() {
        let best = |medians: [f64; 3]| {
            let runs = medians.map(|loss| vec![records(&[loss])]);
            let cell = |i: usize| measured("A", [0.1, 0.2, 0.3][i], &runs[i], false);
            Results::new((0..3).map(cell).collect()).best[0]
        };
        assert_eq!(best([0.3, 0.1, 0.2]), 1);
        assert_eq!(best([f64::NAN, 0.2, 0.1]), 2);
        assert_eq!(best([0.1, 0.1, f64::NAN]), 0);
        assert_eq!(best([f64::NAN; 3]), 0);
    }

    #[test]
    fn a_run_fails_unless_it_ends_below_the_untrained_policy() {
        let failed = |loss: f64, initial: f64| {
            let records = records(&[loss]);
            let outcome =
                Outcome { field: Field::combined(), seed: 0, records: &records, failed: false };
            Run { outcome, initial }.has_failed()
        };
        assert!(
            failed(1.0, 1.0)
                && failed(2.0, 1.0)
                && failed(f64::NAN, 1.0)
                && failed(f64::NAN, f64::NAN)
        );
        assert!(!failed(0.9, 1.0) && !failed(2.0, f64::NAN));
    }
}
