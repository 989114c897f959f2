//! Iterations of Levenberg and Marquardt.

use super::elimination::{Eliminated, Linearized, Weights, gradient, solve, stacked, start_rows};
use super::error::IdentifyError;
use super::fit::Unknown;
use super::problem::{Point, Problem, largest, map};
use super::statistics::rank;
use nalgebra::{DMatrix, DVector};

/// Numbers of computations so far.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Counts {
    pub iterations: usize,
    pub simulations: usize,
    pub jacobians: usize,
}

/// Conditions that end the iterations.
#[derive(Clone, Copy)]
pub(super) struct Stop {
    /// Two consecutive iterations end the loop if each decreases the objective by at most this
    /// fraction.
    pub tolerance: f64,
    pub max_iterations: usize,
    /// Objective that ends the loop with [`IdentifyError::Worse`], if its minimum will be higher.
    pub give_up: f64,
}

impl Stop {
    /// Returns whether the objective stays above [`give_up`](Self::give_up) in all remaining
    /// iterations, if it decreases as fast as in the last ones. `objectives` are those after each
    /// iteration.
    fn is_hopeless(&self, objectives: &[f64]) -> bool {
        /// Iterations that show how fast the objective decreases.
        const SHOWN: usize = 20;
        let count = objectives.len();
        let Some(before) = count.checked_sub(SHOWN + 1) else { return false };
        let now = objectives[count - 1];
        let remaining = (self.max_iterations + 1).saturating_sub(count) as f64 / SHOWN as f64;
        now * (now / objectives[before]).powf(remaining) > self.give_up
    }
}

/// Rounding error of the elimination of initial states, relative to the weight of continuity and to
/// the norm of a column.
const ROUNDING: f64 = 1e-14;

/// Decrease of the objective at which the residuals are rounding errors of the initial ones. Data without
/// noise, from a simulation, may decrease it for ever.
const EXACT: f64 = 1e-30;

/// Minimizes χ² plus `continuity²` times the sum of squared jumps between windows, in units of the
/// noise.
///
/// Returns whether the iterations converged: the tolerance ended them, the residuals are rounding
/// errors, or no step decreases the objective and all residuals and derivatives are finite. Also returns the minimum.
///
/// # Errors
/// [`IdentifyError::Stopped`] if the stop flag is set. [`IdentifyError::Worse`] if the minimum exceeds
/// `stop.give_up`.
pub(super) fn minimize(
    problem: &Problem<'_>,
    point: &mut Point,
    continuity: f64,
    stop: Stop,
    counts: &mut Counts,
) -> Result<(bool, f64), IdentifyError> {
    let objective = |point: &Point, counts: &mut Counts| {
        counts.simulations += 1;
        let misfit = problem.misfit(point)?;
        Ok(misfit.map_or(f64::INFINITY, |misfit| {
            misfit.samples + continuity * continuity * misfit.jumps
        }))
    };
    let (mut damping, mut quiet) = (1e-3, 0);
    let mut least = objective(point, counts)?;
    let mut objectives = vec![least];
    let ended = |converged: bool, least: f64| {
        if least > stop.give_up { Err(IdentifyError::Worse) } else { Ok((converged, least)) }
    };
    for _ in 0..stop.max_iterations {
        counts.iterations += 1;
        counts.jacobians += 1;
        let linearized = problem.linearize(point)?;
        let mut decrease = None;
        while decrease.is_none() && damping < 1e12 {
            let next = step(
                problem,
                point,
                &linearized,
                Weights { per_noise: &problem.per_noise, continuity, damping },
            );
            let value = next.as_ref().map_or(Ok(f64::INFINITY), |next| objective(next, counts))?;
            if let Some(next) = next.filter(|_| value < least) {
                // The relative decrease is 1 after an infinite objective.
                decrease = Some(1.0 - value / least);
                (*point, least) = (next, value);
                damping = (damping * 0.1).max(1e-14);
            } else {
                damping = (damping * 10.0).max(1e-12);
            }
        }
        quiet = match decrease {
            Some(decrease) if decrease > stop.tolerance => 0,
            Some(_) => quiet + 1,
            // No step decreases the objective: a minimum up to rounding, if all residuals and
            // derivatives are finite.
            None => return ended(linearized.iter().flatten().all(Linearized::is_finite), least),
        };
        if quiet >= 2 || least <= EXACT * objectives[0] {
            return ended(true, least);
        }
        objectives.push(least);
        if stop.is_hopeless(&objectives) {
            return Err(IdentifyError::Worse);
        }
    }
    ended(false, least)
}

