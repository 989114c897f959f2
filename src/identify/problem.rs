//! Windows of the measured segments: simulation, residuals, continuity and their derivatives.

use super::elimination::{Linearized, triangle};
use super::error::IdentifyError;
use super::fit::{Options, Segment, Unknown};
use super::jacobian::{Model, Run};
#[cfg(feature = "parallel")]
use crate::numbers::threads;
use nalgebra::DMatrix;
use std::ops::RangeInclusive;
use std::sync::atomic::{AtomicBool, Ordering};

/// Consecutive steps of a segment, with their own initial state.
#[derive(Clone)]
pub(super) struct Window {
    pub segment: usize,
    pub first: usize,
    pub steps: usize,
    pub start: Vec<f64>,
    /// Whether the initial state is unknown.
    pub is_free: bool,
}

/// Values of the parameters, and all windows with their initial states.
#[derive(Clone)]
pub(super) struct Point {
    pub values: Vec<f64>,
    pub windows: Vec<Window>,
}

/// Standard deviations of the noise whose squared ratios to measurements neither overflow nor vanish.
const NOISE: RangeInclusive<f64> = 1e-100..=1e100;

/// Relative changes of a number without derivative that may change the simulation.
const CHANGES: [f64; 5] = [1e-3, 1e-2, 0.1, 0.5, 1.0];

/// Sums of squares, in units of the noise.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Misfit {
    /// χ² of the samples.
    pub samples: f64,
    /// Sum of the squared jumps between windows.
    pub jumps: f64,
    /// Largest jump between windows, in units of the noise.
    pub largest_jump: f64,
}

pub(super) struct Problem<'a> {
    pub model: &'a dyn Model,
    pub segments: &'a [Segment],
    pub unknowns: &'a [Unknown],
    /// 1 / σ of each state component; 1 if the noise is unknown.
    pub per_noise: Vec<f64>,
    pub noise_is_known: bool,
    pub free_starts: bool,
    /// State components with differences modulo 2π.
    pub angles: &'a [usize],
    pub stop: Option<&'a AtomicBool>,
}

impl<'a> Problem<'a> {
    pub fn new(
        model: &'a dyn Model,
        segments: &'a [Segment],
        unknowns: &'a [Unknown],
        options: &'a Options,
    ) -> Result<Self, IdentifyError> {
        let [n, m, params] = model.sizes();
        check_options(options, n)?;
        for (index, segment) in segments.iter().enumerate() {
            check_segment(index, segment, [n, m, params], options.free_starts)?;
        }
        check_unknowns(unknowns, params)?;
        let per_noise = options
            .noise
            .as_ref()
            .map_or_else(|| vec![1.0; n], |noise| noise.iter().map(|s| 1.0 / s).collect());
        let (noise_is_known, free_starts, stop) =
            (options.noise.is_some(), options.free_starts, options.stop.as_deref());
        let angles = &options.angles[..];
        let problem = Self {
            model,
            segments,
            unknowns,
            per_noise,
            noise_is_known,
            free_starts,
            angles,
            stop,
        };
        if problem.free() == 0 {
            return Err(IdentifyError::NothingUnknown);
        }
        Ok(problem)
    }

    /// Number of unknowns that no bounds fix: parameters, and the components of the initial states
    /// of segments if they are unknown. Continuity determines the initial states of later windows.
    pub fn free(&self) -> usize {
        let params = self.unknowns.iter().filter(|unknown| unknown.min < unknown.max).count();
        params + if self.free_starts { self.segments.len() * self.model.sizes()[0] } else { 0 }
    }

    /// Finite measurements, in units of the noise. Without free initial states, the first sample of
    /// a segment is exact and therefore excluded.
    fn finite(&self) -> impl Iterator<Item = f64> {
        let skipped = usize::from(!self.free_starts);
        let rows = self.segments.iter().flat_map(move |segment| segment.x.iter().skip(skipped));
        rows.flat_map(|row| row.iter().zip(&self.per_noise).map(|(y, per_noise)| y * per_noise))
            .filter(|y| y.is_finite())
    }

    /// Number of finite measurements, without first samples that are exact.
    pub fn measurements(&self) -> usize {
        self.finite().count()
    }

    /// Root mean square of the measurements that [`measurements`](Self::measurements) counts, in
    /// units of the noise.
    pub fn size(&self) -> f64 {
        (self.finite().map(|y| y * y).sum::<f64>() / self.measurements() as f64).sqrt()
    }

