//! Normal equations of a least-squares problem with shared parameters and windows.

use nalgebra::{DMatrix, DVector};

/// Normal equations of one window: `Jᵀ J` and `Jᵀ r`, for shared parameters q and its initial
/// state s.
pub(super) struct Block {
    pub qq: DMatrix<f64>,
    pub qs: DMatrix<f64>,
    pub ss: DMatrix<f64>,
    pub q: DVector<f64>,
    pub s: DVector<f64>,
}

impl Block {
    pub fn zeros(params: usize, states: usize) -> Self {
        Self {
            qq: DMatrix::zeros(params, params),
            qs: DMatrix::zeros(params, states),
            ss: DMatrix::zeros(states, states),
            q: DVector::zeros(params),
            s: DVector::zeros(states),
        }
    }

    /// Adds a residual with its derivatives by q and s.
    pub fn add(&mut self, residual: f64, slopes: &[f64]) {
        let (q, s) = slopes.split_at(self.q.len());
        for i in 0..q.len() {
            self.q[i] += q[i] * residual;
            for j in 0..q.len() {
                self.qq[(i, j)] += q[i] * q[j];
            }
            for (j, by_j) in s.iter().enumerate() {
                self.qs[(i, j)] += q[i] * by_j;
            }
        }
        for (i, by_i) in s.iter().enumerate() {
            self.s[i] += by_i * residual;
            for (j, by_j) in s.iter().enumerate() {
                self.ss[(i, j)] += by_i * by_j;
            }
        }
    }
}

/// Step of the parameters, and of the initial state of each window.
pub(super) struct Step {
    pub q: DVector<f64>,
    pub s: Vec<DVector<f64>>,
}

/// Solves `(JᵀJ + damping diag(JᵀJ)) δ = -Jᵀr`. Parameters that are not `free` do not move.
///
/// Schur complements eliminate the initial states. Returns `None` for a singular matrix.
pub(super) fn solve(blocks: &[Block], free: &[bool], damping: f64) -> Option<Step> {
    let damped = |matrix: &DMatrix<f64>| {
        let mut damped = matrix.clone();
        for i in 0..matrix.nrows() {
            damped[(i, i)] += damping * matrix[(i, i)];
        }
        damped
    };
    let (mut matrix, mut right) = sum(blocks);
    matrix = damped(&matrix);
    let mut inner = Vec::with_capacity(blocks.len());
    for block in blocks {
        let factor = damped(&block.ss).cholesky();
        if block.s.is_empty() {
            inner.push(None);
            continue;
        }
        let factor = factor?;
        matrix -= &block.qs * factor.solve(&block.qs.transpose());
        right -= &block.qs * factor.solve(&block.s);
        inner.push(Some(factor));
    }
    for (i, &free) in free.iter().enumerate() {
        if !free {
            matrix.row_mut(i).fill(0.0);
            matrix.column_mut(i).fill(0.0);
            matrix[(i, i)] = 1.0;
            right[i] = 0.0;
        }
    }
    let q = -matrix.cholesky()?.solve(&right);
    let s = blocks.iter().zip(&inner).map(|(block, factor)| match factor {
        Some(factor) => -factor.solve(&(&block.s + block.qs.transpose() * &q)),
        None => DVector::zeros(0),
    });
    let s = s.collect();
    Some(Step { q, s })
}

/// Information matrix of the parameters, with the initial states eliminated: the inverse of their
/// covariance at unit noise.
pub(super) fn information(blocks: &[Block]) -> DMatrix<f64> {
    let (mut matrix, _) = sum(blocks);
    for block in blocks.iter().filter(|block| !block.s.is_empty()) {
        if let Some(factor) = block.ss.clone().cholesky() {
            matrix -= &block.qs * factor.solve(&block.qs.transpose());
        }
    }
    matrix
}

fn sum(blocks: &[Block]) -> (DMatrix<f64>, DVector<f64>) {
    let params = blocks.first().map_or(0, |block| block.q.len());
    let zeros = (DMatrix::zeros(params, params), DVector::zeros(params));
    blocks.iter().fold(zeros, |(matrix, right), block| (matrix + &block.qq, right + &block.q))
}
