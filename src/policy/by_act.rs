//! Batched passes of a policy by calls of [`Policy::act`], on eight columns at a time.
//!
//! Derivatives are those of reverse mode. They reuse buffers of the current thread.

use super::{BLOCK, Policy, PolicyColumns, PolicyPass, act_on, dims};
use crate::numbers::kernels::{Vectorized, dispatch_lanes};
use crate::numbers::pool::lend;
use crate::numbers::reverse_mode::Recording;
use crate::numbers::scalar::{Float, Lanes, Real};

/// Numbers of the columns of one block.
type Lane<F> = Lanes<F, BLOCK>;

/// Numbers of a block: `n` per column. Unused lanes repeat the last column.
fn gathered<F: Float>(x: &[F], n: usize, block: PolicyColumns) -> impl Iterator<Item = Lane<F>> {
    let column = move |lane: usize| block.first + lane.min(block.count - 1) * block.step;
    (0..n).map(move |i| {
        let mut numbers = Lanes([F::zero(); BLOCK]);
        (0..BLOCK).for_each(|lane| numbers.set_lane(lane, x[column(lane) * n + i]));
        numbers
    })
}

/// Parameters, equal in all lanes.
fn splat<F: Float>(packed: &[F]) -> impl Iterator<Item = Lane<F>> {
    packed.iter().map(|&theta| Real::splat(theta))
}

/// Writes the outputs of the columns of a pass.
pub(super) fn forward<P: Policy + ?Sized, F: Float>(policy: &P, pass: PolicyPass<F>, u: &mut [F]) {
    let (inputs, outputs) = dims(policy);
    lend(|[theta, x, block_u]: &mut [Vec<Lane<F>>; 3]| {
        theta.clear();
        theta.extend(splat(pass.packed));
        for (t, block) in pass.blocks() {
            x.clear();
            x.extend(gathered(pass.x, inputs, block));
            block_u.clear();
            block_u.resize(outputs, Lanes([F::zero(); BLOCK]));
            dispatch_lanes(Act { policy, theta, x, t, u: block_u });
            for (lane, c) in block.iter().enumerate() {
                for (u, block_u) in u[c * outputs..][..outputs].iter_mut().zip(&*block_u) {
                    *u = block_u.lane(lane);
                }
            }
        }
    });
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

/// Arguments of a derivative of [`Policy::act`].
#[derive(Clone, Copy, PartialEq)]
pub(super) enum By {
    /// Observation and memory.
    Inputs,
    /// Parameters.
    Params,
}

/// Calls `visit` with each block of columns and its cotangents, one per input or parameter. `u_bar`
/// holds the cotangents of the outputs of all columns.
pub(super) fn each_cotangent<P: Policy + ?Sized, F: Float>(
    policy: &P,
    pass: PolicyPass<F>,
    by: By,
    u_bar: &[F],
    mut visit: impl FnMut(PolicyColumns, &[Lane<F>]),
) {
    let outputs = dims(policy).1;
    lend(|(recording, bars): &mut (Recording<Lane<F>>, Vec<Lane<F>>)| {
        for (t, block) in pass.blocks() {
            dispatch_lanes(Recorded { policy, pass, by, t, block, recording });
            bars.clear();
            bars.extend(gathered(u_bar, outputs, block));
            recording.pull(bars, |cotangents| visit(block, cotangents));
        }
    });
}

/// Recorded [`Policy::act`] on one block.
struct Recorded<'a, P: ?Sized, F: Float> {
    policy: &'a P,
    pass: PolicyPass<'a, F>,
    by: By,
    t: usize,
    block: PolicyColumns,
    recording: &'a mut Recording<Lane<F>>,
}

impl<P: Policy + ?Sized, F: Float> Vectorized for Recorded<'_, P, F> {
    #[inline(always)]
    fn run<const FMA: bool>(self) {
        let Self { policy, pass, by, t, block, recording } = self;
        let (inputs, outputs) = dims(policy);
        recording.clear();
        recording.extend(splat(pass.packed), by == By::Params);
        recording.extend(gathered(pass.x, inputs, block), by == By::Inputs);
        recording.record(outputs, |all, u| {
            let (theta, x) = all.split_at(pass.packed.len());
            act_on(policy, theta, x, t, u);
        });
    }
}
