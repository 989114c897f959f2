//! Measured trajectories in CSV files.

use crate::identify::{Fit, Segment};
use crate::program::platform::csv::csv;
use crate::program::platform::terminal::listed;
use crate::program::tasks::Scene;
use anyhow::{Context, Result, bail};
use std::collections::HashSet;
use std::path::Path;

/// Largest distance in time of a sample from the nearest step of the scene, relative to the time
/// step.
const OFF_GRID: f64 = 1e-3;

/// State components with a measurement in or after the row `first` of a segment.
pub fn measured_components(segments: &[Segment], first: usize) -> Vec<usize> {
    let rows = || segments.iter().flat_map(|segment| segment.x.iter().skip(first));
    let count = rows().next().map_or(0, Vec::len);
    (0..count).filter(|&i| rows().any(|row| row[i].is_finite())).collect()
}

/// Largest number of rows of a segment: one per step, from the first sample to the last.
const MAX_STEPS: usize = 10_000_000;

/// Measured trajectories on the time grid of a scene.
pub struct Measured {
    pub segments: Vec<Segment>,
    /// Names of the parameters of the segments.
    params: Vec<String>,
}

/// Meaning of a column.
#[derive(PartialEq)]
enum Column {
    Segment,
    Time,
    State(usize),
    Control(usize),
    /// A parameter, constant within a segment.
    Param(usize),
    /// A column of `trajectory.csv` without measurements: the step, or an applied control.
    Ignored,
}

impl Measured {
    /// Reads a file, for example `trajectory.csv` of a run. States of steps without a sample are
    /// NaN. A control stays constant until its next value, and is 0 before the first. Parameters
    /// without a column are NaN.
    ///
    /// # Errors
    /// The file cannot be read. It has no samples, no column `t` or `time`, or an unknown or
    /// repeated column. A cell is not a number, or is infinite. A parameter changes within a
    /// segment. A time is missing, or is not a later step on the time grid of the scene. A segment
    /// needs more than 10,000,000 rows, or its rows are not contiguous.
    pub fn read(path: &Path, scene: &Scene) -> Result<Self> {
        let name = path.display();
        let (states, controls, dt) = (scene.state_names(), scene.control_names(), scene.dt());
        let (params, ignored) = (scene.param_names(), [scene.applied_names(), vec!["step".into()]].concat());
        let mut reader = csv::ReaderBuilder::new().comment(Some(b'#')).trim(csv::Trim::All).from_path(path);
        let reader = reader.as_mut().map_err(|error| anyhow::anyhow!("cannot read {name}: {error}"))?;
        let column = |header: &str| {
            let state = states.iter().position(|known| known == header).map(Column::State);
            let control = || controls.iter().position(|known| known == header).map(Column::Control);
            let param = || params.iter().position(|known| known == header).map(Column::Param);
            match header {
                "segment" | "sample" => Ok(Column::Segment),
                "t" | "time" => Ok(Column::Time),
                _ if ignored.iter().any(|known| known == header) => Ok(Column::Ignored),
                _ => state.or_else(control).or_else(param).with_context(|| {
                    format!(
                        "{name}: unknown column `{header}`; allowed: segment, t, {}",
                        [&states, &controls, &params]
                            .into_iter()
                            .filter(|names| !names.is_empty())
                            .map(|names| listed(names))
                            .collect::<Vec<_>>()
                            .join(", ")
                    )
                }),
            }
        };
        let headers = reader.headers()?.clone();
        let columns = headers.iter().map(column).collect::<Result<Vec<_>>>()?;
        for (i, column) in columns.iter().enumerate().filter(|(_, column)| **column != Column::Ignored) {
            if let Some(first) = columns[..i].iter().position(|earlier| earlier == column) {
                bail!("{name}: the columns `{}` and `{}` have one meaning; remove one of them", &headers[first], &headers[i]);
            }
        }
        if !columns.iter().any(|column| matches!(column, Column::Time)) {
            bail!("{name}: there is no column `t` with the time in s");
        }
        let mut segments: Vec<(String, f64, Segment)> = Vec::new();
        let mut seen = HashSet::new();
        for record in reader.records() {
            let record = record.with_context(|| format!("cannot read {name}"))?;
            let line = record.position().map_or(0, csv::Position::line);
            let (mut key, mut time) = (String::new(), 0.0);
            let (mut x, mut u) = (vec![f64::NAN; states.len()], vec![f64::NAN; controls.len()]);
            let mut p = vec![f64::NAN; params.len()];
            for (column, cell) in columns.iter().zip(&record) {
                let number = || match cell {
                    // An empty cell is a missing sample.
                    "" => Ok(f64::NAN),
                    cell => match cell.parse::<f64>() {
                        Ok(number) if number.is_infinite() => {
                            bail!("{name}:{line}: `{cell}` is infinite; leave the cell of a missing sample empty")
                        }
                        number => number.with_context(|| format!("{name}:{line}: `{cell}` is not a number")),
                    },
                };
                match column {
                    Column::Segment => key = cell.to_owned(),
                    Column::Time => time = number()?,
                    Column::State(i) => x[*i] = number()?,
                    Column::Control(i) => u[*i] = number()?,
                    Column::Param(i) => p[*i] = number()?,
                    Column::Ignored => {}
                }
            }
            if time.is_nan() {
                bail!("{name}:{line}: the time is missing; give every row a time in s");
            }
            if segments.last().is_none_or(|(last, ..)| *last != key) {
                if !seen.insert(key.clone()) {
                    bail!("{name}:{line}: the rows of segment {key} are not contiguous; sort the rows by segment");
                }
                segments.push((key, time, Segment { p: p.clone(), ..Segment::default() }));
            }
            let (_, begin, segment) = segments.last_mut().context("a segment begins with its first sample")?;
            for (i, (&p, known)) in p.iter().zip(&mut segment.p).enumerate().filter(|(_, (p, _))| !p.is_nan()) {
                if !known.is_nan() && *known != p {
                    bail!("{name}:{line}: `{}` differs from an earlier row; a parameter is constant in a segment", params[i]);
                }
                *known = p;
            }
            let step = ((time - *begin) / dt).round();
            let is_on_grid = ((time - *begin) / dt - step).abs() < OFF_GRID;
            if step >= MAX_STEPS as f64 {
                bail!("{name}:{line}: the segment has {MAX_STEPS} or more steps of {dt} s; split it, or set system.dt");
            }
            if !is_on_grid {
                bail!("{name}:{line}: the time {time} s is not a later step of {dt} s; resample, or set system.dt");
            }
            if step < segment.x.len() as f64 {
                bail!("{name}:{line}: the time {time} s is not later than in the row before; sort the rows by time");
            }
            let held = segment.u.last().cloned().unwrap_or_else(|| vec![0.0; controls.len()]);
            segment.x.resize(step as usize, vec![f64::NAN; states.len()]);
            segment.u.resize(step as usize, held.clone());
            for (u, held) in u.iter_mut().zip(held) {
                *u = if u.is_nan() { held } else { *u };
            }
            segment.x.push(x);
            segment.u.push(u);
        }
        if segments.is_empty() {
            bail!("{name} has no samples");
        }
        Ok(Self { segments: segments.into_iter().map(|(_, _, segment)| segment).collect(), params })
    }

