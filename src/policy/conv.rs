//! [`Conv`]: a convolutional policy for a two-channel field on a one-dimensional grid, such as a
//! wave function.
//!
//! `θ` holds weights and bias of two convolutions and of the linear output, in the order of Keras.
//!
//! A convolution is one matrix product. Activations are stored position by position, so the window
//! of an output is a contiguous slice of the input. The windows of adjacent columns form one matrix
//! with a fixed stride.
//!
//! A column has twice the capacity of a column of the next layer, in positions, so the stride
//! continues across columns. The forward pass sets outputs to 0 if their window extends beyond the
//! last position of its column. A constant 1 follows the channels of every position. The last
//! constant 1 of a window multiplies the bias.

mod layer;
mod layout;

use super::{
    Action, Activation, LayerKind, NetworkLayer, Observed, Policy, PolicyColumns, PolicyPass,
    PolicyRecord, Sizes, Tensor,
};
use crate::numbers::kernels::SimdLevel;
use crate::numbers::kernels::elementwise::{self, Strided};
use crate::numbers::kernels::gemm::Product;
use crate::numbers::rng::Rng;
use crate::numbers::scalar::{Float, Scalar};
use crate::numbers::zip::zip;
use layer::Layer;
use rand::RngExt;

/// Columns per block. A block passes all layers while its activations stay in the cache.
const BLOCK: usize = 8;
/// Approximate number of windows per matrix product in the weight gradient.
const DEPTH: usize = 64;
/// Kernel size, in positions.
const KERNEL: usize = 3;
/// Distance between windows, in positions.
const STRIDE: usize = 2;
/// Channels of the observation: real and imaginary parts of a wave function.
const CHANNELS: usize = 2;

/// Two tanh convolutions and a linear output: maps an observation x (grid × 2) to one control.
///
/// ```text
/// h₁[q, f] = tanh(b₁[f] + Σ_{k,c} x[2q + k, c] W₁[k, c, f])       q ≤ (grid - 3)/2
/// h₂[q, f] = tanh(b₂[f] + Σ_{k,c} h₁[2q + k, c] W₂[k, c, f])      k < 3, f < width, no padding
/// u        = b₃ + Σ_{q,c} h₂[q, c] W₃[q, c]
/// ```
///
/// The quantum task of the source paper (ICLR 2024) uses 32 grid points, hence 15 and 7 positions,
/// and width 60. Initial weights are Glorot-uniform with the fans of Keras; initial biases are 0.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Conv {
    grid: usize,
    width: usize,
    zero_init_output: bool,
}

impl Conv {
    /// A policy for an observation of `grid` points with two channels, with `width` filters per
    /// convolution.
    ///
    /// # Panics
    /// If `grid < 7`, which leaves no position after two convolutions, or if `width` is 0.
    #[track_caller]
    pub fn new(grid: usize, width: usize) -> Self {
        assert!(
            grid >= 7,
            "two convolutions of kernel size 3 and stride 2 need at least 7 grid points, not {grid}"
        );
        assert!(width > 0, "a convolution needs at least one filter");
        Self { grid, width, zero_init_output: false }
    }

    /// Sets whether the initial output weights are 0 (default: false).
    ///
    /// If true, the initial control is exactly 0, and R equals M in the first update.
    pub fn zero_init_output(mut self, zero: bool) -> Self {
        self.zero_init_output = zero;
        self
    }

    /// Number of filters in each convolution.
    pub fn width(&self) -> usize {
        self.width
    }
}

impl Policy for Conv {
    fn observation_dim(&self) -> usize {
        CHANNELS * self.grid
    }

    fn control_dim(&self) -> usize {
        1
    }

    fn param_count(&self) -> usize {
        self.dense() + self.positions()[2] * self.width + 1
    }

