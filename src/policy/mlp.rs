//! [`Mlp`]: a multi-layer perceptron with a linear output.
//!
//! `θ` holds for each layer the weights (inputs × outputs, row-major), then the bias, if any, as in
//! Keras. Weights and bias form one (inputs + 1) × outputs matrix, and every column of activations
//! ends in a constant 1. For each block of columns, the forward pass of a hidden layer and the
//! weight gradient of any layer are therefore one matrix product each. The forward pass of the
//! output layer consists of dot products.

use super::activation::activate;
use super::{
    Action, Activation, InputLayer, LayerKind, NetworkLayer, Observed, Policy, PolicyColumns,
    PolicyPass, PolicyRecord, Sizes, Tensor,
};
use crate::numbers::kernels::SimdLevel;
use crate::numbers::kernels::elementwise::{self, Strided};
use crate::numbers::kernels::gemm::Product;
use crate::numbers::rng::Rng;
use crate::numbers::scalar::{Float, Scalar};
use crate::numbers::zip::zip;
use rand::RngExt;
use std::ops::Range;

/// Columns per block. A block passes all layers while its activations stay in the L1 cache.
const BLOCK: usize = 32;
/// Columns per matrix product in the weight gradient.
const DEPTH: usize = 64;

/// A multi-layer perceptron: hidden layers of any widths, a linear output. The default
/// [`Activation`] is tanh.
///
/// Initial weights are Glorot-uniform (Glorot and Bengio 2010); initial biases are 0.
/// [`Mlp::zero_init_output`] makes the initial control exactly 0.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Mlp {
    widths: Vec<usize>,
    activation: Activation,
    bias: bool,
    zero_init_output: bool,
}

/// Shape of one layer, and its offsets in `θ` and in the padded buffers.
#[derive(Clone, Copy, Debug)]
struct Layer {
    inputs: usize,
    outputs: usize,
    /// Rows of the weight matrix: the inputs, plus 1 with a bias.
    rows: usize,
    /// Offset in `θ`.
    theta: usize,
    /// Padded length of an input column, including the constant 1.
    ld_in: usize,
    /// Padded length of an output column.
    ld_out: usize,
    /// Offset of the packed weights: one padded column of outputs per row.
    packed: usize,
    /// Offset of the transposed weights: one padded column of inputs per output.
    transposed: usize,
    /// Offset of the input columns in the tape, divided by the number of columns.
    tape: usize,
}

impl Mlp {
    /// An MLP with biases and these widths, from observation to control: for instance
    /// `[10, 100, 100, 1]`.
    ///
    /// # Panics
    /// If there are fewer than two widths, or a width is 0.
    #[track_caller]
    pub fn new(widths: impl Into<Vec<usize>>) -> Self {
        let widths = widths.into();
        assert!(
            widths.len() >= 2,
            "an MLP needs at least the widths of its input and output, not {widths:?}"
        );
        assert!(
            widths.iter().all(|&w| w > 0),
            "every layer of an MLP needs a width of at least 1, not {widths:?}"
        );
        Self { widths, activation: Activation::Tanh, bias: true, zero_init_output: false }
    }

    /// Sets whether the initial output weights are 0 (default: false).
    ///
    /// If true, the initial control is exactly 0, and R equals M in the first update.
    pub fn zero_init_output(mut self, zero: bool) -> Self {
        self.zero_init_output = zero;
        self
    }

    /// Sets the activation of the hidden layers (default: tanh).
    pub fn activation(mut self, activation: Activation) -> Self {
        self.activation = activation;
        self
    }

    /// Sets whether layers have biases (default: true).
    pub fn bias(mut self, bias: bool) -> Self {
        self.bias = bias;
        self
    }

    /// The widths from the observation to the control.
    pub fn widths(&self) -> &[usize] {
        &self.widths
    }

    fn layers<F: Float>(&self) -> impl DoubleEndedIterator<Item = Layer> + ExactSizeIterator {
        (0..self.widths.len() - 1).map(|l| self.layer::<F>(l))
    }

