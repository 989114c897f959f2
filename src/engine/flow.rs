//! [`Flow`]: weights of the paths along which the adjoint propagates.

use serde::{Deserialize, Serialize};
use std::fmt;

/// Weights of the paths along which the adjoint propagates back in time. Forward values do not
/// depend on the flow.
///
/// The reverse pass starts with `λ = ∂φ/∂x_T` and `μ = 0`. For `t = T-1 .. 0`, it performs:
///
/// 1. `λ ← λ + ∂l/∂x_{t+1}`
/// 2. `h_t ← (∂S/∂u)ᵀ λ + ∂l/∂u_t`
/// 3. `ȳ, m̄ ← (∂N/∂(y, m))ᵀ (h_t, μ)`
/// 4. `λ ← physics·(∂S/∂x)ᵀ λ + ∂l/∂x_t + control·(∂y/∂x)ᵀ ȳ` and `μ ← memory·m̄`
///
/// The parameter gradient is `Σ_t (∂N/∂θ)ᵀ (h_t, μ)`. S is the step of the system, N the policy
/// with parameters θ, l the running cost and φ the terminal cost. y is the observation and m the
/// memory. λ is the cotangent of the state x, h that of the control u, and μ that of the memory
/// after the step. ȳ and m̄ are the cotangents of the policy inputs.
///
/// A weight of 1 keeps a path, 0 detaches it. Weights between 0 and 1 discount the effect of a step
/// on later costs.
///
/// ```
/// use physgrad::Flow;
///
/// // The gradient of the loss, truncated every 32 steps, and discounted by 0.98 per step.
/// let flow = Flow::REGULAR.truncated(32).discounted(0.98);
/// assert_eq!(flow.to_string(), "R, discounted by 0.98, truncated every 32 steps");
/// ```
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Flow {
    /// Weight of the path through the physics, `∂S/∂x`.
    pub physics: f64,
    /// Weight of the path through the observation, `∂N/∂y`.
    pub control: f64,
    /// Weight of the path through the memory of the policy, `∂N/∂m`.
    pub memory: f64,
    /// Number of steps between truncations. All weights are 0 at each time step that is a positive
    /// multiple of this number. `None` for no truncation.
    pub truncation: Option<usize>,
    /// Growth in decades above which the adjoint of a sample is cut. `None` for no cut.
    ///
    /// The growth, defined as in [`Growth::along`](crate::engine::Growth), begins at the last cut
    /// or truncation, or where the adjoint of the sample last became 0. At a cut, all weights of
    /// the sample are 0 for one step.
    pub cut: Option<f64>,
}

impl Flow {
    /// R: full backpropagation through time, the gradient of the loss.
    pub const REGULAR: Self = Self::new(1.0, 1.0, 1.0);
    /// M: the observation is detached.
    pub const MODIFIED: Self = Self::new(1.0, 0.0, 1.0);
    /// N: the state input of the physics is detached.
    pub const NETWORK: Self = Self::new(0.0, 1.0, 1.0);
    /// S: no path; `h_t` contains only gradients of costs that depend directly on `u_t` or
    /// `x_{t+1}`.
    pub const STOPPED: Self = Self::new(0.0, 0.0, 0.0);
    /// The flows R, M, N and S.
    pub const ALL: [Self; 4] = [Self::REGULAR, Self::MODIFIED, Self::NETWORK, Self::STOPPED];

    const fn new(physics: f64, control: f64, memory: f64) -> Self {
        Self { physics, control, memory, truncation: None, cut: None }
    }

    /// Multiplies all weights by `factor`.
    pub const fn discounted(self, factor: f64) -> Self {
        Self {
            physics: self.physics * factor,
            control: self.control * factor,
            memory: self.memory * factor,
            ..self
        }
    }

    /// Detaches all paths every `steps` steps: truncated backpropagation through time.
    ///
    /// # Panics
    /// If `steps` is 0.
    #[track_caller]
    pub const fn truncated(self, steps: usize) -> Self {
        assert!(steps > 0, "a flow is truncated every 1 or more steps, not every 0 steps");
        Self { truncation: Some(steps), ..self }
    }

    /// Cuts the adjoint of a sample where it has grown by more than `decades`.
    pub const fn cut(self, decades: f64) -> Self {
        Self { cut: Some(decades), ..self }
    }

    /// Returns the flow at step `t`. All weights are 0 at a truncation.
    pub(crate) fn at(self, t: usize) -> Self {
        let truncated =
            t > 0 && self.truncation.is_some_and(|steps| t.is_multiple_of(steps.max(1)));
        if truncated { self.discounted(0.0) } else { self }
    }

    /// Letter of the flow: R, M, N or S, depending on which of the weights `physics` and `control`
    /// are 0.
    pub fn letter(&self) -> &'static str {
        match (self.physics != 0.0, self.control != 0.0) {
            (true, true) => "R",
            (true, false) => "M",
            (false, true) => "N",
            (false, false) => "S",
        }
    }
}

/// Formats the letter and all deviations from the flow of this letter in [`Flow::ALL`].
impl fmt::Display for Flow {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.letter())?;
        let own = [self.physics, self.control, self.memory];
        let plain = Self::ALL
            .into_iter()
            .find(|flow| flow.letter() == self.letter())
            .unwrap_or(Self::STOPPED);
        let plain = [plain.physics, plain.control, plain.memory];
        let factor = own.into_iter().fold(0.0, f64::max);
        if own != plain {
            if own == plain.map(|weight| weight * factor) {
                write!(f, ", discounted by {factor}")?;
            } else {
                write!(f, ", weights {own:?} of physics, control and memory")?;
            }
        }
        if let Some(steps) = self.truncation {
            write!(f, ", truncated every {steps} steps")?;
        }
        if let Some(decades) = self.cut {
            write!(f, ", cut at a growth of {decades} decades")?;
        }
        Ok(())
    }
}
