//! Figures 3 to 5: learning curves of several fields, for several values of one setting.

use crate::commands::compare::Output;
use crate::commands::paper::{FinishedFigure, Made, Options};
use crate::platform::csv::csv;
use crate::platform::folder::Folder;
use crate::platform::table::Table;
use crate::platform::terminal::{print_message, print_note, program};
use crate::runs::comparison::{
    Comparison, check_runs, read_all, read_plan, train_all, train_shard, write_plan,
};
use crate::runs::shard::Shard;
use crate::runs::statistics::{Outcome, best, by_field, curves, loss_ratio, trailing_mean};
use crate::scenes::{overrides, presets};
use crate::settings::ClipName;
use anyhow::Result;
use physgrad::Field;
use physgrad::text::short;
use physgrad::train::Record;
use physgrad_plot::quantile::{quantile, sorted};
use physgrad_plot::{Abscissa, Case, Curve, Drawing};
use serde_json::Value as Json;
use toml::Value;

/// Window of the moving average in epochs, as in the paper.
const SMOOTHING: usize = 30;

/// Note below the table.
const NOTE: &str = "Table: test loss after the last epoch; ratio of the median to that of the first field, with a 95 % \
                    bootstrap interval. Figure: the mean of up to 30 epochs, as in the paper; bold lines are \
                    medians over the seeds, thin lines single seeds. Bands extend from the first to the third quartile of \
                    four or more seeds, or over the range of fewer.";

/// A figure with one column of panels per value of a setting and one row per kind of clipping.
pub struct Study {
    pub name: &'static str,
    pub title: &'static str,
    /// Preset.
    scene: &'static str,
    /// Key of the varied setting.
    key: &'static str,
    /// Values of the varied setting.
    values: &'static [&'static str],
    /// Title of a panel. `{}` stands for the value.
    panel: &'static str,
    /// Value with a further panel, which shows the norm of the field.
    update_size_of: Option<&'static str>,
}

pub const FIG3: Study = Study {
    name: "fig3",
    title: "Guidance by repulsion",
    scene: "guidance",
    key: "loss.regularization",
    values: &["1.0", "0.1", "0.01", "0.001"],
    panel: "regularization {}",
    update_size_of: None,
};

pub const FIG4: Study = Study {
    name: "fig4",
    title: "Cart-pole swing-up",
    scene: "cart_pole",
    key: "system.poles",
    values: &["1", "2", "3", "4"],
    panel: "poles: {}",
    update_size_of: None,
};

pub const FIG5: Study = Study {
    name: "fig5",
    title: "Quantum control",
    scene: "quantum",
    key: "system.target",
    values: &["3", "4", "5"],
    panel: "eigenstate {}",
    update_size_of: Some("5"),
};

/// Runs with one value and one kind of clipping.
struct Cell<'a> {
    value: &'a str,
    clip: ClipName,
    runs: Vec<Outcome<'a>>,
}

impl Study {
    /// Trains all runs and writes the figure. A shard trains runs and writes no figure. A training
    /// that a signal ends writes no figure either.
    pub fn run(&self, options: &Options, folder: &Folder, shard: Option<Shard>) -> Result<Made> {
        let mut comparisons = self.comparisons(options, folder)?;
        let own = self.folder(folder)?;
        own.create()?;
        // Shards compare their plan with that of the folder.
        if shard.is_none() {
            comparisons.iter().try_for_each(Comparison::check_resumable)?;
        }
        write_plan(&own, options, shard.is_some())?;
        let ended = match shard {
            Some(shard) => train_shard(&comparisons, shard, options.quiet)?,
            None => train_all(&mut comparisons, options.quiet)?,
        };
        let path = folder.path().display();
        if ended.interrupted {
            let _ = print_note(
                &format!("interrupted; to resume in {path}, repeat the same command"),
                options.json,
            );
            return Ok((None, ended.into_result()));
        }
        if shard.is_some() {
            if !options.quiet {
                print_message(&format!(
                    "to make tables and pictures of all runs:\n{} merge {path}",
                    program()
                ));
            }
            return Ok((None, ended.into_result()));
        }
        Ok((Some(self.write(options, folder, &comparisons)?), ended.into_result()))
    }

