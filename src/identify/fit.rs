//! [`identify`]: measured segments, options and the fit.

use super::descent::{Counts, Stop, equations, minimize};
use super::error::IdentifyError;
use super::problem::{Point, Problem};
use super::statistics::{Statistics, statistics, undetermined_components};
use crate::dynamics::system::System;
use std::collections::BTreeSet;
use std::f64::consts::TAU;
use std::sync::Arc;
use std::sync::atomic::AtomicBool;

/// A measured trajectory, one row per step of the system.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Segment {
    /// Measured states, `[step][component]`. NaN marks a missing number. Infinite numbers also
    /// count as missing.
    pub x: Vec<Vec<f64>>,
    /// Controls, `[step][component]`, one row per step from each measured state to the next.
    /// Without any row, all controls are 0.
    pub u: Vec<Vec<f64>>,
    /// Parameters. The identification replaces the unknown entries.
    pub p: Vec<f64>,
    /// Number of the step of the first row, [`Inputs::t`](crate::Inputs::t). Systems that depend on
    /// time need it if a recording begins late.
    pub first_step: usize,
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
#[derive(Clone, Debug)]
pub struct Options {
    /// Standard deviation of the noise of each state component. `None`: equal for all, and
    /// estimated from the residuals.
    pub noise: Option<Vec<f64>>,
    /// Whether the initial state of each segment is unknown. Otherwise it is the first sample.
    pub free_starts: bool,
    /// Length of the windows of multiple shooting, in steps, at least 1. `None`: single shooting of
    /// whole segments.
    pub window: Option<usize>,
    /// Largest number of iterations per weight of continuity.
    pub max_iterations: usize,
    /// Largest relative decrease of the objective that counts as converged. The objective is χ²
    /// plus the weighted squared jumps between windows. Two consecutive such decreases end the
    /// iterations. All weights of continuity but the last use 1e-2 instead.
    pub tolerance: f64,
    /// State components that are angles in rad with measurements known up to full turns, as those
    /// of an encoder that wraps. Differences of these components are modulo 2π. A step must commute
    /// with full turns of them. Default: none, measured angles are continuous.
    pub angles: Vec<usize>,
    /// Flag that another thread sets to stop the identification with [`IdentifyError::Stopped`].
    /// Read before every simulation of a window.
    pub stop: Option<Arc<AtomicBool>>,
}

impl Default for Options {
    fn default() -> Self {
        Self {
            noise: None,
            free_starts: true,
            window: Some(10),
            max_iterations: 300,
            tolerance: 1e-10,
            angles: Vec::new(),
            stop: None,
        }
    }
}

/// Result of [`identify`].
#[derive(Clone, Debug, PartialEq)]
pub struct Fit {
    /// Names of the unknown parameters.
    pub names: Vec<String>,
    /// Identified values.
    pub values: Vec<f64>,
    /// Standard errors. Infinite for parameters in an undetermined combination, and if the noise is
    /// unknown and there are as many unknowns as measurements.
    pub errors: Vec<f64>,
    /// Standard errors that allow for correlated residuals within a segment, from the scatter
    /// between segments (jackknife CR3; Cameron and Miller 2015, doi:10.3368/jhr.50.2.317). An
    /// interval needs the quantile of Student's t with one degree of freedom less than segments.
    /// Infinite wherever `errors` are, and for parameters that only one segment determines.
    /// Infinite for all parameters, unless the segments that depend on a parameter outnumber the
    /// unknown parameters.
    pub robust_errors: Vec<f64>,
    /// Correlations of the values, from the determined combinations of parameters only. NaN for a
    /// parameter that is in no determined combination.
    pub correlations: Vec<Vec<f64>>,
    /// Names of the parameters in each combination that the data do not determine.
    pub undetermined: Vec<Vec<String>>,
    /// State components whose initial values the data do not determine in at least one segment,
    /// even for known parameters. The standard error of such a value exceeds all simulated values
    /// of the component in the second half of the segment.
    pub undetermined_starts: Vec<usize>,
    /// Parameters at one of their bounds.
    pub at_bound: Vec<String>,
    /// Simulated states of each segment. Angles are continuous.
    pub states: Vec<Vec<Vec<f64>>>,
    /// State components with differences modulo 2π, see [`Options::angles`].
    pub angles: Vec<usize>,
    /// Largest jump of the simulated states between windows, in units of the noise. If the noise is
    /// unknown, the unit is the root mean square of the residuals. This substitute is at least 1e-9
    /// times the root mean square of the measurements. If the jump is 0, the states of a segment
    /// are one simulation from its initial state.
    pub jump: f64,
    /// χ² of `states` over all segments, with σ = 1 if the noise is unknown.
    pub chi_squared: f64,
    /// Number of finite measurements, without first samples that are exact.
    pub measurements: usize,
    /// Number of unknown parameters and components of initial states.
    pub unknowns: usize,
    /// Whether the iterations with the last weight of continuity ended by the tolerance, or at a
    /// minimum up to rounding with finite derivatives.
    pub converged: bool,
    /// Number of iterations.
    pub iterations: usize,
    /// Number of evaluations of the objective. Each simulates all segments without derivatives.
    pub simulations: usize,
    /// Number of simulations of all segments with derivatives.
    pub jacobians: usize,
}

