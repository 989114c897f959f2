//! [`identify`]: measured segments, options, and the search for the best fit.

use super::angles::continuous;
use super::descent::{Counts, Equations, Stop, minimize};
use super::error::IdentifyError;
use super::problem::Problem;
use super::result::{Fit, SMALLEST, result};
use crate::dynamics::system::System;
use std::sync::Arc;
use std::sync::atomic::AtomicBool;

/// A measured trajectory, one row per step of the system.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Segment {
    /// Measured states, `[step][component]`. NaN marks a missing number.
    /// [`identify`] refuses infinite numbers.
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
    /// whole segments. If windows do not explain the data, [`identify`] also tries whole segments.
    pub window: Option<usize>,
    /// Largest number of iterations per weight of continuity.
    pub max_iterations: usize,
    /// Largest relative decrease of the objective that counts as converged. The objective is χ²
    /// plus the weighted squared jumps between windows. Two consecutive such decreases end the
    /// iterations. All weights of continuity but the last use 1e-2 instead.
    pub tolerance: f64,
    /// State components that are angles in rad with measurements known up to full turns, as those
    /// of an encoder that wraps. The fit removes the full turns between consecutive measurements,
    /// which must differ by less than half a turn without them. A step must commute with full turns
    /// of these components. Default: none, measured angles are continuous.
    pub angles: Vec<usize>,
    /// Initial states from which the fit also begins if the residuals of the fit before are not noise.
    /// Only components without a measurement in the first row of a segment use them; at first, these
    /// components are 0. The result is the better fit. Default: none.
    pub guesses: Vec<Vec<f64>>,
    /// χ² of another model or reading of the same data. Ends the identification with
    /// [`IdentifyError::Worse`] if its own χ² will be higher, judged by the last iterations. Default:
    /// infinite.
    pub give_up: f64,
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
            guesses: Vec::new(),
            give_up: f64::INFINITY,
            stop: None,
        }
    }
}

/// Standard deviations above which another fit is worth its time.
const SUSPICIOUS: f64 = 2.0;

/// Weights of the continuity between windows, in turn, relative to the weights of the samples.
///
/// The first one lets windows fit their own samples, so a wrong parameter cannot accumulate a phase
/// error over a long segment. The last one reduces jumps to rounding.
const CONTINUITY: [f64; 5] = [1.0, 10.0, 100.0, 1e4, 1e6];

/// Tolerance of the relative decrease for all weights of continuity but the last.
const COARSE: f64 = 1e-2;

/// Ratio of χ² to the least sum of squares with the first weight of continuity, above which windows
/// may have led to a wrong minimum, if the noise is unknown. Both sums have the same degrees of
/// freedom, but the second one lets windows follow the noise.
const MISFIT: f64 = 2.0;

/// Relative decrease of χ² that another fit needs to be better.
const BETTER: f64 = 1e-3;

/// Identifies parameters of a system from measured trajectories.
///
/// Segments consist of windows, each with its own initial state. Iterations with growing weights of
/// continuity join the windows. Windows that are long compared with fast unmeasured states can
/// lead to a wrong minimum. If the result has not converged or does not explain the data, a second
/// fit uses whole segments, and the better fit is the result. So can initial values of unmeasured
/// states: see [`Options::guesses`].
///
/// # Errors
/// See [`IdentifyError`].
#[inline(never)]
pub fn identify<S: System>(
    system: &S,
    segments: &[Segment],
    unknowns: &[Unknown],
    options: &Options,
) -> Result<Fit, IdentifyError> {
    let continuous = (!options.angles.is_empty()).then(|| continuous(segments, &options.angles));
    let segments = continuous.as_deref().unwrap_or(segments);
    let problem = Problem::new(system, segments, unknowns, options)?;
    let mut counts = Counts::default();
    check_count(&problem, options, &mut counts)?;
    let states = system.state_dim();
    let mut best = from_guess(&problem, options, &vec![0.0; states], &mut counts);
    let is_missing = segments.iter().any(|segment| segment.x[0].iter().any(|y| y.is_nan()));
    for guess in options.guesses.iter().filter(|guess| is_missing && guess.len() == states) {
        match &best {
            Ok(best) if !best.is_suspicious(&problem) => break,
            Ok(_) | Err(IdentifyError::Diverged { .. } | IdentifyError::Worse) => {}
            Err(_) => break,
        }
        match (from_guess(&problem, options, guess, &mut counts), &best) {
            (Ok(next), Ok(before)) if !next.is_better(before) => {}
            (Err(IdentifyError::Diverged { .. } | IdentifyError::Worse), _) => {}
            (next, _) => best = next,
        }
    }
    let best = best?;
    let Counts { iterations, simulations, jacobians } = counts;
    Ok(Fit { iterations, simulations, jacobians, ..best.fit })
}

