//! [`Search`]: iterations of backward pass, line search and regularization.

use super::OptimizeError;
use super::backward::{BackwardStep, backward};
use super::derivatives::Expansion;
use super::options::{Bounds, Options};
use super::plan::{Plan, Stop};
use super::trajectory::{Problem, Trajectory};
use std::ops::ControlFlow;

/// State of an optimization.
pub(super) struct Search<'a> {
    problem: Problem<'a>,
    bounds: Bounds,
    options: &'a Options,
    best: Trajectory,
    regularization: Regularization,
    costs: Vec<f64>,
    rollouts: usize,
    /// Number of consecutive iterations with a decrease within the tolerance.
    small_decreases: usize,
}

/// Number of step sizes in the line search: `2^-k` for `k < SIZES`.
const SIZES: i32 = 10;

/// Required decrease of the cost, as a fraction of the predicted decrease.
const SUFFICIENT: f64 = 0.1;

/// Number of consecutive small decreases that count as convergence. Regularization alone may cause
/// a single small decrease.
const SMALL_DECREASES: usize = 3;

impl<'a> Search<'a> {
    pub(super) fn new(
        problem: Problem<'a>,
        bounds: Bounds,
        options: &'a Options,
        start: Trajectory,
    ) -> Self {
        let (costs, regularization) = (vec![start.cost], Regularization::default());
        Self {
            problem,
            bounds,
            options,
            best: start,
            regularization,
            costs,
            rollouts: 1,
            small_decreases: 0,
        }
    }

    /// Iterates until one of the reasons in [`Stop`] applies.
    ///
    /// # Errors
    /// [`OptimizeError::Derivative`] if a derivative at the initial trajectory is not finite.
    /// [`OptimizeError::Stopped`] if the stop flag is set.
    pub(super) fn run(mut self) -> Result<Plan, OptimizeError> {
        let mut expansion = self.problem.expand(&self.best)?;
        loop {
            let improved = if self.gradient_norm(&expansion) <= self.options.gradient_tolerance {
                ControlFlow::Break(Stop::Gradient)
            } else if self.small_decreases >= SMALL_DECREASES
                && self.gradient_predicts_little(&expansion)
            {
                ControlFlow::Break(Stop::Decrease)
            } else if self.costs.len() > self.options.max_iterations {
                ControlFlow::Break(Stop::Iterations)
            } else {
                self.improve(&expansion)?
            };
            match improved {
                ControlFlow::Continue(next) => expansion = next,
                ControlFlow::Break(stop) => return Ok(self.finish(expansion, stop)),
            }
        }
    }

    /// Replaces the trajectory by a better one and returns its expansion, or the reason for the
    /// termination.
    ///
    /// # Errors
    /// [`OptimizeError::Stopped`] if the stop flag is set.
    fn improve(
        &mut self,
        expansion: &Expansion,
    ) -> Result<ControlFlow<Stop, Expansion>, OptimizeError> {
        let tolerance = self.tolerance();
        loop {
            let step = backward(expansion, &self.best.u, &self.bounds, self.regularization.value);
            let better = step.as_ref().and_then(|step| self.line_search(step));
            // Rejects trajectories whose derivatives are not finite.
            let expanded = better
                .and_then(|better| self.problem.expand(&better).ok().map(|next| (better, next)));
            self.problem.check_stop()?;
            if let Some((better, next)) = expanded {
                let decrease = self.best.cost - better.cost;
                self.small_decreases =
                    if decrease <= tolerance { self.small_decreases + 1 } else { 0 };
                self.costs.push(better.cost);
                self.best = better;
                self.regularization.decrease();
                return Ok(ControlFlow::Continue(next));
            }
            if step.is_some_and(|step| step.predicted(1.0) <= tolerance)
                && self.gradient_predicts_little(expansion)
            {
                return Ok(ControlFlow::Break(Stop::Decrease));
            }
            if !self.regularization.increase() {
                return Ok(ControlFlow::Break(Stop::NoDescent));
            }
        }
    }

    /// Largest decrease of the cost that counts as small. It includes the rounding error of the cost
    /// two iterations before, or of the initial cost.
    fn tolerance(&self) -> f64 {
        let recent = self.costs[self.costs.len().saturating_sub(SMALL_DECREASES)];
        self.options.cost_tolerance * self.best.cost.abs() + f64::EPSILON * recent.abs()
    }