    /// Writes the figure from existing runs.
    pub fn merge(&self, folder: &Folder, output: Output) -> Result<Made> {
        let options =
            Options { quiet: output.quiet, json: output.json, ..read_plan(&self.folder(folder)?)? };
        let mut comparisons = self.comparisons(&options, folder)?;
        let ended = read_all(&mut comparisons)?;
        Ok((Some(self.write(&options, folder, &comparisons)?), ended.into_result()))
    }

    /// Folder with the runs of the figure.
    ///
    /// # Errors
    /// It is a link.
    pub fn folder(&self, folder: &Folder) -> Result<Folder> {
        folder.inside(self.name)
    }

    /// Values and kinds of clipping of all cells.
    fn cells<'a>(
        &self,
        options: &'a Options,
    ) -> impl Iterator<Item = (&'static str, ClipName)> + use<'a> {
        let values = self.values;
        options.clip.iter().flat_map(move |&clip| values.iter().map(move |&value| (value, clip)))
    }

    /// One comparison per cell.
    fn comparisons(&self, options: &Options, folder: &Folder) -> Result<Vec<Comparison>> {
        check_runs(self.cells(options).count(), options.fields.len(), options.seeds)?;
        self.cells(options).map(|(value, clip)| self.plan(value, clip, options, folder)).collect()
    }

    fn write(
        &self,
        options: &Options,
        folder: &Folder,
        comparisons: &[Comparison],
    ) -> Result<Json> {
        let outcomes = comparisons.iter().map(Comparison::outcomes);
        let cells: Vec<Cell> = self
            .cells(options)
            .zip(outcomes)
            .map(|((value, clip), runs)| Cell { value, clip, runs })
            .collect();
        let drawing = self.drawing(options, &cells);
        let finished = FinishedFigure {
            drawing,
            csv: self.csv(&cells)?,
            table: self.table(&cells, options.fields[0].0),
            note: NOTE,
        };
        finished.write(self.name, folder, options)
    }

    fn panel(&self, value: &str) -> String {
        self.panel.replace("{}", value.strip_suffix(".0").unwrap_or(value))
    }

    /// Plans the runs of one cell, in a folder that `physgrad report` accepts.
    fn plan(
        &self,
        value: &str,
        clip: ClipName,
        options: &Options,
        folder: &Folder,
    ) -> Result<Comparison> {
        let mut source = presets::source(self.scene)?;
        overrides::set(&mut source, &format!("{}={}", self.key, value))?;
        source.put("training.clip", Value::try_from(clip)?, "--clip")?;
        source.put("epochs", Value::try_from(options.epochs())?, "--epochs")?;
        if options.quick {
            for key in ["training.train_samples", "training.test_samples"] {
                source.put(key, Value::Integer(64), "--quick")?;
            }
        }
        let label = format!("{}, clip {}", self.panel(value), clip.name());
        let setting = self.key.rsplit('.').next().unwrap_or(self.key);
        let inner =
            self.folder(folder)?.inside(&format!("{setting}-{value}-clip-{}", clip.name()))?;
        Comparison::plan(&label, &source.scene()?, &options.fields, options.seeds, &inner)
    }

    fn drawing(&self, options: &Options, cells: &[Cell]) -> Drawing {
        let rows = cells.chunks(self.values.len()).enumerate().map(|(i, row)| {
            // Puts titles above the first row only.
            let title = |text: String| if i == 0 { text } else { String::new() };
            // Shares the loss axis within a column. Losses of different columns differ by orders of
            // magnitude.
            let losses = row.iter().enumerate().map(|(j, cell)| Case {
                title: title(self.panel(cell.value)),
                y_label: format!("test loss (clip: {})", cell.clip.name()),
                y_axis: j,
                x: Abscissa::Epoch,
                curves: smooth(&cell.runs, |r| r.test_loss),
            });
            let sizes =
                row.iter().filter(|cell| self.update_size_of == Some(cell.value)).map(|cell| {
                    Case {
                        title: title(format!("{}: update size", self.panel(cell.value))),
                        y_label: "norm of the field".into(),
                        y_axis: self.values.len(),
                        x: Abscissa::Epoch,
                        curves: smooth(&cell.runs, |r| r.grad_norm.get()),
                    }
                });
            losses.chain(sizes).collect()
        });
        let seeds = format!("{} seed{}", options.seeds, if options.seeds == 1 { "" } else { "s" });
        physgrad_plot::study(
            &format!("{}, {seeds}, means of {SMOOTHING} epochs", self.title),
            &rows.collect::<Vec<_>>(),
        )
    }

    /// One row per run.
    fn csv(&self, cells: &[Cell]) -> Result<Vec<u8>> {
        let header = [
            self.key,
            "clip",
            "field",
            "seed",
            "epochs",
            "final_train_loss",
            "final_test_loss",
            "best_test_loss",
        ];
        let runs = cells.iter().flat_map(|cell| cell.runs.iter().map(move |run| (cell, run)));
        let rows = runs.map(|(cell, run)| {
            let names = [cell.value, cell.clip.name(), run.field.letter()].map(String::from);
            let counts = [run.seed.to_string(), run.records.len().to_string()];
            let losses = [
                run.last(|r| r.train_loss),
                run.last(|r| r.test_loss),
                best(run.records),
                run.seconds(),
            ];
            let skipped: usize = run.records.iter().map(|r| r.skipped).sum();
            let ends = [skipped.to_string(), run.failed.to_string()];
            names.into_iter().chain(counts).chain(losses.map(|x| x.to_string())).chain(ends)
        });
        csv(header.into_iter().chain(["seconds", "skipped", "diverged"]), rows)
    }

    /// Table of final and best losses over the seeds, one row per cell and field. Ratios are those
    /// to the field `reference`.
    fn table(&self, cells: &[Cell], reference: Field) -> Table {
        let header = [
            "case",
            "clip",
            "field",
            "seeds",
            "median final test loss",
            "quartiles",
            "ratio",
            "median best",
            "failed",
        ];
        let mut table =
            Table::new(header).optional(&["median best", "failed", "seeds", "quartiles"]);
        for (cell, (field, runs)) in
            cells.iter().flat_map(|cell| by_field(&cell.runs).map(move |runs| (cell, runs)))
        {
            let first = by_field(&cell.runs).find(|(field, _)| *field == reference);
            let last = sorted(runs.iter().map(|run| run.last(|r| r.test_loss)));
            let lowest = sorted(runs.iter().map(|run| best(run.records)));
            table.row([
                self.panel(cell.value),
                cell.clip.name().to_owned(),
                field.letter().to_owned(),
                runs.len().to_string(),
                short(quantile(&last, 0.5)),
                format!("{} to {}", short(quantile(&last, 0.25)), short(quantile(&last, 0.75))),
                match first {
                    _ if field == reference => "1".into(),
                    Some((_, first)) => {
                        loss_ratio(runs.iter().copied(), first.iter().copied()).to_string()
                    }
                    None => "-".into(),
                },
                short(quantile(&lowest, 0.5)),
                runs.iter().filter(|run| run.failed).count().to_string(),
            ]);
        }
        table
    }
}

/// One curve per field, smoothed as in the paper.
fn smooth(runs: &[Outcome], value: fn(&Record) -> f64) -> Vec<Curve> {
    let mut curves = curves(runs, value);
    for points in curves.iter_mut().flat_map(|curve| &mut curve.runs) {
        let values: Vec<f64> = points.iter().map(|point| point.value).collect();
        for (point, mean) in points.iter_mut().zip(trailing_mean(&values, SMOOTHING)) {
            point.value = mean;
        }
    }
    curves
}