    fn init(&self, rng: &mut Rng, theta: &mut [f64]) {
        theta.fill(0.0);
        let (w, outputs) = (self.width, self.positions()[2] * self.width);
        // Keras defines a fan as receptive field × channels. The first layer of the paper is a
        // two-dimensional convolution with a 3 × 2 kernel and one channel.
        let first = KERNEL * CHANNELS;
        let kernels = [
            (0, first, first * w),
            (self.layers::<f64>()[1].theta, KERNEL * w, KERNEL * w),
            (self.dense(), outputs, 1),
        ];
        for ((start, fan_in, fan_out), len) in zip(kernels, [first * w, KERNEL * w * w, outputs]) {
            // Glorot and Bengio 2010: uniform within sqrt(6 / (fan_in + fan_out)).
            let limit = (6.0 / (fan_in + fan_out) as f64).sqrt();
            theta[start..start + len].fill_with(|| rng.random_range(-limit..limit));
        }
        if self.zero_init_output {
            theta[self.dense()..].fill(0.0);
        }
    }

    #[inline(never)] // see `compiled.rs`
    fn act<T: Scalar>(
        &self,
        theta: &[T],
        Observed { y, .. }: Observed<'_, T>,
        Action { u, .. }: Action<'_, T>,
    ) {
        let w = self.width;
        let mut h = y.to_vec();
        for l in self.layers::<f64>() {
            let weights = &theta[l.theta..][..(KERNEL * l.channels + 1) * w];
            let (kernel, bias) = weights.split_at(KERNEL * l.channels * w);
            let mut next = Vec::with_capacity(l.positions * w);
            for q in 0..l.positions {
                let mut z = bias.to_vec();
                let window = &h[STRIDE * q * l.channels..][..KERNEL * l.channels];
                for (&h, row) in zip(window.iter(), kernel.chunks_exact(w)) {
                    for (z, &weight) in zip(z.iter_mut(), row) {
                        *z += h * weight;
                    }
                }
                next.extend(z.into_iter().map(Scalar::tanh));
            }
            h = next;
        }
        let (kernel, bias) = theta[self.dense()..].split_at(h.len());
        u[0] = h.iter().zip(kernel).fold(bias[0], |sum, (&h, &weight)| sum + h * weight);
    }

    fn tensors(&self) -> Vec<Tensor> {
        let w = self.width;
        let shapes =
            [vec![KERNEL, CHANNELS, 1, w], vec![KERNEL, w, w], vec![self.positions()[2] * w, 1]];
        let (mut tensors, mut end) = (Vec::new(), 0);
        for (i, shape) in shapes.into_iter().enumerate() {
            let bias = vec![shape[shape.len() - 1]];
            for (name, shape) in [("kernel", shape), ("bias", bias)] {
                let range = end..end + shape.iter().product::<usize>();
                end = range.end;
                tensors.push(Tensor { name: format!("layer{}.{name}", i + 1), shape, range });
            }
        }
        tensors
    }

    fn network(&self) -> Option<Vec<NetworkLayer>> {
        let conv = (LayerKind::Conv { stride: STRIDE }, Some(Activation::Tanh));
        let layers = [conv, conv, (LayerKind::Dense, None)].into_iter().zip(1..);
        let layer = |((kind, activation), i): (_, usize)| NetworkLayer {
            kind,
            kernel: format!("layer{i}.kernel"),
            bias: Some(format!("layer{i}.bias")),
            activation,
            bounds: None,
        };
        Some(layers.map(layer).collect())
    }

    fn sizes<F: Float>(&self, columns: usize) -> Sizes {
        let layers = self.layers::<F>();
        let gradient = |l: &Layer| {
            l.slot_out * l.depth() + DEPTH.max(l.capacity) / l.capacity * l.input().min(l.output())
        };
        let two = &layers[1];
        Sizes {
            packed: self.packed_dense(two) + two.output(),
            tape: self.places::<F>(&layers, columns).len,
            tape_bar: Self::places_bar(&layers, columns)[2],
            scratch: layers.iter().map(gradient).max().unwrap_or(0).max(two.output() + DEPTH),
        }
    }

    fn pack<F: Float>(&self, theta: &[F], packed: &mut [F]) {
        let w = self.width;
        let layers = self.layers::<F>();
        for l in &layers {
            for j in 0..l.depth() {
                let Some(start) = l.weight(j, w) else { continue };
                let row = &theta[start..start + w];
                packed[l.packed + j * l.lda..][..w].copy_from_slice(row);
                if j + 1 < l.depth() {
                    for (f, &weight) in row.iter().enumerate() {
                        packed[l.transposed + f * l.entries + j] = weight;
                    }
                }
            }
        }
        let [_, two] = &layers;
        let dense = &mut packed[self.packed_dense(two)..];
        let (kernel, bias) = theta[self.dense()..].split_at(two.positions * w);
        for (to, from) in zip(dense.chunks_exact_mut(two.slot_out), kernel.chunks_exact(w)) {
            to[..w].copy_from_slice(from);
        }
        // The bias multiplies the constant 1 of the first position.
        dense[w] = bias[0];
    }