    /// Returns whether a gradient step predicts a small decrease too. Regularized steps alone may be
    /// small far from a minimum.
    fn gradient_predicts_little(&self, expansion: &Expansion) -> bool {
        expansion.cauchy_decrease(&self.best.u, &self.bounds) <= self.tolerance()
    }

    /// Returns the first trajectory along the step with a sufficient decrease of the cost.
    fn line_search(&mut self, step: &BackwardStep) -> Option<Trajectory> {
        let (n, m) = (self.problem.n, self.problem.m);
        for size in (0..SIZES).map(|k| 0.5f64.powi(k)) {
            let Trajectory { x: old_x, u: old_u, .. } = &self.best;
            let simulated = self.problem.simulate(&old_x[..n], |t, x, u| {
                let deviation = x.iter().zip(&old_x[t * n..]).map(|(x, old)| x - old);
                for i in 0..m {
                    let feedback: f64 =
                        deviation.clone().enumerate().map(|(j, d)| step.gains[t][(i, j)] * d).sum();
                    u[i] = old_u[t * m + i] + size * step.changes[t][i] + feedback;
                }
                self.bounds.clamp(u);
            });
            self.rollouts += 1;
            // A trajectory that diverges is not an improvement.
            if let Ok(new) = simulated
                && new.cost < self.best.cost
                && self.best.cost - new.cost >= SUFFICIENT * step.predicted(size)
            {
                return Some(new);
            }
        }
        None
    }

    /// Largest absolute component of the projected gradient.
    fn gradient_norm(&self, expansion: &Expansion) -> f64 {
        let all = expansion.by_control.iter().zip(&self.best.u).enumerate();
        all.fold(0.0, |norm, (i, (&gradient, &u))| {
            self.bounds.projected(i % self.problem.m, u, gradient).abs().max(norm)
        })
    }

    /// Returns the plan. Computes the gains of the final trajectory, with the least regularization
    /// that determines them.
    fn finish(self, expansion: Expansion, stop: Stop) -> Plan {
        let (n, m) = (self.problem.n, self.problem.m);
        let mut regularization = Regularization::default();
        let gains = loop {
            match backward(&expansion, &self.best.u, &self.bounds, regularization.value) {
                Some(step) => {
                    break step
                        .gains
                        .iter()
                        .flat_map(|gain| gain.transpose().as_slice().to_vec())
                        .collect();
                }
                None if regularization.increase() => {}
                None => break vec![0.0; self.best.u.len() * n],
            }
        };
        let gradient_norm = self.gradient_norm(&expansion);
        let (Trajectory { x, u, cost }, p) = (self.best, self.problem.p.to_vec());
        let (costs, rollouts, gradient) = (self.costs, self.rollouts, expansion.by_control);
        Plan {
            u,
            x,
            gains,
            gradient,
            p,
            cost,
            costs,
            rollouts,
            stop,
            gradient_norm,
            state_dim: n,
            control_dim: m,
        }
    }
}

/// Regularization ρ relative to the damping of the expansion, with the quadratic schedule of Tassa,
/// Erez and Todorov 2012, section II.F.
struct Regularization {
    value: f64,
    /// Factor of the last change.
    factor: f64,
    /// Last positive value whose step decreased the cost.
    successful: f64,
}

impl Default for Regularization {
    fn default() -> Self {
        Self { value: 0.0, factor: 1.0, successful: Self::FIRST }
    }
}

impl Regularization {
    /// Value after the first increase from 0.
    const FIRST: f64 = 1e-2;
    /// Smallest positive value. A decrease below it yields 0.
    const SMALLEST: f64 = 1e-6;
    /// Ratio of the factors of consecutive increases. Decreases use the reciprocal.
    const FACTOR: f64 = 2.0;
    const LARGEST: f64 = 1e10;

    /// Multiplies the value by a factor that doubles with each consecutive increase, or replaces 0
    /// by the last successful value, at first [`FIRST`](Self::FIRST). Returns false if the value exceeds [`LARGEST`](Self::LARGEST).
    fn increase(&mut self) -> bool {
        self.factor = (self.factor * Self::FACTOR).max(Self::FACTOR);
        self.value = if self.value == 0.0 { self.successful } else { self.value * self.factor };
        self.value <= Self::LARGEST
    }

    /// Decreases the value after a success.
    fn decrease(&mut self) {
        if self.value > 0.0 {
            self.successful = self.value;
        }
        self.factor = (self.factor / Self::FACTOR).min(1.0 / Self::FACTOR);
        let value = self.value * self.factor;
        self.value = if value >= Self::SMALLEST { value } else { 0.0 };
    }
}
