//! One convolution as matrix products, and where its numbers are in the padded buffers.

use super::KERNEL;
use crate::numbers::kernels::Level;
use crate::numbers::kernels::elementwise::{self, Strided};
use crate::numbers::kernels::gemm::Product;
use crate::numbers::scalar::Float;
use crate::numbers::zip::zip;

/// One convolution, and where its numbers are.
#[derive(Clone, Copy, Debug)]
pub struct Layer {
    /// Channels of the input.
    pub channels: usize,
    /// Numbers from one position of the input to the next: the channels, a constant 1, padding.
    pub slot: usize,
    /// Positions of the output.
    pub positions: usize,
    /// Positions of the output that a column has room for.
    pub room: usize,
    /// Numbers from one position of the output to the next.
    pub slot_out: usize,
    /// Start in `θ`.
    pub theta: usize,
    /// Start of the weights, one column of filters per entry of a window.
    pub packed: usize,
    /// From one column of the weights to the next.
    pub lda: usize,
    /// Start of their transpose, one column of window entries per filter.
    pub transposed: usize,
    /// From one column of the transpose to the next: the entries that have a cotangent, padded.
    pub entries: usize,
}

impl Layer {
    /// Entries of a window that have a weight or lie between those that have; the last is the constant 1 of the bias.
    pub fn depth(&self) -> usize {
        (KERNEL - 1) * self.slot + self.channels + 1
    }

    /// From one window to the next.
    pub fn stride(&self) -> usize {
        2 * self.slot
    }

    /// Numbers in a column of the input.
    pub fn input(&self) -> usize {
        self.room * self.stride()
    }

    /// Numbers in a column of the output.
    pub fn output(&self) -> usize {
        self.room * self.slot_out
    }

    /// Windows of so many neighbouring columns, from the first to the last that is wholly within its column.
    pub fn windows(&self, columns: usize) -> usize {
        (columns - 1) * self.room + self.positions
    }

    /// Where entry `j` of a window is in `θ`, for the first filter.
    pub fn weight(&self, j: usize, width: usize) -> Option<usize> {
        let (k, channel) = (j / self.slot, j % self.slot);
        let row = if j + 1 == self.depth() {
            KERNEL * self.channels
        } else if channel < self.channels {
            k * self.channels + channel
        } else {
            return None;
        };
        Some(self.theta + row * width)
    }

    /// `z = W·windows`, tanh, constant ones; zero where a position has no window of its own column.
    pub fn convolve<F: Float>(&self, level: Level, width: usize, packed: &[F], input: &[F], output: &mut [F], columns: usize) {
        F::product(
            level,
            Product {
                rows: self.slot_out,
                depth: self.depth(),
                cols: self.windows(columns),
                a: &packed[self.packed..],
                lda: self.lda,
                b: input,
                b_row: 1,
                b_col: self.stride(),
                c: output,
                ldc: self.slot_out,
                accumulate: false,
            },
        );
        let len = self.positions * self.slot_out;
        elementwise::tanh(level, output, Strided { first: 0, step: self.output(), count: columns, len });
        for column in output.chunks_exact_mut(self.output()).take(columns) {
            let (inside, outside) = column.split_at_mut(len);
            inside.chunks_exact_mut(self.slot_out).for_each(|position| position[width] = F::one());
            outside.fill(F::zero());
        }
    }

    /// The cotangents of the windows of so many columns: `Wᵀ z_bar`.
    pub fn windows_bar<F: Float>(&self, level: Level, width: usize, packed: &[F], bar: &[F], columns: usize, windows: &mut [F]) {
        F::product(
            level,
            Product {
                rows: self.entries,
                depth: width,
                cols: self.windows(columns),
                a: &packed[self.transposed..],
                lda: self.entries,
                b: bar,
                b_row: 1,
                b_col: self.slot_out,
                c: windows,
                ldc: self.entries,
                accumulate: false,
            },
        );
    }

    /// Adds the windows of one column to the positions they came from, `slot` numbers apart.
    pub fn add_windows<F: Float>(&self, windows: &[F], slot: usize, to: &mut [F]) {
        for (q, window) in windows.chunks_exact(self.entries).take(self.positions).enumerate() {
            for k in 0..KERNEL {
                let from = &window[k * self.slot..][..self.channels];
                for (to, &bar) in zip(to[(2 * q + k) * slot..][..self.channels].iter_mut(), from) {
                    *to += bar;
                }
            }
        }
    }
}
