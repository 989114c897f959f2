//! Simulation of one window, with exact derivatives by parameters and initial state.

use crate::dynamics::inputs::Inputs;
use crate::dynamics::outline;
use crate::dynamics::system::System;
use num_dual::Dual64;

/// Object-safe system for the two scalar types of an identification.
pub(super) trait Model: Sync {
    fn sizes(&self) -> [usize; 3];
    fn step(&self, inputs: Inputs<'_, f64>, next: &mut [f64]);
    fn step_by_duals(&self, inputs: Inputs<'_, Dual64>, next: &mut [Dual64]);
}

impl<S: System> Model for S {
    fn sizes(&self) -> [usize; 3] {
        [self.state_dim(), self.control_dim(), self.param_dim()]
    }

    fn step(&self, inputs: Inputs<'_, f64>, next: &mut [f64]) {
        outline::step(self, inputs, next);
    }

    fn step_by_duals(&self, inputs: Inputs<'_, Dual64>, next: &mut [Dual64]) {
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
    /// States at all steps, the initial one included. Ends before the first non-finite state.
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

    /// Derivatives of the states at all steps: `[step][component][direction]`.
    ///
    /// The directions are the parameters with these indices, then the initial state if
    /// `by_start`.
    pub fn derivatives(&self, model: &dyn Model, params: &[usize], by_start: bool) -> Vec<Vec<Vec<f64>>> {
        let n = self.x.len();
        let directions = params.len() + if by_start { n } else { 0 };
        let mut all = vec![vec![vec![0.0; directions]; n]; self.steps + 1];
        let convert = |values: &[f64]| values.iter().map(|&value| Dual64::from_re(value)).collect::<Vec<_>>();
        let controls: Vec<Vec<Dual64>> = self.u.iter().map(|u| convert(u)).collect();
        let zeros = convert(&vec![0.0; model.sizes()[1]]);
        for direction in 0..directions {
            let (mut x, mut p) = (convert(self.x), convert(self.p));
            match params.get(direction) {
                Some(&index) => p[index].eps = 1.0,
                None => x[direction - params.len()].eps = 1.0,
            }
            let mut next = x.clone();
            for (i, rows) in all.iter_mut().enumerate() {
                for (row, x) in rows.iter_mut().zip(&x) {
                    row[direction] = x.eps;
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
