//! Detection of vanishing gradients away from a minimum.

use super::normal;
use crate::dynamics::task::Task;
use crate::engine::any::AnyTask;
use crate::engine::batch::Batch;
use crate::engine::divergence::Divergence;
use crate::engine::flow::Flow;
use crate::numbers::rng::{Purpose, stream};
use crate::numbers::text::rough;
use crate::policy::{Policy, Weights};
use std::fmt;

/// Number of neighbouring parameter vectors.
const NEIGHBOURS: u64 = 4;
/// Standard deviation of the normal noise in each parameter of a neighbour.
const AWAY: f64 = 0.01;
/// Gradient norms of at most this share of the largest neighbouring gradient norm count as zero.
const NEGLIGIBLE: f64 = 1e-6;
/// Share of the largest neighbouring gradient norm, times the distance of the neighbours, that the
/// change of a smooth loss reaches at least.
const SMOOTH: f64 = 1e-3;
/// Relative rounding error of a mean loss.
const ROUNDING: f64 = 1e-13;

/// Result of [`plateau`].
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Plateau {
    /// Mean loss.
    pub loss: f64,
    /// Norm of the gradient.
    pub gradient: f64,
    /// Lowest loss among the neighbours.
    pub lowest_nearby: f64,
    /// Largest gradient norm among the neighbours.
    pub gradient_nearby: f64,
}

impl Plateau {
    /// True if the gradient vanishes although a neighbour has a lower loss, as at a maximum or a
    /// saddle.
    pub fn is_stuck(&self) -> bool {
        self.gradient <= NEGLIGIBLE * self.gradient_nearby
            && self.lowest_nearby < self.loss
            && !self.is_unresolved()
    }

    /// True if the loss changes far less than its gradients predict, as in rollouts that amplify
    /// rounding errors. Gradients then do not describe the loss at this distance.
    pub fn is_unresolved(&self) -> bool {
        let rounding = ROUNDING * self.loss.abs();
        AWAY * self.gradient.max(SMOOTH * self.gradient_nearby)
            > (self.loss - self.lowest_nearby).abs() + rounding
    }
}

impl fmt::Display for Plateau {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { loss, gradient, lowest_nearby, gradient_nearby } = self;
        let (here, nearby) = (rough(*gradient), rough(*gradient_nearby));
        let numbers = format!("a gradient of {here}, and up to {nearby} at parameters {AWAY} away");
        if self.is_stuck() {
            write!(
                f,
                "a plateau: {numbers}, where the loss is lower by {}. The gradient here is rounding. Start from other \
                 parameters, with output weights that are not zero, or from other initial states",
                rough(loss - lowest_nearby)
            )
        } else if *gradient == 0.0 && *gradient_nearby == 0.0 {
            write!(f, "flat: {numbers}")
        } else if *gradient <= NEGLIGIBLE * gradient_nearby && self.is_unresolved() {
            write!(
                f,
                "unresolved: {numbers}, where the loss changes by {} only, far less than the gradients predict. Rollouts amplify \
                 perturbations, so these gradients do not describe the loss. Use shorter time steps or a shorter horizon",
                rough((loss - lowest_nearby).abs())
            )
        } else if *gradient <= NEGLIGIBLE * gradient_nearby {
            write!(f, "a minimum: {numbers}, and no lower loss there")
        } else {
            write!(f, "a slope: {numbers}")
        }
    }
}

/// Compares the gradient R of the mean loss with the gradients at four neighbouring parameter
/// vectors.
///
/// `starts` concatenates the initial states of the samples, each followed by its parameters.
/// Typical causes of a vanishing gradient are a saturated policy, a contact that no rollout makes,
/// and zero overlap with a target.
/// ```
/// use physgrad::{Weights, check, policy::Constant, tasks::Bowl};
///
/// // One step moves the state from the origin to θ. The loss is lowest at the origin.
/// let policy = Constant::new(2, 2);
/// let at = |theta: [f64; 2]| check::plateau(&Bowl::default(), &policy, &Weights::new(&policy, theta.to_vec()), &[0.0, 0.0]);
/// assert!(at([0.0, 0.0])?.to_string().starts_with("a minimum"));
/// assert!(at([0.3, 0.1])?.to_string().starts_with("a slope"));
/// # Ok::<(), physgrad::Divergence>(())
/// ```
///
/// # Errors
/// Returns [`Divergence`] if a loss or gradient is non-finite.
///
/// # Panics
/// If the shapes of task and policy differ, or if `starts` is empty or not a whole number of
/// samples.
#[inline(never)]
pub fn plateau<T: Task, P: Policy>(
    task: &T,
    policy: &P,
    weights: &Weights<f64>,
    starts: &[f64],
) -> Result<Plateau, Divergence> {
    let samples = starts.len() / AnyTask::<f64>::start_dim(task);
    let mut batch = Batch::new(task, policy, samples, &[Flow::REGULAR], 1);
    let mut slope = |weights: &Weights<f64>| -> Result<(f64, f64), Divergence> {
        let loss = batch.run(task, policy, weights, starts)?;
        Ok((loss, batch.gradients()[0].norm().get()))
    };
    let (loss, gradient) = slope(weights)?;
    let mut found = Plateau { loss, gradient, lowest_nearby: f64::INFINITY, gradient_nearby: 0.0 };
    for neighbour in 0..NEIGHBOURS {
        let mut nearby = weights.clone();
        let away = normal(&mut stream(neighbour, Purpose::Check, 2), weights.theta().len());
        nearby.update(policy, |theta| {
            theta.iter_mut().zip(&away).for_each(|(theta, away)| *theta += AWAY * away)
        });
        let (loss, gradient) = slope(&nearby)?;
        found.lowest_nearby = found.lowest_nearby.min(loss);
        found.gradient_nearby = found.gradient_nearby.max(gradient);
    }
    Ok(found)
}

#[cfg(test)]
mod tests {
    use super::Plateau;

    #[test]
    fn descriptions_distinguish_plateaus_minima_flat_regions_and_slopes() {
        let at = |gradient: f64, lowest_nearby: f64, gradient_nearby: f64| {
            Plateau { loss: 1.0, gradient, lowest_nearby, gradient_nearby }.to_string()
        };
        assert!(at(0.0, 0.5, 1.0).starts_with("a plateau"));
        assert!(at(0.0, 1.5, 1.0).starts_with("a minimum"));
        // Changes of the loss below its rounding errors.
        assert!(at(0.0, 1.0, 1e-9).starts_with("a minimum"));
        // Gradients of rollouts that amplify rounding errors, beside small changes of the loss.
        assert!(at(1.8e8, 0.956, 2.5e16).starts_with("unresolved"));
        assert!(at(1e-3, 0.956, 2.5e16).starts_with("unresolved"));
        assert!(at(0.0, 1.0, 0.0).starts_with("flat"));
        assert!(at(0.1, 0.5, 1.0).starts_with("a slope"));
    }
}
