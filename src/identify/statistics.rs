//! Standard errors, correlations, and parameters that the data cannot determine.

use super::elimination::{gradient, triangle};
use nalgebra::{DMatrix, DVector, SymmetricEigen};

/// Threshold for eigenvalues of the scaled information matrix, relative to the largest. At or below
/// it, the data do not determine the combination of parameters along the eigenvector. The square
/// root of this ratio, 1e-6, exceeds the relative rounding error of Jacobians, about 1e-7 after
/// long simulations.
const DETERMINED: f64 = 1e-12;

/// Threshold for the fraction of the information from a segment, or from all segments but one. At or
/// below it, a segment does not depend on a parameter, or the others do not determine the combination
/// of parameters.
const SHARED: f64 = 1e-9;

/// Factor by which other unknown initial values increase the standard error of an undetermined one,
/// at least. Initial values of an unstable trajectory exceed it too, but have small errors.
const CONFOUNDED: f64 = 1e3;

/// Damping of the equations of an initial state, relative to the norms of their columns. Exceeds
/// rounding errors.
const DAMPING: f64 = 1e-12;

/// Norm of a column that is 0.
const NO_EFFECT: f64 = 1e-100;

/// Threshold for singular values of the derivatives by an initial state, with columns of norm 1,
/// relative to the largest. At or below it, the data do not determine the combination of its
/// components. Exceeds the rounding errors of windows; short beginnings of a segment decide where
/// perturbations grow.
const INDEPENDENT: f64 = 1e-10;

/// Magnitude of an eigenvector component above which a combination names the parameter.
const NAMED: f64 = 1e-3;

#[derive(Default)]
pub(super) struct Statistics {
    /// Standard errors at unit noise; infinite for undetermined parameters.
    pub errors: Vec<f64>,
    /// Standard errors from the scatter between segments. Infinite for undetermined parameters, and
    /// for those that only one segment determines. Infinite for all parameters, unless the
    /// segments that depend on a parameter outnumber the parameters.
    pub robust_errors: Vec<f64>,
    pub correlations: Vec<Vec<f64>>,
    /// Indices of the parameters in each undetermined combination.
    pub undetermined: Vec<Vec<usize>>,
    /// Number of combinations of parameters that the data determine.
    pub rank: usize,
    /// Largest step of Gauss and Newton along an eigenvector of the scaled information matrix, in
    /// standard errors at unit noise. 0 at a minimum (Bates and Watts 1981,
    /// doi:10.1080/00401706.1981.10486251).
    pub offset: f64,
}

impl Statistics {
    /// Statistics of `count` parameters without finite equations.
    pub fn unknown(count: usize) -> Self {
        let unknown = vec![f64::INFINITY; count];
        let correlations = vec![vec![f64::NAN; count]; count];
        let errors = unknown.clone();
        Self { errors, robust_errors: unknown, correlations, rank: count, ..Self::default() }
    }
}

/// Computes the statistics of the parameters `free` from the equations of all parameters, one
/// matrix `[J | r]` for each segment. Other parameters are known. Indices of results refer to
/// `free`. Columns with norms up to `negligible` are rounding errors.
pub(super) fn statistics(
    equations: &[DMatrix<f64>],
    free: &[usize],
    negligible: &[f64],
) -> Statistics {
    let count = free.len();
    if count == 0 {
        return Statistics::default();
    }
    let columns: Vec<usize> = free.iter().copied().chain([negligible.len()]).collect();
    let equations: Vec<DMatrix<f64>> =
        equations.iter().map(|rows| rows.select_columns(&columns)).collect();
    let negligible: Vec<f64> = free.iter().map(|&i| negligible[i]).collect();
    let (scaled, scale) = scaled_information(&equations, &negligible);
    let (factor, undetermined, rank) = combinations(scaled);
    let covariance = &factor * factor.transpose();
    let variances = robust_variances(&equations, &scale, &factor);
    // Standard errors of determined parameters.
    let errors = |variance: &dyn Fn(usize) -> f64| {
        let is_open = |i: usize| undetermined.iter().any(|members| members.contains(&i));
        let error = |i| if is_open(i) { f64::INFINITY } else { variance(i).sqrt() / scale[i] };
        (0..count).map(error).collect()
    };
    let correlation =
        |i: usize, j: usize| covariance[(i, j)] / (covariance[(i, i)] * covariance[(j, j)]).sqrt();
    let correlations =
        (0..count).map(|i| (0..count).map(|j| correlation(i, j)).collect()).collect();
    let transform = transform(&scale, &factor);
    let step = equations
        .iter()
        .fold(DVector::zeros(count), |sum, rows| sum + transform.tr_mul(&gradient(rows)));
    Statistics {
        errors: errors(&|i| covariance[(i, i)]),
        robust_errors: variances
            .map_or_else(|| vec![f64::INFINITY; count], |variances| errors(&|i| variances[i])),
        correlations,
        undetermined,
        rank,
        offset: step.amax(),
    }
}

