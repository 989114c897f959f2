//! [`identify`]: the loop of Levenberg and Marquardt over windows of growing length.

use super::error::IdentifyError;
use super::jacobian::{Model, Run};
use super::normal::{Block, information, solve};
use super::statistics::{Statistics, statistics};
use crate::dynamics::system::System;

/// A measured trajectory, one row per step of the system.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Segment {
    /// Measured states, `[step][component]`. NaN marks a missing number.
    pub x: Vec<Vec<f64>>,
    /// Controls, `[step][component]`. Missing rows are 0.
    pub u: Vec<Vec<f64>>,
    /// Parameters. Unknown entries are replaced.
    pub p: Vec<f64>,
}

/// An unknown entry of the parameters.
#[derive(Clone, Debug, PartialEq)]
pub struct Unknown {
    /// Name in results.
    pub name: String,
    /// Index in `p`.
    pub index: usize,
    /// Initial value, within the bounds.
    pub start: f64,
    /// Lower bound, or -∞.
    pub min: f64,
    /// Upper bound, or +∞.
    pub max: f64,
}

/// Options of [`identify`].
#[derive(Clone, Debug, PartialEq)]
pub struct Options {
    /// Standard deviation of the noise of each state component. `None`: equal for all, and
    /// estimated from the residuals.
    pub noise: Option<Vec<f64>>,
    /// Whether the initial state of each segment is unknown. Otherwise it is the first sample.
    pub free_starts: bool,
    /// Lengths of the windows before whole segments are used, in steps, in increasing order.
    pub windows: Vec<usize>,
    /// Largest number of iterations per window length.
    pub max_iterations: usize,
    /// Relative decrease of χ² that ends the iterations.
    pub tolerance: f64,
}

impl Default for Options {
    fn default() -> Self {
        Self { noise: None, free_starts: true, windows: vec![20, 60, 180, 540], max_iterations: 60, tolerance: 1e-10 }
    }
}

/// Result of [`identify`].
#[derive(Clone, Debug, PartialEq)]
pub struct Fit {
    /// Names of the unknowns.
    pub names: Vec<String>,
    /// Identified values.
    pub values: Vec<f64>,
    /// Standard errors; infinite for parameters in an undetermined combination.
    pub errors: Vec<f64>,
    /// Correlations of the values.
    pub correlations: Vec<Vec<f64>>,
    /// Combinations of parameters that the data do not determine, by name.
    pub undetermined: Vec<Vec<String>>,
    /// Parameters at one of their bounds.
    pub at_bound: Vec<String>,
    /// Simulated states of each segment, from its initial state; shorter than the segment if it
    /// diverges.
    pub states: Vec<Vec<Vec<f64>>>,
    /// χ² of whole segments.
    pub chi_squared: f64,
    /// Number of measurements.
    pub measurements: usize,
    /// Number of unknowns, with the initial states.
    pub unknowns: usize,
    /// Whether the last iterations ended by the tolerance.
    pub converged: bool,
    /// Number of iterations.
    pub iterations: usize,
    /// Number of simulations of all segments, without derivatives.
    pub simulations: usize,
    /// Number of simulations of all segments with derivatives.
    pub jacobians: usize,
}

impl Fit {
    /// Bayesian information criterion up to a constant (Schwarz 1978, doi:10.1214/aos/1176344136),
    /// for noise of unknown size: `N ln(χ²/N) + k ln N`.
    pub fn bic(&self) -> f64 {
        let (count, unknowns) = (self.measurements as f64, self.unknowns as f64);
        count * (self.chi_squared / count).ln() + unknowns * count.ln()
    }

    /// Root mean square of the residuals of a component in a segment, over finite measurements.
    /// Infinite if the simulation diverges.
    pub fn rms(&self, segment: usize, component: usize, measured: &Segment) -> f64 {
        let states = &self.states[segment];
        if states.len() < measured.x.len() {
            return f64::INFINITY;
        }
        let residuals = states.iter().zip(&measured.x).map(|(x, y)| x[component] - y[component]).filter(|r| r.is_finite());
        let (sum, count) = residuals.fold((0.0, 0), |(sum, count), r| (sum + r * r, count + 1));
        (sum / f64::from(count)).sqrt()
    }
}

