//! [`Smoothing`]: estimates of the gradient of a smoothed loss, from perturbed parameters.
//!
//! These estimators are baselines for fields evaluated at a single parameter vector. They use the
//! field, differences of losses, or both. The field needs derivatives; the differences need none.

use super::epoch::{Problem, State};
use super::record::{Means, UpdateStep};
use crate::engine::divergence::Divergence;
use crate::numbers::extended::scaled;
use crate::numbers::rng::{Purpose, stream};
use crate::numbers::scalar::Float;
use crate::numbers::zip::zip;
use crate::policy::AnyPolicy;
use rand_distr::{Distribution as _, StandardNormal};

/// Update that follows an estimate of the gradient of the smoothed loss `E[L(θ + σ ε)]`. The
/// components of ε are independent standard normal numbers.
///
/// Each update draws `pairs` vectors ε and evaluates the mini-batch at θ + σ ε and θ - σ ε. It
/// costs as much as `2 · pairs` updates without smoothing. With [`Estimator::ZerothOrder`], it
/// costs less, because it omits the reverse passes.
///
/// Two estimates follow from the n pairs:
/// - first order: mean over the pairs of `(v(θ + σ ε) + v(θ - σ ε)) / 2`, with the field v of the
///   training;
/// - zeroth order: mean of `(L(θ + σ ε) - L(θ - σ ε)) / (2 σ) · ε`.
///
/// V₁ and V₀ denote the variances of the first-order and of the zeroth-order estimate. A variance
/// is the sum over the pairs of the squared distance from the mean, divided by n (n - 1).
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Smoothing {
    /// Estimate that the update follows.
    pub estimator: Estimator,
    /// Standard deviation σ of the perturbation of each parameter, positive.
    pub noise: f64,
    /// Number of pairs per update: at least 2 if the estimator needs variances, else at least 1.
    pub pairs: usize,
}

/// Estimate of the gradient of a smoothed loss; see [`Smoothing`].
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Estimator {
    /// The first-order estimate.
    FirstOrder,
    /// The zeroth-order estimate: evolution strategies with antithetic pairs. Source: Salimans et
    /// al. 2017, arXiv:1703.03864, without their ranking of losses and their weight decay.
    ZerothOrder,
    /// Mean of both estimates, weighted by inverse variances: the first-order estimate has the
    /// weight κ = V₀ / (V₀ + V₁). Source: total propagation, Parmas et al. 2018, arXiv:1902.01240.
    /// Parmas et al. perturb the transitions of the system and combine the estimates at every step.
    /// Here, updates perturb the parameters and combine the estimates once.
    InverseVariance,
    /// α-order estimate: weight `min(κ, (γ - e) / ‖g₁ - g₀‖)` of the first-order estimate g₁, with
    /// the bound e = 2 √V₀ on the error of the zeroth-order estimate g₀. The weight is 0 if e
    /// exceeds γ. Source: Suh et al. 2022, arXiv:2202.00817, with two standard errors as the bound.
    AlphaOrder {
        /// Accepted error γ of the estimate, in units of the gradient, not negative.
        tolerance: f64,
    },
}

impl Smoothing {
    /// Name and problem of the first invalid setting.
    pub(super) fn problem(&self) -> Option<(&'static str, String)> {
        let (at_least, tolerance) = match self.estimator {
            Estimator::FirstOrder | Estimator::ZerothOrder => (1, 0.0),
            Estimator::InverseVariance => (2, 0.0),
            Estimator::AlphaOrder { tolerance } => (2, tolerance),
        };
        if !(self.noise > 0.0 && self.noise.is_finite()) {
            return Some(("noise", format!("is {}; allowed: a positive number", self.noise)));
        }
        if self.pairs < at_least {
            return Some(("pairs", format!("is {}; allowed: {at_least} or more", self.pairs)));
        }
        (tolerance.is_nan() || tolerance < 0.0)
            .then(|| ("tolerance", format!("is {tolerance}; allowed: 0 or more")))
    }
}

impl Estimator {
    /// Weight of the first-order estimate. The zeroth-order estimate has the rest.
    fn weight(self, first: &Moments, zeroth: &Moments) -> f64 {
        match self {
            Self::FirstOrder => 1.0,
            Self::ZerothOrder => 0.0,
            Self::InverseVariance => inverse_variance(first, zeroth),
            Self::AlphaOrder { tolerance } => {
                let margin = (tolerance - 2.0 * zeroth.variance().sqrt()).max(0.0);
                let distance = zip(first.mean.iter(), &zeroth.mean)
                    .map(|(&a, &b)| (a - b) * (a - b))
                    .sum::<f64>()
                    .sqrt();
                // 0 / 0 is NaN, which `min` ignores.
                inverse_variance(first, zeroth).min(margin / distance)
            }
        }
    }
}

/// κ = V₀ / (V₀ + V₁): 1 if V₁ is 0, and 0 if V₁ exceeds the range of `f64`.
fn inverse_variance(first: &Moments, zeroth: &Moments) -> f64 {
    match first.variance() {
        0.0 => 1.0,
        variance if variance.is_finite() => 1.0 / (1.0 + variance / zeroth.variance()),
        _ => 0.0,
    }
}