    /// Indices of the fitted segments, `0, every, 2 every, …`, and indices of the other segments.
    pub fn split(&self, every: usize) -> [Vec<usize>; 2] {
        let (fitted, others) = (0..self.segments.len()).partition(|i| i % every == 0);
        [fitted, others]
    }

    /// The segments with these indices, with the parameters of a scene. Parameters without a value
    /// are NaN.
    pub fn chosen(&self, numbers: &[usize], scene: &Scene) -> Vec<Segment> {
        let names = scene.param_names();
        let places: Vec<_> = names.iter().map(|name| self.params.iter().position(|known| known == name)).collect();
        let segment = |&i: &usize| {
            let segment = &self.segments[i];
            let p = places.iter().map(|place| place.map_or(f64::NAN, |place| segment.p[place])).collect();
            Segment { p, ..segment.clone() }
        };
        numbers.iter().map(segment).collect()
    }

    /// CSV of measured and simulated states of the segments with these indices. One row per step
    /// with a measurement.
    pub fn beside(&self, numbers: &[usize], fit: &Fit, scene: &Scene) -> Result<Vec<u8>> {
        let names = scene.state_names();
        let mut header = vec!["segment".to_owned(), "t".to_owned()];
        header.extend(names.iter().flat_map(|name| [format!("{name}_measured"), format!("{name}_simulated")]));
        let mut rows = Vec::new();
        for (&number, states) in numbers.iter().zip(&fit.states) {
            for (step, (measured, simulated)) in self.segments[number].x.iter().zip(states).enumerate() {
                if measured.iter().all(|x| x.is_nan()) {
                    continue;
                }
                let mut row = vec![number.to_string(), (step as f64 * scene.dt()).to_string()];
                let cell = |x: &f64| if x.is_nan() { String::new() } else { x.to_string() };
                row.extend(measured.iter().zip(simulated).flat_map(|(y, x)| [cell(y), cell(x)]));
                rows.push(row);
            }
        }
        csv(header, rows)
    }
}
