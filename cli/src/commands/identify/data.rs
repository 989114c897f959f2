//! Measured trajectories on the time grid of a scene.

use crate::commands::identify::remarks::Words;
use crate::commands::identify::table::{Origin, Row, Table, quoted};
use crate::operations::identification::{MOST_BYTES, bytes_per_step};
use crate::platform::csv::csv;
use crate::platform::terminal::{counted, listed};
use crate::scenes::source::SceneSource;
use crate::tasks::Scene;
use anyhow::{Context, Result, bail};
use physgrad::Number;
use physgrad::identify::{Fit, Segment};
use std::collections::HashSet;

/// Largest distance in time of a sample from the nearest step of the scene, relative to the time
/// step.
const OFF_GRID: f64 = 1e-3;

/// Largest decimal unit of the times that counts as their rounding, relative to the time step.
const COARSEST: f64 = 0.2;

/// Smallest number of steps between all rows that shows times in another unit than s.
const SPARSE: usize = 1000;

/// Largest measured angle, rad. Turns of far larger ones have no meaning in f64.
const LARGEST_ANGLE: f64 = 1e9;

/// Smallest distance of a row from the row before that shows a wrong time, relative to the median
/// distance of the segment times its number of rows.
const ASTRAY: usize = 100;

/// Segments that need more than 1 GB.
#[derive(Debug, thiserror::Error)]
#[error("{0}")]
pub struct TooLong(String);

/// Measured trajectories on the time grid of a scene.
pub struct Measured {
    origin: Origin,
    segments: Vec<Recording>,
    /// Names of the parameters of the segments.
    params: Vec<String>,
    /// Names of the controls, and whether each has a column.
    controls: Vec<(String, bool)>,
}

/// Rows of a segment.
struct Recording {
    key: String,
    rows: Vec<Sample>,
    /// Parameters; NaN without a value.
    p: Vec<f64>,
    /// Whether each control has a value in a row.
    has_control: Vec<bool>,
    /// Number of the step at the first row. None between two steps, and before the time 0.
    first_step: Option<usize>,
    /// Whether it begins after missing rows over which a control changes.
    follows_gap: bool,
}

/// A row of the table.
struct Sample {
    /// Line of the file, or number of the row in memory.
    number: u64,
    /// Number of steps after the first row.
    step: usize,
    /// Time in the file, s.
    time: f64,
    /// Measured state; NaN where missing.
    x: Vec<f64>,
    /// Controls, those of the row before where missing.
    u: Vec<f64>,
}

/// Time grid of a scene.
struct Grid {
    dt: f64,
    /// Largest error of a distance between two times by their decimals, s.
    rounding: f64,
}

impl Grid {
    /// Number of steps between two times. None if it is not an integer, up to rounding.
    fn steps(&self, from: f64, to: f64) -> Option<f64> {
        let steps = (to - from) / self.dt;
        let doubles = 4.0 * f64::EPSILON * from.abs().max(to.abs());
        let tolerance = self.rounding.max(OFF_GRID * self.dt) + doubles;
        ((steps - steps.round()).abs() * self.dt < tolerance).then_some(steps.round())
    }

    /// Number of the step at this time. None between two steps, and before the time 0.
    fn first_step(&self, time: f64) -> Option<usize> {
        // Numbers of steps beyond the exact integers of f64 have no meaning.
        let step = self.steps(0.0, time).filter(|step| (0.0..9e15).contains(step));
        step.map(|step| step as usize)
    }
}

