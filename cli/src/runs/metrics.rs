//! [`Metrics`]: the values of every epoch, in `metrics.csv` and in the files for other tools.

use crate::platform::csv::csv;
use crate::platform::files;
use crate::platform::folder::{EVENTS, Folder, METRICS, METRICS_JSONL};
use crate::runs::tensorboard;
use crate::settings::LogFormat;
use anyhow::{Context, Result};
use physgrad::engine::Growth;
use physgrad::train::Record;
use std::fs::File;
use std::path::PathBuf;
use std::time::{SystemTime, UNIX_EPOCH};

/// Writer of the metrics of a run. Appends to each file at the end of each epoch.
pub struct Metrics {
    logs: Vec<Log>,
}

#[derive(Clone, Copy)]
enum Format {
    Csv,
    Other(LogFormat),
}

struct Log {
    format: Format,
    path: PathBuf,
    file: File,
}

impl Metrics {
    /// Writes `metrics.csv` and the files of `formats`, with the completed epochs. Replaces earlier
    /// files.
    pub fn create(folder: &Folder, formats: &[LogFormat], done: &[Record]) -> Result<Self> {
        let formats =
            LogFormat::ALL.into_iter().filter(|format| formats.contains(format)).map(Format::Other);
        let ends = wall_times(done);
        let create = |format: Format| {
            let (name, mut bytes) = (format.file(), format.start(*ends.first().unwrap_or(&now()))?);
            for (record, &end) in done.iter().zip(&ends) {
                bytes.extend(format.epoch(record, end)?);
            }
            Ok(Log { format, path: folder.file(name), file: folder.start(name, bytes)? })
        };
        Ok(Self {
            logs: [Format::Csv].into_iter().chain(formats).map(create).collect::<Result<_>>()?,
        })
    }

    /// Appends an epoch.
    pub fn append(&mut self, record: &Record) -> Result<()> {
        let time = now();
        for log in &mut self.logs {
            let bytes = log.format.epoch(record, time)?;
            files::append(&mut log.file, &log.path, &bytes).with_context(|| log.unwritable())?;
        }
        Ok(())
    }

    /// Waits until all epochs are on disk.
    pub fn sync(&self) -> Result<()> {
        self.logs
            .iter()
            .try_for_each(|log| files::sync(&log.file, &log.path).with_context(|| log.unwritable()))
    }
}

impl Log {
    fn unwritable(&self) -> String {
        format!("cannot write {}", self.path.display())
    }
}

impl Format {
    fn file(self) -> &'static str {
        match self {
            Self::Csv => METRICS,
            Self::Other(format) => file(format),
        }
    }

    /// Contents before the first epoch.
    fn start(self, wall_time: f64) -> Result<Vec<u8>> {
        match self {
            Self::Csv => row(COLUMNS),
            Self::Other(LogFormat::Jsonl) => Ok(Vec::new()),
            Self::Other(LogFormat::Tensorboard) => Ok(tensorboard::start(wall_time)),
        }
    }

    fn epoch(self, record: &Record, wall_time: f64) -> Result<Vec<u8>> {
        let cells = cells(record);
        match self {
            Self::Csv => row(cells),
            Self::Other(LogFormat::Jsonl) => Ok(json(&cells)),
            Self::Other(LogFormat::Tensorboard) => {
                // The epoch is the step of the values.
                let values = COLUMNS.into_iter().zip(&cells).skip(1);
                let values = values.filter_map(|(name, cell)| Some((name, cell.parse().ok()?)));
                Ok(tensorboard::scalars(record.epoch, wall_time, values))
            }
        }
    }
}

/// Name of the file in this format.
pub fn file(format: LogFormat) -> &'static str {
    match format {
        LogFormat::Jsonl => METRICS_JSONL,
        LogFormat::Tensorboard => EVENTS,
    }
}

/// Time since 1970, s.
fn now() -> f64 {
    SystemTime::now().duration_since(UNIX_EPOCH).map_or(0.0, |time| time.as_secs_f64())
}

/// Estimated times since 1970 at the ends of the epochs, s. Assumes that the last epoch ends now
/// and that the epochs follow each other without pauses.
fn wall_times(done: &[Record]) -> Vec<f64> {
    let mut end = now();
    let mut times: Vec<f64> = Vec::with_capacity(done.len());
    for record in done.iter().rev() {
        times.push(end);
        end -= record.seconds;
    }
    times.reverse();
    times
}

/// One line of CSV.
fn row(cells: [impl AsRef<[u8]>; COLUMNS.len()]) -> Result<Vec<u8>> {
    csv(cells, std::iter::empty::<Vec<String>>())
}

/// One line with a JSON object. Absent values, and values that are not finite in f64, are null.
fn json(cells: &[String; COLUMNS.len()]) -> Vec<u8> {
    let value =
        |cell: &str| if cell.parse().is_ok_and(f64::is_finite) { cell } else { "null" }.to_owned();
    let members =
        COLUMNS.iter().zip(cells).map(|(name, cell)| format!("\"{name}\":{}", value(cell)));
    format!("{{{}}}\n", members.collect::<Vec<_>>().join(",")).into_bytes()
}

/// Names of the values.
const COLUMNS: [&str; 17] = [
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
    "first_order",
    "length",
    "value_error",
    "explained",
];

/// Values of an epoch, in the order of [`COLUMNS`]. Absent values are empty.
fn cells(record: &Record) -> [String; 17] {
    let Record {
        epoch,
        loss,
        train_loss,
        test_loss,
        grad_norm,
        cosine,
        kept,
        first_order,
        length,
        value_error,
        explained,
        skipped,
        seconds,
        ..
    } = record;
    let growth = |growth: Option<Growth>| {
        growth.map_or_else(Default::default, |Growth { along, worst_window }| {
            [along.to_string(), worst_window.to_string()]
        })
    };
    let [[growth_r, worst_r], [growth_m, worst_m]] =
        [record.regular_growth, record.modified_growth].map(growth);
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
        optional(first_order),
        optional(length),
        optional(value_error),
        optional(explained),
    ]
}
