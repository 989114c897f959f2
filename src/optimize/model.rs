//! [`Model`]: the functions of a task that an optimization calls, with fixed scalar types.

use super::derivatives::Second;
use crate::dynamics::inputs::{Cotangents, Inputs};
use crate::dynamics::outline;
use crate::dynamics::system::System;
use crate::dynamics::task::Task;
use crate::numbers::forward_mode::Chunk;

/// Object-safe task. The compiler monomorphizes these functions for each task. The search is
/// compiled once.
pub(super) trait Model {
    /// Numbers of state components, controls and parameters.
    fn sizes(&self) -> [usize; 3];
    fn horizon(&self) -> usize;
    fn step(&self, inputs: Inputs<'_, f64>, next: &mut [f64]);
    fn step_by_duals(&self, inputs: Inputs<'_, Chunk<f64>>, next: &mut [Chunk<f64>]);
    fn running_cost(&self, inputs: Inputs<'_, f64>, next: &[f64]) -> f64;
    fn running_cost_by_duals(&self, inputs: Inputs<'_, Second>, next: &[Second]) -> Second;
    fn running_cost_gradient(
        &self,
        inputs: Inputs<'_, f64>,
        next: &[f64],
        cotangents: Cotangents<'_, f64>,
        next_bar: &mut [f64],
    );
    fn terminal_cost(&self, x: &[f64], p: &[f64]) -> f64;
    fn terminal_cost_by_duals(&self, x: &[Second], p: &[Second]) -> Second;
    fn terminal_cost_gradient(&self, x: &[f64], p: &[f64], x_bar: &mut [f64]);
}

impl<T: Task> Model for T {
    fn sizes(&self) -> [usize; 3] {
        [self.system().state_dim(), self.system().control_dim(), self.param_dim()]
    }

    fn horizon(&self) -> usize {
        Task::horizon(self)
    }

    fn step(&self, inputs: Inputs<'_, f64>, next: &mut [f64]) {
        outline::step(self.system(), inputs, next);
    }

    fn step_by_duals(&self, inputs: Inputs<'_, Chunk<f64>>, next: &mut [Chunk<f64>]) {
        outline::step(self.system(), inputs, next);
    }

    fn running_cost(&self, inputs: Inputs<'_, f64>, next: &[f64]) -> f64 {
        Task::running_cost(self, inputs, next)
    }

    fn running_cost_by_duals(&self, inputs: Inputs<'_, Second>, next: &[Second]) -> Second {
        Task::running_cost(self, inputs, next)
    }

    fn running_cost_gradient(
        &self,
        inputs: Inputs<'_, f64>,
        next: &[f64],
        cotangents: Cotangents<'_, f64>,
        next_bar: &mut [f64],
    ) {
        Task::running_cost_gradient(self, inputs, next, cotangents, next_bar);
    }

    fn terminal_cost(&self, x: &[f64], p: &[f64]) -> f64 {
        Task::terminal_cost(self, x, p)
    }

    fn terminal_cost_by_duals(&self, x: &[Second], p: &[Second]) -> Second {
        Task::terminal_cost(self, x, p)
    }

    fn terminal_cost_gradient(&self, x: &[f64], p: &[f64], x_bar: &mut [f64]) {
        Task::terminal_cost_gradient(self, x, p, x_bar, None);
    }
}
