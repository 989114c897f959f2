//! Conversion between blocks of lanes and policy columns.

use super::{Lane, WIDTH};
use crate::numbers::scalar::{Float, Real};
use crate::numbers::zip::zip;
use crate::policy::PolicyColumns;

/// Finds the first non-finite number, ordered by sample, then by component: `(sample, component)`.
#[cold]
pub(crate) fn find_non_finite<L, F: Float>(
    blocks: &[L],
    n: usize,
    samples: usize,
    lane: impl Fn(&L, usize) -> F,
) -> Option<(usize, usize)> {
    (0..samples)
        .flat_map(|sample| (0..n).map(move |i| (sample, i)))
        .find(|&(sample, i)| !lane(&blocks[(sample / WIDTH) * n + i], sample % WIDTH).as_().is_finite())
}

/// Copies blocks of lanes to policy columns, `n` numbers per sample.
pub(crate) fn gather<L, F: Float>(blocks: &[L], lane: impl Fn(&L, usize) -> F, n: usize, at: PolicyColumns, columns: &mut [F]) {
    for (sample, c) in at.iter().enumerate() {
        let block = &blocks[(sample / WIDTH) * n..][..n];
        for (column, lanes) in zip(columns[c * n..][..n].iter_mut(), block) {
            *column = lane(lanes, sample % WIDTH);
        }
    }
}

/// Copies policy columns to blocks of lanes, `n` numbers per sample. Unused lanes repeat the last
/// sample.
pub(crate) fn scatter<F: Float>(columns: &[F], n: usize, at: PolicyColumns, blocks: &mut [Lane<F>]) {
    for (b, block) in blocks.chunks_exact_mut(n).enumerate() {
        for lane in 0..WIDTH {
            let sample = (b * WIDTH + lane).min(at.count - 1);
            let c = at.first + sample * at.step;
            for (lanes, &column) in zip(block.iter_mut(), &columns[c * n..][..n]) {
                lanes.set_lane(lane, column);
            }
        }
    }
}
