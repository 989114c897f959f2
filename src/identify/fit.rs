//! [`identify`]: measured segments, options and the fit.

use super::descent::{Counts, Equations, Stop, minimize};
use super::error::IdentifyError;
use super::problem::{Misfit, Point, Problem};
use super::statistics::{Statistics, statistics, undetermined_components};
use super::status::{Status, statuses};
use crate::dynamics::system::System;
use std::collections::BTreeSet;
use std::f64::consts::TAU;
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

/// Result of [`identify`].
#[derive(Clone, Debug, PartialEq)]
pub struct Fit {
    /// Names of the unknown parameters.
    pub names: Vec<String>,
    /// Identified values.
    pub values: Vec<f64>,
    /// What the fit knows about each parameter.
    pub statuses: Vec<Status>,
    /// Standard errors, for known values of the parameters at a bound. NaN for those. Infinite for
    /// all others that are not estimated, and if the noise is unknown and there are as many
    /// unknowns as measurements.
    pub errors: Vec<f64>,
    /// Standard errors that allow for correlated residuals within a segment, from the scatter
    /// between segments (jackknife CR3; Cameron and Miller 2015, doi:10.3368/jhr.50.2.317). An
    /// interval needs the quantile of Student's t with one degree of freedom less than segments.
    /// NaN and infinite wherever `errors` are, and infinite for parameters that only one segment
    /// determines. Infinite for all parameters, unless the segments that depend on a parameter
    /// outnumber the unknown parameters that are not at a bound.
    pub robust_errors: Vec<f64>,
    /// Correlations of the values, from the determined combinations of parameters only. NaN for a
    /// parameter that is in no determined combination, and for one at a bound.
    pub correlations: Vec<Vec<f64>>,
    /// Names of the parameters in each combination that the data do not determine. At least one of
    /// them has the status [`Status::Undetermined`].
    pub undetermined: Vec<Vec<String>>,
    /// State components whose initial values the data do not determine in at least one segment,
    /// even for known parameters. The standard error of such a value exceeds all simulated values
    /// of the component in the second half of the segment.
    pub undetermined_starts: Vec<usize>,
    /// State components by which a derivative is not finite, as initial values of a window.
    pub non_finite_starts: Vec<usize>,
    /// Parameters with the status [`Status::AtBound`].
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
    /// Number of combinations of unknown parameters and components of initial states that the data
    /// determine, without parameters at a bound: the rank of the Jacobian of the residuals.
    pub unknowns: usize,
    /// Whether the fit is at a minimum of χ²: the iterations with the last weight of continuity
    /// ended by the tolerance, or no step decreases the objective. Moreover, all derivatives are
    /// finite, no parameter ran away or has a derivative of 0 despite its influence, and no step of
    /// Gauss and Newton exceeds a tenth of its standard error.
    pub converged: bool,
    /// Length of the windows of this result: [`Options::window`], or `None` if a fit of whole
    /// segments had a lower χ².
    pub window: Option<usize>,
    /// Number of iterations.
    pub iterations: usize,
    /// Number of evaluations of the objective. Each simulates all segments without derivatives.
    pub simulations: usize,
    /// Number of simulations of all segments with derivatives.
    pub jacobians: usize,
}

impl Fit {
    /// Bayesian information criterion up to a constant (Schwarz 1978, doi:10.1214/aos/1176344136),
    /// for noise of unknown size: `N ln(χ²/N) + k ln N`, for N measurements and k determined unknowns.
    pub fn bic(&self) -> f64 {
        let (count, unknowns) = (self.measurements as f64, self.unknowns as f64);
        count * (self.chi_squared / count).ln() + unknowns * count.ln()
    }

    /// Degrees of freedom: measurements minus determined unknowns.
    pub fn freedom(&self) -> usize {
        self.measurements.saturating_sub(self.unknowns)
    }