    fn layer<F: Float>(&self, index: usize) -> Layer {
        let mut layer = Layer {
            inputs: 0,
            outputs: 0,
            rows: 0,
            theta: 0,
            ld_in: 0,
            ld_out: 0,
            packed: 0,
            transposed: 0,
            tape: 0,
        };
        for pair in self.widths[..index + 2].windows(2) {
            // Each layer begins at the end of the previous layer.
            layer.theta += layer.rows * layer.outputs;
            layer.packed = layer.transposed + layer.outputs * layer.ld_in;
            layer.tape += layer.ld_in;
            (layer.inputs, layer.outputs) = (pair[0], pair[1]);
            layer.rows = layer.inputs + usize::from(self.bias);
            (layer.ld_in, layer.ld_out) = (padded::<F>(layer.inputs), padded::<F>(layer.outputs));
            layer.transposed = layer.packed + layer.rows * layer.ld_out;
        }
        layer
    }

    /// Returns whether the tape contains the slopes of the activations, after their values. The
    /// slopes of tanh follow from its values.
    fn has_slopes(&self) -> bool {
        self.activation != Activation::Tanh
    }

    fn last<F: Float>(&self) -> Layer {
        self.layer::<F>(self.widths.len() - 2)
    }
}

/// Padded length of a column of `n` numbers and a constant 1.
///
/// An odd number of cache lines, so that adjacent columns do not map to the same cache sets.
fn padded<F: Float>(n: usize) -> usize {
    ((n + 1).div_ceil(F::PAD) | 1) * F::PAD
}

impl Layer {
    /// The input columns `at` in a tape of `total` columns, each with its padding.
    fn input_columns(&self, total: usize, at: PolicyColumns) -> Strided {
        let ld = self.ld_in;
        Strided {
            first: total * self.tape + at.first * ld,
            step: at.step * ld,
            count: at.count,
            len: ld,
        }
    }
}

impl Policy for Mlp {
    fn observation_dim(&self) -> usize {
        self.widths[0]
    }

    fn control_dim(&self) -> usize {
        self.widths[self.widths.len() - 1]
    }

    fn param_count(&self) -> usize {
        self.layers::<f64>().map(|l| l.rows * l.outputs).sum()
    }

    fn init(&self, rng: &mut Rng, theta: &mut [f64]) {
        theta.fill(0.0);
        let last = self.widths.len() - 2;
        for (index, l) in self.layers::<f64>().enumerate() {
            // Glorot and Bengio 2010: uniform within sqrt(6 / (fan_in + fan_out)).
            let limit = (6.0 / (l.inputs + l.outputs) as f64).sqrt();
            for weight in &mut theta[l.theta..][..l.inputs * l.outputs] {
                // Always draws, so that `zero_init_output` does not affect later draws from `rng`.
                let draw = rng.random_range(-limit..limit);
                *weight = if self.zero_init_output && index == last { 0.0 } else { draw };
            }
        }
    }

    #[inline(never)] // see `compiled.rs`
    fn act<T: Scalar>(
        &self,
        theta: &[T],
        Observed { y, .. }: Observed<'_, T>,
        Action { u, .. }: Action<'_, T>,
    ) {
        let mut h = y.to_vec();
        for l in self.layers::<f64>() {
            let weights = &theta[l.theta..][..l.rows * l.outputs];
            let mut z = if self.bias {
                weights[l.inputs * l.outputs..].to_vec()
            } else {
                vec![T::zero(); l.outputs]
            };
            for (&h, row) in zip(h.iter(), weights.chunks_exact(l.outputs)) {
                for (z, &w) in zip(z.iter_mut(), row) {
                    *z += h * w;
                }
            }
            if l.theta + weights.len() < theta.len() {
                h = z.into_iter().map(|z| self.activation.value(z)).collect();
            } else {
                u.copy_from_slice(&z);
            }
        }
    }

    fn tensors(&self) -> Vec<Tensor> {
        let mut tensors = Vec::new();
        for (i, l) in self.layers::<f64>().enumerate() {
            let bias = l.theta + l.inputs * l.outputs;
            let kernel = Tensor {
                name: format!("layer{}.kernel", i + 1),
                shape: vec![l.inputs, l.outputs],
                range: l.theta..bias,
            };
            tensors.push(kernel);
            if self.bias {
                let range = bias..bias + l.outputs;
                tensors.push(Tensor {
                    name: format!("layer{}.bias", i + 1),
                    shape: vec![l.outputs],
                    range,
                });
            }
        }
        tensors
    }

