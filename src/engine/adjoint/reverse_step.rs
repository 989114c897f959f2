//! [`reverse_step`]: one step of the recursion without the policy, for one block of samples.

use super::cost_gradient::{CostGradient, clear};
use crate::dynamics::inputs::{Cotangents, Inputs};
use crate::dynamics::system::System;
use crate::dynamics::task::Task;
use crate::engine::flow::Flow;
use crate::numbers::scalar::{CotangentPack, Real, Scalar};
use crate::numbers::zip::zip;

/// Inputs and outputs of one step of the recursion, for one block of samples.
pub(super) struct BlockStep<'a, R, const K: usize> {
    /// Inputs `x_t`, `u_t`, `p`, `t`.
    pub(super) inputs: Inputs<'a, R>,
    /// Next state `x_{t+1}`.
    pub(super) next: &'a [R],
    /// λ, read and overwritten.
    pub(super) lambda: &'a mut [CotangentPack<R, K>],
    /// `(∂S/∂x)ᵀ λ`, written unless the only flow has no path through the physics.
    pub(super) x_bar: &'a mut [CotangentPack<R, K>],
    /// h, written.
    pub(super) u_bar: &'a mut [CotangentPack<R, K>],
    /// `(∂S/∂p)ᵀ λ`, written if requested.
    pub(super) p_bar: Option<&'a mut [CotangentPack<R, K>]>,
    /// μ, the cotangent of the memory after the step.
    pub(super) memory_bar: &'a [CotangentPack<R, K>],
    /// Gradients of the running cost, written unless given.
    pub(super) cost: &'a mut CostGradient<R>,
    /// True if `cost` is given.
    pub(super) is_given: bool,
    /// Factor of the cost gradients; see [`Exponents`].
    pub(super) inject: CotangentPack<R, K>,
}

/// Performs one step of the recursion without the policy. Returns Σ|λ| + Σ|h| + Σ|μ| per flow and
/// sample.
///
/// ```text
/// λ ← λ + ∂l/∂x_{t+1}
/// h ← (∂S/∂u)ᵀ λ + ∂l/∂u_t
/// p̄ ← (∂S/∂p)ᵀ λ                        if requested
/// λ ← physics·(∂S/∂x)ᵀ λ + ∂l/∂x_t
/// ```
#[inline(always)]
pub(super) fn reverse_step<T: Task, R: Real, const K: usize>(
    task: &T,
    flows: [Flow; K],
    step: BlockStep<'_, R, K>,
) -> CotangentPack<R, K> {
    let BlockStep {
        inputs,
        next,
        lambda,
        x_bar,
        u_bar,
        mut p_bar,
        memory_bar,
        cost,
        is_given,
        inject,
    } = step;
    let mut size = CotangentPack([R::zero(); K]);

    if !is_given {
        cost.clear();
        let (cotangents, next_bar) = cost.requests();
        task.running_cost_gradient(inputs, next, cotangents, next_bar);
    }
    for (lambda, &cost) in zip(lambda.iter_mut(), &cost.next) {
        *lambda += inject * cost;
    }

    clear(u_bar);
    if let Some(p_bar) = &mut p_bar {
        clear(p_bar);
    }
    // Two flows without a physics path are rare: their special case is not compiled.
    if K > 1 || flows.iter().any(|flow| flow.physics != 0.0) {
        clear(x_bar);
        task.system().vjp(inputs, lambda, Cotangents { x: Some(x_bar), u: Some(u_bar), p: p_bar });
    } else {
        task.system().vjp(inputs, lambda, Cotangents { x: None, u: Some(u_bar), p: p_bar });
    }
    for (u_bar, &cost) in zip(u_bar.iter_mut(), &cost.u) {
        *u_bar += inject * cost;
        size += u_bar.abs();
    }
    for memory_bar in memory_bar {
        size += memory_bar.abs();
    }
    for ((lambda, &x_bar), &cost) in zip(zip(lambda.iter_mut(), &*x_bar), &cost.x) {
        for (k, flow) in flows.iter().enumerate() {
            lambda.0[k] = weighted(x_bar.0[k], flow.physics);
        }
        *lambda += inject * cost;
        size += lambda.abs();
    }
    size
}

/// Multiplies a cotangent by the weight of its path. A weight of 0 also removes non-finite numbers.
#[inline(always)]
fn weighted<R: Scalar>(bar: R, weight: f64) -> R {
    if weight == 0.0 { R::zero() } else { bar * weight }
}
