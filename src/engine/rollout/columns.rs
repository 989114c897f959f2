//! Conversion between blocks of lanes and policy columns.

use crate::numbers::scalar::{Float, LANES, Lane, Real};
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
    (0..samples).flat_map(|sample| (0..n).map(move |i| (sample, i))).find(|&(sample, i)| {
        !lane(&blocks[(sample / LANES) * n + i], sample % LANES).as_().is_finite()
    })
}

/// Copies blocks of lanes, `n` numbers per sample, to the entries `offset .. offset + n` of policy
/// columns of length `stride`.
pub(crate) fn gather<L, F: Float>(
    blocks: &[L],
    lane: impl Fn(&L, usize) -> F,
    n: usize,
    at: PolicyColumns,
    columns: &mut [F],
    (offset, stride): (usize, usize),
) {
    // Without components, `blocks` is empty. A chunk length of 0 would panic.
    for (block, at) in zip(blocks.chunks_exact(n.max(1)), at.blocks(LANES)) {
        for (index, c) in at.iter().enumerate() {
            for (column, lanes) in zip(columns[c * stride + offset..][..n].iter_mut(), block) {
                *column = lane(lanes, index);
            }
        }
    }
}

/// Copies the entries `offset .. offset + n` of policy columns of length `stride` to blocks of
/// lanes. Unused lanes repeat the last sample.
pub(crate) fn scatter<F: Float>(
    columns: &[F],
    (offset, stride): (usize, usize),
    n: usize,
    at: PolicyColumns,
    blocks: &mut [Lane<F>],
) {
    // Without components, `blocks` is empty. A chunk length of 0 would panic.
    for (b, block) in blocks.chunks_exact_mut(n.max(1)).enumerate() {
        for lane in 0..LANES {
            let sample = (b * LANES + lane).min(at.count - 1);
            let c = at.first + sample * at.step;
            for (lanes, &column) in zip(block.iter_mut(), &columns[c * stride + offset..][..n]) {
                lanes.set_lane(lane, column);
            }
        }
    }
}
