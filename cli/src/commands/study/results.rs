//! Results of a plan: the best combination of each method, and statistics over the seeds.

use crate::platform::csv::csv;
use crate::platform::parallel;
use crate::platform::table::Table;
use crate::runs::comparison::Comparison;
use crate::runs::statistics::{
    InScene, Method, OPTIONAL, Outcome, best, losses, mean_log_loss, median, median_loss, relation,
    table_header, table_note, table_of_scenes,
};
use crate::scenes::grid::{Point, last_part, number, text};
use crate::scenes::plan::{Case, Expanded, Plan};
use anyhow::Result;
use physgrad::text::short;
use physgrad_plot::quantile::{quantile, sorted};

/// All runs of a plan that ended.
pub struct Results<'a> {
    pub plan: &'a Plan,
    /// One per case, method and combination of the values in `best`, in this order.
    groups: Vec<Group<'a>>,
    /// Indices of the groups with the best combination, one per case and method.
    best: Vec<usize>,
    pub cases: &'a [Case],
}

/// Runs of one method in one case, with several seeds.
pub struct Group<'a> {
    /// Index of the case.
    pub case: usize,
    pub method: Method<'a>,
    /// Combination of the values in `best`.
    chosen: &'a Point,
    pub runs: Vec<Outcome<'a>>,
}

impl<'a> Results<'a> {
    /// Evaluates the untrained policies, and chooses the best combinations.
    ///
    /// # Errors
    /// The settings of a run cannot be read.
    pub fn of(
        plan: &'a Plan,
        expanded: &'a Expanded,
        comparisons: &'a [Comparison],
    ) -> Result<Self> {
        let all: Vec<&'a Comparison> = comparisons.iter().collect();
        let outcomes = parallel::map(&all, |comparison| comparison.outcomes());
        let outcomes = outcomes.into_iter().collect::<Result<Vec<_>>>()?;
        let mut groups: Vec<(usize, Group)> = Vec::new();
        for (cell, outcomes) in expanded.cells.iter().zip(&outcomes) {
            let chosen = &expanded.chosen[cell.chosen];
            for (i, field) in cell.fields.iter().enumerate() {
                let (rank, method) = match cell.method {
                    Some(i) => (i, Method::Named(i, &plan.contents.methods[i].name)),
                    None => (i, Method::Field(field.0)),
                };
                let runs = outcomes.iter().filter(|run| run.field == field.0);
                let runs = runs.map(|run| Outcome { method, ..*run }).collect();
                groups.push((rank, Group { case: cell.case, method, chosen, runs }));
            }
        }
        groups.sort_by_key(|(rank, group)| (group.case, *rank));
        Ok(Self::new(plan, &expanded.cases, groups.into_iter().map(|(_, group)| group).collect()))
    }

    fn new(plan: &'a Plan, cases: &'a [Case], groups: Vec<Group<'a>>) -> Self {
        let mut best: Vec<usize> = Vec::new();
        for (i, group) in groups.iter().enumerate() {
            let loss = |i: usize| median_loss(&groups[i].runs);
            let is_same = |other: &Group| (other.case, other.method) == (group.case, group.method);
            match best.last_mut().filter(|best| is_same(&groups[**best])) {
                None => best.push(i),
                // NaN ranks above every number. The first of equal medians stays.
                Some(best)
                    if loss(i) < loss(*best) || (loss(*best).is_nan() && !loss(i).is_nan()) =>
                {
                    *best = i
                }
                Some(_) => {}
            }
        }
        Self { plan, groups, best, cases }
    }

