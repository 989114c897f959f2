//! [`Fit`]: what a fit found, its errors, and whether its residuals are noise.

use super::angles::unwrapped;
use super::descent::{Counts, Equations};
use super::error::IdentifyError;
use super::fit::Segment;
use super::problem::{Misfit, Point, Problem};
use super::statistics::{Statistics, statistics, undetermined_components};
use super::status::{Status, statuses};
use std::collections::BTreeSet;

/// Standard deviations that chance explains.
const CHANCE: f64 = 4.0;

/// Correlation of successive residuals that makes standard errors too small.
const CORRELATED: f64 = 0.2;

/// Lower bound on the unit of [`Fit::jump`] if the noise is unknown, relative to the root mean
/// square of the measurements.
pub(super) const SMALLEST: f64 = 1e-9;

/// Largest step of Gauss and Newton at a minimum, in standard errors.
const OFFSET: f64 = 0.1;

/// Result of [`identify`](super::identify).
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
    /// State components with differences modulo 2π, see [`Options::angles`](super::Options::angles).
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
    /// Length of the windows of this result: [`Options::window`](super::Options::window), or `None` if a fit of whole
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
    pub(super) fn exceeds(&self, z: f64) -> bool {
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
    pub(super) fn correlated_beyond(
        &self,
        segments: &[Segment],
        large: f64,
        z: f64,
    ) -> Vec<(usize, f64)> {
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

/// Statistics of the parameters `free`. `None` if a derivative is not finite.
fn finite_statistics(equations: &Equations, free: &[usize]) -> Option<Statistics> {
    let is_finite = equations.non_finite_starts.is_empty()
        && equations.slopes.iter().all(|slope| slope.is_finite());
    is_finite.then(|| statistics(&equations.params, free, &equations.negligible))
}

/// The errors of parameters that are estimated or at a bound. Infinite for the others.
fn known_errors(errors: Vec<f64>, statuses: &[Status]) -> Vec<f64> {
    let is_known = |status: &Status| matches!(status, Status::Estimated | Status::AtBound);
    let errors = errors.into_iter().zip(statuses);
    errors.map(|(error, status)| if is_known(status) { error } else { f64::INFINITY }).collect()
}

/// Correlations of all parameters, from those of `free`. NaN for the others.
fn correlations(of_free: &[Vec<f64>], free: &[usize], count: usize) -> Vec<Vec<f64>> {
    let mut correlations = vec![vec![f64::NAN; count]; count];
    for (&i, row) in free.iter().zip(of_free) {
        free.iter().zip(row).for_each(|(&j, correlation)| correlations[i][j] = *correlation);
    }
    correlations
}

/// Names of the parameters in each combination with an undetermined parameter.
fn undetermined_names(
    combinations: &[Vec<usize>],
    statuses: &[Status],
    names: &[String],
) -> Vec<Vec<String>> {
    let is_open = |combination: &&Vec<usize>| {
        combination.iter().any(|&i| statuses[i] == Status::Undetermined)
    };
    let named = |combination: &Vec<usize>| combination.iter().map(|&i| names[i].clone()).collect();
    combinations.iter().filter(is_open).map(named).collect()
}

/// State components whose initial values are undetermined in at least one segment, sorted.
/// `states` are the simulated states of the segments.
fn undetermined_starts(equations: &Equations, noise: f64, states: &[Vec<Vec<f64>>]) -> Vec<usize> {
    let starts = equations.starts.iter().zip(states);
    let open = starts.flat_map(|(rows, states)| undetermined_components(rows, noise, states));
    open.collect::<BTreeSet<usize>>().into_iter().collect()
}

/// The result at the last point of the iterations.
pub(super) fn result(
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
    let found = finite_statistics(&equations, &free);
    let is_finite = found.is_some();
    let found = found.unwrap_or_else(|| Statistics::unknown(free.len()));
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
        known_errors(sizes.errors(of_free, &free, unit, count), &statuses)
    };
    let with = |status: Status| {
        (0..count).filter(|&i| statuses[i] == status).map(|i| names[i].clone()).collect()
    };
    let states = problem.states(&point)?;
    Ok(Fit {
        errors: known(&found.errors, sizes.noise),
        robust_errors: known(&found.robust_errors, 1.0),
        correlations: correlations(&found.correlations, &free, count),
        undetermined: undetermined_names(&undetermined, &statuses, &names),
        undetermined_starts: undetermined_starts(&equations, sizes.noise, &states),
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
