//! [`Critic`]: a value function, trained on the windows that the actor visits.

use super::episodes::Windows;
use super::units::Units;
use super::window::Value;
use crate::dynamics::inputs::{Cotangents, Inputs, Start, add};
use crate::dynamics::system::System;
use crate::dynamics::task::Task;
use crate::engine::batch::Batch;
use crate::engine::divergence::Divergence;
use crate::engine::flow::Flow;
use crate::engine::visited::Visited;
use crate::numbers::aligned::Aligned;
use crate::numbers::rng::{Purpose, Rng, stream};
use crate::numbers::scalar::{Cotangent, Float, Real, Scalar};
use crate::policy::{AnyPolicy, InputLayer, Mlp, Policy, PolicyColumns, PolicyPass, Weights};
use crate::train::optim::{Clip, Optimizer, OptimizerKind};
use rand::RngExt as _;
use rand::seq::SliceRandom;
use serde::{Deserialize, Serialize};

/// Settings of a value function of the last state of a window: a network of the observation with tanh
/// layers, trained by Adam on TD(λ) targets.
///
/// After each window, the target of a visited state is `G_t = l_t + γ ((1-λ) V(x_{t+1}) + λ G_{t+1})`
/// with `G_H = V(x_H)`, the running cost l, the discount γ, and the slow copy V of the network. A state
/// in which an episode ends has the value 0. The actor's windows end with the same V.
#[derive(Clone, Debug, PartialEq)]
pub struct ValueSettings {
    /// Widths of the hidden layers.
    pub widths: Vec<usize>,
    /// Learning rate of Adam.
    pub learning_rate: f64,
    /// Passes over the visited states after each window.
    pub passes: usize,
    /// Updates per pass, each with an equal part of the episodes.
    pub parts: usize,
    /// λ of the targets: 0 for one step, 1 for the whole window.
    pub lambda: f64,
    /// Part of the way that the slow copy moves towards the network after each window.
    pub follow: f64,
}

impl Default for ValueSettings {
    fn default() -> Self {
        Self {
            widths: vec![64, 64],
            learning_rate: 1e-3,
            passes: 4,
            parts: 4,
            lambda: 0.95,
            follow: 0.5,
        }
    }
}

impl ValueSettings {
    /// The first invalid setting, and what is wrong with it.
    pub(super) fn problem(&self) -> Option<(&'static str, String)> {
        let Self { ref widths, learning_rate, passes, parts, lambda, follow } = *self;
        let counts = [("value.passes", passes), ("value.parts", parts)];
        if let Some((key, _)) = counts.into_iter().find(|&(_, count)| count == 0) {
            return Some((key, "is 0; allowed: 1 or more".into()));
        }
        if widths.contains(&0) {
            return Some(("value.widths", "has a layer of width 0; allowed: 1 or more".into()));
        }
        if !(learning_rate > 0.0 && learning_rate <= 1e6) {
            let problem = format!("is {learning_rate}; allowed: a positive number up to 1e6");
            return Some(("value.learning_rate", problem));
        }
        if !(0.0..=1.0).contains(&lambda) {
            return Some(("value.lambda", format!("is {lambda}; allowed: 0 to 1")));
        }
        let follows = follow > 0.0 && follow <= 1.0;
        (!follows)
            .then(|| ("value.follow", format!("is {follow}; allowed: a positive number up to 1")))
    }
}

/// A value function and its training.
#[derive(Debug)]
pub(super) struct Critic<F: Float> {
    settings: ValueSettings,
    discount: f64,
    seed: u64,
    network: Mlp,
    regression: Regression,
    batch: Batch<F>,
    /// Network, slow copy and optimizer.
    pub(super) state: CriticState<F>,
    weights: Weights<F>,
    starts: Vec<F>,
    /// First layer of the network, whose stored parameters are those of observations in units.
    layer: InputLayer,
}

/// What a checkpoint holds of a [`Critic`].
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub(super) struct CriticState<F> {
    pub(super) theta: Vec<F>,
    pub(super) slow: Vec<F>,
    pub(super) optimizer: Optimizer<F>,
    /// Mean and standard deviation of the targets, the units of the networks.
    units: [f64; 2],
    /// Width of the last hidden layer.
    last: usize,
    /// Number of windows learned from.
    windows: u64,
}

