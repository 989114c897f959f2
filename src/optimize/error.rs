//! [`OptimizeError`]: invalid input, a non-finite number, or a stop by the options.

/// Error of [`optimize`](super::optimize) and [`Tracking::new`](super::Tracking::new).
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum OptimizeError {
    /// An argument has the wrong length.
    #[error("{argument} has {found} entries, but the task needs {expected} ({shape})")]
    Length {
        /// Name of the argument.
        argument: &'static str,
        /// Meaning of the expected length.
        shape: &'static str,
        /// Expected length.
        expected: usize,
        /// Found length.
        found: usize,
    },
    /// [`Options::max_iterations`](super::Options::max_iterations) exceeds its limit.
    #[error(
        "the largest number of iterations is {found}; allowed: 0 to {}",
        super::Options::MOST_ITERATIONS
    )]
    Iterations {
        /// Number in the options.
        found: usize,
    },
    /// A number of an argument is not finite.
    #[error("number {index} of {argument} is not finite; give finite numbers")]
    NotFinite {
        /// Name of the argument.
        argument: &'static str,
        /// Index of the number.
        index: usize,
    },
    /// No finite control lies between the bounds, or a bound is NaN.
    #[error(
        "the bounds of control {control} are [{low}, {high}]; allowed: low <= high, low < inf, high > -inf"
    )]
    Bounds {
        /// Index of the control.
        control: usize,
        /// Lower bound.
        low: f64,
        /// Upper bound.
        high: f64,
    },
    /// A state or control of the initial trajectory is not finite.
    #[error(
        "initial trajectory: component {component} of the {variable} at step {step} is not finite. \
         Start from other controls, for instance a stabilizing feedback, or reduce the time step"
    )]
    Diverged {
        /// `state` or `control`.
        variable: &'static str,
        /// Time step. The initial state and the first control have step 0.
        step: usize,
        /// Component of the variable.
        component: usize,
    },
    /// The accumulated cost of the initial trajectory is not finite at this step. The states up to
    /// the end of this step are finite.
    #[error(
        "initial trajectory: the cost {} is not finite, but the states are finite up to there. Check the cost for overflow, division by 0, and \
         roots or logarithms of negative numbers", place(*step)
    )]
    Cost {
        /// Step of the running cost; `None` for the terminal cost.
        step: Option<usize>,
    },
    /// A derivative at the finite initial trajectory is not finite.
    #[error(
        "initial trajectory: a derivative of the {} is not finite. \
         Smooth the cost and the dynamics there, for instance roots near 0, or shorten the horizon if the adjoint overflows", differentiated(*step)
    )]
    Derivative {
        /// Step of the running cost or of the dynamics; `None` for the terminal cost.
        step: Option<usize>,
    },
    /// The flag of the options stopped the optimization.
    #[error("the optimization was stopped before its end; start it again")]
    Stopped,
}

/// Names, for messages, the functions whose derivative at this step is not finite.
fn differentiated(step: Option<usize>) -> String {
    step.map_or("terminal cost".into(), |step| {
        format!("running cost of step {step}, or of the dynamics in this step,")
    })
}

/// Names, for messages, the costs in the sum that is not finite.
fn place(step: Option<usize>) -> String {
    step.map_or("with the terminal cost".into(), |step| {
        format!("up to the running cost of step {step}")
    })
}
