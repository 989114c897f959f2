//! Trajectory optimization: controls that minimize the loss of any [`Task`] from one initial state.
//!
//! [`optimize`] finds `u_0 .. u_{T-1}` that minimize `φ(x_T, p) + Σ_t l(x_t, u_t, p, t, x_{t+1})`.
//! The method is differential dynamic programming, close to iLQR, with bounds on the controls:
//!
//! - Tassa, Erez and Todorov 2012, doi:10.1109/IROS.2012.6386025: regularized backward pass.
//! - Tassa, Mansard and Todorov 2014, doi:10.1109/ICRA.2014.6907001: bounds, as a quadratic program
//!   per step.
//!
//! Each iteration linearizes the dynamics, expands the costs to second order, and solves the
//! resulting linear-quadratic problem by a backward pass. A line search along the new controls and
//! gains accepts only steps that decrease the cost. If the backward pass or the line search fails,
//! the iteration repeats both with more regularization. First derivatives, and second derivatives
//! of the costs, are exact. Of the second derivatives of the dynamics, the method contains only
//! those with respect to two controls. `docs/optimize.md` has the equations and measured figures.
//!
//! - [`Options`], [`Initial`]: settings and initial controls.
//! - [`Plan`]: controls, states, gains, cost and gradient. [`Stop`]: the reason for termination.
//! - [`Tracking`]: a task whose policy learns to follow a plan.
//!
//! # Limits
//! The minimum is local. A stationary initial trajectory, such as that of a pendulum that hangs at
//! rest, does not change: start from other controls. Contacts and dry friction have derivatives of
//! one branch only.
//!
//! Imports `numbers` and `dynamics`. Start reading in `search.rs`.

mod backward;
mod box_qp;
mod cauchy;
mod curvature;
mod derivatives;
mod error;
mod model;
mod options;
mod plan;
mod search;
mod tracking;
mod trajectory;

pub use error::OptimizeError;
pub use options::{Feedback, Initial, Options};
pub use plan::{Plan, Stop};
pub use tracking::Tracking;

use crate::dynamics::task::Task;
use model::Model;
use options::{Bounds, check_length};
use search::Search;
use trajectory::Problem;

/// Minimizes the loss of a task from the initial state `x0`, with parameters `p`.
///
/// The cost never exceeds the cost of the initial controls, clamped to the bounds. Computes in
/// `f64`.
///
/// ```
/// use physgrad::optimize::{Initial, Options, optimize};
/// use physgrad::tasks::Lqr;
///
/// let task = Lqr::spring();
/// let plan = optimize(&task, &[1.0, 0.0], &[], Initial::Zeros, &Options::default())?;
/// // A linear-quadratic problem takes one iteration and has a known minimum.
/// assert_eq!(plan.iterations(), 1);
/// assert!((plan.cost - task.least_loss(&[1.0, 0.0])).abs() < 1e-12);
///
/// let bounded = Options::default().bounded(1, 0.2);
/// let plan = optimize(&task, &[1.0, 0.0], &[], Initial::Controls(&plan.u), &bounded)?;
/// assert!(plan.u.iter().all(|u| u.abs() <= 0.2));
/// # Ok::<(), physgrad::optimize::OptimizeError>(())
/// ```
///
/// # Errors
/// [`OptimizeError`] if
/// - a length differs from that of the task, or a number of `x0` or `p` is not finite,
/// - no finite control lies between two bounds, or a bound is NaN,
/// - the initial trajectory or its cost is not finite,
/// - a derivative at the initial trajectory is not finite,
/// - [`Options::stop`] is set.
#[inline(never)]
pub fn optimize<T: Task>(
    task: &T,
    x0: &[f64],
    p: &[f64],
    initial: Initial<'_>,
    options: &Options,
) -> Result<Plan, OptimizeError> {
    minimize(task, x0, p, initial, options)
}

fn minimize(
    model: &dyn Model,
    x0: &[f64],
    p: &[f64],
    initial: Initial<'_>,
    options: &Options,
) -> Result<Plan, OptimizeError> {
    let [n, m, params] = model.sizes();
    check_length("x0", "the state", n, x0.len())?;
    check_length("p", "the parameters of the task", params, p.len())?;
    if let Initial::Controls(u) = initial {
        check_length(
            "the initial controls",
            "horizon times controls",
            model.horizon() * m,
            u.len(),
        )?;
    }
    for (argument, numbers) in [("x0", x0), ("p", p)] {
        if let Some(index) = numbers.iter().position(|number| !number.is_finite()) {
            return Err(OptimizeError::NotFinite { argument, index });
        }
    }
    let bounds = Bounds::new(options, m)?;
    if options.max_iterations > Options::MOST_ITERATIONS {
        return Err(OptimizeError::Iterations { found: options.max_iterations });
    }
    let problem = Problem { model, p, n, m, stop: options.stop.as_deref() };
    let start = problem.simulate(x0, |t, x, u| {
        match initial {
            Initial::Zeros => u.fill(0.0),
            Initial::Controls(all) => u.copy_from_slice(&all[t * m..][..m]),
            Initial::Feedback(feedback) => feedback(t, x, u),
        }
        bounds.clamp(u);
    })?;
    Search::new(problem, bounds, options, start).run()
}
