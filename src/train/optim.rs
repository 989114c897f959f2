//! Optimizers and gradient clipping. Formulas and defaults are those of Keras 2.15, except the
//! momentum of 0.9.

use crate::engine::gradient::Gradient;
use crate::numbers::extended::ExtendedF64;
use crate::numbers::kernels::{SimdLevel, Vectorized, dispatch};
use crate::numbers::scalar::Float;
use serde::{Deserialize, Serialize};

/// Clipping of the vector field, applied before the optimizer.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub enum Clip {
    /// No clipping.
    None,
    /// Clamps every component to ± the limit.
    Value(f64),
    /// Scales the vector to at most this Euclidean norm.
    Norm(f64),
}

impl Clip {
    /// Problem of an invalid limit, with the allowed values.
    pub(super) fn problem(self) -> Option<String> {
        let (Self::Value(limit) | Self::Norm(limit)) = self else { return None };
        let is_positive = limit > 0.0;
        (!is_positive).then(|| format!("has the limit {limit}; allowed: a positive number"))
    }

    /// Upper bound on the absolute values of the components after clipping, given the norm before
    /// clipping.
    pub(crate) fn bound(self, norm: f64) -> f64 {
        match self {
            Self::None => norm,
            Self::Value(limit) | Self::Norm(limit) => norm.min(limit),
        }
    }

    /// Clips `gradient` in place and sets its exponent to 0.
    ///
    /// Components too small for the range of `F` become 0. Components too large for it become
    /// infinite, unless clipping limits them.
    pub fn apply<F: Float>(self, gradient: &mut Gradient<F>) {
        let norm = match self {
            Self::Norm(_) => gradient.norm(),
            Self::None | Self::Value(_) => ExtendedF64::default(),
        };
        self.apply_knowing(gradient, norm);
    }

    /// Clips a gradient whose norm is known. Only [`Clip::Norm`] reads `norm`.
    pub(crate) fn apply_knowing<F: Float>(self, gradient: &mut Gradient<F>, norm: ExtendedF64) {
        match self {
            Self::None => gradient.flatten(),
            Self::Value(limit) => {
                gradient.flatten();
                let (low, high) = (F::from_f64(-limit), F::from_f64(limit));
                for g in gradient.values_mut(0) {
                    // Comparisons preserve NaN.
                    *g = if *g < low {
                        low
                    } else if *g > high {
                        high
                    } else {
                        *g
                    };
                }
            }
            Self::Norm(limit) if norm.get() > limit => {
                // Norm of the stored values, without the exponent.
                let length = norm.over_power_of_two(gradient.exponent());
                let (factor, values) = (limit / length, gradient.values_mut(0));
                let rounded = F::from_f64(factor);
                for g in values {
                    // The inverse of a subnormal length overflows in f32.
                    *g = if rounded.as_().is_finite() {
                        *g * rounded
                    } else {
                        F::from_f64(g.as_() * factor)
                    };
                }
            }
            Self::Norm(_) => gradient.flatten(),
        }
    }
}

/// Update rule of an optimizer.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub enum OptimizerKind {
    /// Adam, Kingma and Ba 2015 (arXiv:1412.6980), as in Keras: ε is added to the root of the
    /// uncorrected second moment.
    Adam {
        /// Decay of the first moment.
        beta1: f64,
        /// Decay of the second moment.
        beta2: f64,
        /// ε, avoids a division by zero.
        epsilon: f64,
    },
    /// Gradient descent.
    Sgd,
    /// Gradient descent with heavy-ball momentum.
    Momentum {
        /// Factor of the previous step.
        momentum: f64,
    },
    /// RMSprop, Tieleman and Hinton 2012; ε under the root.
    RmsProp {
        /// Decay of the mean square.
        rho: f64,
        /// ε, avoids a division by zero.
        epsilon: f64,
    },
    /// Adagrad, Duchi, Hazan and Singer 2011; ε under the root.
    Adagrad {
        /// Initial value of the accumulators.
        initial: f64,
        /// ε, avoids a division by zero.
        epsilon: f64,
    },
    /// Adadelta, Zeiler 2012 (arXiv:1212.5701).
    Adadelta {
        /// Decay of the mean squares.
        rho: f64,
        /// ε, avoids a division by zero.
        epsilon: f64,
    },
}