/// The point after one damped step, within the bounds. `None` for singular equations.
fn step(
    problem: &Problem<'_>,
    point: &Point,
    linearized: &[Vec<Linearized>],
    weights: Weights<'_>,
) -> Option<Point> {
    let params = point.values.len();
    let segments = eliminated(linearized, params, weights);
    let equations = stacked(&segments, params);
    let norms = norms(linearized, params);
    let limits = |i: usize| {
        [problem.unknowns[i].min - point.values[i], problem.unknowns[i].max - point.values[i]]
    };
    let mut fixed: Vec<Option<f64>> = held(problem.unknowns, &point.values, &equations)
        .into_iter()
        .map(|is_held| is_held.then_some(0.0))
        .collect();
    // Steps beyond a bound end at the bound. Solves again for the other parameters.
    let step = loop {
        let step = solve(&equations, &fixed, &norms, weights.damping)?;
        let beyond: Vec<usize> =
            (0..params).filter(|&i| !(limits(i)[0]..=limits(i)[1]).contains(&step[i])).collect();
        if beyond.is_empty() || beyond.iter().any(|&i| fixed[i].is_some()) {
            break step;
        }
        beyond.iter().for_each(|&i| fixed[i] = Some(step[i].clamp(limits(i)[0], limits(i)[1])));
    };
    let bounded = problem.unknowns.iter().zip(&point.values).zip(step.iter());
    let values: Vec<f64> =
        bounded.map(|((u, value), step)| (value + step).clamp(u.min, u.max)).collect();
    let taken = DVector::from_fn(params, |i, _| values[i] - point.values[i]);
    let mut next = Point { values, windows: point.windows.clone() };
    let mut windows = next.windows.iter_mut();
    for segment in &segments {
        // `zip` advances the steps first, so the end of a segment consumes no window of the next
        // one.
        for (step, window) in segment.starts(&taken)?.iter().zip(windows.by_ref()) {
            window.start.iter_mut().zip(step.iter()).for_each(|(x, step)| *x += step);
        }
    }
    Some(next)
}

fn eliminated(
    linearized: &[Vec<Linearized>],
    params: usize,
    weights: Weights<'_>,
) -> Vec<Eliminated> {
    map(linearized.len(), |i| Eliminated::new(&linearized[i], params, weights))
}

/// Norms of the columns of the Jacobian of the residuals with respect to the parameters.
fn norms(linearized: &[Vec<Linearized>], params: usize) -> Vec<f64> {
    let squares = linearized.iter().flatten().fold(
        vec![0.0; params],
        |sums: Vec<f64>, Linearized { samples, .. }| {
            let first = samples.ncols() - params - 1;
            sums.iter()
                .enumerate()
                .map(|(i, sum)| sum + samples.column(first + i).norm_squared())
                .collect()
        },
    );
    squares.into_iter().map(f64::sqrt).collect()
}

/// Returns which parameters stay at a bound: the objective decreases beyond it, or the bounds are
/// equal.
fn held(unknowns: &[Unknown], values: &[f64], equations: &DMatrix<f64>) -> Vec<bool> {
    let slopes = gradient(equations);
    let is_held = |(i, Unknown { min, max, .. }): (usize, &Unknown)| {
        min == max || values[i] <= *min && slopes[i] > 0.0 || values[i] >= *max && slopes[i] < 0.0
    };
    unknowns.iter().enumerate().map(is_held).collect()
}