impl Measured {
    /// Reads a table, for example `trajectory.csv` of a run. States of steps without a sample are
    /// NaN, and so are those of rows without states and controls, which count as missing. A control
    /// stays constant until its next value, and is 0 before the first. If it changes over missing
    /// rows, its values there are unknown, and a new segment begins. Parameters without a column are
    /// NaN. `source` is that of the scene.
    ///
    /// # Errors
    /// See [`Table::rows`]. There are no rows. The rows of a segment are not contiguous, a parameter
    /// changes within a segment, or a time is missing or not a later step on the time grid of the
    /// scene. A column of a control is empty. A column of a parameter has no value in a segment, or
    /// one outside of the range of its setting. The steps of all segments need more than 1 GB
    /// ([`TooLong`]), or all rows are 1000 or more steps apart. A segment begins between two steps,
    /// or before the time 0, and the physics depends on time.
    pub fn read(table: &Table, scene: &Scene, source: &SceneSource, words: &Words) -> Result<Self> {
        let (dt, unit) = (scene.dt(), table.unit());
        // Both times of a distance are wrong by up to half a unit.
        let grid = Grid { dt, rounding: if unit <= COARSEST * dt { unit } else { 0.0 } };
        let controls = scene.control_names().into_iter().enumerate();
        let controls = controls.map(|(i, name)| (name, table.columns.has_control(i))).collect();
        let (origin, params) = (table.origin.clone(), scene.param_names());
        let mut measured = Self { origin, segments: Vec::new(), params, controls };
        measured.read_rows(table, scene, &grid, words)?;
        measured.check(scene, words)?;
        measured.check_controls()?;
        let given: Vec<usize> =
            (0..measured.params.len()).filter(|&i| table.columns.has_param(i)).collect();
        measured.check_params(&given, &scene.varied(), source)?;
        let origin = &measured.origin;
        let pieces = |segment: Recording| segment.pieces(&grid, origin);
        measured.segments = measured.segments.into_iter().flat_map(pieces).collect();
        Ok(measured)
    }

    fn read_rows(
        &mut self,
        table: &Table,
        scene: &Scene,
        grid: &Grid,
        words: &Words,
    ) -> Result<()> {
        let [states, controls] = [scene.state_names().len(), scene.control_names().len()];
        let most = (MOST_BYTES / bytes_per_step(states, controls)) as usize;
        let (mut seen, mut before) = (HashSet::new(), 0);
        for row in table.rows() {
            let row = row?;
            if row.is_empty() {
                continue;
            }
            let place = table.origin.place(row.number);
            if row.time.is_nan() {
                bail!("{place}: the time is missing; give every row a time in s");
            }
            if self.segments.last().is_none_or(|last| last.key != row.key) {
                if !seen.insert(row.key.clone()) {
                    let key = quoted(&row.key);
                    bail!(
                        "{place}: the rows of segment {key} are not contiguous; sort the rows by segment"
                    );
                }
                before += self.segments.last().map_or(0, Recording::steps);
                self.segments.push(Recording::new(&row, grid));
            }
            let recording =
                self.segments.last_mut().context("a segment begins with its first sample")?;
            recording.push(row, grid, &self.params).with_context(|| place.clone())?;
            let steps = before + recording.steps();
            if steps > most {
                bail!(TooLong(format!(
                    "{place}: the segments have {steps} steps of {} s up to here; allowed: {most}; {}",
                    grid.dt, words.far_apart
                )));
            }
        }
        Ok(())
    }

    /// Refuses a column of a control without a value.
    fn check_controls(&self) -> Result<()> {
        // The control of a single row has no effect.
        let mut moving = self.segments.iter().filter(|segment| segment.rows.len() > 1).peekable();
        if moving.peek().is_none() {
            return Ok(());
        }
        let moving: Vec<&Recording> = moving.collect();
        for (i, (control, has_column)) in self.controls.iter().enumerate() {
            if *has_column && !moving.iter().any(|segment| segment.has_control[i]) {
                bail!(
                    "{}: the column `{control}` is empty; give the control of every row, or zeros if it was 0",
                    self.origin.name
                );
            }
        }
        Ok(())
    }

    /// Refuses segments that lack one of the parameters `given`, or have one that the scene would
    /// refuse.
    fn check_params(
        &self,
        given: &[usize],
        varied: &[(String, Number)],
        source: &SceneSource,
    ) -> Result<()> {
        let mut seen = HashSet::new();
        for (number, segment) in self.segments.iter().enumerate() {
            let place = || {
                let place = self.origin.place(segment.rows[0].number);
                format!("{place}: segment {}", self.label(number))
            };
            for &i in given {
                let name = &self.params[i];
                if segment.p[i].is_nan() {
                    bail!(
                        "{}: the column `{name}` has no value; give it in every segment, or remove the column, so that all \
                         segments have the nominal value",
                        place()
                    );
                }
            }
            let bits: Vec<u64> = given.iter().map(|&i| segment.p[i].to_bits()).collect();
            if seen.insert(bits) {
                let given = given.iter().map(|&i| (&*self.params[i], segment.p[i]));
                let numbers =
                    given.filter(|(name, _)| varied.iter().any(|(known, _)| known == name));
                if let Some(error) = source.refusal_with(numbers)? {
                    bail!("{}: {error}", place());
                }
            }
        }
        Ok(())
    }

