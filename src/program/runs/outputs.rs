//! Output files of a run: metrics, learning curve, animation, trajectories.

use crate::program::operations::trajectory::Trajectory;
use crate::program::platform::csv::csv;
use crate::program::platform::files;
use crate::program::platform::folder::{Folder, METRICS};
use crate::program::tasks::Scene;
use crate::{Growth, Record, report};
use anyhow::{Context, Result};
use std::fs::File;
use std::path::PathBuf;

/// Writer of `metrics.csv`. Appends one row at the end of each epoch.
pub struct Metrics {
    path: PathBuf,
    file: File,
}

impl Metrics {
    /// Replaces the file by one with the rows of the completed epochs.
    pub fn create(folder: &Folder, done: &[Record]) -> Result<Self> {
        let rows = done.iter().map(|record| row(metrics_row(record)));
        let text = [row(METRICS_HEADER)].into_iter().chain(rows).collect::<Result<String>>()?;
        Ok(Self { path: folder.file(METRICS), file: folder.start(METRICS, text)? })
    }

    /// Appends the row of an epoch.
    pub fn append(&mut self, record: &Record) -> Result<()> {
        let text = row(metrics_row(record))?;
        files::append(&mut self.file, &self.path, text.as_bytes()).with_context(|| self.unwritable())
    }

    /// Waits until all rows are on disk.
    pub fn sync(&self) -> Result<()> {
        files::sync(&self.file, &self.path).with_context(|| self.unwritable())
    }

    fn unwritable(&self) -> String {
        format!("cannot write {}", self.path.display())
    }
}

/// One line of CSV.
fn row<const N: usize>(fields: [impl AsRef<[u8]>; N]) -> Result<String> {
    let mut csv = csv::Writer::from_writer(Vec::new());
    csv.write_record(fields)?;
    Ok(String::from_utf8(csv.into_inner()?)?)
}

/// Columns of `metrics.csv`.
pub const METRICS_HEADER: [&str; 13] = [
    "epoch",
    "loss",
    "train_loss",
    "test_loss",
    "grad_norm",
    "cosine",
    "seconds",
    "kept",
    "skipped",
    "growth_R",
    "worst_window_R",
    "growth_M",
    "worst_window_M",
];

/// Row of an epoch in `metrics.csv`. Absent values are empty.
pub fn metrics_row(record: &Record) -> [String; 13] {
    let Record { epoch, loss, train_loss, test_loss, grad_norm, cosine, kept, skipped, seconds, .. } = record;
    let growth = |growth: Option<Growth>| {
        growth.map_or_else(Default::default, |Growth { along, worst_window }| [along.to_string(), worst_window.to_string()])
    };
    let [[growth_r, worst_r], [growth_m, worst_m]] = [record.regular_growth, record.modified_growth].map(growth);
    let number = |x: &f64| x.to_string();
    let optional = |x: &Option<f64>| x.as_ref().map_or_else(String::new, number);
    [
        epoch.to_string(),
        number(loss),
        number(train_loss),
        number(test_loss),
        grad_norm.to_string(),
        optional(cosine),
        number(seconds),
        optional(kept),
        skipped.to_string(),
        growth_r,
        worst_r,
        growth_m,
        worst_m,
    ]
}

/// SVG chart of training and test loss over epochs.
pub fn learning_curve(title: &str, records: &[Record]) -> String {
    let points = |loss: fn(&Record) -> f64| records.iter().map(|r| (r.epoch as f64, loss(r))).collect::<Vec<_>>();
    report::learning_curve(title, &points(|r| r.train_loss), &points(|r| r.test_loss)).to_svg()
}

/// `numbers.csv`: names and values of the trained numbers.
pub fn numbers(numbers: &[(String, f64)]) -> Result<Vec<u8>> {
    csv(["name", "value"], numbers.iter().map(|(name, value)| [name.clone(), value.to_string()]))
}

/// `trajectory.csv`: one row per rollout and step, for rollouts with the indices of their initial
/// states. A row holds the state before the step, the
/// parameters of the rollout, the controls of the policy, and the controls that an actuator
/// applies. The last state has no controls.
pub fn trajectories<'a>(scene: &Scene, rollouts: impl IntoIterator<Item = (usize, &'a Trajectory)>) -> Result<Vec<u8>> {
    let names = ["sample", "step", "time"].map(String::from).into_iter();
    let (states, params) = (scene.state_names(), scene.param_names());
    let (controls, applied) = (scene.control_names(), scene.applied_names());
    let header = names.chain(states).chain(params).chain(controls.clone()).chain(applied.clone());
    let mut rows = Vec::new();
    let dt = scene.dt();
    for (sample, rollout) in rollouts {
        let applied_rows = scene.applied(&rollout.states, &rollout.controls);
        for (t, state) in rollout.states.iter().enumerate() {
            let index = [sample.to_string(), t.to_string(), (t as f64 * dt).to_string()];
            let cells = |rows: &[Vec<f64>], columns: &[String]| -> Vec<String> {
                let cell = |i: usize| rows.get(t).map_or_else(String::new, |row: &Vec<f64>| row[i].to_string());
                (0..columns.len()).map(cell).collect()
            };
            let state = state.iter().chain(&rollout.params).map(f64::to_string);
            let controls = cells(&rollout.controls, &controls).into_iter().chain(cells(&applied_rows, &applied));
            rows.push(index.into_iter().chain(state).chain(controls).collect::<Vec<_>>());
        }
    }
    csv(header, rows)
}