    fn forward<F: Float>(&self, pass: PolicyPass<F>, tape: &mut [F], u: &mut [F]) {
        let PolicyPass { packed, at, x, .. } = pass;
        let level = SimdLevel::best();
        let (n, w) = (self.observation_dim(), self.width);
        let layers = self.layers::<F>();
        let [one, two] = &layers;
        let places = self.places::<F>(&layers, x.len() / n);
        let lens = [one.input(), one.output(), two.output()];
        let (h1, h2, input) = (places.block[1], places.block[2], places.block[0]);
        for at in at.blocks(BLOCK) {
            // Gathers and scatters the columns, because those of one time step are far apart.
            let (block, all) = tape.split_at_mut(places.all[1]);
            for (column, c) in zip(block[input..].chunks_exact_mut(lens[0]), at.iter()) {
                for (position, x) in
                    zip(column.chunks_exact_mut(one.slot), x[c * n..][..n].chunks_exact(CHANNELS))
                {
                    position[..CHANNELS].copy_from_slice(x);
                    position[CHANNELS] = F::one();
                }
                // The tape may contain numbers of another policy, for example of a `Sum`.
                column[n / CHANNELS * one.slot..].fill(F::zero());
            }
            let (activations, inputs) = block.split_at_mut(input);
            let (first, second) = activations.split_at_mut(h2);
            one.convolve(level, w, packed, inputs, &mut first[h1..], at.count);
            two.convolve(level, w, packed, &first[h1..], second, at.count);
            let rows = Strided { first: self.packed_dense(two), step: 0, count: 1, len: lens[2] };
            let columns = Strided { first: 0, step: lens[2], count: at.count, len: lens[2] };
            elementwise::dots(level, packed, rows, second, columns, &mut u[at.first..], at.step);
            for (from, (to, len)) in zip(places.block, zip(places.all, lens)) {
                let to = to - places.all[1];
                for (i, c) in at.iter().enumerate() {
                    all[to + c * len..][..len].copy_from_slice(&block[from + i * len..][..len]);
                }
            }
        }
    }

    fn backward<F: Float>(
        &self,
        pass: PolicyPass<F>,
        tape: &[F],
        u_bar: &[F],
        tape_bar: &mut [F],
        mut x_bar: Option<&mut [F]>,
    ) {
        let PolicyPass { packed, at, x, .. } = pass;
        let level = SimdLevel::best();
        let (n, w) = (self.observation_dim(), self.width);
        let total = x.len() / n;
        let layers = self.layers::<F>();
        let [one, two] = &layers;
        let (len1, len2) = (one.output(), two.output());
        let places = self.places::<F>(&layers, total);
        let [first, second, _] = Self::places_bar(&layers, total);
        // Only contiguous columns share a product.
        for at in at.blocks(if at.step == 1 { BLOCK } else { 1 }) {
            let (windows, cotangents) = tape_bar.split_at_mut(first);
            let (bar1, bar2) = cotangents.split_at_mut(second - first);
            let bar1 = &mut bar1[at.first * len1..][..at.count * len1];
            let bar2 = &mut bar2[at.first * len2..][..at.count * len2];
            let dense = &packed[self.packed_dense(two)..];
            dense_bar(level, dense, &u_bar[at.first..][..at.count], len2, bar2);
            // 1 - h² is 0 at the constant ones; the weights of unused positions are 0.
            let whole = |len: usize| Strided { first: 0, step: len, count: at.count, len };
            elementwise::tanh_bar(
                level,
                &tape[places.all[2] + at.first * len2..],
                bar2,
                whole(len2),
            );

            two.windows_bar(level, w, packed, bar2, at.count, windows);
            bar1.fill(F::zero());
            for (to, windows) in
                zip(bar1.chunks_exact_mut(len1), windows.chunks(two.capacity * two.entries))
            {
                two.add_windows(windows, two.slot, to);
            }
            elementwise::tanh_bar(
                level,
                &tape[places.all[1] + at.first * len1..],
                bar1,
                whole(len1),
            );

            if let Some(x_bar) = &mut x_bar {
                one.windows_bar(level, w, packed, bar1, at.count, windows);
                for (c, windows) in zip(at.iter(), windows.chunks(one.capacity * one.entries)) {
                    let x_bar = &mut x_bar[c * n..][..n];
                    x_bar.fill(F::zero());
                    one.add_windows(windows, CHANNELS, x_bar);
                }
            }
        }
    }