    /// Name of a segment: that in the file, or its number.
    pub fn label(&self, segment: usize) -> String {
        match &*self.segments[segment].key {
            "" => segment.to_string(),
            key => quoted(key),
        }
    }

    /// Sentences about what the fit assumes of these segments: controls without a value, and missing
    /// rows.
    pub fn notes(&self, numbers: &[usize]) -> Vec<String> {
        let mut notes = Vec::new();
        let missing: Vec<String> = self
            .controls
            .iter()
            .filter(|(_, has_column)| !has_column)
            .map(|(name, _)| name.clone())
            .collect();
        if !missing.is_empty() {
            let (column, is) =
                if missing.len() == 1 { ("column", "is") } else { ("columns", "are") };
            notes.push(format!(
                "there is no {column} {}, which {is} taken as 0 in all rows",
                listed(&missing)
            ));
        }
        for (i, (control, has_column)) in self.controls.iter().enumerate() {
            let is_bare = |&&number: &&usize| {
                let Recording { rows, has_control, .. } = &self.segments[number];
                *has_column && rows.len() > 1 && !has_control[i]
            };
            let bare: Vec<String> =
                numbers.iter().filter(is_bare).map(|&number| self.label(number)).collect();
            if !bare.is_empty() {
                notes.push(format!(
                    "{control} has no value in segment {}, and is taken as 0 there",
                    listed(&bare)
                ));
            }
        }
        notes.extend(self.held(numbers));
        let gaps = || numbers.iter().filter(|&&number| self.segments[number].follows_gap);
        if let Some(&first) = gaps().next() {
            notes.push(format!(
                "a new segment begins at {} after a gap in which a control changes (first: {}); add rows with the control to join \
                 them",
                counted(gaps().count(), "row"),
                self.origin.place(self.segments[first].rows[0].number)
            ));
        }
        notes
    }

    /// A sentence about controls that change between rows that are all several steps apart. Rows
    /// further apart than others begin a new segment.
    fn held(&self, numbers: &[usize]) -> Option<String> {
        let most = |&i: &usize| {
            let segment = &self.segments[i];
            let (median, mut pairs) = (segment.median(), segment.distances());
            let is_held = median > 1
                && pairs.any(|(steps, [before, after])| steps > 1 && before.u != after.u);
            is_held.then_some(median)
        };
        let steps = numbers.iter().filter_map(most).max()?;
        Some(format!(
            "the rows are {steps} steps apart, and the fit holds each control over these steps; this is right only if the \
             experiment held it too, and not if rows were left out"
        ))
    }

    fn check(&self, scene: &Scene, words: &Words) -> Result<()> {
        let (origin, dt) = (&self.origin, scene.dt());
        if self.segments.is_empty() {
            bail!("{} has no samples", origin.name);
        }
        let names = scene.state_names();
        for i in scene.angles() {
            let rows = self.segments.iter().flat_map(|segment| &segment.rows);
            if let Some(Sample { number, x, .. }) =
                { rows }.find(|row| row.x[i].abs() > LARGEST_ANGLE)
            {
                bail!(
                    "{}: {} is {:e}; allowed: angles in rad up to {LARGEST_ANGLE:e}, or an empty cell",
                    origin.place(*number),
                    names[i],
                    x[i]
                );
            }
        }
        let distances = self.segments.iter().flat_map(Recording::distances);
        if let Some(distance) = distances.map(|(steps, _)| steps).min().filter(|&d| d >= SPARSE) {
            bail!(
                "{}: all rows are {distance} or more steps of {dt} s apart; {}",
                origin.name,
                words.far_apart
            );
        }
        for segment in &self.segments {
            let (median, rows) = (segment.median(), segment.rows.len());
            let most = ASTRAY * rows * median;
            if let Some((steps, [_, Sample { number, .. }])) =
                segment.distances().find(|(steps, _)| *steps > most)
            {
                bail!(
                    "{}: the row is {steps} steps of {dt} s after the row before, but the median of the {rows} rows of its segment \
                     is {median}; correct its time, or begin another segment there",
                    origin.place(*number)
                );
            }
        }
        for (i, segment) in
            self.segments.iter().enumerate().filter(|(_, segment)| segment.first_step.is_none())
        {
            if scene.depends_on_time(&self.chosen(&[i], scene)[0]) {
                let Sample { number, time, .. } = segment.rows[0];
                bail!(
                    "{}: the segment begins at {time:?} s, but the physics depends on time and has steps of {dt} s from 0; begin \
                     at a step, shift the times, or set system.dt",
                    origin.place(number)
                );
            }
        }
        Ok(())
    }

