//! Linear least squares of one iteration: eliminates the initial states of all windows.
//!
//! The unknowns are the steps δs_k of the initial states and δq of the shared parameters. The rows
//! are residuals of samples, and weighted continuity conditions:
//!
//! ```text
//! Φ_k δs_k + Γ_k δq + c_k = δs_{k+1}
//! ```
//!
//! Φ_k and Γ_k are the derivatives of the end of window k with respect to its initial state and the
//! parameters. c_k is the jump from this end to the next window. Householder transformations
//! eliminate δs_0, δs_1, … in this order. Condensing (Bock 1981, doi:10.1007/978-3-642-68220-9_8)
//! eliminates δs_1, δs_2, … by products Φ_k … Φ_0 instead, which grow exponentially along an
//! unstable trajectory.

use nalgebra::{DMatrix, DVector};

/// A linearized window, with columns `[δs_k | δq | 1]`. Without δs_k if the initial state is known.
pub(super) struct Linearized {
    /// Residuals of the samples and their derivatives, as the factor R of a QR factorization.
    pub samples: DMatrix<f64>,
    /// End of the window minus the initial state of the next one. Without rows in the last window.
    pub jump: DMatrix<f64>,
    /// Largest absolute derivative of the states of the window by each δs_k and δq. NaN if one of
    /// them is non-finite.
    pub slopes: Vec<f64>,
}

impl Linearized {
    /// Returns whether all residuals and derivatives are finite.
    pub fn is_finite(&self) -> bool {
        self.samples.iter().chain(&self.jump).all(|number| number.is_finite())
    }
}

/// Triangular equations of a segment.
pub(super) struct Eliminated {
    /// Rows for each δs_k, with columns `[δs_k | δs_{k+1} | δq | 1]`. Without δs_{k+1} in the last
    /// window.
    windows: Vec<DMatrix<f64>>,
    /// Remaining rows, with columns `[δq | 1]`.
    pub reduced: DMatrix<f64>,
}

/// Weight of the continuity conditions and damping of the steps.
#[derive(Clone, Copy)]
pub(super) struct Weights<'a> {
    /// 1 / σ of each state component.
    pub per_noise: &'a [f64],
    pub continuity: f64,
    /// Factor of `diag(JᵀJ)` in the method of Levenberg and Marquardt.
    pub damping: f64,
}

impl Eliminated {
    /// Eliminates the windows of a segment.
    pub fn new(windows: &[Linearized], params: usize, weights: Weights<'_>) -> Self {
        let mut carried =
            DMatrix::zeros(0, windows.first().map_or(params + 1, |window| window.samples.ncols()));
        let mut eliminated = Vec::with_capacity(windows.len());
        for Linearized { samples, jump, .. } in windows {
            let (own, next) = (samples.ncols() - params - 1, jump.nrows());
            let parts = [jump, &carried, samples];
            let rows = own + parts.iter().map(|part| part.nrows()).sum::<usize>();
            let mut all = DMatrix::zeros(rows, own + next + params + 1);
            let mut first = 0;
            for part in parts {
                all.view_mut((first, 0), (part.nrows(), own)).copy_from(&part.columns(0, own));
                all.view_mut((first, own + next), (part.nrows(), params + 1))
                    .copy_from(&part.columns(own, params + 1));
                first += part.nrows();
            }
            for i in 0..next {
                all[(i, own + i)] = -1.0;
                all.row_mut(i).scale_mut(weights.continuity * weights.per_noise[i]);
            }
            // Adds the weight of one sample, so that states without samples are damped too.
            for i in 0..own {
                all[(first + i, i)] =
                    weights.damping.sqrt() * samples.column(i).norm().hypot(weights.per_noise[i]);
            }
            let all = triangle(all);
            eliminated.push(all.rows(0, own).into_owned());
            carried = all.view((own, own), (all.nrows() - own, all.ncols() - own)).into_owned();
        }
        Self { windows: eliminated, reduced: carried }
    }

