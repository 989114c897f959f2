//! Standard errors, correlations, and parameters that the data cannot determine.

use super::elimination::gradient;
use nalgebra::{DMatrix, DVector, SymmetricEigen};

/// Threshold for eigenvalues of the scaled information matrix, relative to the largest. At or below
/// it, the data do not determine the combination of parameters along the eigenvector. The square
/// root of this ratio, 1e-6, exceeds the relative rounding error of Jacobians, about 1e-7 after
/// long simulations.
const DETERMINED: f64 = 1e-12;

/// Magnitude of an eigenvector component above which a combination names the parameter.
const NAMED: f64 = 1e-3;

pub(super) struct Statistics {
    /// Standard errors at unit noise; infinite for undetermined parameters.
    pub errors: Vec<f64>,
    /// Standard errors from the scatter between segments. Infinite for undetermined parameters.
    /// Infinite for all parameters, unless the segments that depend on a parameter outnumber the
    /// parameters.
    pub robust_errors: Vec<f64>,
    pub correlations: Vec<Vec<f64>>,
    /// Names of the parameters in each undetermined combination.
    pub undetermined: Vec<Vec<String>>,
}

/// Computes the statistics of the named parameters from their equations, one matrix `[J | r]` for
/// each segment.
pub(super) fn statistics(equations: &[DMatrix<f64>], names: &[String]) -> Statistics {
    let count = names.len();
    if count == 0 {
        return Statistics { errors: Vec::new(), robust_errors: Vec::new(), correlations: Vec::new(), undetermined: Vec::new() };
    }
    let information = equations.iter().fold(DMatrix::zeros(count, count), |sum, rows| {
        let slopes = rows.columns(0, count);
        sum + slopes.tr_mul(&slopes)
    });
    let scale: Vec<f64> = (0..count).map(|i| information[(i, i)].max(0.0).sqrt()).collect();
    let scaled = DMatrix::from_fn(count, count, |i, j| {
        let product = scale[i] * scale[j];
        if product > 0.0 { information[(i, j)] / product } else { 0.0 }
    });
    let SymmetricEigen { eigenvalues, eigenvectors } = SymmetricEigen::new(scaled);
    let least = DETERMINED * eigenvalues.iter().copied().fold(0.0, f64::max);
    let mut covariance = DMatrix::<f64>::zeros(count, count);
    let (mut undetermined, mut is_open) = (Vec::new(), vec![false; count]);
    for (k, &eigenvalue) in eigenvalues.iter().enumerate() {
        let vector = eigenvectors.column(k);
        if eigenvalue.is_nan() || eigenvalue <= least {
            let members: Vec<usize> = (0..count).filter(|&i| vector[i].is_nan() || vector[i].abs() > NAMED).collect();
            members.iter().for_each(|&i| is_open[i] = true);
            let combination: Vec<String> = members.iter().map(|&i| names[i].clone()).collect();
            if !undetermined.contains(&combination) {
                undetermined.push(combination);
            }
            continue;
        }
        covariance += vector * vector.transpose() / eigenvalue;
    }
    let errors = (0..count).map(|i| if is_open[i] { f64::INFINITY } else { covariance[(i, i)].sqrt() / scale[i] });
    let informative = equations.iter().filter(|rows| rows.columns(0, count).iter().any(|slope| *slope != 0.0));
    let informative: Vec<&DMatrix<f64>> = informative.collect();
    let scatter = scatter(&informative, &scale);
    let robust = &covariance * scatter * &covariance;
    let is_known = |i: usize| !is_open[i] && informative.len() > count;
    let robust_errors = (0..count).map(|i| if is_known(i) { robust[(i, i)].sqrt() / scale[i] } else { f64::INFINITY });
    let robust_errors = robust_errors.collect();
    let correlation = |i: usize, j: usize| covariance[(i, j)] / (covariance[(i, i)] * covariance[(j, j)]).sqrt();
    let correlations = (0..count).map(|i| (0..count).map(|j| correlation(i, j)).collect()).collect();
    Statistics { errors: errors.collect(), robust_errors, correlations, undetermined }
}

/// Covariance of the gradient with respect to the scaled parameters, from its scatter between
/// segments.
fn scatter(equations: &[&DMatrix<f64>], scale: &[f64]) -> DMatrix<f64> {
    let (count, segments) = (scale.len(), equations.len() as f64);
    let scaled = |rows: &&DMatrix<f64>| {
        gradient(rows).zip_map(&DVector::from_row_slice(scale), |slope, scale| if scale > 0.0 { slope / scale } else { 0.0 })
    };
    let gradients: Vec<DVector<f64>> = equations.iter().map(scaled).collect();
    let mean = gradients.iter().fold(DVector::zeros(count), |sum, gradient| sum + gradient) / segments;
    let squares = gradients.iter().map(|gradient| gradient - &mean).map(|rest| &rest * rest.transpose());
    squares.fold(DMatrix::zeros(count, count), |sum, square| sum + square) * (segments / (segments - 1.0))
}
