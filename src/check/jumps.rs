//! Detection of jumps of the loss, which bias the gradient of a mean loss.

use super::normal;
use crate::dynamics::task::Task;
use crate::engine::adjoint::Adjoint;
use crate::engine::any::AnyTask;
use crate::engine::divergence::Divergence;
use crate::engine::flow::Flow;
use crate::engine::gradient::Gradient;
use crate::engine::rollout::Rollout;
use crate::numbers::rng::{Purpose, stream};
use crate::numbers::scalar::LANES;
use crate::numbers::text::rough;
use crate::policy::{AnyPolicy, Policy, Weights};
use std::fmt;

/// Root mean square of the distances in the parameters, from the centre of the ball to its surface.
const RADIUS: f64 = 0.01;
/// Number of random directions.
const DIRECTIONS: usize = 4;
/// Nodes and weights of the Gauss-Legendre rule of order 3 on [-1, 1]. The weights sum to 2.
/// Source: Abramowitz and Stegun 1964, table 25.4.
const NODES: [(f64, f64); 3] = [
    (-0.774_596_669_241_483_4, 0.555_555_555_555_555_6),
    (0.0, 0.888_888_888_888_888_8),
    (0.774_596_669_241_483_4, 0.555_555_555_555_555_6),
];
/// Number of samples of the first comparison of [`jumps`]. Each later one has twice as many.
pub const FEWEST: usize = 16;
/// Largest numbers of forward and reverse passes of a sample in [`jumps`] that finds no bias.
pub const JUMP_PASSES: [usize; 2] = [DIRECTIONS * (2 + NODES.len()), DIRECTIONS * NODES.len()];
/// Half width of the interval of the error, in standard errors.
const ERRORS: f64 = 3.0;
/// Relative error of R that counts as a bias.
const BIAS: f64 = 0.05;

/// Result of [`jumps`].
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Jumps {
    /// Number of rollouts.
    pub samples: usize,
    /// Slope of the mean loss over a ball of parameters: root mean square over random directions.
    pub slope: f64,
    /// Slope that R predicts, as the mean over the ball.
    pub predicted: f64,
    /// Error of the predicted slopes in the random directions, as a vector, relative to the slopes.
    pub error: f64,
    /// Interval of `error`: three standard errors of the difference, relative to the same slopes.
    pub interval: [f64; 2],
}

impl Jumps {
    /// True if the error of R is above 5 %, and is not explained by the number of rollouts.
    pub fn is_biased(&self) -> bool {
        self.error > BIAS && self.interval[0] > 0.0
    }

    /// True if the number of rollouts does not exclude an error above 5 %.
    pub fn is_undecided(&self) -> bool {
        !self.is_biased() && self.interval[1] > BIAS
    }
}

impl fmt::Display for Jumps {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { samples, error, interval: [low, high], .. } = *self;
        if error.is_nan() {
            return write!(f, "not compared, because the loss has no slope");
        }
        let percent = |share: f64| match share {
            // The mean loss may have no slope at all.
            _ if share > 100.0 => "above 10,000 %".to_owned(),
            _ => format!("{} %", rough(100.0 * share)),
        };
        let [error, low, high] = [error, low, high].map(percent);
        write!(
            f,
            "{}: over distances of {RADIUS} per parameter, R differs from the derivative of the mean loss by {error} ({low} to \
             {high}, {samples} rollouts)",
            match () {
                () if self.is_biased() => "biased",
                () if self.is_undecided() => "undecided",
                () => "no jumps",
            }
        )?;
        if self.is_undecided() {
            write!(
                f,
                ". R varies too strongly between rollouts, as with stiff contact, in chaos, or where some episodes end. Use \
                 softer forces, shorter time steps, or a shorter horizon or window"
            )?;
        }
        if self.is_biased() {
            write!(
                f,
                ". Forces or costs may jump, for example at contact, and R omits jumps. Let them start from 0. In chaos, use a \
                 shorter horizon or window. Over whole rollouts, another `training.estimator` may help"
            )?;
        }
        Ok(())
    }
}

