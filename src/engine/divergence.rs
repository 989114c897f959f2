//! [`Divergence`]: place of a non-finite or too large number.

use crate::dynamics::cause::Cause;
use crate::engine::flow::Flow;
use crate::numbers::extended::ExtendedF64;
use std::fmt;

/// Place of a number that is non-finite, or too large for the optimizer.
///
/// Training skips the affected update.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Divergence {
    /// State, control or memory in the forward pass.
    Forward {
        /// State, control or memory.
        variable: Variable,
        /// Time step. The initial state and the first control have step 0.
        step: usize,
        /// Index of the sample in its batch.
        sample: usize,
        /// Component of the variable.
        component: usize,
        /// Cause, if known.
        cause: Option<Cause>,
    },
    /// Cost of a sample whose states are all finite.
    Cost {
        /// Index of the sample in its batch.
        sample: usize,
    },
    /// Cotangent of a state, control or memory in the reverse pass.
    Cotangent {
        /// Flow of the adjoint.
        flow: Flow,
        /// Variable of the cotangent.
        variable: Variable,
        /// Time step.
        step: usize,
        /// Index of the sample in its batch.
        sample: usize,
        /// Component of the variable.
        component: usize,
        /// Cause, if known.
        cause: Option<Cause>,
    },
    /// Gradient of a batch whose cotangents are all finite. A component or its square is
    /// non-finite.
    Gradient {
        /// Flow of the gradient.
        flow: Flow,
        /// Index of the parameter in `θ`.
        parameter: usize,
    },
    /// Field composed of finite gradients. After clipping, it is too large for the optimizer, which
    /// squares its components.
    Field {
        /// Index of the parameter in `θ`.
        parameter: usize,
        /// Norm of the field before clipping.
        norm: ExtendedF64,
    },
}

/// Variable of a rollout.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Variable {
    /// State of the system.
    State,
    /// Control computed by the policy.
    Control,
    /// Memory computed by the policy for the next step.
    Memory,
    /// Parameter `p` of the sample. NaN if nothing sets it.
    Parameter,
}

impl Divergence {
    /// True if the number is non-finite for any finite parameters of the policy: in the first step,
    /// because of a parameter of the task, or in the initial state.
    pub(crate) fn is_of_task(&self) -> bool {
        let Self::Forward { variable, step, cause, .. } = self else { return false };
        matches!(cause, Some(Cause::ZeroParam(_)))
            || (matches!(variable, Variable::State | Variable::Parameter) && *step == 0)
    }

    /// Adds `first` to the sample index, if the variant has one.
    pub(crate) fn offset(mut self, first: usize) -> Self {
        match &mut self {
            Self::Forward { sample, .. }
            | Self::Cost { sample }
            | Self::Cotangent { sample, .. } => *sample += first,
            Self::Gradient { .. } | Self::Field { .. } => {}
        }
        self
    }

    /// Sort key: the pass, then the time in the direction of the pass, then the sample or
    /// parameter.
    pub(crate) fn order(&self) -> (u8, usize, usize) {
        match *self {
            // The control at step t lies between the states at steps t and t + 1.
            Self::Forward {
                variable: Variable::Control | Variable::Memory, step, sample, ..
            } => (0, 2 * step + 1, sample),
            Self::Forward {
                variable: Variable::State | Variable::Parameter, step, sample, ..
            } => (0, 2 * step, sample),
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
            Self::Memory => "memory",
            Self::Parameter => "parameter",
        })
    }
}

impl fmt::Display for Divergence {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        self.write(f, false)
    }
}

/// A divergence in a training, whose message also has advice about the learning rate.
pub(crate) struct InTraining<'a>(pub &'a Divergence);

impl fmt::Display for InTraining<'_> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        self.0.write(f, true)
    }
}