    /// Initial values. Splits the segments into windows of `length` steps. The last window of a
    /// segment may be shorter. `None`: one window per segment. A window starts at the measured
    /// state. Components without a measurement continue the simulation of the previous window. In
    /// the first window of a segment, they start at `guess`.
    ///
    /// # Errors
    /// [`IdentifyError::Diverged`] if a state or a squared residual is non-finite.
    /// [`IdentifyError::Stopped`] if the stop flag is set.
    pub fn begin(&self, length: Option<usize>, guess: &[f64]) -> Result<Point, IdentifyError> {
        let values: Vec<f64> = self.unknowns.iter().map(|unknown| unknown.start).collect();
        let mut windows = Vec::new();
        for (index, segment) in self.segments.iter().enumerate() {
            let last = segment.x.len().saturating_sub(1);
            let p = self.parameters(index, &values);
            let mut start = guess.to_vec();
            let length = length.unwrap_or(last).max(1);
            for first in (0..last.max(1)).step_by(length) {
                let steps = length.min(last - first);
                start
                    .iter_mut()
                    .zip(&segment.x[first])
                    .filter(|(_, y)| y.is_finite())
                    .for_each(|(x, y)| *x = *y);
                let window = Window {
                    segment: index,
                    first,
                    steps,
                    start,
                    is_free: self.free_starts || first > 0,
                };
                self.check_stop()?;
                let states = self.run(&window, &p).simulate(self.model);
                let mut diverged = (states.len() <= steps).then_some(first + states.len());
                if diverged.is_none() {
                    self.residuals(&window, &states, |step, _, residual| {
                        if !(residual * residual).is_finite() {
                            diverged.get_or_insert(first + step);
                        }
                    });
                }
                if let Some(step) = diverged {
                    return Err(IdentifyError::Diverged { segment: index, step });
                }
                start = states[steps].clone();
                windows.push(window);
            }
        }
        Ok(Point { values, windows })
    }

    fn parameters(&self, segment: usize, values: &[f64]) -> Vec<f64> {
        let mut p = self.segments[segment].p.clone();
        for (unknown, value) in self.unknowns.iter().zip(values) {
            p[unknown.index] = *value;
        }
        p
    }

