//! Blocks of at most eight columns, with the columns in lanes.

use super::PolicyColumns;
use crate::numbers::scalar::{Float, LANES, Lane, Lanes, Real};
use crate::numbers::zip::zip;

/// Numbers of the columns `at`, `n` per column. Unused lanes repeat the last column.
pub(super) fn gathered<F: Float>(
    columns: &[F],
    n: usize,
    at: PolicyColumns,
) -> impl Iterator<Item = Lane<F>> {
    let column = move |lane: usize| at.first + lane.min(at.count - 1) * at.step;
    (0..n).map(move |i| {
        let mut numbers = Lanes([F::zero(); LANES]);
        (0..LANES).for_each(|lane| numbers.set_lane(lane, columns[column(lane) * n + i]));
        numbers
    })
}

/// Replaces `block` by the [`gathered`] numbers of the columns `at`.
pub(crate) fn gather<F: Float>(
    columns: &[F],
    n: usize,
    at: PolicyColumns,
    block: &mut Vec<Lane<F>>,
) {
    block.clear();
    block.extend(gathered(columns, n, at));
}

/// Copies the numbers of a block to its columns `at`.
pub(crate) fn scatter<F: Float>(block: &[Lane<F>], at: PolicyColumns, columns: &mut [F]) {
    for (lane, c) in at.iter().enumerate() {
        for (number, lanes) in zip(columns[c * block.len()..][..block.len()].iter_mut(), block) {
            *number = lanes.lane(lane);
        }
    }
}
