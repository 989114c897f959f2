//! [`Options`] and [`Initial`]: settings and start of an optimization.

use super::OptimizeError;
use std::sync::Arc;
use std::sync::atomic::AtomicBool;

/// Settings of [`optimize`](super::optimize).
#[derive(Clone, Debug)]
pub struct Options {
    /// Largest number of iterations, up to [`Options::MOST_ITERATIONS`]. Each linearizes its accepted
    /// trajectory once.
    pub max_iterations: usize,
    /// Converged if no absolute component of the projected gradient exceeds this number. Unit: cost
    /// per unit of control. At an active bound, a component whose descent direction points out of
    /// the bounds counts as 0.
    pub gradient_tolerance: f64,
    /// Converged if each of three consecutive iterations decreases the cost by at most this
    /// fraction. Also converged if the line search fails and the full step has a predicted decrease
    /// of at most this fraction. In both cases, a gradient step must predict as small a decrease too.
    /// The limits include the rounding error of the cost two iterations
    /// before, or of the initial cost after fewer than two iterations.
    pub cost_tolerance: f64,
    /// Bounds `[low, high]` of each control, at all steps. Infinite bounds are allowed. `None`: no
    /// bounds.
    pub bounds: Option<Vec<[f64; 2]>>,
    /// Flag that another thread sets to stop the optimization with [`OptimizeError::Stopped`]. Read
    /// at every step of a trajectory.
    pub stop: Option<Arc<AtomicBool>>,
}

impl Default for Options {
    /// 200 iterations, tolerances of 1e-8 (gradient) and 1e-10 (cost), no bounds.
    fn default() -> Self {
        Self {
            max_iterations: 200,
            gradient_tolerance: 1e-8,
            cost_tolerance: 1e-10,
            bounds: None,
            stop: None,
        }
    }
}

impl Options {
    /// Upper limit of [`max_iterations`](Self::max_iterations).
    pub const MOST_ITERATIONS: usize = 1_000_000;

    /// Sets equal bounds `[-size, size]` for `controls` controls.
    pub fn bounded(mut self, controls: usize, size: f64) -> Self {
        self.bounds = Some(vec![[-size, size]; controls]);
        self
    }
}

/// Feedback `(t, x, u)`, which writes the control `u` at step `t` and state `x`.
pub type Feedback<'a> = dyn Fn(usize, &[f64], &mut [f64]) + 'a;

/// Initial controls of an optimization. Bounds clamp them.
#[derive(Clone, Copy)]
pub enum Initial<'a> {
    /// All controls are 0.
    Zeros,
    /// Given controls, `[step][control]`: [`Plan::u`](super::Plan::u) of another plan, or the
    /// parameters of a trained [`OpenLoop`](crate::policy::OpenLoop).
    Controls(&'a [f64]),
    /// Controls of a rollout of a feedback.
    ///
    /// For a trained policy without memory that observes the state, call
    /// [`Policy::act`](crate::Policy::act):
    /// ```
    /// use physgrad::optimize::{Initial, Options, optimize};
    /// use physgrad::policy::{Action, Linear, Observed};
    /// use physgrad::{Policy, tasks::Lqr};
    ///
    /// let (task, policy, theta) = (Lqr::spring(), Linear::new(2, 1), [-0.3, -0.8]);
    /// let feedback = |t: usize, y: &[f64], u: &mut [f64]| {
    ///     policy.act(&theta, Observed { y, memory: &[], t }, Action { u, memory: &mut [] });
    /// };
    /// let plan = optimize(&task, &[1.0, 0.0], &[], Initial::Feedback(&feedback), &Options::default())?;
    /// assert!(plan.converged());
    /// # Ok::<(), physgrad::optimize::OptimizeError>(())
    /// ```
    Feedback(&'a Feedback<'a>),
}

/// Valid bounds of all controls, infinite if the options have none.
pub(super) struct Bounds(Vec<[f64; 2]>);

impl Bounds {
    /// Checks the bounds of the options.
    ///
    /// # Errors
    /// [`OptimizeError`] if the numbers of bounds and controls differ, if no finite control lies
    /// between two bounds, or if a bound is NaN.
    pub(super) fn new(options: &Options, control_dim: usize) -> Result<Self, OptimizeError> {
        let unbounded = [f64::NEG_INFINITY, f64::INFINITY];
        let bounds = options.bounds.clone().unwrap_or_else(|| vec![unbounded; control_dim]);
        check_length("options.bounds", "one pair per control", control_dim, bounds.len())?;
        for (control, &[low, high]) in bounds.iter().enumerate() {
            // False for NaN, and if both bounds are ∞ or both are -∞.
            if !(low <= high && low < f64::INFINITY && high > f64::NEG_INFINITY) {
                return Err(OptimizeError::Bounds { control, low, high });
            }
        }
        Ok(Self(bounds))
    }

    /// Clamps the controls of one step. A control at a distance of at most 4 ε |bound| from a bound
    /// becomes this bound, with the machine epsilon ε. Rounding therefore moves no control away
    /// from its bound.
    pub(super) fn clamp(&self, u: &mut [f64]) {
        for (u, &[low, high]) in u.iter_mut().zip(&self.0) {
            let near = |bound: f64| 4.0 * f64::EPSILON * bound.abs();
            if *u >= high || *u >= high - near(high) {
                *u = high;
            } else if *u <= low || *u <= low + near(low) {
                *u = low;
            }
        }
    }

    /// Smallest and largest change of each control within the bounds.
    pub(super) fn changes(&self, u: &[f64]) -> Vec<[f64; 2]> {
        self.0.iter().zip(u).map(|([low, high], u)| [low - u, high - u]).collect()
    }

    /// Returns a component of the gradient, or 0 if its descent direction points out of the bounds.
    pub(super) fn projected(&self, control: usize, u: f64, gradient: f64) -> f64 {
        let [low, high] = self.0[control];
        if (u <= low && gradient > 0.0) || (u >= high && gradient < 0.0) { 0.0 } else { gradient }
    }
}

/// Checks the length of an argument. `shape` names its expected shape.
///
/// # Errors
/// [`OptimizeError::Length`] if the lengths differ.
pub(super) fn check_length(
    argument: &'static str,
    shape: &'static str,
    expected: usize,
    found: usize,
) -> Result<(), OptimizeError> {
    if expected == found {
        Ok(())
    } else {
        Err(OptimizeError::Length { argument, shape, expected, found })
    }
}