impl Fit {
    /// Bayesian information criterion up to a constant (Schwarz 1978, doi:10.1214/aos/1176344136),
    /// for noise of unknown size: `N ln(χ²/N) + k ln N`, for N measurements and k unknowns.
    pub fn bic(&self) -> f64 {
        let (count, unknowns) = (self.measurements as f64, self.unknowns as f64);
        count * (self.chi_squared / count).ln() + unknowns * count.ln()
    }

    /// Root mean square of the residuals of a component in a segment, over its finite measurements,
    /// the first sample included. NaN without a finite measurement.
    pub fn rms(&self, segment: usize, component: usize, measured: &Segment) -> f64 {
        let rows = self.states[segment].iter().zip(&measured.x).map(|(x, y)| (x[component], y[component]));
        let residuals = rows.map(|(x, y)| x - self.near(component, y, x)).filter(|residual| residual.is_finite());
        let (sum, count) = residuals.fold((0.0, 0), |(sum, count), r| (sum + r * r, count + 1));
        (sum / f64::from(count)).sqrt()
    }

    /// The measured value `y` of a component next to the simulated value `x`. An angle of
    /// [`angles`](Fit::angles) is moved by full turns to within half a turn of `x`.
    pub fn near(&self, component: usize, y: f64, x: f64) -> f64 {
        if self.angles.contains(&component) { y + full_turns(x - y) } else { y }
    }
}

/// The full turns that are nearest to an angle, in rad. 0 up to half a turn.
pub(super) fn full_turns(angle: f64) -> f64 {
    (angle / TAU).round() * TAU
}

/// Weights of the continuity between windows, in turn, relative to the weights of the samples.
///
/// The first one lets windows fit their own samples, so a wrong parameter cannot accumulate a phase
/// error over a long segment. The last one reduces jumps to rounding.
const CONTINUITY: [f64; 5] = [1.0, 10.0, 100.0, 1e4, 1e6];

/// Tolerance of the relative decrease for all weights of continuity but the last.
const COARSE: f64 = 1e-2;

/// Lower bound on the unit of [`Fit::jump`] if the noise is unknown, relative to the root mean
/// square of the measurements.
const SMALLEST: f64 = 1e-9;

/// Identifies parameters of a system from measured trajectories.
///
/// Segments consist of windows, each with its own initial state. Iterations with growing weights of
/// continuity join the windows.
///
/// # Errors
/// See [`IdentifyError`].
pub fn identify<S: System>(
    system: &S,
    segments: &[Segment],
    unknowns: &[Unknown],
    options: &Options,
) -> Result<Fit, IdentifyError> {
    let problem = Problem::new(system, segments, unknowns, options)?;
    let mut point = problem.begin(options.window)?;
    let mut counts = Counts::default();
    // Without windows to join, the weights have no influence.
    let stages = if point.windows.len() == segments.len() { 1 } else { CONTINUITY.len() };
    let mut converged = false;
    for (i, &continuity) in CONTINUITY[..stages].iter().enumerate() {
        let tolerance = if i + 1 == stages { options.tolerance } else { COARSE };
        let stop = Stop { tolerance, max_iterations: options.max_iterations };
        converged = minimize(&problem, &mut point, continuity, stop, &mut counts)?;
    }
    result(&problem, point, CONTINUITY[stages - 1], converged, counts)
}

fn result(
    problem: &Problem<'_>,
    point: Point,
    continuity: f64,
    converged: bool,
    mut counts: Counts,
) -> Result<Fit, IdentifyError> {
    let names: Vec<String> = problem.unknowns.iter().map(|unknown| unknown.name.clone()).collect();
    let [equations, starts] = equations(problem, &point, continuity, &mut counts)?;
    let Statistics { errors, robust_errors, correlations, undetermined } = statistics(&equations, &names);
    let (measurements, unknowns) = (problem.measurements(), problem.count());
    let misfit = problem.misfit(&point)?;
    let chi_squared = misfit.map_or(f64::INFINITY, |misfit| misfit.samples);
    let jump = misfit.map_or(f64::INFINITY, |misfit| {
        let residual = || (misfit.samples / measurements as f64).sqrt().max(SMALLEST * problem.size());
        let unit = if problem.noise_is_known || misfit.largest_jump == 0.0 { 1.0 } else { residual() };
        misfit.largest_jump / unit
    });
    let noise = match measurements - unknowns {
        _ if problem.noise_is_known => 1.0,
        // The residuals are 0 and do not show the size of the noise.
        0 => f64::INFINITY,
        freedom => (chi_squared / freedom as f64).sqrt(),
    };
    let states = problem.states(&point)?;
    let open = starts.into_iter().zip(&states).flat_map(|(rows, states)| undetermined_components(rows, noise, states));
    let is_bound =
        |(unknown, value): (&Unknown, &f64)| (*value <= unknown.min || *value >= unknown.max).then(|| unknown.name.clone());
    Ok(Fit {
        errors: errors.into_iter().map(|error| if error.is_finite() { error * noise } else { error }).collect(),
        robust_errors: robust_errors.into_iter().map(|error| if noise.is_finite() { error } else { noise }).collect(),
        correlations,
        undetermined,
        undetermined_starts: open.collect::<BTreeSet<usize>>().into_iter().collect(),
        at_bound: problem.unknowns.iter().zip(&point.values).filter_map(is_bound).collect(),
        states,
        angles: problem.angles.to_vec(),
        jump,
        chi_squared,
        measurements,
        unknowns,
        converged,
        iterations: counts.iterations,
        simulations: counts.simulations,
        jacobians: counts.jacobians,
        names,
        values: point.values,
    })
}