impl<F: Float> CriticState<F> {
    /// Changes the units of both networks, and their last layers so that the values stay (van Hasselt
    /// et al. 2016, arXiv:1602.07714).
    fn set_units(&mut self, units: [f64; 2]) {
        let [[mean, deviation], [old_mean, old_deviation]] = [units, self.units];
        for theta in [&mut self.theta, &mut self.slow] {
            // The weights of the last layer, and its bias.
            let first = theta.len() - self.last - 1;
            for weight in &mut theta[first..] {
                *weight = F::from_f64(weight.as_() * old_deviation / deviation);
            }
            if let Some(bias) = theta.last_mut() {
                *bias = F::from_f64(bias.as_() + (old_mean - mean) / deviation);
            }
        }
        self.units = units;
    }

    /// Checks that a training that began in this state can reach `other`.
    pub(super) fn validate(&self, other: &Self) -> Result<(), String> {
        let [mean, deviation] = other.units;
        if other.last != self.last
            || !(mean.is_finite() && deviation.is_finite() && deviation > 0.0)
        {
            return Err("its value function has other layers, or units that are not finite".into());
        }
        for theta in [&other.theta, &other.slow] {
            if theta.len() != self.theta.len() || theta.iter().any(|x| !x.as_().is_finite()) {
                return Err(
                    "its value function has another size, or numbers that are not finite".into()
                );
            }
        }
        other.optimizer.validate(&self.optimizer, other.optimizer.steps())
    }
}

/// How well the value function fitted the targets of a window before it learned from them.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Fit {
    /// Mean square of value minus target.
    pub(super) error: f64,
    /// Variances of the error and of the targets.
    pub(super) variances: [f64; 2],
}

impl<F: Float> Critic<F> {
    /// A value function for windows of this many steps and `samples` episodes at a time.
    pub(super) fn new(
        windows: &Windows,
        settings: &ValueSettings,
        observed: usize,
        samples: usize,
        seed: u64,
        workers: usize,
    ) -> Self {
        let widths = [&[observed][..], &settings.widths, &[1]].concat();
        let network = Mlp::new(widths).zero_init_output(true);
        let theta = initial(&network, seed);
        let weights = Weights::new(&network, theta.into_iter().map(F::from_f64).collect());
        let regression = Regression { observed, steps: windows.steps };
        let part = samples.div_ceil(settings.parts);
        let theta = weights.theta().to_vec();
        let rule = OptimizerKind::Adam { beta1: 0.9, beta2: 0.999, epsilon: 1e-7 };
        Self {
            batch: Batch::new(&regression, &network, part, &[Flow::REGULAR], workers),
            state: CriticState {
                optimizer: Optimizer::new(rule, settings.learning_rate, theta.len()),
                slow: theta.clone(),
                theta,
                units: [0.0, 1.0],
                last: *settings.widths.last().unwrap_or(&observed),
                windows: 0,
            },
            discount: windows.discount,
            seed,
            settings: settings.clone(),
            layer: Policy::input_layer(&network).expect("a network has a first layer"),
            network,
            regression,
            weights,
            starts: Vec::new(),
        }
    }

    /// The value function by which windows end: the slow copy.
    pub(super) fn value(&self, units: &Units) -> Value {
        let mut theta: Vec<f64> = self.state.slow.iter().map(|theta| theta.as_()).collect();
        units.leave(&self.layer, &mut theta);
        Value { network: self.network.clone(), theta, units: self.state.units }
    }

    /// A value function with random output weights, whose derivatives are not 0.
    pub(super) fn random_value(&self) -> Value {
        let network = self.network.clone().zero_init_output(false);
        let theta = initial(&network, self.seed);
        Value { network, theta, units: [0.3, 1.5] }
    }