/// Mean and variance of vectors (Welford 1962, doi:10.1080/00401706.1962.10490022).
#[derive(Debug)]
struct Moments {
    count: f64,
    mean: Vec<f64>,
    /// Sum of the squared distances from the mean.
    squares: f64,
}

impl Moments {
    fn new(params: usize) -> Self {
        Self { count: 0.0, mean: vec![0.0; params], squares: 0.0 }
    }

    fn clear(&mut self) {
        (self.count, self.squares) = (0.0, 0.0);
        self.mean.fill(0.0);
    }

    fn add(&mut self, vector: impl Iterator<Item = f64>) {
        self.count += 1.0;
        for (mean, x) in zip(self.mean.iter_mut(), vector) {
            let before = x - *mean;
            *mean += before / self.count;
            self.squares += before * (x - *mean);
        }
    }

    /// Variance of the mean, summed over the components.
    fn variance(&self) -> f64 {
        self.squares / (self.count * (self.count - 1.0))
    }
}

/// Workspace of the estimates.
#[derive(Debug)]
pub(super) struct Estimates<F> {
    /// Parameters θ.
    center: Vec<F>,
    /// Perturbation ε.
    perturbation: Vec<f64>,
    /// Mean field of one pair, and then the estimate.
    field: Vec<f64>,
    first: Moments,
    zeroth: Moments,
}

impl<F: Float> Estimates<F> {
    pub(super) fn new(params: usize) -> Self {
        Self {
            center: vec![F::zero(); params],
            perturbation: vec![0.0; params],
            field: vec![0.0; params],
            first: Moments::new(params),
            zeroth: Moments::new(params),
        }
    }
}

impl<F: Float> State<F> {
    /// Writes the estimate for the mini-batch into the combined vector. Returns its norm, the
    /// weight of the first-order estimate, and means of the other results over all evaluations.
    /// `update` is the number of the update in the training, from 0.
    pub(super) fn estimate(
        &mut self,
        problem: Problem<'_, F>,
        smoothing: Smoothing,
        update: usize,
    ) -> Result<UpdateStep, Divergence> {
        let mut estimates =
            self.estimates.take().expect("a training with smoothing has a workspace");
        estimates.center.copy_from_slice(self.weights.theta());
        let outcome = self.evaluate_pairs(problem, smoothing, update, &mut estimates);
        self.weights.update(problem.policy, |theta| theta.copy_from_slice(&estimates.center));
        let weight = smoothing.estimator.weight(&estimates.first, &estimates.zeroth);
        let parts = [(weight, &estimates.first.mean), (1.0 - weight, &estimates.zeroth.mean)];
        for (i, value) in estimates.field.iter_mut().enumerate() {
            // A part without weight may be infinite.
            let parts = parts.iter().filter(|(weight, _)| *weight != 0.0);
            *value = parts.map(|(weight, mean)| weight * mean[i]).sum();
        }
        self.combined.set(&estimates.field);
        self.estimates = Some(estimates);
        let means = outcome?;
        Ok(UpdateStep { norm: self.combined.norm(), first_order: Some(weight), ..means.step() })
    }

    /// Evaluates all pairs and adds them to the moments.
    fn evaluate_pairs(
        &mut self,
        problem: Problem<'_, F>,
        smoothing: Smoothing,
        update: usize,
        estimates: &mut Estimates<F>,
    ) -> Result<Means, Divergence> {
        let Smoothing { estimator, noise, pairs } = smoothing;
        let Estimates { center, perturbation, field, first, zeroth } = estimates;
        let mut means = Means::default();
        first.clear();
        zeroth.clear();
        for pair in 0..pairs {
            // One stream per pair, so a resumed run draws the same numbers.
            let rng =
                &mut stream(self.training.seed, Purpose::Perturb, (update * pairs + pair) as u64);
            perturbation.iter_mut().for_each(|e| *e = StandardNormal.sample(rng));
            field.fill(0.0);
            let mut losses = [0.0; 2];
            for (loss, by) in losses.iter_mut().zip([noise, -noise]) {
                self.perturb(problem.policy, center, perturbation, by);
                let step = match estimator {
                    Estimator::ZerothOrder => self.loss(problem)?,
                    _ => self.field(problem)?,
                };
                if estimator != Estimator::ZerothOrder {
                    for (field, value) in zip(field.iter_mut(), self.combined.values()) {
                        *field += 0.5 * scaled(value.as_(), self.combined.exponent());
                    }
                }
                *loss = step.loss;
                means.add(&step);
            }
            let slope = (losses[0] - losses[1]) / (2.0 * noise);
            first.add(field.iter().copied());
            zeroth.add(perturbation.iter().map(|e| slope * e));
        }
        Ok(means)
    }

    /// Sets the parameters to `center + by · perturbation`.
    fn perturb(&mut self, policy: &dyn AnyPolicy<F>, center: &[F], perturbation: &[f64], by: f64) {
        self.weights.update(policy, |theta| {
            for (theta, (&center, &e)) in zip(theta.iter_mut(), zip(center.iter(), perturbation)) {
                *theta = F::from_f64(center.as_() + by * e);
            }
        });
    }
}
