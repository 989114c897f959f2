//! [`AnyPolicy`]: an object-safe [`Policy`] for one precision.

use super::{
    InputLayer, NetworkLayer, Policy, PolicyPass, PolicyRecord, Sizes, Tensor, TrainedParam,
};
use crate::numbers::rng::Rng;
use crate::numbers::scalar::Float;
use std::ops::Range;

/// Object-safe [`Policy`] for one precision.
///
/// Every [`Policy`] implements the trait, so `&policy` coerces to `&dyn AnyPolicy<F>`. Each hidden
/// method forwards to the [`Policy`] method of equal name.
#[allow(missing_docs)]
pub trait AnyPolicy<F: Float>: Send + Sync {
    #[doc(hidden)]
    fn observation_dim(&self) -> usize;
    #[doc(hidden)]
    fn control_dim(&self) -> usize;
    #[doc(hidden)]
    fn memory_dim(&self) -> usize;
    #[doc(hidden)]
    fn param_count(&self) -> usize;
    #[doc(hidden)]
    fn trained_params(&self) -> &[TrainedParam];
    #[doc(hidden)]
    fn init(&self, rng: &mut Rng, theta: &mut [f64]);
    #[doc(hidden)]
    fn tensors(&self) -> Vec<Tensor>;
    #[doc(hidden)]
    fn network(&self) -> Option<Vec<NetworkLayer>>;
    #[doc(hidden)]
    fn input_layer(&self) -> Option<InputLayer>;
    #[doc(hidden)]
    fn output_layer(&self) -> Option<Range<usize>>;
    #[doc(hidden)]
    fn control_bounds(&self) -> Option<Vec<[f64; 2]>>;
    #[doc(hidden)]
    fn sizes(&self, columns: usize) -> Sizes;
    #[doc(hidden)]
    fn pack(&self, theta: &[F], packed: &mut [F]);
    #[doc(hidden)]
    fn forward(&self, pass: PolicyPass<F>, tape: &mut [F], u: &mut [F]);
    #[doc(hidden)]
    fn backward(
        &self,
        pass: PolicyPass<F>,
        tape: &[F],
        u_bar: &[F],
        tape_bar: &mut [F],
        x_bar: Option<&mut [F]>,
    );
    #[doc(hidden)]
    fn param_gradient(
        &self,
        pass: PolicyPass<F>,
        record: PolicyRecord<F>,
        scratch: &mut [F],
        theta_bar: &mut [F],
    );

    /// Length of the concatenated observation and memory.
    fn input_dim(&self) -> usize {
        self.observation_dim() + self.memory_dim()
    }

    /// Length of the concatenated control and next memory.
    fn output_dim(&self) -> usize {
        self.control_dim() + self.memory_dim()
    }
}

impl<P: Policy, F: Float> AnyPolicy<F> for P {
    fn observation_dim(&self) -> usize {
        Policy::observation_dim(self)
    }

    fn control_dim(&self) -> usize {
        Policy::control_dim(self)
    }

    fn memory_dim(&self) -> usize {
        Policy::memory_dim(self)
    }

    fn param_count(&self) -> usize {
        Policy::param_count(self)
    }

    fn trained_params(&self) -> &[TrainedParam] {
        Policy::trained_params(self)
    }

    fn init(&self, rng: &mut Rng, theta: &mut [f64]) {
        Policy::init(self, rng, theta);
    }

    #[inline(never)]
    fn tensors(&self) -> Vec<Tensor> {
        Policy::tensors(self)
    }

    #[inline(never)]
    fn network(&self) -> Option<Vec<NetworkLayer>> {
        Policy::network(self)
    }

    #[inline(never)]
    fn input_layer(&self) -> Option<InputLayer> {
        Policy::input_layer(self)
    }

    fn output_layer(&self) -> Option<Range<usize>> {
        Policy::output_layer(self)
    }

    fn control_bounds(&self) -> Option<Vec<[f64; 2]>> {
        Policy::control_bounds(self)
    }

    fn sizes(&self, columns: usize) -> Sizes {
        Policy::sizes::<F>(self, columns)
    }

    #[inline(never)]
    fn pack(&self, theta: &[F], packed: &mut [F]) {
        Policy::pack(self, theta, packed);
    }

    #[inline(never)]
    fn forward(&self, pass: PolicyPass<F>, tape: &mut [F], u: &mut [F]) {
        Policy::forward(self, pass, tape, u);
    }

    #[inline(never)]
    fn backward(
        &self,
        pass: PolicyPass<F>,
        tape: &[F],
        u_bar: &[F],
        tape_bar: &mut [F],
        x_bar: Option<&mut [F]>,
    ) {
        Policy::backward(self, pass, tape, u_bar, tape_bar, x_bar);
    }

    #[inline(never)]
    fn param_gradient(
        &self,
        pass: PolicyPass<F>,
        record: PolicyRecord<F>,
        scratch: &mut [F],
        theta_bar: &mut [F],
    ) {
        Policy::param_gradient(self, pass, record, scratch, theta_bar);
    }
}
