//! [`Cause`]: the diagnosis of a non-finite step.

/// Cause of a non-finite step or derivative.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Cause {
    /// An implicit step did not converge, in the forward or in the reverse pass. Holds the largest absolute residual of a state component,
    /// in the unit of that component; infinite if a residual is NaN.
    Unsolved(f64),
    /// The forces of the named effect, or their derivatives, are non-finite at the state before the
    /// step.
    Effect(&'static str),
    /// The rate of the state component with this index is non-finite at the state before the step.
    Rate(usize),
    /// The parameter `p` with this index is 0, and the step is finite with 1 in its place.
    ZeroParam(usize),
    /// The state before the step is so large that the fourth power of a component overflows. Holds
    /// the largest magnitude of a component, in its unit. The rollout has grown before, so an
    /// [`Effect`](Self::Effect) or [`Rate`](Self::Rate) that overflows there is not the cause.
    Grown(f64),
}