/// Compares R with the derivative of the mean loss over a ball of parameters and over the samples.
///
/// R is the derivative of the discrete steps for fixed branches. A force that jumps at contact changes
/// the loss of the rollouts that just reach or just miss the contact, and R omits this change. The mean
/// of R over a ball then differs from the derivative of the mean loss over the same ball. Source: Suh
/// et al. 2022, arXiv:2202.00817.
///
/// The comparison takes up to four random diameters of the ball, whose radius is 0.01 times the root of the
/// number of parameters. Along a diameter, the change of the loss between both ends equals the integral
/// of R if the loss is continuous. All diameters and both sides have the same samples. The integral is
/// a Gauss-Legendre rule with three nodes. A smooth loss may vary too fast for it, and then equally in
/// all rollouts. A bias is therefore confirmed with three nodes on each half, whose distance from the
/// first result counts as an error.
///
/// `starts` concatenates the initial states of the samples, each followed by its parameters. The
/// function takes the first 16 of them, and twice as many until it finds a bias: rare jumps need many
/// samples. The error is NaN if the loss has no slope.
/// ```
/// use physgrad::{Weights, check, policy::Constant, tasks::Bowl};
///
/// let policy = Constant::new(2, 2);
/// let weights = Weights::new(&policy, vec![0.3, 0.1]);
/// let starts = [0.0, 0.0, 0.2, -0.1, -0.3, 0.4];
/// let found = check::jumps(&Bowl::default(), &policy, &weights, &starts)?;
/// assert!(!found.is_biased() && found.error < 1e-9);
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
    of_any(task, policy, weights, starts, &|_| {})
}

/// [`jumps`] over a ball in other coordinates of the parameters. `coordinates` changes a vector from these
/// coordinates to the parameters, and is linear.
///
/// # Errors
/// As [`jumps`].
///
/// # Panics
/// As [`jumps`].
pub fn jumps_in_coordinates<T: Task, P: Policy>(
    task: &T,
    policy: &P,
    weights: &Weights<f64>,
    starts: &[f64],
    coordinates: &dyn Fn(&mut [f64]),
) -> Result<Jumps, Divergence> {
    of_any(task, policy, weights, starts, coordinates)
}

fn of_any(
    task: &dyn AnyTask<f64>,
    policy: &dyn AnyPolicy<f64>,
    weights: &Weights<f64>,
    starts: &[f64],
    coordinates: &dyn Fn(&mut [f64]),
) -> Result<Jumps, Divergence> {
    let len = task.start_dim();
    let all = starts.len() / len;
    let params = weights.theta().len();
    let count = DIRECTIONS.min(params).max(1);
    let mut directions: Vec<_> = (0..count).map(|index| Diameter::random(params, index)).collect();
    directions.iter_mut().for_each(|direction| coordinates(&mut direction.along));
    let (mut from, mut to) = (0, FEWEST.min(all));
    loop {
        for direction in &mut directions {
            direction.add(task, policy, weights, &starts[from * len..to * len])?;
        }
        let mut found = compare(&directions, |direction| &direction.predicted);
        if found.is_biased() {
            for direction in &mut directions {
                let known = direction.finer.len();
                direction.refine(task, policy, weights, &starts[known * len..to * len])?;
            }
            found = compare(&directions, |direction| &direction.finer);
        }
        if found.is_biased() || to == all {
            return Ok(found);
        }
        (from, to) = (to, all.min(2 * to));
    }
}

/// A diameter of the ball, and what the samples have along it.
struct Diameter {
    /// A vector whose coordinates have a root mean square of 1.
    along: Vec<f64>,
    /// Changes of the loss by its length, per sample.
    differences: Vec<f64>,
    /// Means of R along it, per sample.
    predicted: Vec<f64>,
    /// As `predicted`, with twice the nodes.
    finer: Vec<f64>,
}

impl Diameter {
    fn random(params: usize, index: usize) -> Self {
        let mut along = normal(&mut stream(index as u64, Purpose::Check, 6), params);
        let square = along.iter().map(|d| d * d).sum::<f64>() / params.max(1) as f64;
        along.iter_mut().for_each(|d| *d /= square.sqrt());
        Self { along, differences: Vec::new(), predicted: Vec::new(), finer: Vec::new() }
    }