    /// Learns from what the samples of a window visited. `ended` is the component of the state that is
    /// not 0 after the end of an episode.
    ///
    /// # Errors
    /// [`Divergence`] if a value or a gradient is not finite.
    pub(super) fn learn(
        &mut self,
        visited: &Visited<F>,
        ended: Option<usize>,
        units: &Units,
    ) -> Result<Fit, Divergence> {
        let (steps, k) = (self.regression.steps, self.regression.observed);
        let samples = visited.costs.len() / steps;
        let n = visited.states.len() / (samples * (steps + 1));
        let values = self.values(&visited.observations, units);
        let each = self.regression.params() + 1;
        let mut starts = std::mem::take(&mut self.starts);
        starts.clear();
        let mut moments = Moments::default();
        for sample in 0..samples {
            let states = &visited.states[sample * (steps + 1) * n..][..(steps + 1) * n];
            let runs = |t: usize| ended.is_none_or(|e| states[t * n + e] == F::zero());
            let values = &values[sample * (steps + 1)..][..steps + 1];
            let costs = &visited.costs[sample * steps..][..steps];
            let first = starts.len();
            starts.resize(first + each, F::zero());
            let row = &mut starts[first + 1..];
            row[..steps * k]
                .copy_from_slice(&visited.observations[sample * (steps + 1) * k..][..steps * k]);
            let targets = &mut row[steps * k..];
            let mut later = values[steps];
            for t in (0..steps).rev().filter(|&t| runs(t)) {
                let ahead = if runs(t + 1) { later } else { 0.0 };
                // The costs of a window are discounted.
                let cost = costs[t].as_() / self.discount.powi(t as i32);
                let target = cost + self.discount * ahead;
                moments.add(values[t], target);
                targets[t] = F::from_f64(target);
                targets[steps + t] = F::one();
                let lambda = self.settings.lambda;
                later = (1.0 - lambda) * values[t] + lambda * target;
            }
        }
        self.state.set_units(moments.units(self.state.units, self.state.windows));
        let [mean, deviation] = self.state.units;
        for row in starts.chunks_exact_mut(each) {
            for target in &mut row[1 + steps * k..][..steps] {
                *target = F::from_f64((target.as_() - mean) / deviation);
            }
        }
        let outcome = self.regress(&starts, each, units);
        self.starts = starts;
        outcome?;
        let follow = F::from_f64(self.settings.follow);
        let CriticState { theta, slow, windows, .. } = &mut self.state;
        slow.iter_mut().zip(&*theta).for_each(|(slow, &theta)| *slow += follow * (theta - *slow));
        *windows += 1;
        Ok(moments.fit())
    }

    /// Values of these observations by the slow copy.
    pub(super) fn values(&self, observations: &[F], units: &Units) -> Vec<f64> {
        let policy: &dyn AnyPolicy<F> = &self.network;
        let count = observations.len() / self.regression.observed;
        let mut slow = self.state.slow.clone();
        units.leave(&self.layer, &mut slow);
        let slow = Weights::new(policy, slow);
        let mut tape = Aligned::zeros(policy.sizes(count).tape);
        let mut values = vec![F::zero(); count];
        let at = PolicyColumns::range(0..count);
        policy.forward(PolicyPass::new(slow.packed(), at, observations), &mut tape, &mut values);
        let [mean, deviation] = self.state.units;
        values.into_iter().map(|value| value.as_() * deviation + mean).collect()
    }

    /// All updates of a window.
    fn regress(&mut self, starts: &[F], each: usize, units: &Units) -> Result<(), Divergence> {
        let samples = starts.len() / each;
        let mut order: Vec<usize> = (0..samples).collect();
        let mut rng = stream(self.seed, Purpose::Value, 1 + self.state.windows);
        let part = samples.div_ceil(self.settings.parts);
        let mut chosen = Vec::with_capacity(part * each);
        for _ in 0..self.settings.passes {
            order.shuffle(&mut rng);
            for part in order.chunks(part) {
                chosen.clear();
                for &sample in part {
                    chosen.extend_from_slice(&starts[sample * each..][..each]);
                }
                let policy: &dyn AnyPolicy<F> = &self.network;
                self.weights.update(policy, |theta| {
                    theta.copy_from_slice(&self.state.theta);
                    units.leave(&self.layer, theta);
                });
                self.batch.run(&self.regression, policy, &self.weights, &chosen)?;
                let gradient = &mut self.batch.gradients_mut()[0];
                let exponent = gradient.exponent();
                units.enter_gradient(&self.layer, gradient.values_mut(exponent));
                Clip::Norm(1.0).apply(gradient);
                let CriticState { theta, optimizer, .. } = &mut self.state;
                optimizer.step(theta, gradient);
            }
        }
        Ok(())
    }
}

/// Initial parameters, with biases from -1 to 1 in hidden layers. Without biases, tanh layers are odd
/// functions, which learn an even one, such as the value of a plant near its goal, only after long.
fn initial(network: &Mlp, seed: u64) -> Vec<f64> {
    let mut rng = stream(seed, Purpose::Value, 0);
    let mut theta = vec![0.0; Policy::param_count(network)];
    Policy::init(network, &mut rng, &mut theta);
    let widths = network.widths();
    let mut first = 0;
    for layer in widths[..widths.len() - 1].windows(2) {
        first += layer[0] * layer[1];
        theta[first..first + layer[1]].fill_with(|| rng.random_range(-1.0..1.0));
        first += layer[1];
    }
    theta
}