    /// For noise of known size, returns whether the distribution of χ² does not explain its value
    /// per degree of freedom, and the value is not between 1/2 and 2. The bounds are four standard
    /// deviations of a normal variable (Wilson and Hilferty 1931, doi:10.1073/pnas.17.12.684).
    pub fn is_unlikely(&self) -> bool {
        let [low, high] = [-CHANCE, CHANCE].map(|z| self.explained(z));
        let freedom = self.freedom() as f64;
        freedom > 0.0 && !(low.min(0.5)..=high.max(2.0)).contains(&(self.chi_squared / freedom))
    }

    /// For noise of known size, returns whether χ² is larger than its distribution explains.
    pub fn exceeds_chance(&self) -> bool {
        self.exceeds(CHANCE)
    }

    /// Whether χ² is more than `z` standard deviations above its expectation.
    fn exceeds(&self, z: f64) -> bool {
        self.chi_squared / self.freedom() as f64 > self.explained(z)
    }

    /// χ² per degree of freedom `z` standard deviations above its expectation, for noise of known
    /// size.
    fn explained(&self, z: f64) -> f64 {
        let variance = 2.0 / (9.0 * self.freedom() as f64);
        (1.0 - variance + z * variance.sqrt()).max(0.0).powi(3)
    }

    /// State components whose residuals are no independent noise: the correlation of successive
    /// residuals exceeds 0.2, by more than chance explains. Returns the correlations too. A wrong
    /// model, wrong initial values of unmeasured states, a local minimum, integration errors and
    /// filtered measurements have such residuals. Standard errors are then too small.
    ///
    /// Without correlation, the estimate from N pairs has the standard deviation 1/√N (Bartlett 1946,
    /// doi:10.2307/2983611), of which four are chance. Residuals below 1e-6 of the measurements are
    /// rounding errors, and do not count.
    pub fn correlated(&self, segments: &[Segment]) -> Vec<(usize, f64)> {
        self.correlated_beyond(segments, CORRELATED, CHANCE)
    }

    /// Components whose successive residuals have a correlation above `large`, and above `z` standard
    /// deviations of independent ones.
    fn correlated_beyond(&self, segments: &[Segment], large: f64, z: f64) -> Vec<(usize, f64)> {
        const ROUNDING: f64 = 1e-6;
        let correlation = |i: usize| {
            let (mut products, mut squares, mut pairs) = (0.0, 0.0, 0.0_f64);
            let (mut sum, mut size) = (0.0_f64, 0.0_f64);
            for (segment, states) in segments.iter().zip(&self.states) {
                let mut before = f64::NAN;
                for (x, y) in states.iter().zip(self.measured(i, segment)) {
                    let now = x[i] - y;
                    if now.is_nan() {
                        continue;
                    }
                    (sum, size) = (sum + now * now, size + y * y);
                    if !before.is_nan() {
                        products += now * before;
                        squares += 0.5 * (now * now + before * before);
                        pairs += 1.0;
                    }
                    before = now;
                }
            }
            let correlation = products / squares;
            let is_real = correlation > large
                && correlation * pairs.sqrt() > z
                && sum.sqrt() > ROUNDING * size.sqrt();
            is_real.then_some((i, correlation))
        };
        let count = segments.first().and_then(|segment| segment.x.first()).map_or(0, Vec::len);
        (0..count).filter_map(correlation).collect()
    }

    /// Root mean square of the residuals of a component in a segment, over its finite measurements,
    /// the first sample included. NaN without a finite measurement.
    pub fn rms(&self, segment: usize, component: usize, measured: &Segment) -> f64 {
        let measured = self.measured(component, measured);
        let residuals = self.states[segment].iter().zip(measured).map(|(x, y)| x[component] - y);
        let residuals = residuals.filter(|residual| residual.is_finite());
        let (sum, count) = residuals.fold((0.0, 0), |(sum, count), r| (sum + r * r, count + 1));
        (sum / f64::from(count)).sqrt()
    }

