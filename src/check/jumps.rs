//! Detection of jumps of the loss, which bias the gradient of a mean loss.

use crate::dynamics::task::Task;
use crate::engine::adjoint::Adjoint;
use crate::engine::any::AnyTask;
use crate::engine::divergence::Divergence;
use crate::engine::flow::Flow;
use crate::engine::gradient::Gradient;
use crate::engine::rollout::Rollout;
use crate::numbers::scalar::LANES;
use crate::numbers::text::rough;
use crate::policy::{AnyPolicy, Policy, Weights};
use std::fmt;

/// Half of the distance between the two compared parameter vectors.
const STEP: f64 = 0.03;
/// Nodes and weights of the Gauss-Legendre rule of order 8 on [-1, 1]. The weights sum to 2.
/// Source: Abramowitz and Stegun 1964, table 25.4.
const NODES: [(f64, f64); 8] = [
    (-0.960_289_856_497_536_2, 0.101_228_536_290_376_26),
    (-0.796_666_477_413_626_7, 0.222_381_034_453_374_47),
    (-0.525_532_409_916_329, 0.313_706_645_877_887_3),
    (-0.183_434_642_495_649_8, 0.362_683_783_378_362),
    (0.183_434_642_495_649_8, 0.362_683_783_378_362),
    (0.525_532_409_916_329, 0.313_706_645_877_887_3),
    (0.796_666_477_413_626_7, 0.222_381_034_453_374_47),
    (0.960_289_856_497_536_2, 0.101_228_536_290_376_26),
];
/// Number of standard errors that a bias exceeds.
const ERRORS: f64 = 4.0;
/// Smallest bias relative to the larger slope.
const SHARE: f64 = 0.1;

/// Result of [`jumps`].
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Jumps {
    /// Number of rollouts.
    pub samples: usize,
    /// Mean slope of the loss between two parameter vectors, according to R.
    pub predicted: f64,
    /// Difference of the mean losses at both parameter vectors, divided by their distance.
    pub difference: f64,
    /// Standard error of `difference - predicted`. Also contains the error of the integral, if
    /// that could be a bias.
    pub error: f64,
}

impl Jumps {
    /// True if R mispredicts the mean loss by more than four standard errors, and by more than 10 %
    /// of the larger slope.
    pub fn is_biased(&self) -> bool {
        let bias = (self.difference - self.predicted).abs();
        bias > ERRORS * self.error && bias > SHARE * self.difference.abs().max(self.predicted.abs())
    }
}

impl fmt::Display for Jumps {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { samples, predicted, difference, error } = *self;
        if predicted.is_nan() {
            return write!(f, "not tested, because R is 0");
        }
        let [predicted, difference, error] = [predicted, difference, error].map(rough);
        if self.is_biased() {
            return write!(
                f,
                "biased: within {STEP}, R predicts a slope of {predicted}, but the mean loss of {samples} rollouts has \
                 {difference} ± {error}. Forces or costs may jump, for example at contact, and R omits jumps. Let them start from \
                 0, or use another `training.estimator`. In chaos, use a shorter horizon"
            );
        }
        if ERRORS * self.error > self.difference.abs().max(self.predicted.abs()) {
            return write!(
                f,
                "undecided: within {STEP}, R predicts a slope of {predicted}, and {samples} rollouts have {difference} ± {error}. Use \
                 shorter time steps or a shorter horizon"
            );
        }
        write!(
            f,
            "no jumps: within {STEP}, R predicts a slope of {predicted}, and {samples} rollouts have {difference} ± {error}"
        )
    }
}

/// Compares the change of the mean loss between two parameter vectors with the integral of R.
///
/// The vectors lie 0.03 from `weights`, along R and against it. The integral is a Gauss-Legendre
/// rule with eight nodes. It equals the change if the loss is continuous. A smooth loss may vary
/// too fast for eight nodes, and then equally in all rollouts. A difference is therefore confirmed
/// with eight nodes on each half, whose distance from the first result counts as an error. R is the
/// derivative of the discrete steps for fixed branches. A force that jumps at contact changes the
/// loss of the samples that just reach or just miss the contact. R omits this change. Source: Suh
/// et al. 2022, arXiv:2202.00817.
///
/// `starts` concatenates the initial states of the samples, each followed by its parameters. The
/// standard error decreases with the number of samples; some hundred are useful. The result is NaN
/// if R is 0.
/// ```
/// use physgrad::{Weights, check, policy::Constant, tasks::Bowl};
///
/// let policy = Constant::new(2, 2);
/// let weights = Weights::new(&policy, vec![0.3, 0.1]);
/// let starts = [0.0, 0.0, 0.2, -0.1, -0.3, 0.4];
/// let found = check::jumps(&Bowl::default(), &policy, &weights, &starts)?;
/// assert!(!found.is_biased());
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
pub fn jumps<T: Task, P: Policy>(
    task: &T,
    policy: &P,
    weights: &Weights<f64>,
    starts: &[f64],
) -> Result<Jumps, Divergence> {
    of_any(task, policy, weights, starts)
}

