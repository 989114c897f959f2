//! Numbers on their way between blocks of lanes and the policy's columns.

use super::{Lane, WIDTH};
use crate::numbers::scalar::{Float, Real};
use crate::numbers::zip::zip;
use crate::policy::PolicyColumns;

/// First non-finite number, by sample and then component.
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

/// Blocks of lanes to one column of `n` numbers per sample.
pub(crate) fn gather<L, F: Float>(blocks: &[L], lane: impl Fn(&L, usize) -> F, n: usize, at: PolicyColumns, columns: &mut [F]) {
    for (sample, c) in at.iter().enumerate() {
        let block = &blocks[(sample / WIDTH) * n..][..n];
        for (column, lanes) in zip(columns[c * n..][..n].iter_mut(), block) {
            *column = lane(lanes, sample % WIDTH);
        }
    }
}

/// One column of `n` numbers per sample to blocks of lanes; lanes without a sample repeat the last one.
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