    fn run<'b>(&'b self, window: &'b Window, p: &'b [f64]) -> Run<'b> {
        let Segment { u, first_step, .. } = &self.segments[window.segment];
        Run {
            x: &window.start,
            p,
            u: &u[window.first.min(u.len())..],
            t: first_step + window.first,
            steps: window.steps,
        }
    }

    /// Calls `add(step, component, residual)` for the finite measurements of a window, without a
    /// first sample that is exact. `step` counts from the start of the window.
    fn residuals(
        &self,
        window: &Window,
        states: &[Vec<f64>],
        mut add: impl FnMut(usize, usize, f64),
    ) {
        let measured = &self.segments[window.segment].x[window.first..];
        // The next window starts at the end of this one and includes the measurement there.
        let is_last = window.first + window.steps + 1 == self.segments[window.segment].x.len();
        let steps =
            usize::from(!window.is_free)..window.steps + usize::from(is_last || window.steps == 0);
        for step in steps {
            for (i, (x, y)) in states[step]
                .iter()
                .zip(&measured[step])
                .enumerate()
                .filter(|(_, (_, y))| y.is_finite())
            {
                add(step, i, (*x - *y) * self.per_noise[i]);
            }
        }
    }

    /// Returns an error if the flag of the options is set.
    fn check_stop(&self) -> Result<(), IdentifyError> {
        let stopped = self.stop.is_some_and(|stop| stop.load(Ordering::Relaxed));
        if stopped { Err(IdentifyError::Stopped) } else { Ok(()) }
    }

    /// Results of `work` for the indices of all windows, in order.
    ///
    /// # Errors
    /// [`IdentifyError::Stopped`] if the stop flag is set.
    fn map<R: Send>(
        &self,
        point: &Point,
        work: impl Fn(usize) -> R + Sync + Send,
    ) -> Result<Vec<R>, IdentifyError> {
        map(point.windows.len(), |k| self.check_stop().map(|()| work(k))).into_iter().collect()
    }

    /// Misfit of all windows. `None` if a state or a sum of squares is non-finite.
    pub fn misfit(&self, point: &Point) -> Result<Option<Misfit>, IdentifyError> {
        let of_window = |k: usize| {
            let window = &point.windows[k];
            let states = self
                .run(window, &self.parameters(window.segment, &point.values))
                .simulate(self.model);
            let end = states.get(window.steps)?;
            let mut misfit = Misfit::default();
            self.residuals(window, &states, |_, _, residual| misfit.samples += residual * residual);
            for (i, (end, start)) in end.iter().zip(point.after(k).unwrap_or(end)).enumerate() {
                let jump = ((*end - *start) * self.per_noise[i]).abs();
                misfit.jumps += jump * jump;
                misfit.largest_jump = misfit.largest_jump.max(jump);
            }
            Some(misfit)
        };
        let Some(misfits) =
            self.map(point, of_window)?.into_iter().collect::<Option<Vec<Misfit>>>()
        else {
            return Ok(None);
        };
        let [samples, jumps] = [|m: &Misfit| m.samples, |m: &Misfit| m.jumps]
            .map(|part| misfits.iter().map(part).sum::<f64>());
        let largest_jump =
            misfits.iter().fold(0.0, |largest, misfit| misfit.largest_jump.max(largest));
        Ok((samples + jumps).is_finite().then_some(Misfit { samples, jumps, largest_jump }))
    }

    /// States of all segments. The first state of a window replaces the last state of the previous
    /// window.
    pub fn states(&self, point: &Point) -> Result<Vec<Vec<Vec<f64>>>, IdentifyError> {
        let mut states: Vec<Vec<Vec<f64>>> = vec![Vec::new(); self.segments.len()];
        for window in &point.windows {
            self.check_stop()?;
            let run = self
                .run(window, &self.parameters(window.segment, &point.values))
                .simulate(self.model);
            states[window.segment].truncate(window.first);
            states[window.segment].extend(run);
        }
        Ok(states)
    }

    /// Returns whether a finite change of the unknown `i` changes a simulated state. The changes are
    /// fractions of the value, or 1 if it is 0, within the bounds, and those to finite bounds.
    pub fn is_changed_by(&self, i: usize, point: &Point) -> Result<bool, IdentifyError> {
        let (value, Unknown { min, max, .. }) = (point.values[i], &self.unknowns[i]);
        let size = if value == 0.0 { 1.0 } else { value.abs() };
        let near = CHANGES.iter().flat_map(|change| [value - change * size, value + change * size]);
        let states = self.states(point)?;
        for value in near
            .map(|near| near.clamp(*min, *max))
            .chain([*min, *max].into_iter().filter(|bound| bound.is_finite()))
        {
            let mut changed = point.clone();
            changed.values[i] = value;
            if self.states(&changed)? != states {
                return Ok(true);
            }
        }
        Ok(false)
    }

    /// Linearizes all windows, by segment.
    pub fn linearize(&self, point: &Point) -> Result<Vec<Vec<Linearized>>, IdentifyError> {
        let indices: Vec<usize> = self.unknowns.iter().map(|unknown| unknown.index).collect();
        let of_window = |k: usize| {
            let window = &point.windows[k];
            let p = self.parameters(window.segment, &point.values);
            let run = self.run(window, &p);
            let (states, slopes) =
                (run.simulate(self.model), run.derivatives(self.model, window.is_free, &indices));
            let columns = slopes[0].ncols() + 1;
            // A QR factorization spreads a NaN to all columns.
            let column = |j: usize| {
                slopes
                    .iter()
                    .flat_map(move |slopes| (0..slopes.nrows()).map(move |i| slopes[(i, j)]))
            };
            let largest = (0..columns - 1).map(|j| largest(column(j))).collect();
            let mut rows = Vec::new();
            self.residuals(window, &states, |step, i, residual| {
                rows.extend(slopes[step].row(i).iter().map(|slope| slope * self.per_noise[i]));
                rows.push(residual);
            });
            let samples = triangle(DMatrix::from_row_slice(rows.len() / columns, columns, &rows));
            let (end, slopes) = (&states[window.steps], &slopes[window.steps]);
            let jump = point.after(k).map_or(DMatrix::zeros(0, columns), |start| {
                DMatrix::from_fn(end.len(), columns, |i, j| {
                    if j + 1 < columns { slopes[(i, j)] } else { end[i] - start[i] }
                })
            });
            Linearized { samples, jump, slopes: largest }
        };
        let mut segments: Vec<Vec<Linearized>> = self.segments.iter().map(|_| Vec::new()).collect();
        for (window, linearized) in point.windows.iter().zip(self.map(point, of_window)?) {
            segments[window.segment].push(linearized);
        }
        Ok(segments)
    }
}