    fn network(&self) -> Option<Vec<NetworkLayer>> {
        let last = self.widths.len() - 1;
        let layer = |i: usize| NetworkLayer {
            kind: LayerKind::Dense,
            kernel: format!("layer{i}.kernel"),
            bias: self.bias.then(|| format!("layer{i}.bias")),
            activation: (i < last).then_some(self.activation),
            bounds: None,
        };
        Some((1..=last).map(layer).collect())
    }

    fn input_layer(&self) -> Option<InputLayer> {
        let Layer { inputs, outputs, .. } = self.layer::<f64>(0);
        let end = inputs * outputs;
        Some(InputLayer { inputs, kernel: 0..end, bias: self.bias.then_some(end..end + outputs) })
    }

    fn output_layer(&self) -> Option<Range<usize>> {
        Some(self.layers::<f64>().last()?.theta..self.param_count())
    }

    fn sizes<F: Float>(&self, columns: usize) -> Sizes {
        let last = self.last::<F>();
        let gradient = |l: Layer| l.ld_out * l.rows + DEPTH * l.ld_out.min(l.ld_in);
        Sizes {
            packed: last.transposed + last.outputs * last.ld_in,
            tape: columns * (last.tape + last.ld_in) * if self.has_slopes() { 2 } else { 1 },
            tape_bar: columns * (last.tape + last.ld_in),
            scratch: self
                .layers::<F>()
                .map(gradient)
                .max()
                .unwrap_or(0)
                .max(last.outputs * (last.ld_in + DEPTH)),
        }
    }

    fn pack<F: Float>(&self, theta: &[F], packed: &mut [F]) {
        for l in self.layers::<F>() {
            for (i, row) in
                theta[l.theta..][..l.rows * l.outputs].chunks_exact(l.outputs).enumerate()
            {
                packed[l.packed + i * l.ld_out..][..l.outputs].copy_from_slice(row);
                for (o, &weight) in row.iter().enumerate() {
                    packed[l.transposed + o * l.ld_in + i] = weight;
                }
            }
        }
    }