impl Divergence {
    fn write(&self, f: &mut fmt::Formatter<'_>, is_trained: bool) -> fmt::Result {
        let if_trained = |text: &'static str| if is_trained { text } else { "" };
        let or_rate = if_trained(" or the learning rate");
        match self {
            Self::Forward { cause: Some(Cause::Unsolved(residual)), step, sample, .. } => write!(
                f,
                "forward pass: the Newton iteration of the implicit integrator did not converge for sample {sample} at step \
                 {step}: residual {residual:.1e}. Use substeps, an explicit integrator, or a larger tolerance if the residual is small"
            ),
            Self::Forward { variable: Variable::State, step: 0, sample, component, .. } => write!(
                f,
                "forward pass: component {component} of the initial state of sample {sample} is not finite. Check `start`, and the \
                 range of the precision"
            ),
            Self::Forward { variable: Variable::Parameter, sample, component, .. } => write!(
                f,
                "forward pass: the parameter p[{component}] of sample {sample} is NaN. Write it in `Task::start`, or train it. If \
                 it is a number of a system or effect within another one, forward `varied` together with `param_dim`"
            ),
            Self::Forward { variable, step: 0, sample, component, .. } => write!(
                f,
                "forward pass: {variable} component {component} of sample {sample} is not finite at step 0, although the initial \
                 state is finite. Check the parameters p that `start` draws, and `observe`{}",
                if_trained("; if these are finite, reduce the learning rate")
            ),
            Self::Forward {
                variable: Variable::State,
                step: 1,
                sample,
                component,
                cause: None,
            } => write!(
                f,
                "forward pass: state component {component} of sample {sample} is not finite after the first step, although the initial \
                 state and the control are finite. Check `step` for division by 0, and for roots and logarithms of negative \
                 numbers{}",
                if_trained(". If earlier updates succeeded, reduce the learning rate")
            ),
            Self::Forward { variable, step, sample, component, cause } => {
                write!(
                    f,
                    "forward pass: {variable} component {component} of sample {sample} is not finite at step {step}{}",
                    advice(cause, &format!("Reduce the time step{or_rate}"), or_rate)
                )
            }
            Self::Cost { sample } => {
                write!(
                    f,
                    "forward pass: the cost of sample {sample} is not finite, but its states are finite. Check \
                     `running_cost` and `terminal_cost` for overflow, division by 0, and roots or logarithms of negative numbers"
                )
            }
            Self::Cotangent {
                flow, cause: Some(Cause::Unsolved(residual)), step, sample, ..
            } => write!(
                f,
                "reverse pass of {flow}: the Newton iteration of the implicit integrator did not converge for sample {sample} at \
                 step {step}: residual {residual:.1e}. The reverse pass solves the step up to rounding errors, for any tolerance. \
                 Use substeps or an explicit integrator, or remove kinks and jumps of the rates"
            ),
            Self::Cotangent { flow, variable, step, sample, component, cause } => write!(
                f,
                "reverse pass of {flow}: the cotangent of {variable} component {component} of sample {sample} is not finite at \
                 step {step}{}",
                advice(cause, "Shorten the horizon or use another field", or_rate)
            ),
            Self::Gradient { flow, parameter } => {
                write!(
                    f,
                    "gradient of {flow}: component {parameter} or its square is not finite, but all cotangents are finite. \
                     Shorten the horizon, or use another field"
                )
            }
            Self::Field { parameter, norm } => write!(
                f,
                "field: norm {norm} is too large for the optimizer, mainly in parameter {parameter}. Clip by norm, shorten the \
                 horizon, or use another field"
            ),
        }
    }
}

/// Advice for the effect that caused the divergence, if known. Otherwise returns `general`. A
/// smaller time step helps against growth; `or_rate` adds the learning rate.
fn advice(cause: &Option<Cause>, general: &str, or_rate: &str) -> String {
    match cause {
        Some(Cause::Effect(name)) => {
            format!(
                ". At the state before the step, the forces of {name} or their derivatives are not finite. Reduce the values of {name}"
            )
        }
        Some(Cause::Rate(component)) => {
            format!(
                ". At the state before the step, the rate of component {component} is not finite. Check it for division by 0, and \
                 for roots and logarithms of negative numbers"
            )
        }
        Some(Cause::ZeroParam(index)) => {
            format!(
                ". The parameter p[{index}] of this sample is 0, and with 1 in its place the step is finite. Write p[{index}] in `start`, \
                 or handle 0 in `step`"
            )
        }
        Some(Cause::Grown(largest)) => {
            format!(
                ". The state before the step has grown to {largest:.1e}, where forces overflow. Reduce the time \
                 step{or_rate}"
            )
        }
        Some(Cause::Unsolved(_)) | None => format!(". {general}"),
    }
}

impl std::error::Error for Divergence {}

#[cfg(test)]
mod tests {
    use super::*;

    /// Only a training has a learning rate.
    #[test]
    fn messages_advise_on_the_learning_rate_in_a_training_only() {
        let at = |variable, step, cause| Divergence::Forward {
            variable,
            step,
            sample: 2,
            component: 1,
            cause,
        };
        for (divergence, advice) in [
            (at(Variable::Control, 0, None), "`observe`; if these are finite, reduce"),
            (at(Variable::State, 1, None), "numbers. If earlier updates succeeded, reduce"),
            (at(Variable::State, 9, None), "Reduce the time step or"),
            (at(Variable::Memory, 9, Some(Cause::Grown(1e30))), "Reduce the time step or"),
        ] {
            let [plain, trained] = [divergence.to_string(), InTraining(&divergence).to_string()];
            assert_eq!(trained, format!("{plain}{}", &trained[plain.len()..]));
            assert!(!plain.contains("learning rate"), "{plain}");
            assert!(trained.ends_with(&format!("{advice} the learning rate")), "{trained}");
        }
        // Other advice is the same.
        for divergence in [
            at(Variable::State, 0, None),
            at(Variable::State, 9, Some(Cause::Effect("Wind"))),
            at(Variable::State, 9, Some(Cause::Unsolved(1.0))),
            Divergence::Cost { sample: 0 },
            Divergence::Gradient { flow: Flow::REGULAR, parameter: 3 },
        ] {
            assert_eq!(divergence.to_string(), InTraining(&divergence).to_string());
        }
    }
}
