//! [`CostGradient`]: gradients of the running cost of one step.

use crate::dynamics::inputs::Cotangents;
use crate::numbers::scalar::{Cotangent, Real};

/// Gradients of the running cost of one step, for one block of samples. Before the first step,
/// `next` and `p` hold the gradient of the terminal cost.
#[derive(Debug)]
pub(super) struct CostGradient<R> {
    /// `∂l/∂x_{t+1}`.
    pub(super) next: Vec<R>,
    /// `∂l/∂x_t`.
    pub(super) x: Vec<R>,
    /// `∂l/∂u_t`.
    pub(super) u: Vec<R>,
    /// `∂l/∂p`. Empty if not requested.
    pub(super) p: Vec<R>,
}

impl<R: Real> CostGradient<R> {
    pub(super) fn new(n: usize, m: usize) -> Self {
        let nulls = |len: usize| vec![R::null(); len];
        Self { next: nulls(n), x: nulls(n), u: nulls(m), p: Vec::new() }
    }

    pub(super) fn bytes_of(n: usize, m: usize) -> usize {
        (2 * n + m) * size_of::<R>()
    }

    /// All gradients, concatenated.
    pub(super) fn values(&self) -> impl Iterator<Item = &R> {
        self.next.iter().chain(&self.x).chain(&self.u).chain(&self.p)
    }

    /// Sets all entries to the initial value of a sum.
    #[inline(always)]
    pub(super) fn clear(&mut self) {
        for values in [&mut self.next, &mut self.x, &mut self.u, &mut self.p] {
            clear(values);
        }
    }

    /// Cotangents to which [`Task::running_cost_gradient`] adds.
    #[inline(always)]
    pub(super) fn requests(&mut self) -> (Cotangents<'_, R>, &mut [R]) {
        let p = (!self.p.is_empty()).then_some(&mut self.p[..]);
        (Cotangents { x: Some(&mut self.x), u: Some(&mut self.u), p }, &mut self.next)
    }
}

/// Sets all cotangents to the initial value of a sum. Inlined, unlike `fill`.
#[inline(always)]
pub(super) fn clear<R, C: Cotangent<R>>(cotangents: &mut [C]) {
    for bar in cotangents {
        *bar = C::null();
    }
}