    fn param_gradient<F: Float>(
        &self,
        pass: PolicyPass<F>,
        record: PolicyRecord<F>,
        scratch: &mut [F],
        theta_bar: &mut [F],
    ) {
        let PolicyPass { at, x, .. } = pass;
        let PolicyRecord { tape, u_bar, tape_bar, weight } = record;
        if at.count == 0 {
            return;
        }
        let level = SimdLevel::best();
        let w = self.width;
        let total = x.len() / self.observation_dim();
        let layers = self.layers::<F>();
        let [_, two] = &layers;
        let places = self.places::<F>(&layers, total);
        let cotangents = Self::places_bar(&layers, total);
        for (i, l) in layers.iter().enumerate() {
            let (inputs, bars) = (&tape[places.all[i]..], &tape_bar[cotangents[i]..]);
            l.weight_gradient(level, at, inputs, bars, weight, scratch);
            let sum = &scratch[..l.slot_out * l.depth()];
            for (j, sum) in sum.chunks_exact(l.slot_out).enumerate() {
                let Some(start) = l.weight(j, w) else { continue };
                for (bar, &sum) in zip(theta_bar[start..start + w].iter_mut(), sum) {
                    *bar += sum;
                }
            }
        }

        let second = &tape[places.all[2]..];
        dense_gradient(level, at, second, u_bar, weight, two.output(), scratch);
        let sum = &scratch[..two.output()];
        let (kernel, bias) = theta_bar[self.dense()..].split_at_mut(two.positions * w);
        for (bar, sum) in zip(kernel.chunks_exact_mut(w), sum.chunks_exact(two.slot_out)) {
            for (bar, &sum) in zip(bar.iter_mut(), sum) {
                *bar += sum;
            }
        }
        bias[0] += sum[w];
    }
}

/// Writes the gradient of the packed output weights, `Σ u_bar h₂` over the columns, to the start of
/// `scratch`. `second` are the columns of h₂, of length `len`. The rest of `scratch` receives
/// `u_bar` scaled by `weight`.
#[inline(always)]
fn dense_gradient<F: Float>(
    level: SimdLevel,
    at: PolicyColumns,
    second: &[F],
    u_bar: &[F],
    weight: Option<&[F]>,
    len: usize,
    scratch: &mut [F],
) {
    let (sum, scaled) = scratch.split_at_mut(len);
    for block in at.blocks(DEPTH) {
        let columns = block.as_range();
        let mut b = &u_bar[columns.clone()];
        if let Some(weight) = weight {
            elementwise::scale(level, b, &weight[columns], 1, scaled);
            b = scaled;
        }
        let a = &second[block.first * len..];
        let accumulate = block.first != at.first;
        let product = Product {
            rows: len,
            depth: block.count,
            cols: 1,
            a,
            lda: len,
            b,
            b_row: 1,
            b_col: 1,
            c: sum,
            ldc: len,
            accumulate,
        };
        F::product(level, product);
    }
}

/// Writes `W₃ᵀ u_bar`, the cotangents of h₂ in adjacent columns. `dense` are the packed output
/// weights.
#[inline(always)]
fn dense_bar<F: Float>(level: SimdLevel, dense: &[F], u_bar: &[F], len: usize, bar: &mut [F]) {
    let outer = Product {
        rows: len,
        depth: 1,
        cols: u_bar.len(),
        a: dense,
        lda: len,
        b: u_bar,
        b_row: 1,
        b_col: 1,
        c: bar,
        ldc: len,
        accumulate: false,
    };
    F::product(level, outer);
}
