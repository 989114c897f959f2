//! [`Matrix`]: a symmetric matrix whose entries follow the chains of a tree, and its factors.

use crate::spatial::Linear;
use crate::tree::NONE;
use physgrad::Scalar;

/// Symmetric matrix of the degrees of freedom, or its factors `Lᵀ D L`. Only entries (k, j) with j
/// on the chain from k to the root are stored. Without fill-in, factors have the same entries.
/// Source: R. Featherstone, Rigid Body Dynamics Algorithms, section 6.5.
#[derive(Clone, Debug)]
pub(crate) struct Matrix<T> {
    n: usize,
    entries: Vec<T>,
    /// Reciprocals of D.
    reciprocals: Vec<T>,
}

impl<T> Default for Matrix<T> {
    fn default() -> Self {
        Self { n: 0, entries: Vec::new(), reciprocals: Vec::new() }
    }
}

impl<T: Scalar> Matrix<T> {
    pub(crate) fn resize(&mut self, n: usize) {
        self.n = n;
        self.entries.resize(n * n, T::zero());
        self.reciprocals.resize(n, T::zero());
    }

    #[inline(always)]
    pub(crate) fn at(&self, k: usize, j: usize) -> T {
        self.entries[k * self.n + j]
    }

    #[inline(always)]
    pub(crate) fn at_mut(&mut self, k: usize, j: usize) -> &mut T {
        &mut self.entries[k * self.n + j]
    }

    /// Copies a matrix on the chains of `parent`. Entries of `chains` beyond them become 0.
    #[inline(always)]
    pub(crate) fn copy(&mut self, from: &Self, parent: &[usize], chains: Chains<'_>) {
        if let Chains::All = chains {
            for k in 0..self.n {
                for j in 0..k {
                    *self.at_mut(k, j) = T::zero();
                }
            }
        }
        for k in 0..self.n {
            let mut j = k;
            while j != NONE {
                *self.at_mut(k, j) = from.at(k, j);
                j = parent[j];
            }
        }
    }

    /// Product with a vector.
    #[inline(always)]
    pub(crate) fn times<X: Linear<T>>(&self, parent: &[usize], x: &[X], out: &mut [X]) {
        for k in 0..self.n {
            out[k] = x[k] * self.at(k, k);
        }
        for k in 0..self.n {
            let mut j = parent[k];
            while j != NONE {
                let m = self.at(k, j);
                out[k] += x[j] * m;
                out[j] += x[k] * m;
                j = parent[j];
            }
        }
    }

    /// Replaces the matrix by its factors.
    #[inline(always)]
    pub(crate) fn factor(&mut self, parent: &[usize]) {
        self.factor_along(Chains::Tree(parent));
    }

    #[inline(always)]
    pub(crate) fn factor_along(&mut self, chains: Chains<'_>) {
        for k in (0..self.n).rev() {
            let d = self.at(k, k).recip();
            self.reciprocals[k] = d;
            let mut i = chains.after(k);
            while i != NONE {
                let a = self.at(k, i) * d;
                let mut j = i;
                while j != NONE {
                    let by = a * self.at(k, j);
                    *self.at_mut(i, j) -= by;
                    j = chains.after(j);
                }
                *self.at_mut(k, i) = a;
                i = chains.after(i);
            }
        }
    }

    /// Replaces `x` by the solution for the right-hand side `x`, from the factors.
    #[inline(always)]
    pub(crate) fn solve<X: Linear<T>>(&self, parent: &[usize], x: &mut [X]) {
        self.solve_along(Chains::Tree(parent), x);
    }

    #[inline(always)]
    pub(crate) fn solve_along<X: Linear<T>>(&self, chains: Chains<'_>, x: &mut [X]) {
        for k in (0..self.n).rev() {
            let mut j = chains.after(k);
            while j != NONE {
                let by = x[k] * self.at(k, j);
                x[j] += -by;
                j = chains.after(j);
            }
        }
        for k in 0..self.n {
            x[k] = x[k] * self.reciprocals[k];
            let mut j = chains.after(k);
            while j != NONE {
                let by = x[j] * self.at(k, j);
                x[k] += -by;
                j = chains.after(j);
            }
        }
    }
}

/// Entries of a matrix that may differ from 0.
#[derive(Clone, Copy, Debug)]
pub(crate) enum Chains<'a> {
    /// Those of a tree: the parent of each degree of freedom.
    Tree(&'a [usize]),
    /// All: contacts couple different branches.
    All,
}

impl Chains<'_> {
    /// The next index towards the root.
    #[inline(always)]
    fn after(&self, k: usize) -> usize {
        match self {
            Self::Tree(parent) => parent[k],
            // 0 - 1 is `NONE`.
            Self::All => k.wrapping_sub(1),
        }
    }
}
