//! The figures that are trained for: learning curves of several fields, over the values of one setting.

use super::{Options, Plain};
use crate::cli::folder::Folder;
use crate::cli::scene::Scene;
use crate::cli::settings::{self, ClipName, Settings};
use crate::cli::statistics::{quantile, sorted, trailing_mean};
use crate::cli::sweep::{Comparison, Run, sweep};
use crate::cli::terminal::say;
use crate::cli::train::best;
use anyhow::Result;
use comfy_table::Table;
use comfy_table::presets::ASCII_MARKDOWN;
use physgrad::report::{self, Case, Curve, Drawing, Point, field_color};
use physgrad::{Field, Record};
use toml::Value;

/// Epochs that a point of a curve is the mean of, as in the paper.
const SMOOTHING: usize = 30;

/// A figure with a column of panels for every value of a setting, and a row for every kind of clipping.
pub struct Study {
    pub name: &'static str,
    pub title: &'static str,
    /// The setting, and its values.
    key: &'static str,
    values: &'static [&'static str],
    /// What the values are called, with `{}` for the value.
    panel: &'static str,
    /// The value whose runs also show the length of their updates.
    update_size_of: Option<&'static str>,
}

pub const FIG3: Study = Study {
    name: "fig3",
    title: "Guidance by repulsion",
    key: "loss.regularization",
    values: &["1.0", "0.1", "0.01", "0.001"],
    panel: "regularization {}",
    update_size_of: None,
};

pub const FIG4: Study = Study {
    name: "fig4",
    title: "Cart-pole swing-up",
    key: "system.poles",
    values: &["1", "2", "3", "4"],
    panel: "poles: {}",
    update_size_of: None,
};

pub const FIG5: Study = Study {
    name: "fig5",
    title: "Quantum control",
    key: "system.target",
    values: &["3", "4", "5"],
    panel: "eigenstate {}",
    update_size_of: Some("5"),
};

/// All runs with one value and one kind of clipping.
struct Cell<'a> {
    value: &'a str,
    clip: ClipName,
}

impl Study {
    /// Trains what the figure needs, and writes it.
    pub fn run<S: Scene>(&self, options: &Options, folder: &Folder) -> Result<()> {
        let cells: Vec<Cell> =
            options.clip.iter().flat_map(|&clip| self.values.iter().map(move |value| Cell { value, clip })).collect();
        let mut comparisons = cells.iter().map(|cell| self.plan(cell, options, folder)).collect::<Result<Vec<_>>>()?;
        let outcome = sweep::<S>(&mut comparisons, options.quiet)?;
        if outcome.interrupted {
            say(&format!("interrupted; the same command goes on, in {}", folder.path().display()));
            return outcome.into_result();
        }
        let drawing = self.drawing(options, &comparisons);
        let table = table(self, &cells, &comparisons);
        let plain = Plain { drawing, csv: csv(self, &cells, &comparisons)?, table: table.to_string() };
        plain.write(self.name, folder, options)?;
        outcome.into_result()
    }

    fn panel(&self, value: &str) -> String {
        self.panel.replace("{}", value.strip_suffix(".0").unwrap_or(value))
    }

    /// The runs of one cell; its folder is one that `physgrad report` understands.
    fn plan<S: Scene>(&self, cell: &Cell, options: &Options, folder: &Folder) -> Result<Comparison<S>> {
        let mut table = Settings::<S>::defaults().to_table();
        settings::set(&mut table, &format!("{}={}", self.key, cell.value))?;
        settings::put(&mut table, "training.clip", Value::try_from(cell.clip)?)?;
        let epochs = options.epochs.unwrap_or(if options.quick { 5 } else { 1000 });
        settings::put(&mut table, "epochs", Value::try_from(epochs)?)?;
        if options.quick {
            for key in ["training.train_samples", "training.test_samples"] {
                settings::put(&mut table, key, Value::Integer(64))?;
            }
        }
        let label = format!("{}, clip {}", self.panel(cell.value), cell.clip.name());
        let setting = self.key.rsplit('.').next().unwrap_or(self.key);
        let inner = folder.file(self.name).join(format!("{setting}-{}-clip-{}", cell.value, cell.clip.name()));
        Comparison::plan(&label, &Settings::from_table(table)?, &options.fields, options.seeds, &Folder::create(&inner)?)
    }

