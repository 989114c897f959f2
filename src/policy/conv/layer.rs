//! [`Layer`]: one convolution as matrix products on padded buffers.

use super::{DEPTH, KERNEL, STRIDE};
use crate::numbers::kernels::SimdLevel;
use crate::numbers::kernels::elementwise::{self, Strided};
use crate::numbers::kernels::gemm::Product;
use crate::numbers::scalar::Float;
use crate::numbers::zip::zip;
use crate::policy::PolicyColumns;

/// Shape of one convolution, and its offsets in `θ` and in the padded buffers.
#[derive(Clone, Copy, Debug)]
pub struct Layer {
    /// Channels of the input.
    pub channels: usize,
    /// Distance between positions of the input: the channels, a constant 1, padding.
    pub slot: usize,
    /// Positions of the output.
    pub positions: usize,
    /// Capacity of an output column, in positions.
    pub capacity: usize,
    /// Distance between positions of the output.
    pub slot_out: usize,
    /// Offset in `θ`.
    pub theta: usize,
    /// Offset of the packed weights: one column of filters per window entry.
    pub packed: usize,
    /// Distance between columns of the weights.
    pub lda: usize,
    /// Offset of the transposed weights: one column of window entries per filter.
    pub transposed: usize,
    /// Distance between columns of the transpose: the window entries without the last 1, padded.
    pub entries: usize,
}

impl Layer {
    /// Length of a window, including padding between positions and the final constant 1.
    pub fn depth(&self) -> usize {
        (KERNEL - 1) * self.slot + self.channels + 1
    }

    /// Distance between windows.
    pub fn stride(&self) -> usize {
        STRIDE * self.slot
    }

    /// Length of an input column.
    pub fn input(&self) -> usize {
        self.capacity * self.stride()
    }

    /// Length of an output column.
    pub fn output(&self) -> usize {
        self.capacity * self.slot_out
    }

    /// Number of windows of `columns` contiguous columns, up to the last valid one.
    pub fn windows(&self, columns: usize) -> usize {
        (columns - 1) * self.capacity + self.positions
    }

    /// Offset in `θ` of the weight of window entry `j` for the first filter. `None` for padding and
    /// for every constant 1 except the last, which multiplies the bias.
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

    /// Writes `tanh(W·windows)` and the constant ones; 0 at positions without a valid window.
    pub fn convolve<F: Float>(
        &self,
        level: SimdLevel,
        width: usize,
        packed: &[F],
        input: &[F],
        output: &mut [F],
        columns: usize,
    ) {
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
        elementwise::tanh(
            level,
            output,
            Strided { first: 0, step: self.output(), count: columns, len },
        );
        for column in output.chunks_exact_mut(self.output()).take(columns) {
            let (inside, outside) = column.split_at_mut(len);
            inside.chunks_exact_mut(self.slot_out).for_each(|position| position[width] = F::one());
            outside.fill(F::zero());
        }
    }

    /// Writes the cotangents of the windows of `columns` columns, `Wᵀ z_bar`.
    pub fn windows_bar<F: Float>(
        &self,
        level: SimdLevel,
        width: usize,
        packed: &[F],
        bar: &[F],
        columns: usize,
        windows: &mut [F],
    ) {
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

    /// Writes the gradient of the padded weights, one column of filters per window entry, to the
    /// start of `scratch`. The rest of `scratch` receives the factors scaled by `weight`.
    #[inline(always)]
    pub fn weight_gradient<F: Float>(
        &self,
        level: SimdLevel,
        at: PolicyColumns,
        input: &[F],
        bar: &[F],
        weight: Option<&[F]>,
        scratch: &mut [F],
    ) {
        let (sum, scaled) = scratch.split_at_mut(self.slot_out * self.depth());
        for block in at.blocks(DEPTH.max(self.capacity) / self.capacity) {
            let columns = block.as_range();
            let mut input = &input[columns.start * self.input()..columns.end * self.input()];
            let mut bar = &bar[columns.start * self.output()..columns.end * self.output()];
            if let Some(weight) = weight {
                // Scales the smaller factor.
                let smaller = self.input().min(self.output());
                let factor = if self.output() <= self.input() { &mut bar } else { &mut input };
                elementwise::scale(level, factor, &weight[columns], smaller, scaled);
                *factor = &scaled[..block.count * smaller];
            }
            F::product(
                level,
                Product {
                    rows: self.slot_out,
                    depth: self.windows(block.count),
                    cols: self.depth(),
                    a: bar,
                    lda: self.slot_out,
                    b: input,
                    b_row: self.stride(),
                    b_col: 1,
                    c: sum,
                    ldc: self.slot_out,
                    accumulate: block.first != at.first,
                },
            );
        }
    }

    /// Adds the window cotangents of one column to the cotangents of its input positions. `slot` is
    /// the distance between positions in `to`.
    pub fn add_windows<F: Float>(&self, windows: &[F], slot: usize, to: &mut [F]) {
        for (q, window) in windows.chunks_exact(self.entries).take(self.positions).enumerate() {
            for k in 0..KERNEL {
                let from = &window[k * self.slot..][..self.channels];
                for (to, &bar) in
                    zip(to[(STRIDE * q + k) * slot..][..self.channels].iter_mut(), from)
                {
                    *to += bar;
                }
            }
        }
    }
}