impl OptimizerKind {
    /// Names accepted by [`OptimizerKind::named`].
    pub const NAMES: [&str; 6] = ["adam", "sgd", "momentum", "rmsprop", "adagrad", "adadelta"];

    /// Returns the named rule with default parameters, or `None` for an unknown name.
    pub fn named(name: &str) -> Option<Self> {
        Some(match name {
            "adam" => Self::Adam { beta1: 0.9, beta2: 0.999, epsilon: 1e-7 },
            "sgd" => Self::Sgd,
            "momentum" => Self::Momentum { momentum: 0.9 },
            "rmsprop" => Self::RmsProp { rho: 0.9, epsilon: 1e-7 },
            "adagrad" => Self::Adagrad { initial: 0.1, epsilon: 1e-7 },
            "adadelta" => Self::Adadelta { rho: 0.95, epsilon: 1e-7 },
            _ => return None,
        })
    }

    /// Problem of an invalid parameter, with the allowed values.
    pub(super) fn problem(self) -> Option<String> {
        let below_one = |name, value: f64| {
            (!(0.0..1.0).contains(&value))
                .then(|| format!("has {name} = {value}; allowed: 0 to below 1"))
        };
        let positive = |name, value: f64| {
            // Smaller numbers can be 0 in f32.
            let is_positive = value >= f64::from(f32::MIN_POSITIVE) && value.is_finite();
            (!is_positive).then(|| {
                format!("has {name} = {value}; allowed: a positive number, at least 1.2e-38")
            })
        };
        match self {
            Self::Sgd => None,
            Self::Adam { beta1, beta2, epsilon } => below_one("beta1", beta1)
                .or_else(|| below_one("beta2", beta2))
                .or_else(|| positive("epsilon", epsilon)),
            Self::Momentum { momentum } => below_one("momentum", momentum),
            Self::RmsProp { rho, epsilon } | Self::Adadelta { rho, epsilon } => {
                below_one("rho", rho).or_else(|| positive("epsilon", epsilon))
            }
            Self::Adagrad { initial, epsilon } => {
                let is_valid = initial >= 0.0 && initial.is_finite();
                let problem = (!is_valid)
                    .then(|| format!("has initial = {initial}; allowed: 0 or a positive number"));
                problem.or_else(|| positive("epsilon", epsilon))
            }
        }
    }
}

/// An [`OptimizerKind`], a learning rate, the number of steps taken, and the accumulated moments.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Optimizer<F> {
    rule: OptimizerKind,
    learning_rate: f64,
    steps: u64,
    /// Adam: first moment. Momentum: previous step. RMSprop and Adadelta: mean square of the
    /// gradient. Adagrad: sum of squares. Gradient descent: unused.
    first: Vec<F>,
    /// Adam: second moment. Adadelta: mean square of the steps. Others: unused.
    second: Vec<F>,
}

impl<F: Float> Optimizer<F> {
    /// Creates an optimizer for `params` parameters.
    pub fn new(rule: OptimizerKind, learning_rate: f64, params: usize) -> Self {
        let start = if let OptimizerKind::Adagrad { initial, .. } = rule { initial } else { 0.0 };
        Self {
            rule,
            learning_rate,
            steps: 0,
            first: vec![F::from_f64(start); params],
            second: vec![F::zero(); params],
        }
    }

    /// Creates Adam with the defaults of Keras.
    pub fn adam(learning_rate: f64, params: usize) -> Self {
        Self::new(
            OptimizerKind::Adam { beta1: 0.9, beta2: 0.999, epsilon: 1e-7 },
            learning_rate,
            params,
        )
    }

    /// Number of steps taken.
    pub fn steps(&self) -> u64 {
        self.steps
    }

    /// Number of parameters.
    pub fn params(&self) -> usize {
        self.first.len()
    }

