//! [`NetworkLayer`]: layers of a policy, for files that other programs read. [`InputLayer`]: the
//! place of the first one.

use super::Activation;
use serde::Serialize;
use std::ops::Range;

/// Place in `θ` of a first layer `z[o] = b[o] + Σ_i y[i] W[i, o]` through which alone a policy depends
/// on the observation y.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct InputLayer {
    /// Components of the observation.
    pub inputs: usize,
    /// Entries of W, row-major.
    pub kernel: Range<usize>,
    /// Entries of b, after those of W.
    pub bias: Option<Range<usize>>,
}

/// Range of a control: `u = middle + half_width tanh((v - origin) / half_width)`.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Bound {
    /// Middle of the range.
    pub middle: f64,
    /// Half the width of the range.
    pub half_width: f64,
    /// The v that becomes the middle.
    pub origin: f64,
}

impl InputLayer {
    /// The rows of W, and b, within parameters or their derivatives.
    pub(crate) fn parts<'a, F>(
        &self,
        theta: &'a mut [F],
    ) -> (impl Iterator<Item = &'a mut [F]>, Option<&'a mut [F]>) {
        let (before, after) = theta.split_at_mut(self.kernel.end);
        let outputs = self.kernel.len() / self.inputs.max(1);
        let bias = self
            .bias
            .clone()
            .map(|bias| &mut after[bias.start - self.kernel.end..bias.end - self.kernel.end]);
        (before[self.kernel.start..].chunks_exact_mut(outputs.max(1)), bias)
    }
}

/// A layer of a feedforward policy. The observation is the input of the first layer, and the
/// control is the output of the last one.
///
/// The output of every layer is one vector. A convolution reads its input position by position,
/// with the channels of a position adjacent, and writes its output in the same order.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct NetworkLayer {
    /// Operation on the input.
    #[serde(flatten)]
    pub kind: LayerKind,
    /// Name of the [`Tensor`](super::Tensor) W with the weights.
    pub kernel: String,
    /// Name of the tensor b with one bias per output or filter, if any.
    pub bias: Option<String>,
    /// Function of every output. `None` for a linear layer.
    pub activation: Option<Activation>,
    /// Range of every output after the activation, of a last layer with bounds.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub bounds: Option<Vec<Bound>>,
}

/// Operation of a [`NetworkLayer`] before its activation.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(tag = "kind", rename_all = "snake_case")]
pub enum LayerKind {
    /// `z[o] = b[o] + Σ_i x[i] W[i, o]`.
    Dense,
    /// `z[q, f] = b[f] + Σ_{k,c} x[stride q + k, c] W[k, c, f]`, without padding. The shape of W
    /// may contain further dimensions of size 1.
    Conv {
        /// Distance between windows, in positions.
        stride: usize,
    },
}
