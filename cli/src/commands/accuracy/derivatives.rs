//! Measured quantities per gradient method, memory budget and horizon.

use crate::commands::accuracy::gradients::at_chosen;
use crate::commands::accuracy::row::spread;
use crate::operations::gradients::{Derived, GradientMethod};
use crate::settings::Precision;
use std::fmt;

impl fmt::Display for GradientMethod {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Forward => f.write_str("loss alone"),
            Self::Reverse { field, .. } => write!(f, "reverse {}", field.letter()),
            Self::Central(step) => write!(f, "central differences {step:e}"),
            Self::Duals => f.write_str("forward mode"),
        }
    }
}

/// Euclidean norm. Scales the components first, because squares may overflow. NaN if a component is
/// NaN.
fn norm(x: &[f64]) -> f64 {
    // `f64::max` ignores NaN.
    if x.iter().any(|x| x.is_nan()) {
        return f64::NAN;
    }
    let largest = x.iter().fold(0.0_f64, |largest, x| largest.max(x.abs()));
    if largest == 0.0 || largest.is_infinite() {
        largest
    } else {
        largest * x.iter().map(|x| (x / largest) * (x / largest)).sum::<f64>().sqrt()
    }
}

/// Relative error in the Euclidean norm, and the share of components with the correct sign
/// (negative, zero or positive).
pub fn compare(found: &[f64], right: &[f64]) -> (f64, f64) {
    let difference: Vec<f64> = found.iter().zip(right).map(|(a, b)| a - b).collect();
    let error = norm(&difference) / norm(right);
    let same = |(a, b): &(&f64, &f64)| (**a > 0.0) == (**b > 0.0) && (**a < 0.0) == (**b < 0.0);
    (error, found.iter().zip(right).filter(same).count() as f64 / right.len() as f64)
}

/// Error and cost of one gradient method.
pub struct Derivative {
    pub method: GradientMethod,
    pub precision: Precision,
    /// Error relative to the double-double reference, or the message of a divergence. Without
    /// meaning for [`GradientMethod::Forward`].
    pub error: Result<f64, String>,
    /// Share of all components with the same sign as in f64. None for methods other than reverse
    /// passes, and if this pass or the pass in f64 diverges.
    pub signs: Option<f64>,
    /// Seconds for a whole gradient: lowest, median and highest. NaN for a diverged gradient. With
    /// [`GradientMethod::Forward`], seconds for the loss.
    pub seconds: [f64; 3],
    /// Bytes in the buffers of rollouts and adjoints.
    pub bytes: usize,
}

impl Derivative {
    pub fn new(
        method: GradientMethod,
        precision: Precision,
        derived: &Derived,
        times: Vec<f64>,
        right: &[f64],
        full: Option<&Vec<f64>>,
    ) -> Self {
        let error = derived
            .gradient
            .as_ref()
            .map(|found| compare(&at_chosen(found, right.len()), right).0)
            .map_err(Clone::clone);
        let signs =
            full.zip(derived.gradient.as_ref().ok()).map(|(full, found)| compare(found, full).1);
        Self { method, precision, error, signs, seconds: spread(times), bytes: derived.bytes }
    }
}

/// Reverse pass of R within a memory budget. The first pass of a list has no budget.
pub struct Checkpoint {
    /// Number of steps.
    pub horizon: usize,
    /// Memory budget in bytes. Without a budget, the size of the buffers.
    pub budget: u64,
    /// Bytes in the buffers of rollouts and adjoints.
    pub bytes: usize,
    /// Seconds for the gradient: lowest, median and highest. NaN without a gradient.
    pub seconds: [f64; 3],
    /// True if the gradient is bitwise equal to the gradient without a budget. An error is the
    /// message of a divergence or of a budget that is too small.
    pub same: Result<bool, String>,
}

impl Checkpoint {
    pub fn new(
        horizon: usize,
        budget: u64,
        derived: &Derived,
        times: Vec<f64>,
        all: &Result<Vec<f64>, String>,
    ) -> Self {
        let bits = |x: &[f64]| x.iter().map(|x| x.to_bits()).collect::<Vec<u64>>();
        let same = match (&derived.gradient, all) {
            (Ok(found), Ok(all)) => Ok(bits(found) == bits(all)),
            (Err(error), _) | (_, Err(error)) => Err(error.clone()),
        };
        Self { horizon, budget, bytes: derived.bytes, seconds: spread(times), same }
    }
}

/// Gradient R at one horizon.
pub struct Horizon {
    /// Number of steps.
    pub horizon: usize,
    /// Norm of the gradient in f64. NaN for a divergence.
    pub norm: f64,
    /// Relative error and share of correct signs, or the message of a divergence.
    ///
    /// Both entries are relative to the gradient in f64. The first is for the gradient in f32, the
    /// second for the gradient in f64 from initial states perturbed by one rounding.
    pub found: [Result<(f64, f64), String>; 2],
}

impl Horizon {
    /// `gradients` are those in f32, in f64, and in f64 from perturbed initial states.
    pub fn new(horizon: usize, gradients: &[Result<Vec<f64>, String>]) -> Self {
        let against = |found: &Result<Vec<f64>, String>| match (found, &gradients[1]) {
            (Ok(found), Ok(right)) => Ok(compare(found, right)),
            (Err(error), _) | (_, Err(error)) => Err(error.clone()),
        };
        let norm = gradients[1].as_ref().map_or(f64::NAN, |gradient| norm(gradient));
        Self { horizon, norm, found: [against(&gradients[0]), against(&gradients[2])] }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_norm_is_nan_if_a_component_is() {
        for x in [[f64::NAN; 2], [f64::NAN, 0.0], [1.0, f64::NAN]] {
            assert!(norm(&x).is_nan(), "{x:?}");
        }
        assert_eq!([norm(&[]), norm(&[0.0]), norm(&[3.0, -4.0])], [0.0, 0.0, 5.0]);
    }
}
