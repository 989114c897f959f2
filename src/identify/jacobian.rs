//! Simulation of one window, and exact derivatives with respect to initial state and parameters.

use crate::dynamics::inputs::Inputs;
use crate::dynamics::outline;
use crate::dynamics::system::System;
use crate::numbers::forward_mode::{CHUNK, Chunk};
use nalgebra::DMatrix;

/// Object-safe system for the two scalar types of an identification.
pub(super) trait Model: Sync {
    fn sizes(&self) -> [usize; 3];
    fn step(&self, inputs: Inputs<'_, f64>, next: &mut [f64]);
    fn step_by_duals(&self, inputs: Inputs<'_, Chunk<f64>>, next: &mut [Chunk<f64>]);
}

impl<S: System> Model for S {
    fn sizes(&self) -> [usize; 3] {
        [self.state_dim(), self.control_dim(), self.param_dim()]
    }

    fn step(&self, inputs: Inputs<'_, f64>, next: &mut [f64]) {
        outline::step(self, inputs, next);
    }

    fn step_by_duals(&self, inputs: Inputs<'_, Chunk<f64>>, next: &mut [Chunk<f64>]) {
        outline::step(self, inputs, next);
    }
}

/// Initial state, parameters and controls of a simulation.
#[derive(Clone, Copy)]
pub(super) struct Run<'a> {
    pub x: &'a [f64],
    pub p: &'a [f64],
    /// Controls of the steps; missing ones are 0.
    pub u: &'a [Vec<f64>],
    /// Number of the first step.
    pub t: usize,
    pub steps: usize,
}

impl Run<'_> {
    /// Returns the initial state and the state after each step. Ends before the first non-finite
    /// state.
    pub fn simulate(&self, model: &dyn Model) -> Vec<Vec<f64>> {
        let zeros = vec![0.0; model.sizes()[1]];
        let mut states = vec![self.x.to_vec()];
        for i in 0..self.steps {
            let mut next = vec![0.0; self.x.len()];
            let u = self.u.get(i).unwrap_or(&zeros);
            model.step(Inputs { x: &states[i], u, p: self.p, t: self.t + i }, &mut next);
            if !next.iter().all(|x| x.is_finite()) {
                break;
            }
            states.push(next);
        }
        states
    }

    /// Derivatives of the states at all steps. Rows are components of the state. Columns are the
    /// components of the initial state if `by_start`, then the parameters with the indices
    /// `params`.
    pub fn derivatives(
        &self,
        model: &dyn Model,
        by_start: bool,
        params: &[usize],
    ) -> Vec<DMatrix<f64>> {
        let n = self.x.len();
        let starts = if by_start { n } else { 0 };
        let directions = starts + params.len();
        let mut all = vec![DMatrix::zeros(n, directions); self.steps + 1];
        let constants =
            |values: &[f64]| values.iter().map(|&value| Chunk::constant(value)).collect::<Vec<_>>();
        let controls: Vec<Vec<Chunk<f64>>> =
            self.u.iter().take(self.steps).map(|u| constants(u)).collect();
        let zeros = constants(&vec![0.0; model.sizes()[1]]);
        for first in (0..directions).step_by(CHUNK) {
            let chunk = first..directions.min(first + CHUNK);
            let (mut x, mut p) = (constants(self.x), constants(self.p));
            for (k, direction) in chunk.clone().enumerate() {
                match direction.checked_sub(starts) {
                    Some(unknown) => {
                        p[params[unknown]] = Chunk::variable(self.p[params[unknown]], k)
                    }
                    None => x[direction] = Chunk::variable(self.x[direction], k),
                }
            }
            let mut next = x.clone();
            for (i, slopes) in all.iter_mut().enumerate() {
                for (row, x) in x.iter().enumerate() {
                    chunk
                        .clone()
                        .enumerate()
                        .for_each(|(k, direction)| slopes[(row, direction)] = x.tangents[k]);
                }
                if i < self.steps {
                    let u = controls.get(i).unwrap_or(&zeros);
                    model.step_by_duals(Inputs { x: &x, u, p: &p, t: self.t + i }, &mut next);
                    std::mem::swap(&mut x, &mut next);
                }
            }
        }
        all
    }
}