    /// Checks a restored state: rule and rate against `settings`, the number of steps against
    /// `expected`, and the sizes, ranges and signs of the moments.
    ///
    /// # Errors
    /// Describes the first fault.
    pub(crate) fn validate(&self, settings: &Self, expected: u64) -> Result<(), String> {
        let Self { rule, learning_rate, steps, first, second } = self;
        let n = settings.params();
        if *rule != settings.rule || *learning_rate != settings.learning_rate {
            let (session_rule, rate) = (settings.rule, settings.learning_rate);
            return Err(format!(
                "its optimizer is {rule:?} at the rate {learning_rate}, but this run uses {session_rule:?} at {rate}"
            ));
        }
        if *steps != expected {
            return Err(format!(
                "its optimizer counts {steps} steps, but its epochs have {expected} updates"
            ));
        }
        // Only the first moments of Adam and of momentum may be negative.
        let signed = matches!(rule, OptimizerKind::Adam { .. } | OptimizerKind::Momentum { .. });
        for (name, moments, signed) in [("first", first, signed), ("second", second, false)] {
            if moments.len() != n {
                return Err(format!(
                    "its optimizer has {} {name} moments for {n} parameters",
                    moments.len()
                ));
            }
            if let Some(i) =
                moments.iter().position(|m| !m.as_().is_finite() || (!signed && *m < F::zero()))
            {
                return Err(format!("the {name} moment of parameter {i} is {}", moments[i]));
            }
        }
        Ok(())
    }

    /// Copies another optimizer with the same number of parameters, without allocating.
    pub(crate) fn copy_from(&mut self, other: &Self) {
        (self.rule, self.learning_rate, self.steps) =
            (other.rule, other.learning_rate, other.steps);
        self.first.copy_from_slice(&other.first);
        self.second.copy_from_slice(&other.second);
    }

    /// Takes one step of `theta` against `gradient`, whatever its exponent. Components too small
    /// for the range of `F` count as 0. Clip gradients that may exceed this range.
    ///
    /// # Panics
    /// If a length differs from the number of parameters.
    #[track_caller]
    pub fn step(&mut self, theta: &mut [F], gradient: &Gradient<F>) {
        self.step_at(self.learning_rate, theta, gradient);
    }

    /// Takes one step with another learning rate, for example one with a
    /// [`Decay`](crate::train::Decay).
    ///
    /// # Panics
    /// If a length differs from the number of parameters.
    #[track_caller]
    pub fn step_at(&mut self, learning_rate: f64, theta: &mut [F], gradient: &Gradient<F>) {
        match gradient.exponent() {
            0 => self.step_along(learning_rate, theta, gradient.values()),
            _ => self.step_along(learning_rate, theta, &gradient.to_vec()),
        }
    }

    /// Takes one step against a vector of plain numbers.
    #[track_caller]
    pub(crate) fn step_along(&mut self, learning_rate: f64, theta: &mut [F], gradient: &[F]) {
        let n = self.first.len();
        assert!(
            theta.len() == n && gradient.len() == n,
            "the optimizer has {n} parameters, but θ has {} and the gradient has {}",
            theta.len(),
            gradient.len()
        );
        self.steps += 1;
        dispatch(
            SimdLevel::best(),
            OptimizerStep { optimizer: self, rate: learning_rate, theta, gradient },
        );
    }
}

struct OptimizerStep<'a, F> {
    optimizer: &'a mut Optimizer<F>,
    /// Learning rate of this step.
    rate: f64,
    theta: &'a mut [F],
    gradient: &'a [F],
}