    fn drawing<S: Scene>(&self, options: &Options, comparisons: &[Comparison<S>]) -> Drawing {
        let rows = options.clip.iter().zip(comparisons.chunks(self.values.len())).enumerate();
        let rows = rows.map(|(i, (clip, row))| {
            // Titles stand above the first row only.
            let title = |text: String| if i == 0 { text } else { String::new() };
            let losses = self.values.iter().zip(row).map(|(value, comparison)| Case {
                title: title(self.panel(value)),
                y_label: format!("test loss (clip: {})", clip.name()),
                y_axis: 0,
                curves: curves(comparison, |r| r.test_loss),
            });
            let sizes = self.values.iter().zip(row).filter(|(value, _)| self.update_size_of == Some(**value));
            let sizes = sizes.map(|(value, comparison)| Case {
                title: title(format!("{}: update size", self.panel(value))),
                y_label: "length of the field".into(),
                y_axis: 1,
                curves: curves(comparison, |r| r.grad_norm),
            });
            losses.chain(sizes).collect()
        });
        let seeds = format!("{} seed{}", options.seeds, if options.seeds == 1 { "" } else { "s" });
        report::study(&format!("{}, {seeds}", self.title), &rows.collect::<Vec<_>>())
    }
}

/// A curve for every field, smoothed as in the paper.
fn curves<S: Scene>(comparison: &Comparison<S>, value: fn(&Record) -> f64) -> Vec<Curve> {
    let points = |run: &Run<S>| {
        let values: Vec<f64> = run.records.iter().map(value).collect();
        let smooth = trailing_mean(&values, SMOOTHING);
        // Wall time means little for runs side by side: these curves are against epochs.
        run.records.iter().zip(smooth).map(|(r, value)| Point { epoch: r.epoch as f64, seconds: f64::NAN, value }).collect()
    };
    let curve = |(field, runs): (Field, &[Run<S>])| Curve {
        label: format!("{} ({field})", field.letter()),
        color: field_color(field.letter()),
        runs: runs.iter().map(points).collect(),
    };
    comparison.by_field().map(curve).collect()
}

/// One row a run.
fn csv<S: Scene>(study: &Study, cells: &[Cell], comparisons: &[Comparison<S>]) -> Result<Vec<u8>> {
    let mut csv = csv::Writer::from_writer(Vec::new());
    let header =
        [study.key, "clip", "field", "seed", "epochs", "final_train_loss", "final_test_loss", "best_test_loss", "seconds"];
    csv.write_record(header.into_iter().chain(["skipped", "broke_off"]))?;
    for (cell, comparison) in cells.iter().zip(comparisons) {
        for run in &comparison.runs {
            let losses = [run.last(|r| r.train_loss), run.last(|r| r.test_loss), best(&run.records), run.seconds()];
            let skipped: usize = run.records.iter().map(|r| r.skipped).sum();
            let names = [cell.value.to_owned(), cell.clip.name().to_owned(), run.field.letter().to_owned()];
            let counts = [run.seed.to_string(), run.records.len().to_string()];
            let ends = [skipped.to_string(), run.broken.is_some().to_string()];
            csv.write_record(names.into_iter().chain(counts).chain(losses.map(|x| x.to_string())).chain(ends))?;
        }
    }
    Ok(csv.into_inner()?)
}

/// Final losses over the seeds, as Markdown.
fn table<S: Scene>(study: &Study, cells: &[Cell], comparisons: &[Comparison<S>]) -> Table {
    let mut table = Table::new();
    let header = ["case", "clip", "field", "seeds", "median final test loss", "quartiles", "median best", "broke off"];
    table.load_style(ASCII_MARKDOWN).set_header(header);
    for (cell, comparison) in cells.iter().zip(comparisons) {
        for (field, runs) in comparison.by_field() {
            let last = sorted(runs.iter().map(|run| run.last(|r| r.test_loss)));
            let lowest = sorted(runs.iter().map(|run| best(&run.records)));
            table.add_row([
                study.panel(cell.value),
                cell.clip.name().to_owned(),
                field.letter().to_owned(),
                runs.len().to_string(),
                format!("{:.3e}", quantile(&last, 0.5)),
                format!("{:.3e} to {:.3e}", quantile(&last, 0.25), quantile(&last, 0.75)),
                format!("{:.3e}", quantile(&lowest, 0.5)),
                runs.iter().filter(|run| run.broken.is_some()).count().to_string(),
            ]);
        }
    }
    table
}