    fn forward<F: Float>(&self, pass: PolicyPass<F>, tape: &mut [F], u: &mut [F]) {
        let PolicyPass { packed, at, x, .. } = pass;
        let level = SimdLevel::best();
        let n = self.observation_dim();
        let total = x.len() / n;
        let first = self.layer::<F>(0);
        let (tape, slopes) =
            tape.split_at_mut(total * (self.last::<F>().tape + self.last::<F>().ld_in));
        for c in at.iter() {
            let column = &mut tape[c * first.ld_in..][..first.ld_in];
            column[..n].copy_from_slice(&x[c * n..][..n]);
            column[n] = F::one();
            // Inlined, unlike `fill`.
            for padding in &mut column[n + 1..] {
                *padding = F::zero();
            }
        }
        for at in at.blocks(BLOCK) {
            for l in self.layers::<F>() {
                let input = l.input_columns(total, at);
                if l.tape == self.last::<F>().tape {
                    let rows = Strided {
                        first: l.transposed,
                        step: l.ld_in,
                        count: l.outputs,
                        len: l.ld_in,
                    };
                    let u = &mut u[at.first * l.outputs..];
                    elementwise::dots(level, packed, rows, tape, input, u, at.step * l.outputs);
                    continue;
                }
                let (before, after) = tape.split_at_mut(total * (l.tape + l.ld_in));
                // Whole registers, not the whole padding, of which no result depends.
                let rows = l.outputs.next_multiple_of(F::lanes(level));
                let output = Strided {
                    first: at.first * l.ld_out,
                    step: at.step * l.ld_out,
                    count: at.count,
                    len: rows,
                };
                F::product(
                    level,
                    Product {
                        rows,
                        depth: l.rows,
                        cols: at.count,
                        a: &packed[l.packed..],
                        lda: l.ld_out,
                        b: &before[input.first..],
                        b_row: 1,
                        b_col: input.step,
                        c: &mut after[output.first..],
                        ldc: output.step,
                        accumulate: false,
                    },
                );
                if self.has_slopes() {
                    let slopes = &mut slopes[total * (l.tape + l.ld_in)..];
                    activate(level, self.activation, after, slopes, output);
                } else {
                    elementwise::tanh(level, after, output);
                }
                for c in at.iter() {
                    after[c * l.ld_out + l.outputs] = F::one();
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
        let n = self.observation_dim();
        let total = x.len() / n;
        let (tape, slopes) =
            tape.split_at(total * (self.last::<F>().tape + self.last::<F>().ld_in));
        for at in at.blocks(BLOCK) {
            for l in self.layers::<F>().rev() {
                let first_layer = l.tape == 0;
                if first_layer && x_bar.is_none() {
                    break;
                }
                let rows = l.inputs.next_multiple_of(F::lanes(level));
                let input = Strided { len: rows, ..l.input_columns(total, at) };
                let (before, after) = tape_bar.split_at_mut(total * (l.tape + l.ld_in));
                let (b, b_col) = if l.tape == self.last::<F>().tape {
                    (&u_bar[at.first * l.outputs..], at.step * l.outputs)
                } else {
                    (&after[at.first * l.ld_out..], at.step * l.ld_out)
                };
                F::product(
                    level,
                    Product {
                        rows,
                        depth: l.outputs,
                        cols: at.count,
                        a: &packed[l.transposed..],
                        lda: l.ld_in,
                        b,
                        b_row: 1,
                        b_col,
                        c: &mut before[input.first..],
                        ldc: input.step,
                        accumulate: false,
                    },
                );
                if !first_layer && self.has_slopes() {
                    elementwise::times(level, slopes, before, input);
                } else if !first_layer {
                    elementwise::tanh_bar(level, tape, before, input);
                } else if let Some(x_bar) = &mut x_bar {
                    for c in at.iter() {
                        x_bar[c * n..][..n].copy_from_slice(&before[c * l.ld_in..][..n]);
                    }
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
        let total = x.len() / self.observation_dim();
        for l in self.layers::<F>() {
            let is_last = l.tape == self.last::<F>().tape;
            let (bar, bar_len) = if is_last {
                (u_bar, l.outputs)
            } else {
                (&tape_bar[total * (l.tape + l.ld_in)..], l.ld_out)
            };
            let input = &tape[total * l.tape..];
            // The last layer has few outputs; its transposed product avoids padding them.
            let (ld, rows, cols) =
                if is_last { (l.ld_in, l.rows, l.outputs) } else { (l.ld_out, l.outputs, l.rows) };
            let rows = rows.next_multiple_of(F::lanes(level));
            let (sum, scaled) = scratch.split_at_mut(rows * cols);
            for block in at.blocks(DEPTH) {
                let columns = block.as_range();
                let mut bar = &bar[columns.start * bar_len..columns.end * bar_len];
                let mut input = &input[columns.start * l.ld_in..columns.end * l.ld_in];
                if let Some(weight) = weight {
                    // Scales the smaller factor.
                    let (factor, len) = if bar_len <= l.ld_in {
                        (&mut bar, bar_len)
                    } else {
                        (&mut input, l.ld_in)
                    };
                    elementwise::scale(level, factor, &weight[columns], len, scaled);
                    *factor = scaled;
                }
                let (a, b, b_row) =
                    if is_last { (input, bar, bar_len) } else { (bar, input, l.ld_in) };
                let accumulate = block.first != at.first;
                let product = Product {
                    rows,
                    depth: block.count,
                    cols,
                    a,
                    lda: ld,
                    b,
                    b_row,
                    b_col: 1,
                    c: sum,
                    ldc: rows,
                    accumulate,
                };
                F::product(level, product);
            }
            let theta_bar = &mut theta_bar[l.theta..][..l.rows * l.outputs];
            for (i, row) in theta_bar.chunks_exact_mut(l.outputs).enumerate() {
                if is_last {
                    for (o, bar) in row.iter_mut().enumerate() {
                        *bar += sum[o * rows + i];
                    }
                } else {
                    for (bar, &sum) in zip(row.iter_mut(), &sum[i * rows..]) {
                        *bar += sum;
                    }
                }
            }
        }
    }
}