    /// State components with a measurement in or after the row `first` of a segment.
    pub fn components(&self, first: usize) -> Vec<usize> {
        let rows = || self.segments.iter().flat_map(|segment| segment.rows.iter().skip(first));
        let count = rows().next().map_or(0, |row| row.x.len());
        (0..count).filter(|&i| rows().any(|row| row.x[i].is_finite())).collect()
    }

    /// First measured state of a segment.
    pub fn first(&self, segment: usize) -> &[f64] {
        &self.segments[segment].rows[0].x
    }

    /// Time of the first row of a segment, s.
    pub fn begin(&self, segment: usize) -> f64 {
        self.segments[segment].rows[0].time
    }

    /// Time of the first row of a segment, s: that of its step, or the time itself between two steps.
    pub fn begin_at_step(&self, segment: usize, scene: &Scene) -> f64 {
        let first_step = self.segments[segment].first_step;
        first_step.map_or(self.begin(segment), |step| step as f64 * scene.dt())
    }

    /// Indices of the fitted segments, `0, every, 2 every, …`, and indices of the other segments.
    pub fn split(&self, every: usize) -> [Vec<usize>; 2] {
        let (fitted, others) = (0..self.segments.len()).partition(|i| i % every == 0);
        [fitted, others]
    }

    /// The segments with these indices, one row per step, with the parameters of a scene.
    /// Parameters without a value are NaN. A segment that begins between two steps has the nearest
    /// one.
    pub fn chosen(&self, numbers: &[usize], scene: &Scene) -> Vec<Segment> {
        let names = scene.param_names();
        let places: Vec<_> =
            names.iter().map(|name| self.params.iter().position(|known| known == name)).collect();
        let segment = |&i: &usize| {
            let Recording { rows, p, first_step, .. } = &self.segments[i];
            let p = places.iter().map(|place| place.map_or(f64::NAN, |place| p[place])).collect();
            let nearest = || (rows[0].time / scene.dt()).round() as usize;
            let mut segment =
                Segment { p, first_step: first_step.unwrap_or_else(nearest), ..Segment::default() };
            for row in rows {
                segment.x.resize(row.step, vec![f64::NAN; row.x.len()]);
                let held = segment.u.last().cloned().unwrap_or_default();
                segment.u.resize(row.step, held);
                segment.x.push(row.x.clone());
                segment.u.push(row.u.clone());
            }
            segment
        };
        numbers.iter().map(segment).collect()
    }

    /// Measured values of a state in a segment, by row.
    pub fn values(&self, segment: usize, component: usize) -> Vec<f64> {
        self.segments[segment].rows.iter().map(|row| row.x[component]).collect()
    }

    /// Number of segments.
    pub fn count(&self) -> usize {
        self.segments.len()
    }

    /// The line of a row, and the same with the name of the file.
    pub fn place(&self, segment: usize, row: usize) -> [String; 2] {
        let number = self.segments[segment].rows[row].number;
        [self.origin.row(number), self.origin.place(number)]
    }

    /// CSV of measured and simulated states of the segments with these indices. One row per row of
    /// the file with a measurement, at its time. Full turns separate a measured angle from the file
    /// if the data wrap.
    pub fn beside(&self, numbers: &[usize], fit: &Fit, scene: &Scene) -> Result<Vec<u8>> {
        let names = scene.state_names();
        let mut header = vec!["segment".to_owned(), "t".to_owned()];
        header.extend(
            names.iter().flat_map(|name| [format!("{name}_measured"), format!("{name}_simulated")]),
        );
        let segments = numbers.iter().zip(&fit.states);
        let rows = segments.flat_map(|(&number, states)| {
            let segment = &self.chosen(&[number], scene)[0];
            let columns: Vec<Vec<f64>> =
                (0..names.len()).map(|i| fit.measured(i, segment)).collect();
            let key = match &*self.segments[number].key {
                "" => number.to_string(),
                key => key.to_owned(),
            };
            let measured =
                self.segments[number].rows.iter().filter(|row| !row.x.iter().all(|x| x.is_nan()));
            measured.map(move |Sample { step, time, .. }| {
                let cell = |x: f64| if x.is_nan() { String::new() } else { x.to_string() };
                let pairs = columns.iter().zip(&states[*step]);
                let cells = pairs.flat_map(|(column, &x)| [cell(column[*step]), cell(x)]);
                [key.clone(), time.to_string()].into_iter().chain(cells).collect::<Vec<_>>()
            })
        });
        csv(header, rows)
    }
}