/// Identifies parameters of a system from measured trajectories.
///
/// Each window length starts from the values of the last one, with the measured states as initial
/// states; missing components start from the simulation. Windows of one length have no continuity
/// conditions, so a wrong parameter cannot accumulate a phase error over a long segment. The last
/// stage simulates whole segments.
///
/// # Errors
/// See [`IdentifyError`].
pub fn identify<S: System>(
    system: &S,
    segments: &[Segment],
    unknowns: &[Unknown],
    options: &Options,
) -> Result<Fit, IdentifyError> {
    let mut problem = Problem::new(system, segments, unknowns, options)?;
    let longest = segments.iter().map(|segment| segment.x.len()).max().unwrap_or(0);
    for &length in options.windows.iter().filter(|&&length| length > 0 && length < longest) {
        problem.split(Some(length));
        problem.minimize(options);
    }
    problem.split(None);
    problem.check_start()?;
    let converged = problem.minimize(options);
    Ok(problem.result(converged))
}

/// Consecutive steps of a segment with an initial state.
struct Window {
    segment: usize,
    first: usize,
    steps: usize,
    start: Vec<f64>,
    /// Whether the initial state is unknown.
    is_free: bool,
}

struct Problem<'a> {
    model: &'a dyn Model,
    segments: &'a [Segment],
    unknowns: &'a [Unknown],
    values: Vec<f64>,
    per_noise: Vec<f64>,
    noise_is_known: bool,
    free_starts: bool,
    windows: Vec<Window>,
    iterations: usize,
    simulations: usize,
    jacobians: usize,
}

impl<'a> Problem<'a> {
    fn new(
        model: &'a dyn Model,
        segments: &'a [Segment],
        unknowns: &'a [Unknown],
        options: &Options,
    ) -> Result<Self, IdentifyError> {
        let [n, m, params] = model.sizes();
        if unknowns.is_empty() && !options.free_starts {
            return Err(IdentifyError::NothingUnknown);
        }
        for (segment, Segment { x, u, p }) in segments.iter().enumerate() {
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
            if let Some(noise) = options.noise.as_ref().filter(|noise| noise.len() != n) {
                return Err(shape("the list of noise levels", noise.len(), n));
            }
        }
        for Unknown { name, index, start, min, max } in unknowns {
            let is_inside = start.is_finite() && min <= start && start <= max && *index < params;
            if !is_inside {
                let (name, start, min, max, index) = (name.clone(), *start, *min, *max, *index);
                return Err(IdentifyError::Unknown { name, start, min, max, index, params });
            }
        }
        let problem = Self {
            model,
            segments,
            unknowns,
            values: unknowns.iter().map(|unknown| unknown.start).collect(),
            per_noise: options.noise.as_ref().map_or_else(|| vec![1.0; n], |noise| noise.iter().map(|s| 1.0 / s).collect()),
            noise_is_known: options.noise.is_some(),
            free_starts: options.free_starts,
            windows: Vec::new(),
            iterations: 0,
            simulations: 0,
            jacobians: 0,
        };
        let (measurements, unknowns) = (problem.measurements(), problem.count());
        if measurements < unknowns {
            return Err(IdentifyError::TooFewMeasurements { measurements, unknowns });
        }
        Ok(problem)
    }

    /// Number of finite measurements. Without free initial states, the first sample of a segment is
    /// exact.
    fn measurements(&self) -> usize {
        let skipped = usize::from(!self.free_starts);
        let rows = self.segments.iter().flat_map(|segment| segment.x.iter().skip(skipped));
        rows.flatten().filter(|value| value.is_finite()).count()
    }

    /// Number of unknowns.
    fn count(&self) -> usize {
        self.unknowns.len() + if self.free_starts { self.segments.len() * self.model.sizes()[0] } else { 0 }
    }

