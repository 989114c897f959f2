//! [`Listed`]: a saved run as its files describe it. Reading it does not need the code of its task.

use crate::platform::folder::{CHECKPOINT, Folder, MAX_SETTINGS, METRICS, SETTINGS};
use crate::runs::saved;
use anyhow::{Context, Result, anyhow};
use physgrad_plot::Point;
use std::fs;
use std::time::SystemTime;
use toml::{Table, Value};

/// Settings and losses of a saved run. Runs of other programs and other versions can be read.
pub struct Listed {
    pub folder: Folder,
    pub task: String,
    pub field: String,
    pub seed: i64,
    /// Total number of epochs in the settings.
    pub epochs: i64,
    pub tags: Vec<String>,
    /// Test loss after each epoch.
    pub losses: Vec<Point>,
    /// Time of the last checkpoint. Without a checkpoint, the time of the settings.
    pub saved: SystemTime,
}

/// Runs in a folder and in five levels of its subfolders, sorted by path, and the errors of damaged
/// runs and of folders that cannot be read. Omits renamed earlier runs and links to folders.
pub fn below(folder: &Folder) -> (Vec<Listed>, Vec<anyhow::Error>) {
    /// Number of levels of folders, from `runs` to a run of `physgrad paper`: `runs`, `paper`,
    /// figure, comparison, `runs`, run.
    const DEPTH: usize = 6;
    let (mut level, mut runs, mut unreadable) = (vec![folder.clone()], Vec::new(), Vec::new());
    for _ in 0..DEPTH {
        let mut next = Vec::new();
        for folder in level {
            match saved::has_run(&folder) {
                true => match Listed::read(folder) {
                    Ok(run) => runs.push(run),
                    Err(error) => unreadable.push(error.context("omitted a run")),
                },
                false => match saved::folders(&folder) {
                    Ok(folders) => next.extend(folders),
                    Err(error) => unreadable.push(error.context("omitted a folder")),
                },
            }
        }
        level = next;
    }
    runs.sort_by(|a, b| a.folder.path().cmp(b.folder.path()));
    (runs, unreadable)
}

impl Listed {
    fn read(folder: Folder) -> Result<Self> {
        let path = folder.file(SETTINGS);
        let damaged = || {
            format!(
                "{} is damaged; restore the file, or delete the folder of the run",
                path.display()
            )
        };
        let bytes = folder.read_up_to(SETTINGS, MAX_SETTINGS)?;
        // Omits the line of the error, which may be long.
        let parse = |text: &str| {
            text.parse().map_err(|error: toml::de::Error| anyhow!("{}", error.message()))
        };
        let table: Table = std::str::from_utf8(&bytes)
            .map_err(Into::into)
            .and_then(parse)
            .with_context(damaged)?;
        let text = |key: &str| table.get(key).and_then(Value::as_str).unwrap_or("?").to_owned();
        let number = |key: &str| table.get(key).and_then(Value::as_integer).unwrap_or(0);
        let tags = table.get("tags").and_then(Value::as_array).into_iter().flatten();
        let time = |name: &str| fs::metadata(folder.file(name)).and_then(|file| file.modified());
        Ok(Self {
            task: text("task"),
            field: text("field"),
            seed: number("seed"),
            epochs: number("epochs"),
            tags: tags.filter_map(Value::as_str).map(String::from).collect(),
            losses: losses(&folder)?,
            saved: time(CHECKPOINT).or_else(|_| time(SETTINGS)).unwrap_or(SystemTime::UNIX_EPOCH),
            folder,
        })
    }

    /// Test loss of the last epoch. NaN before the first epoch.
    pub fn last(&self) -> f64 {
        self.losses.last().map_or(f64::NAN, |point| point.value)
    }

    /// Lowest test loss. NaN if no loss is a number.
    pub fn best(&self) -> f64 {
        self.losses.iter().map(|point| point.value).fold(f64::NAN, f64::min)
    }
}

/// Columns `epoch`, `seconds` and `test_loss` of `metrics.csv`. Sums the seconds to elapsed times.
/// Empty without the file.
fn losses(folder: &Folder) -> Result<Vec<Point>> {
    if !folder.has(METRICS) {
        return Ok(Vec::new());
    }
    let damaged = || {
        format!(
            "{} is damaged; continue the run with `train --resume`, or restore the file",
            folder.file(METRICS).display()
        )
    };
    let bytes = folder.read(METRICS)?;
    let mut rows = csv::Reader::from_reader(&*bytes);
    let header = rows.headers().with_context(damaged)?.clone();
    let column = |name: &str| header.iter().position(|header| header == name).with_context(damaged);
    let columns = [column("epoch")?, column("seconds")?, column("test_loss")?];
    let mut elapsed = 0.0;
    let point = |row: Result<csv::StringRecord, csv::Error>| {
        let row = row.with_context(damaged)?;
        let [epoch, seconds, value] =
            columns.map(|column| row[column].parse::<f64>().with_context(damaged));
        elapsed += seconds?;
        Ok(Point { epoch: epoch?, seconds: elapsed, value: value? })
    };
    rows.records().map(point).collect()
}
