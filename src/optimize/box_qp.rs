//! [`BoxQp`]: quadratic program with bounds, by a projected Newton method.
//!
//! Bertsekas 1982, doi:10.1137/0320018; Tassa, Mansard and Todorov 2014,
//! doi:10.1109/ICRA.2014.6907001.

use nalgebra::{Cholesky, DMatrix, DVector, Dyn};

/// Solution of `min_d dᵀ Q d / 2 + qᵀ d` with `low <= d <= high`.
pub(super) struct BoxQp {
    /// Minimizer d.
    pub(super) solution: DVector<f64>,
    /// Components except those at a bound with a descent direction that points outside.
    free: Vec<usize>,
    /// Factor of the free rows and columns of Q.
    factor: Cholesky<f64, Dyn>,
}

/// Largest number of Newton steps. The free set of a convex problem rarely changes more often than
/// the problem has components.
const MOST_STEPS: usize = 100;

/// Fraction of a Newton step below which the line search ends.
const SMALLEST: f64 = 1e-12;

/// Required decrease of a Newton step, as a fraction of the first-order prediction.
const SUFFICIENT: f64 = 0.1;

impl BoxQp {
    /// Solves the program. The bounds contain 0. Returns `None` if Q is not positive definite on
    /// the free components.
    pub(super) fn solve(
        hessian: &DMatrix<f64>,
        gradient: &DVector<f64>,
        bounds: &[[f64; 2]],
    ) -> Option<Self> {
        let value = |d: &DVector<f64>| d.dot(&(hessian * d * 0.5 + gradient));
        let mut solution = DVector::zeros(gradient.len());
        let mut free = free_components(&solution, gradient, bounds);
        let mut factor = restricted(hessian, &free)?;
        for _ in 0..MOST_STEPS {
            let slope = gradient + hessian * &solution;
            let step = -factor.solve(&slope.select_rows(&free));
            let (mut size, before) = (1.0, value(&solution));
            let moved = loop {
                let moved = moved(&solution, &free, &step, size, bounds);
                let enough =
                    before - value(&moved) >= SUFFICIENT * slope.dot(&(&solution - &moved));
                if enough || size < SMALLEST {
                    break moved;
                }
                size *= 0.5;
            };
            solution = moved;
            let now_free = free_components(&solution, &(gradient + hessian * &solution), bounds);
            // A full Newton step within the bounds is exact for its free set. A full step that the
            // bounds clamp changes the free set: the slope then points out of at least one of them.
            if now_free == free && size == 1.0 {
                break;
            }
            if now_free != free {
                factor = restricted(hessian, &now_free)?;
                free = now_free;
            }
        }
        Some(Self { solution, free, factor })
    }

    /// Returns the gains `-Q⁻¹ c` for a gradient `q = c x`, with Q and c restricted to the free
    /// components. The rows of the other components are 0.
    pub(super) fn gains(&self, cross: &DMatrix<f64>) -> DMatrix<f64> {
        let mut gains = DMatrix::zeros(cross.nrows(), cross.ncols());
        let of_free = -self.factor.solve(&cross.select_rows(&self.free));
        for (row, &i) in self.free.iter().enumerate() {
            gains.set_row(i, &of_free.row(row));
        }
        gains
    }
}

/// Returns the components except those at a bound with a descent direction that points outside.
fn free_components(d: &DVector<f64>, slope: &DVector<f64>, bounds: &[[f64; 2]]) -> Vec<usize> {
    let at_active_bound = |i: usize| {
        (d[i] <= bounds[i][0] && slope[i] > 0.0) || (d[i] >= bounds[i][1] && slope[i] < 0.0)
    };
    (0..d.len()).filter(|&i| !at_active_bound(i)).collect()
}

/// Returns the Cholesky factor of the rows and columns `free`, or `None` if they are not positive
/// definite.
fn restricted(hessian: &DMatrix<f64>, free: &[usize]) -> Option<Cholesky<f64, Dyn>> {
    hessian.select_rows(free).select_columns(free).cholesky()
}

/// Moves the free components by `size` times `step` and clamps them.
fn moved(
    d: &DVector<f64>,
    free: &[usize],
    step: &DVector<f64>,
    size: f64,
    bounds: &[[f64; 2]],
) -> DVector<f64> {
    let mut moved = d.clone();
    for (&i, step) in free.iter().zip(step.iter()) {
        moved[i] = (d[i] + size * step).max(bounds[i][0]).min(bounds[i][1]);
    }
    moved
}