    /// Splits all segments into windows. `None` keeps whole segments.
    fn split(&mut self, length: Option<usize>) {
        let mut windows = Vec::new();
        for (index, segment) in self.segments.iter().enumerate() {
            let last = segment.x.len().saturating_sub(1);
            let length = length.unwrap_or(last).max(1);
            // A whole segment keeps the initial state of its first window.
            let known = self.windows.iter().find(|window| window.segment == index && window.first == 0);
            let mut before = known.map_or_else(|| vec![0.0; self.model.sizes()[0]], |window| window.start.clone());
            for first in (0..last.max(1)).step_by(length) {
                let steps = length.min(last - first);
                // Missing components continue the simulation of the window before.
                let mut start = before.clone();
                if first > 0 || known.is_none() {
                    start.iter_mut().zip(&segment.x[first]).filter(|(_, y)| y.is_finite()).for_each(|(x, y)| *x = *y);
                }
                let is_free = self.free_starts || first > 0;
                windows.push(Window { segment: index, first, steps, start, is_free });
                let states = self.run(&windows[windows.len() - 1], &self.parameters(index, &self.values)).simulate(self.model);
                before.clone_from(&states[states.len() - 1]);
            }
        }
        self.windows = windows;
    }

    fn parameters(&self, segment: usize, values: &[f64]) -> Vec<f64> {
        let mut p = self.segments[segment].p.clone();
        for (unknown, value) in self.unknowns.iter().zip(values) {
            p[unknown.index] = *value;
        }
        p
    }

