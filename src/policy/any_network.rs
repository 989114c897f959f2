//! [`AnyNetwork`]: a network whose kind is chosen at run time.

use super::{
    Action, Conv, Mlp, NetworkLayer, Observed, Policy, PolicyPass, PolicyRecord, Sizes, Tensor,
};
use crate::numbers::rng::Rng;
use crate::numbers::scalar::{Float, Scalar};

/// An [`Mlp`] or a [`Conv`], chosen at run time. Results are bitwise equal to those of the network.
#[derive(Clone, Debug, PartialEq, Eq)]
#[allow(missing_docs)]
pub enum AnyNetwork {
    Mlp(Mlp),
    Conv(Conv),
}

/// Evaluates `$result` with the network as `$network`.
macro_rules! each {
    ($any:ident, $network:ident => $result:expr) => {
        match $any {
            Self::Mlp($network) => $result,
            Self::Conv($network) => $result,
        }
    };
}

impl Policy for AnyNetwork {
    fn observation_dim(&self) -> usize {
        each!(self, network => network.observation_dim())
    }

    fn control_dim(&self) -> usize {
        each!(self, network => network.control_dim())
    }

    fn param_count(&self) -> usize {
        each!(self, network => network.param_count())
    }

    fn init(&self, rng: &mut Rng, theta: &mut [f64]) {
        each!(self, network => network.init(rng, theta));
    }

    fn act<T: Scalar>(&self, theta: &[T], observed: Observed<'_, T>, action: Action<'_, T>) {
        each!(self, network => network.act(theta, observed, action));
    }

    fn tensors(&self) -> Vec<Tensor> {
        each!(self, network => network.tensors())
    }

    fn network(&self) -> Option<Vec<NetworkLayer>> {
        each!(self, network => network.network())
    }

    fn sizes<F: Float>(&self, columns: usize) -> Sizes {
        each!(self, network => network.sizes::<F>(columns))
    }

    fn pack<F: Float>(&self, theta: &[F], packed: &mut [F]) {
        each!(self, network => network.pack(theta, packed));
    }

    fn forward<F: Float>(&self, pass: PolicyPass<F>, tape: &mut [F], u: &mut [F]) {
        each!(self, network => network.forward(pass, tape, u));
    }

    fn backward<F: Float>(
        &self,
        pass: PolicyPass<F>,
        tape: &[F],
        u_bar: &[F],
        tape_bar: &mut [F],
        x_bar: Option<&mut [F]>,
    ) {
        each!(self, network => network.backward(pass, tape, u_bar, tape_bar, x_bar));
    }

    fn param_gradient<F: Float>(
        &self,
        pass: PolicyPass<F>,
        record: PolicyRecord<F>,
        scratch: &mut [F],
        theta_bar: &mut [F],
    ) {
        each!(self, network => network.param_gradient(pass, record, scratch, theta_bar));
    }
}