fn of_any(
    task: &dyn AnyTask<f64>,
    policy: &dyn AnyPolicy<f64>,
    weights: &Weights<f64>,
    starts: &[f64],
) -> Result<Jumps, Divergence> {
    let samples = starts.len() / task.start_dim();
    let mut mean = vec![0.0; weights.theta().len()];
    gradients(task, policy, weights, starts, &mut |_, gradient| {
        mean.iter_mut().zip(gradient).for_each(|(mean, g)| *mean += g / samples as f64);
    })?;
    let norm = mean.iter().map(|g| g * g).sum::<f64>().sqrt();
    if norm == 0.0 {
        return Ok(Jumps { samples, predicted: f64::NAN, difference: f64::NAN, error: f64::NAN });
    }
    let at = |along: f64| {
        Weights::new(
            policy,
            weights
                .theta()
                .iter()
                .zip(&mean)
                .map(|(theta, g)| theta + STEP * along * g / norm)
                .collect(),
        )
    };
    // Mean of R along the line, per sample, by the rule on each of these parts of [-1, 1].
    let integral = |parts: &[[f64; 2]]| -> Result<Vec<f64>, Divergence> {
        let mut predicted = vec![0.0; samples];
        for &[from, to] in parts {
            for (node, weight) in NODES {
                let along = 0.5 * (from + to + (to - from) * node);
                let weight = 0.25 * (to - from) * weight;
                gradients(task, policy, &at(along), starts, &mut |sample, gradient| {
                    let products = mean.iter().zip(gradient).map(|(d, g)| d / norm * g);
                    predicted[sample] += weight * products.sum::<f64>();
                })?;
            }
        }
        Ok(predicted)
    };
    let [before, after] =
        [losses(task, policy, &at(-1.0), starts)?, losses(task, policy, &at(1.0), starts)?];
    let differences: Vec<f64> =
        before.iter().zip(&after).map(|(before, after)| (after - before) / (2.0 * STEP)).collect();
    let found = compare(&differences, &integral(&[[-1.0, 1.0]])?);
    if !found.is_biased() {
        return Ok(found);
    }
    let finer = compare(&differences, &integral(&[[-1.0, 0.0], [0.0, 1.0]])?);
    Ok(Jumps { error: finer.error + (finer.predicted - found.predicted).abs(), ..finer })
}

/// Means of the differences and of the predicted slopes, given per sample, with the standard error
/// of the difference of the means.
fn compare(differences: &[f64], predicted: &[f64]) -> Jumps {
    let samples = differences.len();
    let average = |values: &[f64]| values.iter().sum::<f64>() / samples as f64;
    let biases: Vec<f64> = differences.iter().zip(predicted).map(|(d, p)| d - p).collect();
    let bias = average(&biases);
    let squares = biases.iter().map(|b| (b - bias) * (b - bias)).sum::<f64>();
    let error = (squares / (samples as f64 - 1.0) / samples as f64).sqrt();
    let (predicted, difference) = (average(predicted), average(differences));
    Jumps { samples, predicted, difference, error }
}

/// Calls `each` with the index of every sample and the gradient R of its loss.
fn gradients(
    task: &dyn AnyTask<f64>,
    policy: &dyn AnyPolicy<f64>,
    weights: &Weights<f64>,
    starts: &[f64],
    each: &mut dyn FnMut(usize, &[f64]),
) -> Result<(), Divergence> {
    let mut rollout = Rollout::new(task, policy, LANES);
    let mut adjoint = Adjoint::new(task, policy, &rollout, &[Flow::REGULAR]);
    let mut gradient = Gradient::zeros(weights.theta().len());
    for (block, starts) in starts.chunks(LANES * task.start_dim()).enumerate() {
        let first = block * LANES;
        rollout.start(starts);
        rollout.run(task, policy, weights).map_err(|divergence| divergence.offset(first))?;
        adjoint
            .run(task, policy, weights, &rollout, 1.0)
            .map_err(|divergence| divergence.offset(first))?;
        for sample in 0..rollout.samples() {
            adjoint.param_gradient(0, policy, weights, &rollout, sample..sample + 1, &mut gradient);
            each(first + sample, &gradient.to_vec());
        }
    }
    Ok(())
}

/// Loss of every sample.
fn losses(
    task: &dyn AnyTask<f64>,
    policy: &dyn AnyPolicy<f64>,
    weights: &Weights<f64>,
    starts: &[f64],
) -> Result<Vec<f64>, Divergence> {
    let mut rollout = Rollout::for_evaluation(task, policy, LANES);
    let mut losses = Vec::new();
    for starts in starts.chunks(LANES * task.start_dim()) {
        rollout.start(starts);
        rollout.run(task, policy, weights).map_err(|divergence| divergence.offset(losses.len()))?;
        losses.extend((0..rollout.samples()).map(|sample| rollout.cost(sample)));
    }
    Ok(losses)
}