/// Information matrix of all segments with a unit diagonal, and the square roots of its diagonal
/// before. Both are 0 for parameters with a root up to `negligible`.
fn scaled_information(equations: &[DMatrix<f64>], negligible: &[f64]) -> (DMatrix<f64>, Vec<f64>) {
    let count = negligible.len();
    let information = equations.iter().fold(DMatrix::zeros(count, count), |sum, rows| {
        let slopes = rows.columns(0, count);
        sum + slopes.tr_mul(&slopes)
    });
    let scale =
        |i: usize| Some(information[(i, i)].max(0.0).sqrt()).filter(|scale| *scale > negligible[i]);
    let scale: Vec<f64> = (0..count).map(|i| scale(i).unwrap_or(0.0)).collect();
    let scaled = DMatrix::from_fn(count, count, |i, j| {
        let product = scale[i] * scale[j];
        if product > 0.0 { information[(i, j)] / product } else { 0.0 }
    });
    (scaled, scale)
}

/// A `factor` of the covariance `factor factorᵀ` of the determined combinations of parameters, the
/// indices of the parameters in each undetermined combination, and the number of determined ones.
fn combinations(scaled: DMatrix<f64>) -> (DMatrix<f64>, Vec<Vec<usize>>, usize) {
    let count = scaled.ncols();
    let SymmetricEigen { eigenvalues, eigenvectors } = SymmetricEigen::new(scaled);
    let least = DETERMINED * eigenvalues.iter().copied().fold(0.0, f64::max);
    let mut factor = DMatrix::<f64>::zeros(count, count);
    let (mut undetermined, mut rank) = (Vec::new(), 0);
    for (k, &eigenvalue) in eigenvalues.iter().enumerate() {
        let vector = eigenvectors.column(k);
        if eigenvalue.is_nan() || eigenvalue <= least {
            let members: Vec<usize> =
                (0..count).filter(|&i| vector[i].is_nan() || vector[i].abs() > NAMED).collect();
            if !undetermined.contains(&members) {
                undetermined.push(members);
            }
            continue;
        }
        rank += 1;
        factor.set_column(k, &(vector / eigenvalue.sqrt()));
    }
    (factor, undetermined, rank)
}

/// Variances of the scaled parameters from the scatter between segments. `None`, unless the
/// segments that depend on a parameter outnumber the parameters.
fn robust_variances(
    equations: &[DMatrix<f64>],
    scale: &[f64],
    factor: &DMatrix<f64>,
) -> Option<Vec<f64>> {
    let count = scale.len();
    // Elimination of initial states leaves rounding errors where a segment has no information.
    let depends = |rows: &DMatrix<f64>, i: usize| {
        rows.column(i).norm_squared() > SHARED * scale[i] * scale[i]
    };
    let informative = equations.iter().filter(|rows| (0..count).any(|i| depends(rows, i)));
    let informative: Vec<&DMatrix<f64>> = informative.collect();
    (informative.len() > count).then(|| jackknife(&informative, scale, factor))
}

