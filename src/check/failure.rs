//! Failed checks, and their messages.

use super::ROLLOUT;
use crate::engine::divergence::Divergence;
use crate::engine::flow::Flow;
use std::fmt;

/// Largest relative error of a rollout that may be due to rounding.
const ROUNDED: f64 = 1e-6;

/// First failed comparison of a check.
#[derive(Clone, Debug, PartialEq)]
pub struct Mismatch {
    /// Compared quantity, for instance `vjp: x_bar`.
    pub what: String,
    /// Index of the first mismatching component or random direction; 0 for the inner product of a
    /// JVP.
    pub index: usize,
    /// Reference value, from dual numbers or from an equivalent reference form. NaN if the tested
    /// function is non-finite.
    pub expected: f64,
    /// Value of the tested form.
    pub found: f64,
    /// Relative error; absolute for an exact comparison or a zero reference. NaN if the tested
    /// function is non-finite.
    pub error: f64,
    /// Tolerance of the relative error; 0 for an exact comparison or a non-finite function.
    pub allowed: f64,
    /// Index of the random case. The check draws inputs from `stream(case, Purpose::Check, 0)`.
    pub case: u64,
}

impl Mismatch {
    /// Returns true if the tested function is non-finite. The check then has no reference value.
    pub(super) fn is_not_finite(&self) -> bool {
        self.expected.is_nan() && self.allowed == 0.0
    }
}

impl fmt::Display for Mismatch {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { what, index, expected, found, error, allowed, case } = self;
        if self.is_not_finite() {
            return write!(f, "{what}[{index}] is {found:e} (case {case})");
        }
        if found.is_nan() && expected.is_nan() {
            return write!(f, "{what}[{index}] is no number by either method (case {case})");
        }
        write!(f, "{what}[{index}] is {found:e}, expected {expected:e}: ")?;
        // Only exact comparisons allow no error.
        if *allowed == 0.0 {
            return write!(f, "both must be equal, but differ by {error:.1e} (case {case})");
        }
        let scale = (found - expected).abs() / error;
        write!(
            f,
            "relative error {error:.1e} at the scale {scale:.1e}, allowed {allowed:.0e} (case {case})"
        )?;
        // Losses of both forms have no derivatives.
        if *allowed == ROLLOUT && (*error < ROUNDED || what == "loss") {
            write!(
                f,
                ". Rounding errors may cause this if the rollout amplifies them, or if two branches of a selection are nearly \
                 equal where the state jumps: repeat the check with shorter time steps or a shorter horizon, and see the kinks"
            )?;
        }
        Ok(())
    }
}

impl std::error::Error for Mismatch {}

/// What a check found.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum Finding {
    /// The error of a derivative or loss exceeds the tolerance, or a function is not finite.
    #[error(transparent)]
    Mismatch(#[from] Mismatch),
    /// The rollout or its gradient is non-finite.
    #[error("case {case} cannot be checked: {divergence}")]
    Diverged {
        /// Index of the random case.
        case: u64,
        /// First non-finite value.
        divergence: Divergence,
    },
}

/// Failed check.
///
/// `Display` prints the finding. `Debug`, and therefore `unwrap` and `main`, also print what was
/// checked and what to do.
#[derive(Clone, PartialEq, thiserror::Error)]
#[error("{finding}")]
pub struct Failure {
    /// What the check found.
    pub finding: Box<Finding>,
    /// What was checked, with the verdict.
    verdict: String,
    advice: &'static str,
}

impl fmt::Debug for Failure {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { finding, verdict, advice } = self;
        write!(f, "{verdict}: {finding}")?;
        if advice.is_empty() { Ok(()) } else { write!(f, ". {advice}") }
    }
}

impl Failure {
    fn new(finding: impl Into<Finding>, verdict: impl Into<String>, advice: &'static str) -> Self {
        Self { finding: Box::new(finding.into()), verdict: verdict.into(), advice }
    }

    /// The failed comparison, if the rollouts were finite.
    pub fn mismatch(&self) -> Option<&Mismatch> {
        match &*self.finding {
            Finding::Mismatch(mismatch) => Some(mismatch),
            Finding::Diverged { .. } => None,
        }
    }

    /// Replaces the advice if the tested function is not finite.
    pub(super) fn refused_with(self, advice: &'static str) -> Self {
        let refused = self.mismatch().is_some_and(Mismatch::is_not_finite);
        if refused { Self { advice, ..self } } else { self }
    }

    pub(super) fn of_system(mismatch: Mismatch) -> Self {
        if mismatch.is_not_finite() {
            return Self::new(mismatch, "the system cannot be checked", "");
        }
        Self::new(
            mismatch,
            "the system's derivatives are wrong",
            "Correct the named method. `vjp` and `jvp` can also be removed: dual numbers then \
             provide the derivatives",
        )
    }

    pub(super) fn of_costs(mismatch: Mismatch) -> Self {
        if mismatch.is_not_finite() {
            let advice = "The check adds noise of 0.1 to the initial states";
            return Self::new(mismatch, "the task cannot be checked", advice);
        }
        Self::new(
            mismatch,
            "the task's derivatives are wrong",
            "Correct the named method. A method for derivatives can also be removed: dual numbers \
             then provide them",
        )
    }

    pub(super) fn of_policy(mismatch: Mismatch) -> Self {
        Self::new(
            mismatch,
            "the policy is wrong",
            "Correct the named method, or remove all batched passes: `act` then defines them",
        )
    }

    pub(super) fn along(finding: Finding) -> Self {
        Self::new(
            finding,
            "in a state of a rollout",
            "Correct the named method. Methods for derivatives can also be removed",
        )
    }

    pub(super) fn of_flow(finding: Finding, flow: Flow) -> Self {
        let words = match flow.letter() {
            "R" => "full backpropagation",
            "M" => "the physics path, observations detached",
            "N" => "the policy path, physics detached",
            _ => "each step alone, all paths detached",
        };
        let (verdict, advice) = match &finding {
            Finding::Diverged { .. } => ("is not finite", ""),
            Finding::Mismatch(_) => (
                "is wrong",
                "`check::system`, `check::cost` and `check::policy` find the method to correct",
            ),
        };
        Self::new(finding, format!("the gradient of flow {flow} ({words}) {verdict}"), advice)
    }
}
