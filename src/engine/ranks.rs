//! [`Ranks`]: processes that share the samples of each mini-batch and data set.
//!
//! Every rank holds the whole state of the training and performs every update. A rank runs the
//! rollouts of its range of samples. The ranks then exchange gradients in two rounds. Each rank
//! owns a slice of the parameters. First, the owner of a slice receives its part of the sums over
//! blocks of samples. It adds the blocks in their order, so the total is bitwise that of a single
//! process. Then every rank receives the slices of the total.

use crate::engine::gradient::Gradient;
use crate::numbers::scalar::Float;
use std::fmt::Debug;
use std::ops::Range;

/// Processes that call the same functions in the same order.
pub trait Ranks: Debug + Send + Sync {
    /// Number of this process, from 0.
    fn rank(&self) -> usize;

    /// Number of processes.
    fn count(&self) -> usize;

    /// Sends message r to rank r, and returns the messages to this rank, in the order of the ranks.
    ///
    /// Returns after every rank has called the function. `messages` has one element per rank.
    fn exchange(&self, messages: &[&[u8]]) -> Vec<Vec<u8>>;
}

/// Sends a message to all ranks, and returns the messages of all ranks in their order.
pub fn gather(ranks: &dyn Ranks, message: &[u8]) -> Vec<Vec<u8>> {
    ranks.exchange(&vec![message; ranks.count()])
}

/// Returns the bytes of rank 0 on every rank. Pieces keep each exchange below 2 GiB.
pub fn broadcast(ranks: &dyn Ranks, own: &[u8]) -> Vec<u8> {
    let length = gather(ranks, &own.len().to_le_bytes()).swap_remove(0);
    let length = usize::from_le_bytes(length.try_into().expect("a rank sends one length"));
    let (piece, is_first) = ((1 << 30) / ranks.count(), ranks.rank() == 0);
    let mut bytes = Vec::with_capacity(length);
    while bytes.len() < length {
        let next = bytes.len()..length.min(bytes.len() + piece);
        bytes.extend(gather(ranks, if is_first { &own[next] } else { &[] }).swap_remove(0));
    }
    bytes
}

/// Returns whether `value` is true on some rank.
pub fn any(ranks: &dyn Ranks, value: bool) -> bool {
    gather(ranks, &[u8::from(value)]).iter().any(|message| message == &[1])
}

/// Part of a range of `count` items that belongs to a rank. The parts of all ranks are consecutive,
/// and their lengths differ by at most 1.
fn part(count: usize, rank: usize, ranks: usize) -> Range<usize> {
    count * rank / ranks..count * (rank + 1) / ranks
}

/// Samples of a rank, in blocks of `block` samples. Only the last block of all ranks may be
/// incomplete.
pub(crate) fn samples_of(samples: usize, block: usize, rank: usize, ranks: usize) -> Range<usize> {
    let Range { start, end } = part(samples.div_ceil(block), rank, ranks);
    start * block..samples.min(end * block)
}

/// Numbers of all ranks, in the order of the ranks.
pub(crate) fn gather_f64(ranks: &dyn Ranks, own: &[f64]) -> Vec<f64> {
    let bytes: Vec<u8> = own.iter().flat_map(|x| x.to_le_bytes()).collect();
    gather(ranks, &bytes)
        .concat()
        .as_chunks()
        .0
        .iter()
        .map(|&bytes| f64::from_le_bytes(bytes))
        .collect()
}

/// Sets `totals`, one per flow, to the sums over the blocks of all ranks, in order. `blocks[b][k]`
/// is the sum of block b for flow k.
pub(crate) fn add_blocks<F: Float>(
    ranks: &dyn Ranks,
    blocks: &[Vec<Gradient<F>>],
    totals: &mut [Gradient<F>],
) {
    let (params, count) = (totals[0].values().len(), ranks.count());
    let slice = |rank: usize| part(params, rank, count);
    let messages: Vec<Vec<u8>> = (0..count)
        .map(|rank| {
            let mut bytes = Vec::new();
            blocks.iter().flatten().for_each(|sum| sum.write_slice(slice(rank), &mut bytes));
            bytes
        })
        .collect();
    let received = ranks.exchange(&messages.iter().map(|message| &message[..]).collect::<Vec<_>>());
    let own = slice(ranks.rank()).len();
    let mut sums: Vec<Gradient<F>> = totals.iter().map(|_| Gradient::zeros(own)).collect();
    let mut block = Gradient::zeros(own);
    let mut is_first = true;
    for message in &received {
        let mut rest = &message[..];
        while !rest.is_empty() {
            for sum in &mut sums {
                block.read_slice(0..own, &mut rest);
                sum.set_or_add(&block, is_first);
            }
            is_first = false;
        }
    }
    let mut bytes = Vec::new();
    sums.iter().for_each(|sum| sum.write_slice(0..own, &mut bytes));
    for (rank, message) in gather(ranks, &bytes).iter().enumerate() {
        let mut rest = &message[..];
        totals.iter_mut().for_each(|total| total.read_slice(slice(rank), &mut rest));
    }
}
