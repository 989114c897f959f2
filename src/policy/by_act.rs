//! Default batched passes of a policy: calls of [`Policy::act`] on blocks of columns.
//!
//! Derivatives use forward mode for at most 16 inputs and parameters together, else reverse mode.
//! The forward pass and reverse mode reuse buffers of the current thread.

use super::blocks::{gather, gathered, scatter};
use super::{Policy, PolicyColumns, PolicyPass, PolicyRecord, act_on, dims};
use crate::numbers::forward_mode::{Chunk, jacobian};
use crate::numbers::kernels::{Vectorized, dispatch_lanes};
use crate::numbers::pool::lend;
use crate::numbers::reverse_mode::{REVERSE_ABOVE, Recording};
use crate::numbers::scalar::{Float, Lane, Real, Scalar};
use smallvec::SmallVec;

/// Inputs or parameters of a block in forward mode, on the stack.
type Few<T> = SmallVec<[T; 32]>;

/// Returns whether derivatives of [`Policy::act`] use reverse mode.
fn in_reverse<P: Policy + ?Sized>(policy: &P) -> bool {
    dims(policy).0 + policy.param_count() > REVERSE_ABOVE
}

/// Parameters, equal in all lanes.
fn splat<F: Float>(packed: &[F]) -> impl Iterator<Item = Lane<F>> {
    packed.iter().map(|&theta| Real::splat(theta))
}

/// Inner product of one lane of `a` with `b`.
fn dot<F: Float>(a: &[Lane<F>], lane: usize, b: &[F]) -> F {
    a.iter().zip(b).fold(F::zero(), |sum, (a, &b)| sum + a.lane(lane) * b)
}

/// Writes the outputs of the columns of a pass.
pub(super) fn forward<P: Policy + ?Sized, F: Float>(policy: &P, pass: PolicyPass<F>, u: &mut [F]) {
    let (inputs, outputs) = dims(policy);
    lend(|[theta, x, block_u]: &mut [Vec<Lane<F>>; 3]| {
        theta.clear();
        theta.extend(splat(pass.packed));
        for (t, at) in pass.blocks() {
            gather(pass.x, inputs, at, x);
            block_u.clear();
            block_u.resize(outputs, Lane::zero());
            dispatch_lanes(Act { policy, theta, x, t, u: block_u });
            scatter(block_u, at, u);
        }
    });
}

/// Writes `x_bar = (∂N/∂(y, m))ᵀ u_bar` in the columns of a pass.
pub(super) fn input_vjp<P: Policy + ?Sized, F: Float>(
    policy: &P,
    pass: PolicyPass<F>,
    u_bar: &[F],
    x_bar: &mut [F],
) {
    if in_reverse(policy) {
        return each_cotangent(policy, pass, By::Inputs, u_bar, |at, cotangents| {
            scatter(cotangents, at, x_bar)
        });
    }
    let (inputs, outputs) = dims(policy);
    let theta: Few<Chunk<Lane<F>>> = splat(pass.packed).map(Chunk::constant).collect();
    for (t, at) in pass.blocks() {
        let x: Few<Lane<F>> = gathered(pass.x, inputs, at).collect();
        let act = |x: &[_], u: &mut [_]| act_on(policy, &theta, x, t, u);
        jacobian(&x, 0..inputs, outputs, act, |i, slope| {
            for (lane, c) in at.iter().enumerate() {
                x_bar[c * inputs + i] = dot(slope, lane, &u_bar[c * outputs..][..outputs]);
            }
        });
    }
}

/// Adds `Σ_c weight[c]·(∂N/∂θ)ᵀ u_bar[c]` over the columns of a pass to `theta_bar`.
pub(super) fn add_param_vjp<P: Policy + ?Sized, F: Float>(
    policy: &P,
    pass: PolicyPass<F>,
    record: PolicyRecord<F>,
    theta_bar: &mut [F],
) {
    let weight = |c: usize| record.weight.map_or(F::one(), |weight| weight[c]);
    if in_reverse(policy) {
        return each_cotangent(policy, pass, By::Params, record.u_bar, |at, cotangents| {
            for (lane, c) in at.iter().enumerate() {
                let weight = weight(c);
                for (theta_bar, bar) in theta_bar.iter_mut().zip(cotangents) {
                    *theta_bar += weight * bar.lane(lane);
                }
            }
        });
    }
    let (inputs, outputs) = dims(policy);
    let theta: Few<Lane<F>> = splat(pass.packed).collect();
    for (t, at) in pass.blocks() {
        let x: Few<Chunk<Lane<F>>> = gathered(pass.x, inputs, at).map(Chunk::constant).collect();
        let act = |theta: &[_], u: &mut [_]| act_on(policy, theta, &x, t, u);
        jacobian(&theta, 0..theta.len(), outputs, act, |i, slope| {
            for (lane, c) in at.iter().enumerate() {
                theta_bar[i] +=
                    weight(c) * dot(slope, lane, &record.u_bar[c * outputs..][..outputs]);
            }
        });
    }
}

/// [`Policy::act`] on one block.
struct Act<'a, P: ?Sized, F: Float> {
    policy: &'a P,
    theta: &'a [Lane<F>],
    x: &'a [Lane<F>],
    t: usize,
    u: &'a mut [Lane<F>],
}

impl<P: Policy + ?Sized, F: Float> Vectorized for Act<'_, P, F> {
    #[inline(always)]
    fn run<const FMA: bool>(self) {
        act_on(self.policy, self.theta, self.x, self.t, self.u);
    }
}

/// Arguments with respect to which [`Policy::act`] is differentiated.
#[derive(Clone, Copy, PartialEq)]
enum By {
    /// Observation and memory.
    Inputs,
    /// Parameters.
    Params,
}

/// Calls `visit` with each block of columns and its cotangents, one per input or parameter. `u_bar`
/// holds the cotangents of the outputs of all columns.
fn each_cotangent<P: Policy + ?Sized, F: Float>(
    policy: &P,
    pass: PolicyPass<F>,
    by: By,
    u_bar: &[F],
    mut visit: impl FnMut(PolicyColumns, &[Lane<F>]),
) {
    let outputs = dims(policy).1;
    lend(|(recording, cotangents): &mut (Recording<Lane<F>>, Vec<Lane<F>>)| {
        for (t, at) in pass.blocks() {
            dispatch_lanes(Recorded { policy, pass, by, t, at, recording });
            gather(u_bar, outputs, at, cotangents);
            recording.pull(cotangents, &mut |pulled| visit(at, pulled));
        }
    });
}

/// Recorded [`Policy::act`] on one block.
struct Recorded<'a, P: ?Sized, F: Float> {
    policy: &'a P,
    pass: PolicyPass<'a, F>,
    by: By,
    t: usize,
    at: PolicyColumns,
    recording: &'a mut Recording<Lane<F>>,
}

impl<P: Policy + ?Sized, F: Float> Vectorized for Recorded<'_, P, F> {
    #[inline(always)]
    fn run<const FMA: bool>(self) {
        let Self { policy, pass, by, t, at, recording } = self;
        let (inputs, outputs) = dims(policy);
        recording.clear();
        recording.extend(splat(pass.packed), by == By::Params);
        recording.extend(gathered(pass.x, inputs, at), by == By::Inputs);
        recording.record(outputs, |all, u| {
            let (theta, x) = all.split_at(pass.packed.len());
            act_on(policy, theta, x, t, u);
        });
    }
}