/// Sums of targets and errors.
#[derive(Default)]
struct Moments {
    count: f64,
    error: [f64; 2],
    target: [f64; 2],
}

impl Moments {
    fn add(&mut self, value: f64, target: f64) {
        self.count += 1.0;
        for (sums, number) in [(&mut self.error, target - value), (&mut self.target, target)] {
            sums[0] += number;
            sums[1] += number * number;
        }
    }

    /// Mean and standard deviation of the targets: those of the first window, then moving averages.
    /// The deviation stays if the targets do not vary.
    fn units(&self, [old_mean, old_deviation]: [f64; 2], windows: u64) -> [f64; 2] {
        let share = if windows == 0 { 1.0 } else { 0.05 };
        let mean = self.target[0] / self.count;
        let moved = old_mean + share * (mean - old_mean);
        let square = old_deviation * old_deviation;
        // About the moving mean, so that a shift of the targets counts.
        let variance = self.target[1] / self.count - mean * mean + (mean - moved).powi(2);
        let deviation = (square + share * (variance - square)).max(0.0).sqrt();
        let varies = deviation > 1e-6 * moved.abs().max(1e-30);
        [moved, if varies { deviation } else { old_deviation }]
    }

    fn fit(&self) -> Fit {
        let variance = |[sum, square]: [f64; 2]| {
            let rounded = square / self.count - (sum / self.count).powi(2);
            if rounded > f64::EPSILON * square / self.count { rounded } else { 0.0 }
        };
        let variances = [self.error, self.target].map(variance);
        Fit { error: self.error[1] / self.count, variances }
    }
}

/// The regression of values on targets as a task: its physics is the recorded window. The parameters
/// of a sample are the observations, then the targets, then the weights of its steps.
#[derive(Clone, Copy, Debug)]
struct Regression {
    observed: usize,
    steps: usize,
}

impl Regression {
    fn params(&self) -> usize {
        self.steps * (self.observed + 2)
    }
}

impl System for Regression {
    fn state_dim(&self) -> usize {
        1
    }

    fn control_dim(&self) -> usize {
        1
    }

    fn param_dim(&self) -> usize {
        self.params()
    }

    fn step<T: Scalar>(&self, inputs: Inputs<'_, T>, next: &mut [T]) {
        next[0] = inputs.x[0];
    }

    fn vjp<R: Real, C: Cotangent<R>>(
        &self,
        _inputs: Inputs<'_, R>,
        next_bar: &[C],
        cotangents: Cotangents<'_, C>,
    ) {
        if let Some(x_bar) = cotangents.x {
            x_bar[0] += next_bar[0];
        }
    }
}

impl Task for Regression {
    type System = Self;

    fn system(&self) -> &Self {
        self
    }

    fn horizon(&self) -> usize {
        self.steps
    }

    fn start(&self, _rng: &mut Rng, Start { p, .. }: Start<'_>) {
        p.fill(0.0);
    }

    fn observation_dim(&self) -> Option<usize> {
        Some(self.observed)
    }

    fn observe<T: Scalar>(&self, Inputs { p, t, .. }: Inputs<'_, T>, y: &mut [T]) {
        y.copy_from_slice(&p[t * self.observed..][..self.observed]);
    }

    fn observe_vjp<R: Real, C: Cotangent<R>>(
        &self,
        Inputs { t, .. }: Inputs<'_, R>,
        y_bar: &[C],
        cotangents: Cotangents<'_, C>,
    ) {
        if let Some(p_bar) = cotangents.p {
            add(&mut p_bar[t * self.observed..][..self.observed], y_bar);
        }
    }

    fn running_cost<T: Scalar>(&self, Inputs { u, p, t, .. }: Inputs<'_, T>, _next: &[T]) -> T {
        let of_steps = &p[self.steps * self.observed..];
        let error = u[0] - of_steps[t];
        error * error * of_steps[self.steps + t] / self.steps as f64
    }

    fn running_cost_gradient<R: Real>(
        &self,
        Inputs { u, p, t, .. }: Inputs<'_, R>,
        _next: &[R],
        cotangents: Cotangents<'_, R>,
        _next_bar: &mut [R],
    ) {
        let of_steps = &p[self.steps * self.observed..];
        if let Some(u_bar) = cotangents.u {
            let slope = (u[0] - of_steps[t]) * of_steps[self.steps + t];
            u_bar[0] += slope * (2.0 / self.steps as f64);
        }
    }
}