/// Transforms coordinates in which the information of all segments is the unit matrix to steps of
/// the parameters.
fn transform(scale: &[f64], factor: &DMatrix<f64>) -> DMatrix<f64> {
    let per_scale = scale.iter().map(|&scale| if scale > 0.0 { 1.0 / scale } else { 0.0 });
    DMatrix::from_diagonal(&DVector::from_iterator(scale.len(), per_scale)) * factor
}

/// Number of combinations of the components of an initial state that the samples determine. `rows`
/// are its linear equations. All components if an equation is not finite.
pub(super) fn rank(rows: &DMatrix<f64>) -> usize {
    if !rows.iter().all(|slope| slope.is_finite()) {
        return rows.ncols();
    }
    let seen: Vec<usize> = (0..rows.ncols()).filter(|&i| rows.column(i).amax() > 0.0).collect();
    if seen.is_empty() {
        return 0;
    }
    let mut scaled = rows.select_columns(&seen);
    // The largest entry first: squares of large numbers overflow.
    for mut column in scaled.column_iter_mut() {
        column /= column.amax();
        column /= column.norm();
    }
    let sizes = scaled.singular_values();
    sizes.iter().filter(|size| **size > INDEPENDENT * sizes.amax()).count()
}

/// Components of an initial state that the samples do not determine. `rows` are its linear
/// equations at unit noise.
pub(super) fn undetermined_components(
    rows: &DMatrix<f64>,
    noise: f64,
    states: &[Vec<f64>],
) -> Vec<usize> {
    let count = rows.ncols();
    let norms: Vec<f64> = rows
        .column_iter()
        .map(|column| if column.amax() > 0.0 { column.norm() } else { NO_EFFECT })
        .collect();
    let mut damped = rows.clone().resize_vertically(rows.nrows() + count, 0.0);
    norms.iter().enumerate().for_each(|(i, norm)| damped[(rows.nrows() + i, i)] = DAMPING * norm);
    // The covariance is `inverse inverseᵀ`.
    let inverse = triangle(damped).solve_upper_triangular(&DMatrix::identity(count, count));
    let Some(inverse) = inverse.filter(|inverse| inverse.iter().all(|number| number.is_finite()))
    else {
        return Vec::new();
    };
    let is_open = |i: usize| {
        let error = inverse.row(i).norm();
        // Wrong initial states are large, and decay.
        let largest =
            states[states.len() / 2..].iter().fold(0.0, |largest: f64, x| largest.max(x[i].abs()));
        error * norms[i] > CONFOUNDED && error * noise > largest
    };
    (0..count).filter(|&i| is_open(i)).collect()
}

/// Variances of the scaled parameters, by a linearized jackknife that leaves out one segment at a
/// time (CR3 of Cameron and Miller 2015, doi:10.3368/jhr.50.2.317). Infinite for parameters that
/// the other segments do not determine.
///
/// `factor` is a factor of the covariance at unit noise. In its coordinates, the information of all
/// segments is the unit matrix.
fn jackknife(equations: &[&DMatrix<f64>], scale: &[f64], factor: &DMatrix<f64>) -> Vec<f64> {
    let (count, segments) = (scale.len(), equations.len() as f64);
    let transform = transform(scale, factor);
    let mut variances = vec![0.0; count];
    for rows in equations {
        let gradient = transform.tr_mul(&gradient(rows));
        let slopes = rows.columns(0, count) * &transform;
        let others = SymmetricEigen::new(DMatrix::identity(count, count) - slopes.tr_mul(&slopes));
        let mut change = DVector::zeros(count);
        for (vector, &eigenvalue) in others.eigenvectors.column_iter().zip(&others.eigenvalues) {
            let direction = factor * vector;
            if eigenvalue > SHARED {
                change += direction * (vector.dot(&gradient) / eigenvalue);
                continue;
            }
            let is_open = |i: usize| direction[i].abs() > NAMED * factor.row(i).norm();
            (0..count).filter(|&i| is_open(i)).for_each(|i| variances[i] = f64::INFINITY);
        }
        variances
            .iter_mut()
            .zip(&change)
            .for_each(|(sum, change)| *sum += change * change * (segments - 1.0) / segments);
    }
    variances
}