    fn run<'b>(&'b self, window: &'b Window, p: &'b [f64]) -> Run<'b> {
        let u = &self.segments[window.segment].u;
        Run { x: &window.start, p, u: &u[window.first.min(u.len())..], t: window.first, steps: window.steps }
    }

    fn check_start(&self) -> Result<(), IdentifyError> {
        for window in &self.windows {
            let p = self.parameters(window.segment, &self.values);
            let states = self.run(window, &p).simulate(self.model);
            let mut diverged = (states.len() <= window.steps).then_some(states.len());
            if diverged.is_none() {
                self.residuals(window, &states, |step, _, residual| {
                    if !(residual * residual).is_finite() {
                        diverged.get_or_insert(step);
                    }
                });
            }
            if let Some(step) = diverged {
                return Err(IdentifyError::Diverged { segment: window.segment, step });
            }
        }
        Ok(())
    }

    /// Calls `add(step, component, residual)` for the measurements of a window.
    fn residuals(&self, window: &Window, states: &[Vec<f64>], mut add: impl FnMut(usize, usize, f64)) {
        let measured = &self.segments[window.segment].x[window.first..];
        // The last state of a window is the first one of the next, where it is measured.
        let is_last = window.first + window.steps + 1 == self.segments[window.segment].x.len();
        let steps = usize::from(!window.is_free)..window.steps + usize::from(is_last || window.steps == 0);
        for step in steps {
            for (i, (x, y)) in states[step].iter().zip(&measured[step]).enumerate().filter(|(_, (_, y))| y.is_finite()) {
                add(step, i, (x - y) * self.per_noise[i]);
            }
        }
    }

    /// χ² of all windows. Infinite if a window diverges.
    fn chi_squared(&mut self, windows: &[Window], values: &[f64]) -> f64 {
        self.simulations += 1;
        let of_window = |window: &Window| {
            let p = self.parameters(window.segment, values);
            let states = self.run(window, &p).simulate(self.model);
            if states.len() <= window.steps {
                return f64::INFINITY;
            }
            let mut sum = 0.0;
            self.residuals(window, &states, |_, _, residual| sum += residual * residual);
            sum
        };
        let sum: f64 = map(windows, of_window).into_iter().sum();
        if sum.is_finite() { sum } else { f64::INFINITY }
    }

    fn blocks(&mut self) -> Vec<Block> {
        self.jacobians += 1;
        let indices: Vec<usize> = self.unknowns.iter().map(|unknown| unknown.index).collect();
        let block = |window: &Window| {
            let p = self.parameters(window.segment, &self.values);
            let run = self.run(window, &p);
            let (states, slopes) = (run.simulate(self.model), run.derivatives(self.model, &indices, window.is_free));
            let mut block = Block::zeros(indices.len(), if window.is_free { window.start.len() } else { 0 });
            let mut row = vec![0.0; slopes[0][0].len()];
            self.residuals(window, &states, |step, i, residual| {
                row.iter_mut().zip(&slopes[step][i]).for_each(|(row, slope)| *row = slope * self.per_noise[i]);
                block.add(residual, &row);
            });
            block
        };
        map(&self.windows, block)
    }

    /// Iterates to a minimum. Returns whether the tolerance ended the iterations.
    fn minimize(&mut self, options: &Options) -> bool {
        let (mut damping, mut quiet) = (1e-3, 0);
        let windows = std::mem::take(&mut self.windows);
        let mut chi = self.chi_squared(&windows, &self.values.clone());
        self.windows = windows;
        for _ in 0..options.max_iterations {
            self.iterations += 1;
            let blocks = self.blocks();
            let gradient = blocks.iter().fold(vec![0.0; self.values.len()], |sum, block| {
                sum.iter().zip(block.q.iter()).map(|(sum, slope)| sum + slope).collect()
            });
            // A parameter at a bound stays there while χ² decreases beyond it.
            let free = self.unknowns.iter().zip(&self.values).zip(&gradient).map(|((unknown, value), slope)| {
                !(*value <= unknown.min && *slope > 0.0 || *value >= unknown.max && *slope < 0.0)
            });
            let free: Vec<bool> = free.collect();
            let mut decrease = None;
            while decrease.is_none() && damping < 1e12 {
                let Some(step) = solve(&blocks, &free, damping) else {
                    damping = (damping * 10.0).max(1e-12);
                    continue;
                };
                let bounded = self.unknowns.iter().zip(&self.values).zip(step.q.iter());
                let values: Vec<f64> = bounded.map(|((u, value), step)| (value + step).clamp(u.min, u.max)).collect();
                let windows: Vec<Window> = self.windows.iter().zip(&step.s).map(|(window, step)| window.moved(step)).collect();
                let next = self.chi_squared(&windows, &values);
                if next < chi {
                    decrease = Some((chi - next) / chi);
                    (self.values, self.windows, chi) = (values, windows, next);
                    damping = (damping * 0.1).max(1e-14);
                } else {
                    damping *= 10.0;
                }
            }
            quiet = match decrease {
                Some(decrease) if decrease > options.tolerance => 0,
                Some(_) => quiet + 1,
                // No step decreases χ²: a minimum up to rounding.
                None => return true,
            };
            if quiet >= 2 {
                return true;
            }
        }
        false
    }

    fn result(mut self, converged: bool) -> Fit {
        let blocks = self.blocks();
        let names: Vec<&str> = self.unknowns.iter().map(|unknown| &*unknown.name).collect();
        let Statistics { errors, correlations, undetermined } = statistics(&information(&blocks), &names);
        let windows = std::mem::take(&mut self.windows);
        let chi_squared = self.chi_squared(&windows, &self.values.clone());
        let (measurements, unknowns) = (self.measurements(), self.count());
        let noise = if self.noise_is_known { 1.0 } else { (chi_squared / (measurements - unknowns).max(1) as f64).sqrt() };
        let states =
            windows.iter().map(|window| self.run(window, &self.parameters(window.segment, &self.values)).simulate(self.model));
        let is_bound =
            |(unknown, value): (&Unknown, &f64)| (*value <= unknown.min || *value >= unknown.max).then(|| unknown.name.clone());
        Fit {
            names: names.iter().map(|name| (*name).to_owned()).collect(),
            errors: errors.into_iter().map(|error| if error.is_finite() { error * noise } else { error }).collect(),
            correlations,
            undetermined,
            at_bound: self.unknowns.iter().zip(&self.values).filter_map(is_bound).collect(),
            states: states.collect(),
            chi_squared,
            measurements,
            unknowns,
            converged,
            iterations: self.iterations,
            simulations: self.simulations,
            jacobians: self.jacobians,
            values: self.values,
        }
    }
}

/// Maps all windows, in parallel with the feature `parallel`. The order is that of the windows.
fn map<R: Send>(windows: &[Window], work: impl Fn(&Window) -> R + Sync + Send) -> Vec<R> {
    #[cfg(feature = "parallel")]
    {
        use rayon::prelude::*;
        windows.par_iter().map(work).collect()
    }
    #[cfg(not(feature = "parallel"))]
    windows.iter().map(work).collect()
}

impl Window {
    fn moved(&self, step: &nalgebra::DVector<f64>) -> Self {
        let mut start = self.start.clone();
        start.iter_mut().zip(step.iter()).for_each(|(x, step)| *x += step);
        Self { start, ..*self }
    }
}
