//! [`Gru`] and [`Elman`]: recurrent policies with a linear output.
//!
//! All parameters belong to affine maps `z = W v + b`. `θ` holds for each map the weights `Wᵀ`
//! (inputs × outputs, row-major), then the bias. [`Cell`] states the equations of one column. The
//! forward and backward passes apply them to blocks of columns in lanes, the parameter gradient to
//! single columns.

mod affine;
mod elman;
mod gru;

pub use elman::Elman;
pub use gru::Gru;

use super::blocks::{gather, scatter};
use super::{Action, Observed, Policy, PolicyPass, PolicyRecord, Sizes, Tensor};
use crate::numbers::kernels::{Vectorized, dispatch_lanes};
use crate::numbers::pool::lend;
use crate::numbers::rng::Rng;
use crate::numbers::scalar::{Float, Lane, Real, Scalar};
use affine::Affine;
use smallvec::SmallVec;

/// Dimensions of a recurrent policy.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Shape {
    observations: usize,
    units: usize,
    controls: usize,
}

impl Shape {
    #[track_caller]
    fn new(observations: usize, units: usize, controls: usize) -> Self {
        assert!(
            units > 0,
            "a recurrent policy needs at least one unit; use `policy::Linear` for feedback without memory"
        );
        Self { observations, units, controls }
    }
}

/// Equations of a recurrent policy for one column, or for one block of columns in lanes.
trait Cell {
    /// Numbers per unit that the forward pass stores. The next memory is the last one.
    const STORED: usize;
    /// Cotangents per unit that the backward pass stores.
    const BARS: usize;

    fn shape(&self) -> Shape;

    /// Writes the stored numbers, `[number][unit]`, and the control.
    ///
    /// Converts parameters by `splat`.
    fn evaluate<W: Copy, T: Scalar>(
        &self,
        theta: &[W],
        splat: impl Fn(W) -> T + Copy,
        x: (&[T], &[T]),
        stored: &mut [T],
        u: &mut [T],
    );

    /// Writes to `cotangents` the cotangents of the outputs of all affine maps but the last,
    /// `[map][unit]`. Adds the cotangents of the observation and the memory to `x_bar`.
    ///
    /// `next_bar` contains the cotangents of the next memory, including those through the control.
    fn reverse<R: Real>(
        &self,
        theta: &[R::Real],
        memory: &[R],
        stored: &[R],
        next_bar: &[R],
        cotangents: &mut [R],
        x_bar: Option<(&mut [R], &mut [R])>,
    );

    /// Adds `factor` times the parameter gradient of one column.
    fn add_gradient<F: Float>(
        &self,
        x: (&[F], &[F]),
        stored: &[F],
        cotangents: &[F],
        u_bar: &[F],
        factor: F,
        theta_bar: &mut [F],
    );

    /// The map from the next memory to the control.
    fn to_control(&self) -> Affine;
}

/// Arguments of [`Policy::forward`] for a recurrent policy, with reusable buffers.
struct Forward<'a, C, F> {
    cell: &'a C,
    pass: PolicyPass<'a, F>,
    tape: &'a mut [F],
    u: &'a mut [F],
    buffers: &'a mut [Vec<Lane<F>>; 3],
}

impl<C: Cell, F: Float> Vectorized for Forward<'_, C, F> {
    #[inline(always)]
    fn run<const FMA: bool>(self) {
        let Self { cell, pass, tape, u, buffers: [x, stored, outputs] } = self;
        let Shape { observations, units, controls } = cell.shape();
        stored.resize(units * C::STORED, Lane::zero());
        outputs.resize(controls + units, Lane::zero());
        for (_, at) in pass.blocks() {
            gather(pass.x, observations + units, at, x);
            cell.evaluate(
                pass.packed,
                Real::splat,
                x.split_at(observations),
                stored,
                &mut outputs[..controls],
            );
            outputs[controls..].copy_from_slice(&stored[units * (C::STORED - 1)..]);
            scatter(stored, at, tape);
            scatter(outputs, at, u);
        }
    }
}

/// Arguments of [`Policy::backward`] for a recurrent policy, with reusable buffers.
struct Backward<'a, C, F> {
    cell: &'a C,
    pass: PolicyPass<'a, F>,
    tape: &'a [F],
    u_bar: &'a [F],
    tape_bar: &'a mut [F],
    x_bar: Option<&'a mut [F]>,
    buffers: &'a mut [Vec<Lane<F>>; 5],
}