impl Recording {
    /// Without the first row itself.
    fn new(row: &Row, grid: &Grid) -> Self {
        Self {
            key: row.key.clone(),
            rows: Vec::new(),
            p: row.p.clone(),
            has_control: vec![false; row.u.len()],
            first_step: grid.first_step(row.time),
            follows_gap: false,
        }
    }

    /// Number of steps from the first row to the last, both included.
    fn steps(&self) -> usize {
        self.rows.last().map_or(0, |row| row.step + 1)
    }

    fn push(
        &mut self,
        Row { number, time, x, mut u, p, .. }: Row,
        grid: &Grid,
        params: &[String],
    ) -> Result<()> {
        for (i, (p, known)) in
            p.into_iter().zip(&mut self.p).enumerate().filter(|(_, (p, _))| !p.is_nan())
        {
            if !known.is_nan() && *known != p {
                bail!(
                    "`{}` differs from an earlier row; a parameter is constant in a segment",
                    params[i]
                );
            }
            *known = p;
        }
        let begin = self.rows.first().map_or(time, |row| row.time);
        let Some(step) = grid.steps(begin, time) else {
            bail!(
                "the time {time:?} s is not a later step of {} s; resample, or set system.dt",
                grid.dt
            );
        };
        if self.rows.last().is_some_and(|last| step <= last.step as f64) {
            bail!("the time {time:?} s is not later than in the row before; sort the rows by time");
        }
        self.has_control.iter_mut().zip(&u).for_each(|(has, u)| *has |= !u.is_nan());
        let held = self.rows.last().map(|row| &row.u);
        for (i, u) in u.iter_mut().enumerate().filter(|(_, u)| u.is_nan()) {
            *u = held.map_or(0.0, |held| held[i]);
        }
        // A larger number saturates, and exceeds the limit on the steps.
        self.rows.push(Sample { number, step: (step as usize).min(usize::MAX / 4), time, x, u });
        Ok(())
    }

    /// Steps between successive rows, each with both rows.
    fn distances(&self) -> impl Iterator<Item = (usize, [&Sample; 2])> {
        self.rows.windows(2).map(|pair| (pair[1].step - pair[0].step, [&pair[0], &pair[1]]))
    }

    /// Median number of steps between successive rows, 1 for a single row.
    fn median(&self) -> usize {
        let mut distances: Vec<usize> = self.distances().map(|(steps, _)| steps).collect();
        distances.sort_unstable();
        distances.get(distances.len() / 2).copied().unwrap_or(1)
    }

    /// The parts between distances of at least twice the median over which a control changes.
    fn pieces(mut self, grid: &Grid, origin: &Origin) -> Vec<Self> {
        let median = self.median();
        let is_gap = |(steps, [before, after]): (usize, [&Sample; 2])| {
            steps >= 2 * median && before.u != after.u
        };
        let gaps = self.distances().enumerate().filter(|(_, distance)| is_gap(*distance));
        let begins: Vec<usize> = gaps.map(|(i, _)| i + 1).collect();
        let mut pieces = Vec::new();
        for begin in begins.into_iter().rev() {
            let mut rows = self.rows.split_off(begin);
            let Sample { number, step, time, .. } = rows[0];
            rows.iter_mut().for_each(|row| row.step -= step);
            let key = match &*self.key {
                "" => String::new(),
                key => format!("{key} from {}", origin.row(number)),
            };
            let (p, has_control) = (self.p.clone(), self.has_control.clone());
            let first_step = grid.first_step(time);
            pieces.push(Self { key, rows, p, has_control, first_step, follows_gap: true });
        }
        pieces.push(self);
        pieces.reverse();
        pieces
    }
}
