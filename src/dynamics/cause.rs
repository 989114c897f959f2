//! [`Cause`]: the reason for a non-finite step.

/// What made a step, or its derivative, a number that is none.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Cause {
    /// The step had to solve an equation and could not: this is the size of the residual that it was left with.
    Unsolved(f64),
    /// The forces of this effect, or their derivatives, are not finite at the state in which the step begins.
    Effect(&'static str),
}