    /// The best group of each case and method. Groups may have no runs.
    pub fn best(&self) -> impl Iterator<Item = &Group<'a>> {
        self.best.iter().map(|&i| &self.groups[i])
    }

    /// The best groups with runs, by case, for tables and learning curves.
    pub fn scenes(&self) -> Vec<InScene<'_>> {
        let scene = |(i, case): (usize, &'a Case)| {
            let groups =
                || self.best().filter(move |group| group.case == i && !group.runs.is_empty());
            let runs = groups().flat_map(|group| group.runs.iter().copied()).collect();
            InScene {
                name: &case.name,
                runs,
                chosen: groups().map(|group| self.chosen(group)).collect(),
            }
        };
        self.cases.iter().enumerate().map(scene).collect()
    }

    /// Cells of the columns of chosen values. The smallest and the largest of several numbers have
    /// a mark: values beyond them may be better.
    fn chosen(&self, group: &Group) -> Vec<String> {
        let cell = |(key, value): (&str, &toml::Value)| {
            let values = self.plan.contents.best[key].as_array().into_iter().flatten();
            let numbers = sorted(values.filter_map(number));
            let ends = [numbers.first(), numbers.last()].map(|end| end.copied());
            let is_end = numbers.len() > 1 && ends.contains(&number(value));
            format!("{}{}", text(value), if is_end { " (end)" } else { "" })
        };
        group.chosen.iter().map(cell).collect()
    }

    /// Returns whether methods have names. Otherwise, fields are the methods.
    fn is_named(&self) -> bool {
        !self.plan.contents.methods.is_empty()
    }

    /// Table with one row per case and method; with measured times if `timed`.
    pub fn table(&self, timed: bool) -> Table {
        let scenes = self.scenes();
        let chosen: Vec<&str> = self.plan.contents.best.keys().map(|key| last_part(key)).collect();
        let header = table_header(&scenes, &chosen);
        // The last column has the measured times.
        let columns = header.len() - usize::from(!timed);
        let mut table = Table::new(header[..columns].iter().copied()).optional(&OPTIONAL);
        table_of_scenes(&scenes)
            .into_iter()
            .for_each(|row| table.row(row.into_iter().take(columns)));
        table
    }

    /// Explanation of the table.
    pub fn note(&self) -> String {
        let mut note = table_note(&self.scenes(), self.is_named());
        if !self.plan.contents.best.is_empty() {
            note += "\neach method at its combination of values with the lowest median; (end): the smallest or largest value, add \
                     values beyond it to the plan";
        }
        note
    }

    /// Line with the point and method of the lowest median final test loss. Empty for a single
    /// point or several tasks, or if every median is NaN.
    pub fn lowest(&self) -> String {
        let medians = self.best().map(|group| (median_loss(&group.runs), group));
        let lowest = medians.filter(|(loss, _)| !loss.is_nan()).min_by(|a, b| a.0.total_cmp(&b.0));
        match lowest {
            Some((loss, group)) if self.cases.len() > 1 && self.plan.contents.tasks.len() == 1 => {
                let (name, method) = (&self.cases[group.case].name, group.method.name());
                format!("\nlowest median final test loss: {name}, {method}: {}", short(loss))
            }
            _ => String::new(),
        }
    }

    /// Names of the columns with the task, the varied settings, the method and the chosen settings.
    fn columns(&self) -> Vec<&str> {
        let contents = &self.plan.contents;
        let has_tasks = contents.tasks.iter().any(|task| task.name.as_deref() != Some(""));
        let task = has_tasks.then_some("task").into_iter();
        let method = if self.is_named() { "method" } else { "field" };
        task.chain(contents.varied_keys())
            .chain([method])
            .chain(contents.best.keys().map(String::as_str))
            .collect()
    }

    /// Cells of [`columns`](Self::columns).
    fn names(&self, group: &Group) -> Vec<String> {
        let case = &self.cases[group.case];
        let cell = |column: &str| match (column, group.method) {
            ("task", _) => self.plan.contents.tasks[case.task].name.clone().unwrap_or_default(),
            ("method", Method::Named(_, name)) => name.to_owned(),
            ("field", Method::Field(field)) => field.letter().to_owned(),
            (key, _) => {
                case.point.get(key).or(group.chosen.get(key)).map_or_else(String::new, text)
            }
        };
        self.columns().into_iter().map(cell).collect()
    }

    /// `summary.csv`: one row per run, also with other combinations than the best one.
    pub fn runs_csv(&self) -> Result<Vec<u8>> {
        let is_chosen = !self.plan.contents.best.is_empty();
        let best_column = is_chosen.then_some("best");
        let field_column = self.is_named().then_some("field");
        let numbers = [
            "seed",
            "epochs",
            "untrained_test_loss",
            "final_train_loss",
            "final_test_loss",
            "best_test_loss",
            "failed",
            "skipped",
            "seconds",
        ];
        let header =
            self.columns().into_iter().chain(best_column).chain(field_column).chain(numbers);
        let runs = self.groups.iter().enumerate();
        let runs = runs.flat_map(|(i, group)| group.runs.iter().map(move |run| (i, group, run)));
        let rows = runs.map(|(i, group, run)| {
            let chosen = is_chosen.then(|| self.best.contains(&i).to_string());
            let counts = [run.seed.to_string(), run.records.len().to_string()];
            let losses = [run.untrained, run.last(|r| r.train_loss), run.loss(), best(run.records)];
            let skipped: usize = run.records.iter().map(|r| r.skipped).sum();
            self.names(group)
                .into_iter()
                .chain(chosen)
                .chain(field_column.map(|_| run.field.letter().to_owned()))
                .chain(counts)
                .chain(losses.map(|x| x.to_string()))
                .chain([run.has_failed().to_string(), skipped.to_string()])
                .chain([run.seconds().to_string()])
                .collect::<Vec<_>>()
        });
        csv(header, rows)
    }

    /// `table.csv`: one row per case and method, at the best combination.
    pub fn methods_csv(&self) -> Result<Vec<u8>> {
        let numbers = [
            "seeds",
            "failed",
            "median_test_loss",
            "first_quartile",
            "third_quartile",
            "lowest_test_loss",
            "highest_test_loss",
            "ratio",
            "ratio_low",
            "ratio_high",
            "verdict",
            "median_best_test_loss",
        ];
        let header = self.columns().into_iter().chain(numbers);
        let scenes = self.scenes();
        let rows = self.best().filter(|group| !group.runs.is_empty()).map(|group| {
            let (runs, losses) = (&group.runs, losses(&group.runs));
            let failed = runs.iter().filter(|run| run.has_failed()).count();
            let relation = relation(&scenes[group.case].runs, group.method);
            // A method without a ratio has empty cells.
            let ratio = relation.ratio().map(|numbers| numbers.map(|x| x.to_string()));
            let [median_loss, first, third] = [0.5, 0.25, 0.75].map(|q| quantile(&losses, q));
            let (lowest, highest) = (losses[0], losses[losses.len() - 1]);
            let best = median(runs, |run| best(run.records));
            let numbers = [median_loss, first, third, lowest, highest];
            self.names(group)
                .into_iter()
                .chain([runs.len().to_string(), failed.to_string()])
                .chain(numbers.map(|x| x.to_string()))
                .chain(ratio.unwrap_or_default())
                .chain([relation.verdict(), best.to_string()])
                .collect::<Vec<_>>()
        });
        csv(header, rows)
    }

    /// `times.csv`: measured times, one row per case and method.
    pub fn times_csv(&self) -> Result<Vec<u8>> {
        let numbers = ["seconds", "duration", "mean_log10_loss"];
        let header = self.columns().into_iter().chain(numbers);
        let rows = self.best().filter(|group| !group.runs.is_empty()).map(|group| {
            let duration = self.duration(group.case);
            let area = |run: &Outcome| {
                mean_log_loss(&run.points(|r| r.test_loss), run.untrained, duration)
            };
            let numbers =
                [median(&group.runs, Outcome::seconds), duration, median(&group.runs, area)];
            self.names(group).into_iter().chain(numbers.map(|x| x.to_string())).collect::<Vec<_>>()
        });
        csv(header, rows)
    }

    /// Shortest training time of a run of the case that reached its last epoch, at the best
    /// combinations, in s. Infinite without such a run.
    fn duration(&self, case: usize) -> f64 {
        let runs = self.best().filter(|group| group.case == case).flat_map(|group| &group.runs);
        let complete = runs.filter(|run| !run.diverged).map(Outcome::seconds);
        complete.fold(f64::INFINITY, f64::min)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use physgrad::Field;
    use physgrad::train::Record;

    const PLAN: &str = "\
        [best]\n\"training.learning_rate\" = [0.001, 0.01, 0.1]\n\
        [[task]]\nname = \"task\"\nscene = \"lqr\"\n\
        [[method]]\nname = \"A\"\n[[method]]\nname = \"B\"\n";

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

    fn group<'a>(
        method: Method<'a>,
        chosen: &'a Point,
        runs: &'a [Vec<Record>],
        diverged: bool,
    ) -> Group<'a> {
        let outcome = |(i, records): (usize, &'a Vec<Record>)| {
            // The training of the last seed diverged.
            let diverged = diverged && i + 1 == runs.len();
            let field = Field::combined();
            Outcome { method, field, seed: i as u64, records, untrained: 1.0, diverged }
        };
        Group { case: 0, method, chosen, runs: runs.iter().enumerate().map(outcome).collect() }
    }

    #[test]
    fn a_small_table_has_the_numbers_computed_by_hand() {
        let plan = Plan::built_in("plan", PLAN).expect("a plan");
        let Expanded { cases, chosen, .. } = plan.expand().expect("trainings");
        let [a, b] = [Method::Named(0, "A"), Method::Named(1, "B")];
        let slow = [[0.1, 0.4], [0.1, 0.8], [0.1, 0.9]].map(|losses| records(&losses));
        let fast = [[0.1, 0.1], [0.1, 0.2], [0.1, 1.5]].map(|losses| records(&losses));
        let other = [[0.1, 0.4], [0.1, 0.8], [0.01, 0.01]].map(|losses| records(&losses));
        // Method A has the medians 0.8 and 0.2. Method B has the losses 0.4 and 0.8, and a run that
        // diverged, so its median is 0.8.
        let groups = vec![
            group(a, &chosen[1], &slow, false),
            group(a, &chosen[2], &fast, false),
            group(b, &chosen[1], &other, true),
        ];
        let results = Results::new(&plan, &cases, groups);
        let text = |csv: Vec<u8>| String::from_utf8(csv).expect("text");
        let methods = text(results.methods_csv().expect("CSV"));
        let rows: Vec<&str> = methods.lines().collect();
        assert!(rows[0].starts_with("task,method,training.learning_rate,seeds,failed,median"));
        // One seed of three fails with either method. The seed of A ends above the loss 1 of the
        // untrained policy. The seed of B has no final loss. The ratio of the medians of B and A is
        // 0.8 / 0.2. Resamples have medians of A among 0.1, 0.2 and 1.5, and of B among 0.4, 0.8
        // and infinity. At the same seeds, the ratios are 4, 4 and infinity.
        assert_eq!(
            rows[1],
            "task,A,0.1,3,1,0.2,0.15000000000000002,0.8500000000000001,0.1,1.5,1,1,1,reference,0.1"
        );
        assert!(rows[2].starts_with("task,B,0.01,3,1,0.8,"), "{methods}");
        assert!(rows[2].ends_with(",0.4,NaN,4,4,inf,fewer than 6 seeds,0.1"), "{methods}");
        let runs = text(results.runs_csv().expect("CSV"));
        assert_eq!(runs.lines().count(), 1 + 9, "also the runs with another learning rate");
        assert_eq!(runs.lines().filter(|row| row.contains(",true,C,")).count(), 6);
        assert!(runs.contains("task,A,0.1,true,C,2,2,1,0,1.5,0.1,true,0,2\n"), "{runs}");
        // The logarithm falls from 0 to -1 in the first second, with the mean -1/2. In the second
        // one, the median seed of A continues to log 0.2, with the mean (-1 + log 0.2) / 2.
        let times = text(results.times_csv().expect("CSV"));
        let row = times.lines().nth(1).expect("a row");
        let mean: f64 = row
            .strip_prefix("task,A,0.1,2,2,")
            .and_then(|mean| mean.parse().ok())
            .expect("the mean");
        let expected = (-0.5 + (-1.0 + 0.2f64.log10()) / 2.0) / 2.0;
        assert!((mean - expected).abs() < 1e-12, "{times}, expected {expected}");
        let table = results.table(true).markdown();
        assert!(table.contains("4.000 (4.000 to inf)") && table.contains("learning_rate"));
        assert!(
            table.contains("| A      |     0.1 (end) |")
                && table.contains("| B      |          0.01 |"),
            "{table}"
        );
    }

    #[test]
    fn the_best_combination_has_the_lowest_median_and_nan_ranks_above_every_number() {
        let plan = Plan::built_in("plan", PLAN).expect("a plan");
        let Expanded { cases, chosen, .. } = plan.expand().expect("trainings");
        let best = |medians: [f64; 3]| {
            let runs = medians.map(|loss| vec![records(&[loss])]);
            let group = |i: usize| group(Method::Named(0, "A"), &chosen[i], &runs[i], false);
            Results::new(&plan, &cases, (0..3).map(group).collect()).best[0]
        };
        assert_eq!(best([0.3, 0.1, 0.2]), 1);
        assert_eq!(best([f64::NAN, 0.2, 0.1]), 2);
        assert_eq!(best([0.1, 0.1, f64::NAN]), 0);
        assert_eq!(best([f64::NAN; 3]), 0);
    }
}
