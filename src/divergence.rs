//! [`Divergence`]: a number that is no number any more, as data.

use crate::backward::Flow;
use std::fmt;

/// Where a number stopped being finite. The update it belongs to is not taken.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Divergence {
    /// A state, in the forward pass.
    State {
        /// Time step, 1 being the first state after the start.
        step: usize,
        /// Index of the sample in its batch.
        sample: usize,
        /// State component.
        component: usize,
    },
    /// The cost of a sample whose states are all finite.
    Cost {
        /// Index of the sample in its batch.
        sample: usize,
    },
    /// A cotangent of the state, in the reverse pass.
    Cotangent {
        /// Flow whose adjoint it is.
        flow: Flow,
        /// Time step.
        step: usize,
        /// Index of the sample in its batch.
        sample: usize,
        /// State component.
        component: usize,
    },
    /// The sum of the gradient over a batch whose cotangents are all finite.
    Gradient {
        /// Flow whose gradient it is.
        flow: Flow,
        /// Index of the parameter in `θ`.
        parameter: usize,
    },
}

impl Divergence {
    /// The same, for a sample counted from `first` on.
    pub(crate) fn offset(mut self, first: usize) -> Self {
        match &mut self {
            Self::State { sample, .. } | Self::Cost { sample } | Self::Cotangent { sample, .. } => *sample += first,
            Self::Gradient { .. } => {}
        }
        self
    }

    /// Which of two to report: the one met first by a single pass over the whole batch.
    pub(crate) fn order(&self) -> (u8, usize, usize) {
        match *self {
            Self::State { step, sample, .. } => (0, step, sample),
            Self::Cost { sample } => (1, 0, sample),
            Self::Cotangent { step, sample, .. } => (2, usize::MAX - step, sample),
            Self::Gradient { parameter, .. } => (3, 0, parameter),
        }
    }
}

impl fmt::Display for Divergence {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::State { step, sample, component } => {
                write!(f, "forward pass: state component {component} of sample {sample} is not finite at step {step}")
            }
            Self::Cost { sample } => write!(f, "forward pass: the cost of sample {sample} is not finite, though its states are"),
            Self::Cotangent { flow, step, sample, component } => {
                write!(
                    f,
                    "reverse pass of {flow}: cotangent component {component} of sample {sample} is not finite at step {step}"
                )
            }
            Self::Gradient { flow, parameter } => {
                write!(f, "gradient of {flow}: parameter {parameter} is not finite, though all cotangents are")
            }
        }
    }
}

impl std::error::Error for Divergence {}
