//! [`Plan`]: result of an optimization.

use std::fmt;

/// Result of an optimization from one initial state: controls, states, gains and cost. See
/// [`converged`](Plan::converged).
#[derive(Clone, Debug, PartialEq)]
pub struct Plan {
    /// Controls, `[step][control]`: the parameters of an [`OpenLoop`](crate::policy::OpenLoop).
    pub u: Vec<f64>,
    /// States, `[step][component]`, from the initial state to the last one.
    pub x: Vec<f64>,
    /// Gains `K_t`, `[step][control][component]`. See [`feedback`](Plan::feedback).
    pub gains: Vec<f64>,
    /// Gradient of the cost with respect to the controls, `[step][control]`, without projection. At
    /// an active bound, a component may be nonzero at the optimum.
    pub gradient: Vec<f64>,
    /// Parameters of the sample.
    pub p: Vec<f64>,
    /// Running costs plus terminal cost.
    pub cost: f64,
    /// Initial cost, then the cost after each iteration. Never increases.
    pub costs: Vec<f64>,
    /// Number of simulated trajectories, rejected ones included.
    pub rollouts: usize,
    /// Reason for the termination.
    pub stop: Stop,
    pub(super) gradient_norm: f64,
    pub(super) state_dim: usize,
    pub(super) control_dim: usize,
}

/// Reason for the termination of an optimization.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Stop {
    /// The projected gradient is within its tolerance.
    Gradient,
    /// The relative decrease of the cost is within its tolerance.
    Decrease,
    /// No step decreases the cost sufficiently, even with the largest regularization.
    NoDescent,
    /// The optimization reached the largest number of iterations.
    Iterations,
}

/// Share of the initial cost below which a cost counts as 0. Its gradient then exceeds any share of
/// the cost.
const AS_GOOD_AS_0: f64 = 1e-9;
/// Decrease relative to the cost up to which a search has ended where it began.
const UNCHANGED: f64 = 1e-8;

impl Plan {
    /// Sentences about a search that may have ended far from a minimum: at a gradient above 1e-4 of
    /// the cost, or where it began.
    pub fn warnings(&self) -> Vec<&'static str> {
        let is_steep = self.stop != Stop::Gradient
            && self.gradient_norm > 1e-4 * self.cost.abs()
            && self.cost.abs() > AS_GOOD_AS_0 * self.costs[0].abs();
        let is_flat = self.converged()
            && self.cost != 0.0
            && self.costs[0] - self.cost <= UNCHANGED * self.cost.abs()
            && !self.gradient.is_empty();
        let is_unfinished = is_steep && self.stop == Stop::Iterations;
        let warnings = [
            (
                is_unfinished,
                "the search ended at a gradient above 1e-4 of the cost, because it reached the largest number of iterations. Allow \
                 more iterations",
            ),
            (
                is_steep && !is_unfinished,
                "the search ended at a gradient above 1e-4 of the cost, so lower costs exist nearby. A saturation of the controls \
                 inside the step may cause this, because its derivative is 0 at its limits and beyond. Remove it from the step and \
                 bound the controls, or keep the bounds strictly inside its limits",
            ),
            (
                is_flat,
                "the search ended where it began. Either the cost has a minimum there, or another stationary point, for example \
                 a pendulum that hangs or balances, or no control acts: each is at the kink of a function such as max(u, 0), or \
                 beyond a saturation inside the step. Start from other controls, or bound them strictly inside the saturation",
            ),
        ];
        warnings.into_iter().filter(|(applies, _)| *applies).map(|(_, text)| text).collect()
    }

    /// Number of iterations.
    pub fn iterations(&self) -> usize {
        self.costs.len() - 1
    }

    /// Returns whether the optimization reached a tolerance.
    pub fn converged(&self) -> bool {
        matches!(self.stop, Stop::Gradient | Stop::Decrease)
    }

    /// Largest absolute component of the projected gradient. At an active bound, a component whose
    /// descent direction points out of the bounds counts as 0.
    pub fn gradient_norm(&self) -> f64 {
        self.gradient_norm
    }

    /// Number of steps.
    pub fn horizon(&self) -> usize {
        self.x.len() / self.state_dim - 1
    }

    /// State at step `t`, from 0 to the horizon.
    ///
    /// # Panics
    /// If `t` exceeds the horizon.
    #[track_caller]
    pub fn state(&self, t: usize) -> &[f64] {
        &self.x[t * self.state_dim..][..self.state_dim]
    }

    /// Control of step `t`.
    ///
    /// # Panics
    /// If `t` is not below the horizon.
    #[track_caller]
    pub fn control(&self, t: usize) -> &[f64] {
        &self.u[t * self.control_dim..][..self.control_dim]
    }

    /// Writes the control `u_t + K_t (x - x_t)` of a state near the plan, without clamping.
    ///
    /// The gains result from a backward pass along the plan, with the least regularization that
    /// determines them. If the plan converged and this regularization is zero, the gains are
    /// optimal for the linearized dynamics and quadratic costs. Rows of controls at an active bound
    /// are 0. All gains are 0 if no regularization determines them.
    ///
    /// # Panics
    /// If `t` is not below the horizon, or `x` or `u` has the wrong length.
    #[track_caller]
    pub fn feedback(&self, t: usize, x: &[f64], u: &mut [f64]) {
        let (n, m) = (self.state_dim, self.control_dim);
        assert_eq!([x.len(), u.len()], [n, m], "lengths of the state and the control");
        let rows = self.gains[t * m * n..][..m * n].chunks_exact(n);
        let deviation = || x.iter().zip(self.state(t)).map(|(x, planned)| x - planned);
        for ((u, planned), row) in u.iter_mut().zip(self.control(t)).zip(rows) {
            *u = planned
                + row
                    .iter()
                    .zip(deviation())
                    .map(|(gain, deviation)| gain * deviation)
                    .sum::<f64>();
        }
    }
}

impl fmt::Display for Stop {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::Gradient => "the gradient is within its tolerance",
            Self::Decrease => "the decrease of the cost is within its tolerance",
            Self::NoDescent => "no step decreases the cost",
            Self::Iterations => "the largest number of iterations was reached",
        })
    }
}
