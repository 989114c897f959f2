//! [`Divergence`]: a number that is no number any more, as data.

use crate::backward::Flow;
use crate::wide::Wide;
use std::fmt;

/// Where a number stopped being finite. The update it belongs to is not taken.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Divergence {
    /// A state or control, in the forward pass.
    Forward {
        /// Which of the two.
        variable: Variable,
        /// Time step: of a state, 1 is the first after the start; of a control, 0 is the first.
        step: usize,
        /// Index of the sample in its batch.
        sample: usize,
        /// Its component.
        component: usize,
        /// What did it, if that is known.
        cause: Option<Cause>,
    },
    /// The cost of a sample whose states are all finite.
    Cost {
        /// Index of the sample in its batch.
        sample: usize,
    },
    /// The cotangent of a state or control, in the reverse pass.
    Cotangent {
        /// Flow whose adjoint it is.
        flow: Flow,
        /// What it is the cotangent of.
        variable: Variable,
        /// Time step.
        step: usize,
        /// Index of the sample in its batch.
        sample: usize,
        /// Its component.
        component: usize,
        /// What did it, if that is known.
        cause: Option<Cause>,
    },
    /// The gradient of a batch whose cotangents are all finite: a component is not, or its square is not.
    Gradient {
        /// Flow whose gradient it is.
        flow: Flow,
        /// Index of the parameter in `θ`.
        parameter: usize,
    },
    /// The field made of finite gradients and clipped: a component is not finite, or too large to be squared by an
    /// optimizer.
    Field {
        /// Index of the parameter in `θ`.
        parameter: usize,
        /// The length of the field.
        norm: Wide,
    },
}

/// What made a step, or its derivative, a number that is none.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Cause {
    /// The step had to solve an equation and could not: this is the size of the residual that it was left with.
    Unsolved(f64),
    /// The forces of the effect of this name, or their derivatives, are not finite at the state in which the step begins.
    Effect(&'static str),
}

/// What a rollout computes at every step.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Variable {
    /// The state of the system.
    State,
    /// The control that the policy sets.
    Control,
}

impl Divergence {
    /// The same, for a sample counted from `first` on.
    pub(crate) fn offset(mut self, first: usize) -> Self {
        match &mut self {
            Self::Forward { sample, .. } | Self::Cost { sample } | Self::Cotangent { sample, .. } => *sample += first,
            Self::Gradient { .. } | Self::Field { .. } => {}
        }
        self
    }

    /// Which of two to report: the one met first by a single pass over the whole batch.
    pub(crate) fn order(&self) -> (u8, usize, usize) {
        match *self {
            // A control comes before the state it leads to, one step later by its number.
            Self::Forward { variable: Variable::Control, step, sample, .. } => (0, 2 * step + 1, sample),
            Self::Forward { variable: Variable::State, step, sample, .. } => (0, 2 * step, sample),
            Self::Cost { sample } => (1, 0, sample),
            Self::Cotangent { step, sample, .. } => (2, usize::MAX - step, sample),
            Self::Gradient { parameter, .. } | Self::Field { parameter, .. } => (3, 0, parameter),
        }
    }
}

impl fmt::Display for Variable {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::State => "state",
            Self::Control => "control",
        })
    }
}

impl fmt::Display for Divergence {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Forward { cause: Some(Cause::Unsolved(residual)), step, sample, .. } => write!(
                f,
                "forward pass: the equation of the implicit rule could not be solved for sample {sample} at step {step}: Newton's iteration \
                 was given up with a residual of {residual:.1e}. Smaller steps help (`integrator.substeps`), a larger tolerance if the \
                 residual is small (`integrator.tolerance`), or a rule that solves nothing"
            ),
            Self::Forward { variable, step, sample, component, cause } => {
                write!(
                    f,
                    "forward pass: {variable} component {component} of sample {sample} is not finite at step {step}{}",
                    by(cause)
                )
            }
            Self::Cost { sample } => write!(f, "forward pass: the cost of sample {sample} is not finite, though its states are"),
            Self::Cotangent { flow, variable, step, sample, component, cause } => write!(
                f,
                "reverse pass of {flow}: the cotangent of {variable} component {component} of sample {sample} is not finite at step \
                 {step}{}",
                by(cause)
            ),
            Self::Gradient { flow, parameter } => {
                write!(
                    f,
                    "gradient of {flow}: parameter {parameter} is not finite, or its square is not, though all cotangents are"
                )
            }
            Self::Field { parameter, norm } => write!(
                f,
                "composed field: it is {norm} long, most of all in parameter {parameter}, which is too much for an optimizer; clipping by \
                 norm helps (`training.clip`), a shorter horizon, or another field"
            ),
        }
    }
}

/// The effect that did it.
fn by(cause: &Option<Cause>) -> String {
    match cause {
        Some(Cause::Effect(name)) => {
            format!(": at the state before, the forces of {name} or their slopes are not finite, and smaller values in it help")
        }
        _ => String::new(),
    }
}

impl std::error::Error for Divergence {}