impl<C: Cell, F: Float> Vectorized for Backward<'_, C, F> {
    #[inline(always)]
    fn run<const FMA: bool>(self) {
        let Self { cell, pass, tape, u_bar, tape_bar, mut x_bar, buffers } = self;
        let Shape { observations, units, controls } = cell.shape();
        let (inputs, to_control) = (observations + units, cell.to_control());
        let [x, stored, outputs_bar, cotangents, inputs_bar] = buffers;
        cotangents.resize(units * C::BARS, Lane::zero());
        inputs_bar.resize(inputs, Lane::zero());
        for (_, at) in pass.blocks() {
            gather(pass.x, inputs, at, x);
            gather(tape, units * C::STORED, at, stored);
            gather(u_bar, controls + units, at, outputs_bar);
            let (u_bar, next_bar) = outputs_bar.split_at_mut(controls);
            for (i, bar) in next_bar.iter_mut().enumerate() {
                *bar += to_control.input_bar(pass.packed, i, u_bar);
            }
            inputs_bar.fill(Lane::zero());
            let requested = x_bar.is_some().then(|| inputs_bar.split_at_mut(observations));
            cell.reverse(pass.packed, &x[observations..], stored, next_bar, cotangents, requested);
            scatter(cotangents, at, tape_bar);
            if let Some(x_bar) = &mut x_bar {
                scatter(inputs_bar, at, x_bar);
            }
        }
    }
}

/// Implements [`Policy`] by a [`Cell`], with the names of its affine maps.
macro_rules! recurrent {
    ($cell:ty, $names:expr) => {
        impl Policy for $cell {
            fn observation_dim(&self) -> usize {
                self.0.observations
            }

            fn control_dim(&self) -> usize {
                self.0.controls
            }

            fn memory_dim(&self) -> usize {
                self.0.units
            }

            fn param_count(&self) -> usize {
                self.to_control().end()
            }

            fn init(&self, rng: &mut Rng, theta: &mut [f64]) {
                self.maps().into_iter().for_each(|map| map.init(rng, theta));
            }

            fn act<T: Scalar>(
                &self,
                theta: &[T],
                Observed { y, memory, .. }: Observed<'_, T>,
                action: Action<'_, T>,
            ) {
                let units = self.0.units;
                let mut stored: SmallVec<[T; 32]> =
                    SmallVec::from_elem(T::zero(), units * Self::STORED);
                self.evaluate(theta, |theta| theta, (y, memory), &mut stored, action.u);
                action.memory.copy_from_slice(&stored[units * (Self::STORED - 1)..]);
            }

            fn tensors(&self) -> Vec<Tensor> {
                self.maps()
                    .into_iter()
                    .zip($names)
                    .flat_map(|(map, name)| map.tensors(name))
                    .collect()
            }

            fn sizes<F: Float>(&self, columns: usize) -> Sizes {
                let tape = columns * self.0.units;
                Sizes {
                    packed: self.param_count(),
                    tape: tape * Self::STORED,
                    tape_bar: tape * Self::BARS,
                    scratch: 0,
                }
            }

            fn forward<F: Float>(&self, pass: PolicyPass<F>, tape: &mut [F], u: &mut [F]) {
                lend(|buffers| dispatch_lanes(Forward { cell: self, pass, tape, u, buffers }));
            }

            fn backward<F: Float>(
                &self,
                pass: PolicyPass<F>,
                tape: &[F],
                u_bar: &[F],
                tape_bar: &mut [F],
                x_bar: Option<&mut [F]>,
            ) {
                lend(|buffers| {
                    dispatch_lanes(Backward {
                        cell: self,
                        pass,
                        tape,
                        u_bar,
                        tape_bar,
                        x_bar,
                        buffers,
                    })
                });
            }

            fn param_gradient<F: Float>(
                &self,
                pass: PolicyPass<F>,
                record: PolicyRecord<F>,
                _scratch: &mut [F],
                theta_bar: &mut [F],
            ) {
                let Shape { observations, units, controls } = self.0;
                for c in pass.at.iter() {
                    let x = &pass.x[c * (observations + units)..][..observations + units];
                    let stored = &record.tape[c * units * Self::STORED..][..units * Self::STORED];
                    let cotangents =
                        &record.tape_bar[c * units * Self::BARS..][..units * Self::BARS];
                    let u_bar = &record.u_bar[c * (controls + units)..][..controls];
                    let factor = record.weight.map_or(F::one(), |weight| weight[c]);
                    self.add_gradient(
                        x.split_at(observations),
                        stored,
                        cotangents,
                        u_bar,
                        factor,
                        theta_bar,
                    );
                }
            }
        }
    };
}

recurrent!(Elman, ["memory", "output"]);
recurrent!(Gru, ["update", "reset", "candidate", "output"]);