impl<F: Float> Vectorized for OptimizerStep<'_, F> {
    #[inline(always)]
    fn run<const FMA: bool>(self) {
        let Optimizer { rule, steps, first, second, .. } = self.optimizer;
        let rate = self.rate;
        let all = self
            .theta
            .iter_mut()
            .zip(self.gradient)
            .zip(first)
            .zip(second)
            .map(|(((t, &g), m), v)| (t, g, m, v));
        let convert = F::from_f64;
        match *rule {
            OptimizerKind::Adam { beta1, beta2, epsilon } => {
                let steps = i32::try_from(*steps).unwrap_or(i32::MAX);
                let rate =
                    convert(rate * (1.0 - beta2.powi(steps)).sqrt() / (1.0 - beta1.powi(steps)));
                let (share1, share2, epsilon) =
                    (convert(1.0 - beta1), convert(1.0 - beta2), convert(epsilon));
                for (theta, g, m, v) in all {
                    *m += (g - *m) * share1;
                    *v += (g * g - *v) * share2;
                    *theta -= *m * rate / (Float::sqrt(*v) + epsilon);
                }
            }
            OptimizerKind::Sgd => {
                for (theta, g, _, _) in all {
                    *theta -= g * convert(rate);
                }
            }
            OptimizerKind::Momentum { momentum } => {
                for (theta, g, m, _) in all {
                    *m = *m * convert(momentum) - g * convert(rate);
                    *theta += *m;
                }
            }
            OptimizerKind::RmsProp { rho, epsilon } => {
                for (theta, g, m, _) in all {
                    *m = *m * convert(rho) + g * g * convert(1.0 - rho);
                    *theta -= g * convert(rate) / Float::sqrt(*m + convert(epsilon));
                }
            }
            OptimizerKind::Adagrad { epsilon, .. } => {
                for (theta, g, m, _) in all {
                    *m += g * g;
                    *theta -= g * convert(rate) / Float::sqrt(*m + convert(epsilon));
                }
            }
            OptimizerKind::Adadelta { rho, epsilon } => {
                for (theta, g, m, v) in all {
                    *m = *m * convert(rho) + g * g * convert(1.0 - rho);
                    let step =
                        g * Float::sqrt(*v + convert(epsilon)) / Float::sqrt(*m + convert(epsilon));
                    *v = *v * convert(rho) + step * step * convert(1.0 - rho);
                    *theta -= step * convert(rate);
                }
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Returns θ after each of two steps from 1 with the gradients 0.5 and -2.
    fn two_steps(rule: &str) -> [f64; 2] {
        let mut optimizer = Optimizer::<f64>::new(OptimizerKind::named(rule).expect(rule), 0.1, 1);
        let mut theta = [1.0];
        [0.5, -2.0].map(|gradient| {
            optimizer.step_along(0.1, &mut theta, &[gradient]);
            theta[0]
        })
    }

    /// The formulas of Keras 2.15, written out for two steps.
    #[test]
    fn two_steps_of_every_rule_equal_the_formulas_of_keras() {
        let epsilon = 1e-7;
        let expected = |rule: &str| -> [f64; 2] {
            match rule {
                "adam" => {
                    let (m1, v1) = (0.1 * 0.5, 0.001 * 0.25);
                    let first = 1.0
                        - 0.1 * (1.0f64 - 0.999).sqrt() / (1.0 - 0.9) * m1
                            / (f64::sqrt(v1) + epsilon);
                    let (m2, v2) = (0.9 * m1 - 0.1 * 2.0, 0.999 * v1 + 0.001 * 4.0);
                    let rate = 0.1 * (1.0f64 - 0.999 * 0.999).sqrt() / (1.0 - 0.81);
                    [first, first - rate * m2 / (f64::sqrt(v2) + epsilon)]
                }
                "sgd" => [0.95, 1.15],
                "momentum" => [0.95, 0.95 + (0.9 * -0.05 + 0.2)],
                "rmsprop" => {
                    let (v1, v2): (f64, f64) = (0.1 * 0.25, 0.9 * 0.1 * 0.25 + 0.1 * 4.0);
                    let first = 1.0 - 0.1 * 0.5 / (v1 + epsilon).sqrt();
                    [first, first + 0.1 * 2.0 / (v2 + epsilon).sqrt()]
                }
                "adagrad" => {
                    let first = 1.0 - 0.1 * 0.5 / (0.1 + 0.25 + epsilon).sqrt();
                    [first, first + 0.1 * 2.0 / (0.1 + 0.25 + 4.0 + epsilon).sqrt()]
                }
                "adadelta" => {
                    let g1 = 0.05 * 0.25;
                    let d1 = 0.5 * epsilon.sqrt() / (g1 + epsilon).sqrt();
                    let (x1, g2) = (0.05 * d1 * d1, 0.95 * g1 + 0.05 * 4.0);
                    let first = 1.0 - 0.1 * d1;
                    [first, first + 0.1 * 2.0 * (x1 + epsilon).sqrt() / (g2 + epsilon).sqrt()]
                }
                other => panic!("no formula for {other}"),
            }
        };
        for rule in OptimizerKind::NAMES {
            for (step, (got, expected)) in
                two_steps(rule).into_iter().zip(expected(rule)).enumerate()
            {
                approx::assert_relative_eq!(got, expected, max_relative = 1e-14);
                assert!(got != 1.0, "{rule} does nothing in step {step}");
            }
        }
    }

    #[test]
    fn wrong_sizes_signs_rates_rules_and_step_counts_of_a_restored_optimizer_are_errors() {
        let settings =
            |rule: &str| Optimizer::<f32>::new(OptimizerKind::named(rule).expect(rule), 0.1, 2);
        let fault = |rule: &str, change: fn(&mut Optimizer<f32>)| {
            let mut read = settings(rule);
            (read.steps, read.first) = (7, vec![0.5, 2.0]);
            change(&mut read);
            read.validate(&settings(rule), 7).err().unwrap_or_default()
        };
        for rule in OptimizerKind::NAMES {
            assert_eq!(fault(rule, |_| ()), "");
            assert!(
                fault(rule, |read| read.first.truncate(1))
                    .contains("1 first moments for 2 parameters")
            );
            assert!(
                fault(rule, |read| read.second.push(0.0))
                    .contains("3 second moments for 2 parameters")
            );
            assert!(
                fault(rule, |read| read.second[1] = -1.0)
                    .contains("the second moment of parameter 1 is -1")
            );
            assert!(
                fault(rule, |read| read.first[0] = f32::NAN)
                    .contains("the first moment of parameter 0 is NaN")
            );
            assert!(
                fault(rule, |read| read.second[0] = f32::INFINITY)
                    .contains("the second moment of parameter 0 is inf")
            );
            assert!(
                fault(rule, |read| read.steps = u64::MAX)
                    .contains("counts 18446744073709551615 steps")
            );
            assert!(fault(rule, |read| read.learning_rate = f64::NAN).contains("at the rate NaN"));
            assert!(
                fault(rule, |read| read.rule = OptimizerKind::Momentum { momentum: 0.1 })
                    .contains("Momentum { momentum: 0.1 }")
            );
            let signed = ["adam", "momentum"].contains(&rule);
            assert_eq!(fault(rule, |read| read.first[0] = -1.0).is_empty(), signed, "{rule}");
        }
    }

    #[test]
    fn clipping_bounds_components_or_the_norm_for_exponents_of_minus_5000_to_5000() {
        let clipped_with = |clip: Clip, exponent: i32| {
            let mut g = Gradient::<f64>::zeros(3);
            g.values_mut(exponent).copy_from_slice(&[3.0, -4.0, 0.5]);
            clip.apply(&mut g);
            assert_eq!(g.exponent(), 0);
            g.to_vec()
        };
        let clipped = |clip: Clip| clipped_with(clip, 0);
        let norm = (9.0f64 + 16.0 + 0.25).sqrt();
        assert_eq!(clipped(Clip::None), [3.0, -4.0, 0.5]);
        assert_eq!(clipped(Clip::Value(1.0)), [1.0, -1.0, 0.5]);
        assert_eq!(clipped(Clip::Norm(10.0)), [3.0, -4.0, 0.5]);
        // The clipped vector does not depend on the exponent.
        for exponent in [0, 5000] {
            for (got, whole) in
                clipped_with(Clip::Norm(1.0), exponent).into_iter().zip([3.0, -4.0, 0.5])
            {
                approx::assert_relative_eq!(got, whole / norm, max_relative = 1e-15);
            }
        }
        assert_eq!(clipped_with(Clip::Value(1.0), 5000), [1.0, -1.0, 1.0]);
        assert_eq!(
            clipped_with(Clip::None, 5000),
            [f64::INFINITY, f64::NEG_INFINITY, f64::INFINITY]
        );
        assert_eq!(clipped_with(Clip::Norm(1.0), -5000), [0.0, -0.0, 0.0]);
    }
}
