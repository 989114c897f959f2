//! Memory layout of [`Conv`]: positions, weights in `θ` and in packed form, activations and
//! cotangents.

use super::layer::Layer;
use super::{BLOCK, CHANNELS, Conv, KERNEL, STRIDE};
use crate::numbers::scalar::Float;

/// Layout of the tape: the activations of one block, then those of all columns.
pub(super) struct Places {
    /// Offsets of the columns of x, h₁, h₂ of one block.
    pub(super) block: [usize; 3],
    /// Offsets of the columns of x, h₁, h₂ of the whole rollout.
    pub(super) all: [usize; 3],
    /// Length of the tape.
    pub(super) len: usize,
}

/// Rounds `n` up to a multiple of the entries per cache line.
fn padded<F: Float>(n: usize) -> usize {
    n.next_multiple_of(F::PAD)
}

impl Conv {
    /// Number of positions of x, h₁, h₂.
    pub(super) fn positions(&self) -> [usize; 3] {
        let next = |positions: usize| (positions - KERNEL) / STRIDE + 1;
        [self.grid, next(self.grid), next(next(self.grid))]
    }

    pub(super) fn layers<F: Float>(&self) -> [Layer; 2] {
        let [grid, first, second] = self.positions();
        let capacity = grid.div_ceil(4);
        let slot = padded::<F>(self.width + 1);
        // An odd number of cache lines: adjacent columns do not map to the same cache sets.
        let lda = ((slot / F::PAD) | 1) * F::PAD;
        let mut one = Layer {
            channels: CHANNELS,
            slot: CHANNELS + 1,
            positions: first,
            capacity: 2 * capacity,
            slot_out: slot,
            theta: 0,
            packed: 0,
            lda,
            transposed: 0,
            entries: 0,
        };
        let mut two = Layer { channels: self.width, slot, positions: second, capacity, ..one };
        let mut end = 0;
        for layer in [&mut one, &mut two] {
            layer.packed = end;
            layer.transposed = layer.packed + layer.depth() * lda;
            layer.entries = padded::<F>(layer.depth() - 1);
            end = layer.transposed + self.width * layer.entries;
        }
        two.theta = (KERNEL * CHANNELS + 1) * self.width;
        [one, two]
    }

    /// Offset of the output weights in `θ`.
    pub(super) fn dense(&self) -> usize {
        (KERNEL * CHANNELS + 1) * self.width + (KERNEL * self.width + 1) * self.width
    }

    /// Offset of the packed output weights. They have the layout of a column of h₂, and end the
    /// buffer.
    pub(super) fn packed_dense(&self, two: &Layer) -> usize {
        two.transposed + self.width * two.entries
    }

    pub(super) fn places<F: Float>(&self, [one, two]: &[Layer; 2], total: usize) -> Places {
        let lens = [one.input(), one.output(), two.output()];
        let mut end = 0;
        let mut place = |columns: usize| {
            // Order h₁, h₂, x: the forward pass splits the tape at these offsets.
            let mut starts = [0; 3];
            for i in [1, 2, 0] {
                starts[i] = end;
                end += padded::<F>(columns * lens[i]);
            }
            starts
        };
        let (block, all) = (place(BLOCK), place(total));
        Places { block, all, len: end }
    }

    /// Offsets of the cotangents of h₁ and h₂ in all columns, and the total length.
    ///
    /// The buffer begins with the window cotangents of one block.
    pub(super) fn places_bar([one, two]: &[Layer; 2], total: usize) -> [usize; 3] {
        let windows = [one, two].map(|l| BLOCK * l.capacity * l.entries);
        let first = windows[0].max(windows[1]);
        let second = first + total * one.output();
        [first, second, second + total * two.output()]
    }
}