    fn at(&self, policy: &dyn AnyPolicy<f64>, weights: &Weights<f64>, share: f64) -> Weights<f64> {
        let moved = |(theta, d): (&f64, &f64)| theta + RADIUS * share * d;
        Weights::new(policy, weights.theta().iter().zip(&self.along).map(moved).collect())
    }

    /// Adds samples.
    fn add(
        &mut self,
        task: &dyn AnyTask<f64>,
        policy: &dyn AnyPolicy<f64>,
        weights: &Weights<f64>,
        starts: &[f64],
    ) -> Result<(), Divergence> {
        let [before, after] =
            [-1.0, 1.0].map(|share| losses(task, policy, &self.at(policy, weights, share), starts));
        let slopes = after?
            .into_iter()
            .zip(before?)
            .map(|(after, before)| (after - before) / (2.0 * RADIUS));
        self.differences.extend(slopes.collect::<Vec<_>>());
        let predicted = self.integral(task, policy, weights, starts, &[[-1.0, 1.0]])?;
        self.predicted.extend(predicted);
        Ok(())
    }

    /// Adds samples to `finer`.
    fn refine(
        &mut self,
        task: &dyn AnyTask<f64>,
        policy: &dyn AnyPolicy<f64>,
        weights: &Weights<f64>,
        starts: &[f64],
    ) -> Result<(), Divergence> {
        let finer = self.integral(task, policy, weights, starts, &[[-1.0, 0.0], [0.0, 1.0]])?;
        self.finer.extend(finer);
        Ok(())
    }

    /// Mean of R along the diameter, per sample, by the rule on each of these parts of [-1, 1].
    fn integral(
        &self,
        task: &dyn AnyTask<f64>,
        policy: &dyn AnyPolicy<f64>,
        weights: &Weights<f64>,
        starts: &[f64],
        parts: &[[f64; 2]],
    ) -> Result<Vec<f64>, Divergence> {
        let mut predicted = vec![0.0; starts.len() / task.start_dim()];
        for &[from, to] in parts {
            for (node, weight) in NODES {
                let share = 0.5 * (from + to + (to - from) * node);
                let weight = 0.25 * (to - from) * weight;
                let at = self.at(policy, weights, share);
                gradients(task, policy, &at, starts, &mut |sample, gradient| {
                    let products = self.along.iter().zip(gradient).map(|(d, g)| d * g);
                    predicted[sample] += weight * products.sum::<f64>();
                })?;
            }
        }
        Ok(predicted)
    }
}

/// Error of the slopes that `predicted` has, with the interval.
///
/// The errors of the means in all directions form a vector, and the norm of its own error bounds that
/// of its norm. Where `finer` slopes exist, their distance from the others counts as an error too.
fn compare(directions: &[Diameter], predicted: impl Fn(&Diameter) -> &Vec<f64>) -> Jumps {
    let samples = directions[0].differences.len();
    let mean = |values: &[f64]| values.iter().sum::<f64>() / samples as f64;
    // Squared standard error of a mean.
    let noise = |values: &[f64]| {
        let mean = mean(values);
        let squares = values.iter().map(|value| (value - mean).powi(2)).sum::<f64>();
        squares / (samples as f64 - 1.0).max(1.0) / samples as f64
    };
    let [mut bias, mut slope, mut size, mut of_bias, mut of_rule] = [0.0; 5];
    for direction in directions {
        let found = predicted(direction);
        let errors: Vec<f64> =
            found.iter().zip(&direction.differences).map(|(found, slope)| found - slope).collect();
        bias += mean(&errors).powi(2);
        of_bias += noise(&errors);
        slope += mean(&direction.differences).powi(2);
        size += mean(found).powi(2);
        of_rule += (mean(found) - mean(&direction.predicted)).powi(2);
    }
    let [bias, slope, size, of_bias, of_rule] =
        [bias, slope, size, of_bias, of_rule].map(f64::sqrt);
    let root = (directions.len() as f64).sqrt();
    let half = ERRORS * (of_bias + of_rule);
    Jumps {
        samples,
        slope: slope / root,
        predicted: size / root,
        error: bias / slope,
        interval: [(bias - half).max(0.0), bias + half].map(|bound| bound / slope),
    }
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
