//! Exact propagation of a free particle in a box over one time step.

use super::QuantumSystem;
use super::elimination::Vector;
use super::system::STACK;
use crate::numbers::scalar::Scalar;
use crate::numbers::zip::zip;
use smallvec::SmallVec;
use std::f64::consts::PI;

/// Propagator `K = exp(i dt D₂)`, the exponential of the second difference. The eigenvectors are
/// sines. With M = grid + 1:
///
/// ```text
/// E_m = 4/dx² sin²(πm / 2M)
/// K_jk = 2/M Σ_m sin(πmj/M) sin(πmk/M) exp(-i E_m dt) = t(j - k) - t(j + k)
/// t(d) = 1/M Σ_m cos(πmd/M) exp(-i E_m dt)
/// ```
///
/// K commutes with reflection: it maps even functions to even functions and odd to odd functions. K
/// is stored as two matrices with half as many rows and columns, which halves the work.
///
/// ```text
/// a_k = ψ_k + ψ_{M-k},  b_k = ψ_k - ψ_{M-k}
/// ψ'_j, ψ'_{M-j} = Σ_k (K_jk + K_{j,M-k})/2 a_k ± Σ_k (K_jk - K_{j,M-k})/2 b_k,   j, k ≤ M/2
/// ```
///
/// For even M, the term k = M/2 of the first sum is halved, because a_k contains ψ_k twice.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Propagator {
    grid: usize,
    /// Both matrices, row by row. Each entry holds the real and imaginary parts of the even matrix,
    /// then of the odd one.
    table: Vec<[f64; 4]>,
    /// `table` in single precision, for direct loads into `f32` vector registers.
    rounded: Vec<[f32; 4]>,
}

impl Propagator {
    /// Creates the propagator for one step of `system`, in O(grid²).
    pub(super) fn new(system: &QuantumSystem) -> Self {
        let (grid, intervals) = (system.grid, system.grid + 1);
        let cosines: Vec<f64> =
            (0..2 * intervals).map(|d| Scalar::cos(PI * d as f64 / intervals as f64)).collect();
        let phase = |m: usize| {
            let sine = Scalar::sin(0.5 * PI * m as f64 / intervals as f64) / system.spacing();
            Scalar::sin_cos(-4.0 * sine * sine * system.dt)
        };
        let phases: Vec<(f64, f64)> = (1..=grid).map(phase).collect();
        let cosine_sum = |d: usize| {
            let (mut re, mut im) = (0.0, 0.0);
            for (m, (sin, cos)) in zip(1.., &phases) {
                let cosine = cosines[m * d % (2 * intervals)];
                (re, im) = (re + cosine * cos, im + cosine * sin);
            }
            [re / intervals as f64, im / intervals as f64]
        };
        let sums: Vec<[f64; 2]> = (0..2 * intervals).map(cosine_sum).collect();
        let half = grid.div_ceil(2);
        let mut table = Vec::with_capacity(half * half);
        for j in 1..=half {
            for k in 1..=half {
                let entry = |k: usize, part: usize| sums[j.abs_diff(k)][part] - sums[j + k][part];
                // The middle point is its own mirror image, so a_k contains it twice.
                let share = if 2 * k == intervals { 0.25 } else { 0.5 };
                let even = |part| share * (entry(k, part) + entry(intervals - k, part));
                let odd = |part| share * (entry(k, part) - entry(intervals - k, part));
                table.push([even(0), even(1), odd(0), odd(1)]);
            }
        }
        let rounded = table.iter().map(|entries| entries.map(|entry| entry as f32)).collect();
        Self { grid, table, rounded }
    }

    /// Computes `out ← K psi`. In both slices, real and imaginary parts alternate. With `ADJOINT`,
    /// applies the conjugate, which is the adjoint because K is symmetric.
    #[inline(always)]
    pub(super) fn apply<T: Scalar, V: Vector<T>, const ADJOINT: bool>(
        &self,
        psi: &[V],
        out: &mut [V],
    ) {
        let (n, half) = (self.grid, self.grid.div_ceil(2));
        let (psi, out) = (&psi.as_chunks::<2>().0[..n], &mut out.as_chunks_mut::<2>().0[..n]);
        let mut parts = SmallVec::<[[V; 4]; STACK / 2]>::new();
        let filler = psi[0][0];
        parts.resize(half, [filler; 4]);
        let parts = &mut parts[..];
        for k in 0..half {
            let ([re, im], [mirror_re, mirror_im]) = (psi[k], psi[n - 1 - k]);
            parts[k] = [re + mirror_re, im + mirror_im, re - mirror_re, im - mirror_im];
        }
        for j in 0..half {
            let [mut a_re, mut a_im, mut b_re, mut b_im] = self.term::<T, V, ADJOINT>(j, 0, parts);
            for k in 1..half {
                let term = self.term::<T, V, ADJOINT>(j, k, parts);
                (a_re, a_im) = (a_re + term[0], a_im + term[1]);
                (b_re, b_im) = (b_re + term[2], b_im + term[3]);
            }
            out[j] = [a_re + b_re, a_im + b_im];
            out[n - 1 - j] = [a_re - b_re, a_im - b_im];
        }
    }

    /// Returns the products of entry (j, k) of both matrices with the even and the odd part.
    #[inline(always)]
    fn term<T: Scalar, V: Vector<T>, const ADJOINT: bool>(
        &self,
        j: usize,
        k: usize,
        parts: &[[V; 4]],
    ) -> [V; 4] {
        let (place, [a_re, a_im, b_re, b_im]) = (j * parts.len() + k, parts[k]);
        // `array::map` would not be inlined.
        let (even_re, even_im, odd_re, odd_im) = if size_of::<T::Real>() == size_of::<f32>() {
            let [even_re, even_im, odd_re, odd_im] = self.rounded[place];
            (f64::from(even_re), f64::from(even_im), f64::from(odd_re), f64::from(odd_im))
        } else {
            self.table[place].into()
        };
        let (even_re, even_im) = (T::from(even_re), T::from(even_im));
        let (odd_re, odd_im) = (T::from(odd_re), T::from(odd_im));
        if ADJOINT {
            [
                a_re * even_re + a_im * even_im,
                a_im * even_re - a_re * even_im,
                b_re * odd_re + b_im * odd_im,
                b_im * odd_re - b_re * odd_im,
            ]
        } else {
            [
                a_re * even_re - a_im * even_im,
                a_im * even_re + a_re * even_im,
                b_re * odd_re - b_im * odd_im,
                b_im * odd_re + b_re * odd_im,
            ]
        }
    }
}
