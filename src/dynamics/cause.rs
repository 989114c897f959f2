//! [`Cause`]: the diagnosis of a non-finite step.

/// Cause of a non-finite step or derivative.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Cause {
    /// An implicit step did not converge. Holds the largest residual among the state components,
    /// each in the unit of its component.
    Unsolved(f64),
    /// The forces of the named effect, or their derivatives, are non-finite at the state before the
    /// step.
    Effect(&'static str),
}
