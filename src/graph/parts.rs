//! [`Parts`]: the observation and the costs of a task as functions of a graph.

use super::function::Function;
use crate::dynamics::inputs::{Cotangents, Inputs};
use crate::numbers::scalar::{Cotangent, Real, Scalar};
use std::sync::Arc;

/// Observation and costs. `signals` are the numbers that depend on time alone.
#[derive(Clone, Debug, Default)]
pub(super) struct Parts {
    pub(super) observe: Option<Arc<Function>>,
    pub(super) running: Option<Arc<Function>>,
    pub(super) terminal: Option<Arc<Function>>,
    /// Negative where an episode ends.
    pub(super) margin: Option<Arc<Function>>,
}

impl Parts {
    /// Number of observations. None without an observation.
    pub(super) fn observations(&self) -> Option<usize> {
        self.observe.as_ref().map(|function| function.len())
    }

    /// Writes the observation. Returns false without one.
    pub(super) fn observe<T: Scalar>(
        &self,
        Inputs { x, p, .. }: Inputs<'_, T>,
        signals: &[T],
        y: &mut [T],
    ) -> bool {
        let Some(function) = &self.observe else { return false };
        function.eval([x, &[], p, &[], signals], y);
        true
    }

    /// Adds the Jacobian products of the observation. Returns false without one.
    pub(super) fn observe_vjp<R: Real, C: Cotangent<R>>(
        &self,
        Inputs { x, p, .. }: Inputs<'_, R>,
        signals: &[R],
        y_bar: &[C],
        cotangents: &mut Cotangents<'_, C>,
    ) -> bool {
        let Some(function) = &self.observe else { return false };
        let Cotangents { x: x_bar, p: p_bar, .. } = cotangents.reborrow();
        function.vjp([x, &[], p, &[], signals], y_bar, [x_bar, None, p_bar, None]);
        true
    }

    /// The running cost, or 0.
    pub(super) fn running_cost<T: Scalar>(
        &self,
        Inputs { x, u, p, .. }: Inputs<'_, T>,
        next: &[T],
        signals: &[T],
    ) -> T {
        let mut cost = [T::zero()];
        if let Some(function) = &self.running {
            function.eval([x, u, p, next, signals], &mut cost);
        }
        cost[0]
    }

    /// Adds the gradient of the running cost.
    pub(super) fn running_cost_gradient<R: Real>(
        &self,
        Inputs { x, u, p, .. }: Inputs<'_, R>,
        next: &[R],
        signals: &[R],
        cotangents: Cotangents<'_, R>,
        next_bar: &mut [R],
    ) {
        if let Some(function) = &self.running {
            let [x_bar, u_bar, p_bar] = cotangents.lists();
            let lists = [x, u, p, next, signals];
            function.vjp(lists, &[R::one()], [x_bar, u_bar, p_bar, Some(next_bar)]);
        }
    }

    /// The terminal cost, or 0.
    pub(super) fn terminal_cost<T: Scalar>(&self, x: &[T], p: &[T]) -> T {
        let mut cost = [T::zero()];
        if let Some(function) = &self.terminal {
            function.eval([x, &[], p, &[], &[]], &mut cost);
        }
        cost[0]
    }

    /// Adds the gradient of the terminal cost.
    pub(super) fn terminal_cost_gradient<R: Real>(
        &self,
        x: &[R],
        p: &[R],
        x_bar: &mut [R],
        p_bar: Option<&mut [R]>,
    ) {
        if let Some(function) = &self.terminal {
            function.vjp([x, &[], p, &[], &[]], &[R::one()], [Some(x_bar), None, p_bar, None]);
        }
    }

    /// Negative where an episode ends; 1 if none does.
    pub(super) fn margin<T: Scalar>(&self, x: &[T], p: &[T]) -> T {
        let mut margin = [T::one()];
        if let Some(function) = &self.margin {
            function.eval([x, &[], p, &[], &[]], &mut margin);
        }
        margin[0]
    }
}