impl Point {
    /// Initial state of the window after window `k`, if it belongs to the same segment.
    fn after(&self, k: usize) -> Option<&Vec<f64>> {
        self.windows
            .get(k + 1)
            .filter(|next| next.segment == self.windows[k].segment)
            .map(|next| &next.start)
    }
}

/// Refuses standard deviations of the noise and angles that do not fit `n` state components.
fn check_options(options: &Options, n: usize) -> Result<(), IdentifyError> {
    if let Some(noise) = options.noise.as_ref().filter(|noise| noise.len() != n) {
        return Err(IdentifyError::NoiseCount { found: noise.len(), expected: n });
    }
    let noise = options.noise.iter().flatten().copied().enumerate();
    if let Some((component, noise)) = { noise }.find(|(_, noise)| !NOISE.contains(noise)) {
        return Err(IdentifyError::Noise { component, noise });
    }
    if let Some(&component) = options.angles.iter().find(|&&component| component >= n) {
        return Err(IdentifyError::Angle { component, states: n });
    }
    Ok(())
}

/// Refuses a segment whose sizes differ from `[n, m, params]` of the model, or whose numbers are
/// not finite. A measurement may be missing, but in the first row only if `free_starts`.
fn check_segment(
    segment: usize,
    Segment { x, u, p, .. }: &Segment,
    [n, m, params]: [usize; 3],
    free_starts: bool,
) -> Result<(), IdentifyError> {
    let shape = |what, found, expected| IdentifyError::Shape { segment, what, found, expected };
    if let Some(row) = x.iter().find(|row| row.len() != n) {
        return Err(shape("a measured state", row.len(), n));
    }
    if let Some(row) = u.iter().find(|row| row.len() != m) {
        return Err(shape("a control", row.len(), m));
    }
    if p.len() != params {
        return Err(shape("the list of parameters", p.len(), params));
    }
    if !u.is_empty() && u.len() + 1 < x.len() {
        return Err(shape("the list of controls", u.len(), x.len() - 1));
    }
    for (what, mut numbers) in [("control", u.concat()), ("parameter", p.clone())] {
        if numbers.drain(..).any(|number| !number.is_finite()) {
            return Err(IdentifyError::NonFinite { segment, what });
        }
    }
    if x.iter().flatten().any(|y| y.is_infinite()) {
        return Err(IdentifyError::NonFinite { segment, what: "measured state" });
    }
    let first = x.first().ok_or(IdentifyError::Empty { segment })?;
    if let (false, Some(component)) = (free_starts, first.iter().position(|y| !y.is_finite())) {
        return Err(IdentifyError::MissingStart { segment, component });
    }
    Ok(())
}

/// Refuses unknowns whose start is outside of their bounds, or whose index is not below `params` or
/// occurs twice.
fn check_unknowns(unknowns: &[Unknown], params: usize) -> Result<(), IdentifyError> {
    for (i, Unknown { name, index, start, min, max }) in unknowns.iter().enumerate() {
        let is_inside = start.is_finite() && min <= start && start <= max && *index < params;
        if !is_inside {
            let (name, start, min, max, index) = (name.clone(), *start, *min, *max, *index);
            return Err(IdentifyError::Unknown { name, start, min, max, index, params });
        }
        if let Some(before) = unknowns[..i].iter().find(|before| before.index == *index) {
            return Err(IdentifyError::Twice {
                names: [before.name.clone(), name.clone()],
                index: *index,
            });
        }
    }
    Ok(())
}

/// Largest absolute number. NaN if a number is non-finite.
pub(super) fn largest(numbers: impl Iterator<Item = f64>) -> f64 {
    numbers.fold(0.0, |largest, x| {
        if largest.is_nan() || !x.is_finite() { f64::NAN } else { x.abs().max(largest) }
    })
}

/// Returns the results of `work` for `0..count`, in order. Threads share the work if the feature
/// `parallel` is enabled.
pub(super) fn map<R: Send>(count: usize, work: impl Fn(usize) -> R + Sync + Send) -> Vec<R> {
    #[cfg(feature = "parallel")]
    {
        use rayon::prelude::*;
        let mut results = Vec::new();
        if threads::run(&mut || results = (0..count).into_par_iter().map(&work).collect()) {
            return results;
        }
    }
    (0..count).map(work).collect()
}
