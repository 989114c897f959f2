//! What a fit knows about each of its numbers.

use super::descent::{Counts, Equations};
use super::error::IdentifyError;
use super::problem::{Point, Problem};

/// Threshold for the largest derivative by a number, relative to that at its initial value. Below
/// it, a number has left the values where it has an influence.
const LOST: f64 = 1e-3;

/// What a fit knows about a number.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Status {
    /// The value minimizes χ² and has a standard error.
    Estimated,
    /// χ² decreases beyond a bound, or the bounds are equal. The value is that of the bound, and
    /// known in the statistics of the other numbers. There is no standard error.
    AtBound,
    /// The data do not determine the number, or only together with others. The simulation agrees
    /// with the data for other values too.
    Undetermined,
    /// The number moved to a value where it has almost no influence. χ² has no minimum there.
    RanAway,
    /// A derivative by the number is not finite, which ends the iterations.
    NonFinite,
    /// All derivatives by the number are exactly 0, so it keeps its initial value, but a finite
    /// change affects the simulation. Examples are a time that a simulation compares with t, and a
    /// limit that the simulation never reaches.
    NoSlope,
    /// The fit is not at a minimum of χ² over all numbers, because of this or of other numbers.
    NotConverged,
}

impl Status {
    /// Name in files, such as `estimated` or `ran away`.
    pub fn name(self) -> &'static str {
        match self {
            Self::Estimated => "estimated",
            Self::AtBound => "at bound",
            Self::Undetermined => "undetermined",
            Self::RanAway => "ran away",
            Self::NonFinite => "non-finite derivative",
            Self::NoSlope => "zero derivative",
            Self::NotConverged => "not converged",
        }
    }

    /// Returns whether the value is not a result, which also spoils the values of other numbers.
    pub fn is_failure(self) -> bool {
        matches!(self, Self::RanAway | Self::NonFinite | Self::NoSlope)
    }
}

/// Status of each number. `errors` are standard errors, infinite for undetermined numbers. The
/// combinations `undetermined` are lists of indices. `converged`: whether the iterations ended at a
/// minimum.
pub(super) fn statuses(
    problem: &Problem<'_>,
    point: &Point,
    equations: &Equations,
    errors: &[f64],
    undetermined: &[Vec<usize>],
    mut converged: bool,
    counts: &mut Counts,
) -> Result<Vec<Status>, IdentifyError> {
    let mut statuses = Vec::with_capacity(errors.len());
    for (i, (&error, &slope)) in errors.iter().zip(&equations.slopes).enumerate() {
        statuses.push(if equations.held[i] {
            Status::AtBound
        } else if slope.is_nan() {
            Status::NonFinite
        } else if has_run_away(problem, point, i, error, slope, counts)? {
            Status::RanAway
        } else if slope == 0.0 && problem.is_changed_by(i, point)? {
            Status::NoSlope
        } else if undetermined.iter().flatten().any(|&open| open == i) {
            Status::Undetermined
        } else {
            Status::Estimated
        });
    }
    converged &= !statuses.iter().any(|status| status.is_failure());
    let undecided =
        statuses.iter_mut().filter(|status| **status == Status::Estimated && !converged);
    undecided.for_each(|status| *status = Status::NotConverged);
    Ok(statuses)
}

/// Returns whether number `i` left its initial value by less than its standard error, and lost
/// nearly all the influence that it had at the initial values of all numbers.
fn has_run_away(
    problem: &Problem<'_>,
    point: &Point,
    i: usize,
    error: f64,
    slope: f64,
    counts: &mut Counts,
) -> Result<bool, IdentifyError> {
    let starts: Vec<f64> = problem.unknowns.iter().map(|unknown| unknown.start).collect();
    let way = (point.values[i] - starts[i]).abs();
    let back = Point { values: starts, ..point.clone() };
    if way == 0.0 || way > error || problem.misfit(&back)?.is_none() {
        return Ok(false);
    }
    counts.jacobians += 1;
    Ok(slope < LOST * Equations::slopes(&problem.linearize(&back)?, point.values.len())[i])
}