/// Rank of the derivatives of the samples of a segment by its initial state. Perturbations that grow
/// hide the others in the samples of a whole segment, but not in those of its beginning.
fn start_rank(windows: &[Linearized], params: usize) -> usize {
    let mut greatest = 0;
    let lengths = std::iter::successors(Some(1), |length| Some(2 * length));
    for length in lengths.take_while(|&length| length < windows.len()).chain([windows.len()]) {
        let rows = start_rows(&windows[..length], params);
        greatest = greatest.max(rank(&rows));
        if greatest == rows.ncols() {
            break;
        }
    }
    greatest
}

/// Linear equations at the end of the iterations.
pub(super) struct Equations {
    /// Equations `[δq | 1]` of the parameters with negligible damping, for each segment.
    pub params: Vec<DMatrix<f64>>,
    /// Rows of the initial state, for each segment.
    pub starts: Vec<DMatrix<f64>>,
    /// Number of combinations of the components of all initial states that the samples determine.
    pub start_rank: usize,
    /// Whether each parameter stays at a bound.
    pub held: Vec<bool>,
    /// Norms of the columns of the parameters below which the elimination of the initial states
    /// leaves rounding errors only.
    pub negligible: Vec<f64>,
    /// Largest absolute derivative of a state by each parameter. NaN if one of them is non-finite.
    pub slopes: Vec<f64>,
    /// Components of the initial states of windows by which a derivative is non-finite.
    pub non_finite_starts: Vec<usize>,
}

impl Equations {
    /// Linearizes the problem.
    ///
    /// # Errors
    /// [`IdentifyError::Stopped`] if the stop flag is set.
    pub fn new(
        problem: &Problem<'_>,
        point: &Point,
        continuity: f64,
        counts: &mut Counts,
    ) -> Result<Self, IdentifyError> {
        counts.jacobians += 1;
        // Negligible damping, which only determines initial states that do not affect the samples.
        let weights = Weights { per_noise: &problem.per_noise, continuity, damping: 1e-24 };
        let (linearized, params) = (problem.linearize(point)?, point.values.len());
        let segments = eliminated(&linearized, params, weights);
        let is_broken = |&i: &usize| {
            let starts = linearized
                .iter()
                .flatten()
                .map(|window| &window.slopes[..window.slopes.len() - params]);
            starts.filter_map(|slopes| slopes.get(i)).any(|slope| slope.is_nan())
        };
        Ok(Self {
            starts: map(linearized.len(), |i| start_rows(&linearized[i], params)),
            start_rank: map(linearized.len(), |i| start_rank(&linearized[i], params)).iter().sum(),
            held: held(problem.unknowns, &point.values, &stacked(&segments, params)),
            negligible: { norms(&linearized, params) }
                .into_iter()
                .map(|norm| ROUNDING * continuity * norm)
                .collect(),
            slopes: Self::slopes(&linearized, params),
            non_finite_starts: (0..problem.per_noise.len()).filter(is_broken).collect(),
            params: segments.into_iter().map(|segment| segment.reduced).collect(),
        })
    }

    /// Number of unknowns that affect a sample, or for parameters, a state.
    pub fn seen(&self, unknowns: &[Unknown]) -> usize {
        let columns = self.starts.iter().flat_map(|rows| rows.column_iter());
        let starts = columns.filter(|column| column.iter().any(|slope| *slope != 0.0)).count();
        let params = unknowns.iter().zip(&self.slopes);
        starts + params.filter(|(u, slope)| u.min < u.max && **slope != 0.0).count()
    }

    /// Largest absolute derivative of a state by each parameter. NaN if one of them is non-finite.
    pub fn slopes(linearized: &[Vec<Linearized>], params: usize) -> Vec<f64> {
        let of_window =
            |window: &Linearized, i: usize| window.slopes[window.slopes.len() - params + i];
        (0..params)
            .map(|i| largest(linearized.iter().flatten().map(|window| of_window(window, i))))
            .collect()
    }
}