    /// Measurements of a component as in the residuals of the fit, by step. An angle of
    /// [`angles`](Fit::angles) is continuous.
    pub fn measured(&self, component: usize, segment: &Segment) -> Vec<f64> {
        let measured = segment.x.iter().map(|row| row[component]);
        if self.angles.contains(&component) { unwrapped(measured) } else { measured.collect() }
    }
}

/// The segments, with full turns added to these components, so that consecutive measurements of an
/// angle differ by at most half a turn. Residuals modulo 2π would have false minima instead.
fn continuous(segments: &[Segment], angles: &[usize]) -> Vec<Segment> {
    let mut segments = segments.to_vec();
    for segment in &mut segments {
        for &i in angles {
            let column = unwrapped(segment.x.iter().filter_map(|row| row.get(i)).copied());
            let measured = segment.x.iter_mut().filter_map(|row| row.get_mut(i));
            measured.zip(column).for_each(|(angle, continuous)| *angle = continuous);
        }
    }
    segments
}

/// Removes the full turns between consecutive finite angles.
fn unwrapped(angles: impl Iterator<Item = f64>) -> Vec<f64> {
    let mut before = None;
    let angles = angles.map(|angle| {
        if !angle.is_finite() {
            return angle;
        }
        let angle = angle + full_turns(before.map_or(0.0, |before: f64| before - angle));
        before = Some(angle);
        angle
    });
    angles.collect()
}

/// The full turns that are nearest to an angle, in rad. 0 up to half a turn.
fn full_turns(angle: f64) -> f64 {
    (angle / TAU).round() * TAU
}

/// Standard deviations that chance explains.
const CHANCE: f64 = 4.0;

/// Standard deviations above which another fit is worth its time.
const SUSPICIOUS: f64 = 2.0;

/// Correlation of successive residuals that makes standard errors too small.
const CORRELATED: f64 = 0.2;

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

/// Largest step of Gauss and Newton at a minimum, in standard errors.
const OFFSET: f64 = 0.1;

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

/// Sizes of residuals, in units of the noise.
struct Sizes {
    /// The noise. Infinite if it is unknown and there are no degrees of freedom.
    noise: f64,
    /// The noise, or the residuals if they are larger, as those of a wrong model are.
    spread: f64,
    /// Residuals that are rounding errors.
    smallest: f64,
}

impl Sizes {
    fn of(problem: &Problem<'_>, chi_squared: f64, freedom: usize) -> Self {
        let residual = match freedom {
            // The residuals are 0 and do not show the size of the noise.
            0 => f64::INFINITY,
            freedom => (chi_squared / freedom as f64).sqrt(),
        };
        let noise = if problem.noise_is_known { 1.0 } else { residual };
        let spread = if residual.is_finite() { noise.max(residual) } else { noise };
        Self { noise, spread, smallest: SMALLEST * problem.size() }
    }

    /// Whether a step of Gauss and Newton from `values` of the parameters `free` is small.
    fn is_minimum(&self, found: &Statistics, free: &[usize], values: &[f64]) -> bool {
        let spread = self.spread.max(self.smallest);
        // Rounding of a number whose error is smaller still would change the residuals by more than
        // the noise, so no minimum can be told.
        let is_rounded = free
            .iter()
            .zip(&found.errors)
            .any(|(&i, error)| error * spread < 0.5 * f64::EPSILON * values[i].abs());
        found.offset <= OFFSET * spread && !is_rounded
    }

    /// Errors of all parameters, from those of `free` at unit noise. NaN for the others.
    fn errors(&self, of_free: &[f64], free: &[usize], unit: f64, count: usize) -> Vec<f64> {
        let mut errors = vec![f64::NAN; count];
        for (&i, error) in free.iter().zip(of_free) {
            let is_known = error.is_finite() && self.noise.is_finite();
            errors[i] = if is_known { error * unit } else { f64::INFINITY };
        }
        errors
    }
}