/// Fits with the windows of the options, and again with whole segments if windows may have led to a
/// wrong minimum. Components without a measurement begin at `guess`.
fn from_guess(
    problem: &Problem<'_>,
    options: &Options,
    guess: &[f64],
    counts: &mut Counts,
) -> Result<Attempt, IdentifyError> {
    let whole = Options { window: None, ..options.clone() };
    let mut best = match attempt(problem, options, guess, counts) {
        // Windows may have led to a wrong minimum.
        Err(IdentifyError::Worse) if options.window.is_some() => {
            attempt(problem, &whole, guess, counts)?
        }
        other => other?,
    };
    if best.is_doubtful {
        match attempt(problem, &whole, guess, counts) {
            Ok(whole) if whole.is_better(&best) => best = whole,
            // Whole segments can diverge where windows do not.
            Ok(_) | Err(IdentifyError::Diverged { .. } | IdentifyError::Worse) => {}
            Err(error) => return Err(error),
        }
    }
    Ok(best)
}

/// Refuses data with fewer measurements than unknowns that affect them.
fn check_count(
    problem: &Problem<'_>,
    options: &Options,
    counts: &mut Counts,
) -> Result<(), IdentifyError> {
    let (measurements, mut unknowns) = (problem.measurements(), problem.free());
    if (1..unknowns).contains(&measurements) {
        let point = problem.begin(options.window, &vec![0.0; problem.per_noise.len()])?;
        unknowns = Equations::new(problem, &point, 1.0, counts)?.seen(problem.unknowns);
    }
    if measurements < unknowns {
        return Err(IdentifyError::TooFewMeasurements { measurements, unknowns });
    }
    Ok(())
}

struct Attempt {
    fit: Fit,
    /// χ² plus the weighted squared jumps.
    objective: f64,
    /// Whether the windows may have led to a wrong minimum.
    is_doubtful: bool,
}

impl Attempt {
    /// Whether the residuals are not noise, or exceed a known one by more than chance, or the fit has
    /// not converged.
    fn is_suspicious(&self, problem: &Problem<'_>) -> bool {
        let is_excess = problem.noise_is_known && self.fit.exceeds(SUSPICIOUS);
        let correlated = self.fit.correlated_beyond(problem.segments, 0.0, SUSPICIOUS);
        is_excess || !self.fit.converged || !correlated.is_empty()
    }

    fn is_better(&self, other: &Self) -> bool {
        let converges = self.fit.converged && !other.fit.converged;
        self.objective < other.objective * if converges { 1.0 + BETTER } else { 1.0 - BETTER }
    }
}

/// Fits with the windows of the options.
fn attempt(
    problem: &Problem<'_>,
    options: &Options,
    guess: &[f64],
    counts: &mut Counts,
) -> Result<Attempt, IdentifyError> {
    let mut point = problem.begin(options.window, guess)?;
    // Without windows to join, the weights have no influence.
    let stages = if point.windows.len() == problem.segments.len() { 1 } else { CONTINUITY.len() };
    let (mut objective, mut first, mut all_converged) = (f64::INFINITY, None, true);
    let mut converged = false;
    for (i, &continuity) in CONTINUITY[..stages].iter().enumerate() {
        let tolerance = if i + 1 == stages { options.tolerance } else { COARSE };
        let stop =
            Stop { tolerance, max_iterations: options.max_iterations, give_up: options.give_up };
        (converged, objective) = minimize(problem, &mut point, continuity, stop, counts)?;
        first.get_or_insert(objective);
        all_converged &= converged;
    }
    let window = options.window.map(|steps| steps.max(1));
    let fit = result(problem, point, window, CONTINUITY[stages - 1], converged, counts)?;
    let is_misfit = if problem.noise_is_known {
        fit.exceeds_chance()
    } else {
        first.is_some_and(|first| fit.chi_squared > MISFIT * first)
    };
    let is_exact =
        fit.chi_squared <= problem.size().powi(2) * SMALLEST * SMALLEST * fit.measurements as f64;
    let is_doubtful = stages > 1 && !is_exact && (is_misfit || !all_converged || !fit.converged);
    Ok(Attempt { fit, objective, is_doubtful })
}