    /// Steps of the initial states for the step `params` of the parameters. The step of a known
    /// initial state is empty. `None` for singular equations.
    pub fn starts(&self, params: &DVector<f64>) -> Option<Vec<DVector<f64>>> {
        let mut steps: Vec<DVector<f64>> = Vec::with_capacity(self.windows.len());
        for rows in self.windows.iter().rev() {
            let own = rows.nrows();
            let next = rows.ncols() - own - params.len() - 1;
            let mut right =
                rows.column(rows.ncols() - 1) + rows.columns(own + next, params.len()) * params;
            if let Some(step) = steps.last().filter(|_| next > 0) {
                right += rows.columns(own, next) * step;
            }
            steps.push(-rows.columns(0, own).solve_upper_triangular(&right)?);
        }
        steps.reverse();
        Some(steps)
    }
}

/// Derivatives of the samples of a segment without jumps with respect to its initial state, as the
/// factor R of a QR factorization. Without columns for a known initial state. The derivatives grow
/// along an unstable trajectory, and can overflow.
pub(super) fn start_rows(windows: &[Linearized], params: usize) -> DMatrix<f64> {
    let mut rows = DMatrix::zeros(0, 0);
    for Linearized { samples, jump, .. } in windows.iter().rev() {
        let own = samples.ncols() - params - 1;
        // Without a next window, there are no rows.
        let later =
            if rows.is_empty() { DMatrix::zeros(0, own) } else { rows * jump.columns(0, own) };
        let mut all = DMatrix::zeros(samples.nrows() + later.nrows(), own);
        all.rows_mut(0, samples.nrows()).copy_from(&samples.columns(0, own));
        all.rows_mut(samples.nrows(), later.nrows()).copy_from(&later);
        rows = triangle(all);
    }
    rows
}

/// Equations of the parameters from all segments, with columns `[δq | 1]`.
pub(super) fn stacked(segments: &[Eliminated], params: usize) -> DMatrix<f64> {
    let rows = segments.iter().map(|segment| segment.reduced.nrows()).sum();
    let mut all = DMatrix::zeros(rows, params + 1);
    let mut first = 0;
    for Eliminated { reduced, .. } in segments {
        all.rows_mut(first, reduced.nrows()).copy_from(reduced);
        first += reduced.nrows();
    }
    triangle(all)
}

/// Gradient of half the sum of squares at δq = 0.
pub(super) fn gradient(equations: &DMatrix<f64>) -> DVector<f64> {
    let params = equations.ncols() - 1;
    equations.columns(0, params).tr_mul(&equations.column(params))
}

/// Step of the parameters, damped in proportion to the norms of their columns. `fixed` contains the
/// steps that are known in advance. `None` for singular equations.
pub(super) fn solve(
    equations: &DMatrix<f64>,
    fixed: &[Option<f64>],
    norms: &[f64],
    damping: f64,
) -> Option<DVector<f64>> {
    let free: Vec<usize> = (0..fixed.len()).filter(|&i| fixed[i].is_none()).collect();
    let rows = equations.nrows();
    let mut step = DVector::from_fn(fixed.len(), |i, _| fixed[i].unwrap_or(0.0));
    let right = equations.column(fixed.len()) + equations.columns(0, fixed.len()) * &step;
    let mut all = DMatrix::zeros(rows + free.len(), free.len() + 1);
    for (column, &i) in free.iter().enumerate() {
        all.view_mut((0, column), (rows, 1)).copy_from(&equations.column(i));
        // A parameter without influence does not move.
        all[(rows + column, column)] = damping.sqrt() * if norms[i] > 0.0 { norms[i] } else { 1.0 };
    }
    all.view_mut((0, free.len()), (rows, 1)).copy_from(&right);
    let all = triangle(all);
    let solved = all
        .view((0, 0), (free.len(), free.len()))
        .solve_upper_triangular(&all.view((0, free.len()), (free.len(), 1)))?;
    free.iter().zip(solved.iter()).for_each(|(&i, solved)| step[i] = -solved);
    Some(step)
}

/// Upper triangular factor R of the QR factorization. R preserves the norms and inner products of
/// the columns.
pub(super) fn triangle(rows: DMatrix<f64>) -> DMatrix<f64> {
    if rows.is_empty() { rows } else { rows.qr().unpack_r() }
}