/// Largest jump between windows, see [`Fit::jump`].
fn jump(problem: &Problem<'_>, misfit: Option<Misfit>, smallest: f64) -> f64 {
    let Some(Misfit { samples, largest_jump, .. }) = misfit else { return f64::INFINITY };
    let residual = || (samples / problem.measurements() as f64).sqrt().max(smallest);
    let unit = if problem.noise_is_known || largest_jump == 0.0 { 1.0 } else { residual() };
    largest_jump / unit
}

fn result(
    problem: &Problem<'_>,
    point: Point,
    window: Option<usize>,
    continuity: f64,
    converged: bool,
    counts: &mut Counts,
) -> Result<Fit, IdentifyError> {
    let names: Vec<String> = problem.unknowns.iter().map(|unknown| unknown.name.clone()).collect();
    let count = names.len();
    let equations = Equations::new(problem, &point, continuity, counts)?;
    let free: Vec<usize> = (0..count).filter(|&i| !equations.held[i]).collect();
    let is_finite = equations.non_finite_starts.is_empty()
        && equations.slopes.iter().all(|slope| slope.is_finite());
    let found = if is_finite {
        statistics(&equations.params, &free, &equations.negligible)
    } else {
        Statistics::unknown(free.len())
    };
    let (measurements, unknowns) = (problem.measurements(), equations.start_rank + found.rank);
    let misfit = problem.misfit(&point)?;
    let chi_squared = misfit.map_or(f64::INFINITY, |misfit| misfit.samples);
    let sizes = Sizes::of(problem, chi_squared, measurements.saturating_sub(unknowns));
    let undetermined: Vec<Vec<usize>> = found
        .undetermined
        .iter()
        .map(|combination| combination.iter().map(|&k| free[k]).collect())
        .collect();
    let at_minimum = converged && is_finite && sizes.is_minimum(&found, &free, &point.values);
    let spreads = sizes.errors(&found.errors, &free, sizes.spread, count);
    let statuses =
        statuses(problem, &point, &equations, &spreads, &undetermined, at_minimum, counts)?;
    let known = |of_free: &[f64], unit: f64| -> Vec<f64> {
        let is_known = |status: &Status| matches!(status, Status::Estimated | Status::AtBound);
        let errors = sizes.errors(of_free, &free, unit, count).into_iter().zip(&statuses);
        errors.map(|(error, status)| if is_known(status) { error } else { f64::INFINITY }).collect()
    };
    let mut correlations = vec![vec![f64::NAN; count]; count];
    for (&i, row) in free.iter().zip(&found.correlations) {
        free.iter().zip(row).for_each(|(&j, correlation)| correlations[i][j] = *correlation);
    }
    let with = |status: Status| {
        (0..count).filter(|&i| statuses[i] == status).map(|i| names[i].clone()).collect()
    };
    let is_open = |combination: &&Vec<usize>| {
        combination.iter().any(|&i| statuses[i] == Status::Undetermined)
    };
    let named = |combination: &Vec<usize>| combination.iter().map(|&i| names[i].clone()).collect();
    let states = problem.states(&point)?;
    let starts = equations.starts.iter().zip(&states);
    let open = starts.flat_map(|(rows, states)| undetermined_components(rows, sizes.noise, states));
    Ok(Fit {
        errors: known(&found.errors, sizes.noise),
        robust_errors: known(&found.robust_errors, 1.0),
        correlations,
        undetermined: undetermined.iter().filter(is_open).map(named).collect(),
        undetermined_starts: open.collect::<BTreeSet<usize>>().into_iter().collect(),
        non_finite_starts: equations.non_finite_starts,
        at_bound: with(Status::AtBound),
        states,
        angles: problem.angles.to_vec(),
        jump: jump(problem, misfit, sizes.smallest),
        chi_squared,
        measurements,
        unknowns,
        converged: at_minimum && !statuses.iter().any(|status| status.is_failure()),
        window,
        iterations: counts.iterations,
        simulations: counts.simulations,
        jacobians: counts.jacobians,
        statuses,
        names,
        values: point.values,
    })
}
