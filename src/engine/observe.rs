//! [`Observe`]: observations of all samples, one block of lanes at a time.

use crate::dynamics::inputs::{Cotangents, Inputs};
use crate::dynamics::outline::One;
use crate::dynamics::system::System;
use crate::dynamics::task::Task;
use crate::numbers::kernels::{Vectorized, dispatch_lanes};
use crate::numbers::scalar::{Float, Lane};

/// Observations of a task for all samples at once. Inputs concatenate the states and parameters of
/// all blocks; controls are empty.
pub trait Observe<F: Float> {
    /// Writes the observations of all blocks.
    fn observe(&self, inputs: Inputs<'_, Lane<F>>, y: &mut [Lane<F>]);
    /// Adds `(∂y/∂x)ᵀ y_bar` to `x_bar`, and `(∂y/∂p)ᵀ y_bar` to `p_bar` if requested, for all
    /// blocks.
    fn observe_back(
        &self,
        inputs: Inputs<'_, Lane<F>>,
        y_bar: &[One<Lane<F>>],
        x_bar: &mut [One<Lane<F>>],
        p_bar: Option<&mut [One<Lane<F>>]>,
    );
}

impl<T: Task, F: Float> Observe<F> for T {
    #[inline(never)]
    fn observe(&self, inputs: Inputs<'_, Lane<F>>, y: &mut [Lane<F>]) {
        dispatch_lanes(Forward { task: self, inputs, y });
    }

    #[inline(never)]
    fn observe_back(
        &self,
        inputs: Inputs<'_, Lane<F>>,
        y_bar: &[One<Lane<F>>],
        x_bar: &mut [One<Lane<F>>],
        p_bar: Option<&mut [One<Lane<F>>]>,
    ) {
        dispatch_lanes(Back { task: self, inputs, y_bar, x_bar, p_bar });
    }
}

/// Inputs of one block.
#[inline(always)]
fn of_block<'a, T: Task, F: Float>(
    task: &T,
    inputs: Inputs<'a, Lane<F>>,
    block: usize,
) -> Inputs<'a, Lane<F>> {
    let (n, params) = (task.system().state_dim(), task.param_dim());
    Inputs { x: &inputs.x[block * n..][..n], p: &inputs.p[block * params..][..params], ..inputs }
}

struct Forward<'a, T, F: Float> {
    task: &'a T,
    inputs: Inputs<'a, Lane<F>>,
    y: &'a mut [Lane<F>],
}

impl<T: Task, F: Float> Vectorized for Forward<'_, T, F> {
    #[inline(always)]
    fn run<const FMA: bool>(self) {
        let Self { task, inputs, y } = self;
        let dim = task.observation_dim().unwrap_or(0);
        // Without components, `y` is empty. A chunk length of 0 would panic.
        for (block, y) in y.chunks_exact_mut(dim.max(1)).enumerate() {
            task.observe(of_block(task, inputs, block), y);
        }
    }
}

struct Back<'a, T, F: Float> {
    task: &'a T,
    inputs: Inputs<'a, Lane<F>>,
    y_bar: &'a [One<Lane<F>>],
    x_bar: &'a mut [One<Lane<F>>],
    p_bar: Option<&'a mut [One<Lane<F>>]>,
}

impl<T: Task, F: Float> Vectorized for Back<'_, T, F> {
    #[inline(always)]
    fn run<const FMA: bool>(self) {
        let Self { task, inputs, y_bar, x_bar, mut p_bar } = self;
        let (n, dim) = (task.system().state_dim(), task.observation_dim().unwrap_or(0));
        let params = task.param_dim();
        for (block, x_bar) in x_bar.chunks_exact_mut(n).enumerate() {
            let p_bar = p_bar.as_deref_mut().map(|p_bar| &mut p_bar[block * params..][..params]);
            let cotangents = Cotangents { x: Some(x_bar), u: None, p: p_bar };
            task.observe_vjp(
                of_block(task, inputs, block),
                &y_bar[block * dim..][..dim],
                cotangents,
            );
        }
    }
}
