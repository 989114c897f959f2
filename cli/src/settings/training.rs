//! The `training` section.

use crate::settings::config_error::{ConfigError, allowed, count, positive};
use crate::settings::{ClipName, DecayName, EstimatorName, OptimizerName};
use physgrad::train::{Decay, Estimator, Smoothing};
use physgrad::{Clip, Field, Flow, Training};
use schemars::JsonSchema;
use serde::de::{self, Deserializer, Visitor};
use serde::{Deserialize, Serialize};
use std::fmt;

/// Settings of the training.
#[derive(Clone, Debug, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct TrainingSettings {
    /// Samples per update.
    pub batch: usize,
    /// Initial states in the training set.
    pub train_samples: usize,
    /// Initial states in the test set.
    pub test_samples: usize,
    /// Draws a new order of the training set in every epoch.
    pub shuffle: bool,
    /// Draws new initial states for the updates of every epoch. The evaluated sets stay fixed.
    pub resample: bool,
    /// Optimizer that turns the field into updates.
    pub optimizer: OptimizerName,
    /// Learning rate of the optimizer.
    pub learning_rate: f64,
    /// Decay of the learning rate over all epochs.
    pub decay: DecayName,
    /// Learning rate at the end of the decay, as a fraction of `learning_rate`, 0.01 by default.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub decay_end: Option<f64>,
    /// Updates at the start in which the learning rate rises linearly to its full value.
    pub warm_up: usize,
    /// Weight of all paths of the adjoint, per step. Below 1, it discounts effects on later costs.
    /// With the section `window`, weight of the costs of the next step.
    pub discount: f64,
    /// Factor of the path through the observation. Interpolates field R between M (0) and R (1).
    pub control: f64,
    /// Steps between truncations of the adjoint; never by default.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub truncation: Option<usize>,
    /// Growth in decades above which the adjoint of a sample is cut; never by default.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub cut: Option<f64>,
    /// Weight of the past in a moving average of the direction of R, which combinations use instead
    /// of R. 0, the default, uses the current R.
    pub average: f64,
    /// Estimator of the field: `exact` evaluates it at the parameters, the others at perturbed
    /// ones.
    pub estimator: EstimatorName,
    /// Standard deviation of the perturbations, 0.02 by default.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub noise: Option<f64>,
    /// Pairs of opposite perturbations per update, 8 by default.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub pairs: Option<usize>,
    /// Accepted error of `alpha_order`, in units of the gradient, 1 by default.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub tolerance: Option<f64>,
    /// Clipping of the field before the optimizer: of every component (value), or of the norm.
    pub clip: ClipName,
    /// Limit of `clip`, 1 by default.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub clip_limit: Option<f64>,
    /// Bound on the bytes of states and tapes of a mini-batch, over all threads, such as "64MB".
    /// The reverse pass recomputes the rest, with bit-identical results. By default, unbounded.
    #[serde(default, skip_serializing_if = "Option::is_none", deserialize_with = "text_of_bytes")]
    pub memory: Option<String>,
    /// Consecutive updates that may be skipped because of a non-finite number.
    pub max_skipped: usize,
}

impl Default for TrainingSettings {
    fn default() -> Self {
        let Training {
            batch,
            train_samples,
            test_samples,
            shuffle,
            resample,
            learning_rate,
            warm_up,
            max_skipped,
            ..
        } = Training::default();
        Self {
            batch,
            train_samples,
            test_samples,
            shuffle,
            resample,
            optimizer: OptimizerName::default(),
            learning_rate,
            decay: DecayName::Constant,
            decay_end: None,
            warm_up,
            discount: 1.0,
            control: 1.0,
            truncation: None,
            cut: None,
            average: 0.0,
            estimator: EstimatorName::Exact,
            noise: None,
            pairs: None,
            tolerance: None,
            clip: ClipName::None,
            clip_limit: None,
            memory: None,
            max_skipped,
        }
    }
}

impl TrainingSettings {
    /// Sets the defaults that depend on other settings.
    pub fn complete(&mut self) {
        if self.clip != ClipName::None {
            self.clip_limit.get_or_insert(1.0);
        }
        if self.estimator != EstimatorName::Exact {
            self.noise.get_or_insert(0.02);
            self.pairs.get_or_insert(8);
        }
        if self.estimator == EstimatorName::AlphaOrder {
            self.tolerance.get_or_insert(1.0);
        }
        if self.decay != DecayName::Constant {
            self.decay_end.get_or_insert(0.01);
        }
    }

    /// Rejects invalid values and unused keys.
    pub fn validate(&self) -> Result<(), ConfigError> {
        self.reject_unread()?;
        count("training.batch", self.batch, 1..=1_000_000)?;
        count("training.train_samples", self.train_samples, 1..=1_000_000)?;
        count("training.test_samples", self.test_samples, 1..=1_000_000)?;
        let rate = self.learning_rate;
        allowed(
            "training.learning_rate",
            rate,
            rate > 0.0 && rate <= 1e6,
            "a positive number up to 1e6",
        )?;
        count("training.warm_up", self.warm_up, 0..=1_000_000_000)?;
        allowed(
            "training.discount",
            self.discount,
            (0.0..=1.0).contains(&self.discount),
            "0 to 1",
        )?;
        allowed("training.control", self.control, (0.0..=1.0).contains(&self.control), "0 to 1")?;
        if let Some(steps) = self.truncation {
            count("training.truncation", steps, 1..=1_000_000_000)?;
        }
        if let Some(decades) = self.cut {
            positive("training.cut", decades)?;
        }
        if let Some(end) = self.decay_end {
            let exponential = self.decay == DecayName::Exponential;
            let range = if exponential { "a positive number up to 1" } else { "0 to 1" };
            allowed(
                "training.decay_end",
                end,
                (0.0..=1.0).contains(&end) && !(exponential && end == 0.0),
                range,
            )?;
        }
        allowed(
            "training.average",
            self.average,
            (0.0..1.0).contains(&self.average),
            "0 to below 1",
        )?;
        if let Some(noise) = self.noise {
            positive("training.noise", noise)?;
        }
        if let Some(pairs) = self.pairs {
            // Variances need two pairs.
            let weighted = matches!(
                self.estimator,
                EstimatorName::InverseVariance | EstimatorName::AlphaOrder
            );
            count("training.pairs", pairs, if weighted { 2 } else { 1 }..=100_000)?;
        }
        if let Some(tolerance) = self.tolerance {
            positive("training.tolerance", tolerance)?;
        }
        if let Some(limit) = self.clip_limit {
            positive("training.clip_limit", limit)?;
        }
        if let Some(memory) = &self.memory {
            allowed("training.memory", format!("{memory:?}"), bytes(memory).is_some(), BYTES)?;
        }
        Ok(())
    }

    /// Rejects keys that have no effect because of another setting.
    fn reject_unread(&self) -> Result<(), ConfigError> {
        let (exact, pairs) =
            (self.estimator == EstimatorName::Exact, self.pairs.map(|pairs| pairs as f64));
        let keys = [
            (
                "training.decay_end",
                self.decay_end,
                self.decay == DecayName::Constant,
                "`training.decay` is constant",
            ),
            ("training.noise", self.noise, exact, "`training.estimator` is exact"),
            ("training.pairs", pairs, exact, "`training.estimator` is exact"),
            (
                "training.tolerance",
                self.tolerance,
                self.estimator != EstimatorName::AlphaOrder,
                "`training.estimator` is not alpha_order",
            ),
            (
                "training.clip_limit",
                self.clip_limit,
                self.clip == ClipName::None,
                "`training.clip` is none",
            ),
        ];
        for (key, value, unread, reason) in keys {
            if let (Some(value), true) = (value, unread) {
                return Err(ConfigError::unread(key, value, reason));
            }
        }
        Ok(())
    }

    /// Estimator with its settings. None without perturbations.
    fn smoothing(&self) -> Option<Smoothing> {
        let estimator = match self.estimator {
            EstimatorName::Exact => return None,
            EstimatorName::FirstOrder => Estimator::FirstOrder,
            EstimatorName::ZerothOrder => Estimator::ZerothOrder,
            EstimatorName::InverseVariance => Estimator::InverseVariance,
            EstimatorName::AlphaOrder => Estimator::AlphaOrder { tolerance: self.tolerance? },
        };
        Some(Smoothing { estimator, noise: self.noise?, pairs: self.pairs? })
    }

    /// Bound on the bytes of a mini-batch. None without a bound.
    pub fn budget(&self) -> Option<u64> {
        self.memory.as_deref().and_then(bytes)
    }

    /// The field, with control, truncation and cut applied to all its flows, and the discount unless
    /// the training is by windows, which apply it.
    pub fn weighted_in(&self, field: Field, by_windows: bool) -> Field {
        let discount = if by_windows { 1.0 } else { self.discount };
        Self { discount, ..self.clone() }.weighted(field)
    }

    /// The field, with discount, control, truncation and cut applied to all its flows.
    pub fn weighted(&self, field: Field) -> Field {
        field.with_flows(|flow| {
            let flow = flow.discounted(self.discount);
            Flow {
                control: flow.control * self.control,
                truncation: self.truncation,
                cut: self.cut,
                ..flow
            }
        })
    }

    /// Settings of the library's trainer.
    pub fn training(&self, epochs: usize, seed: u64, workers: usize) -> Training {
        Training {
            epochs,
            batch: self.batch,
            train_samples: self.train_samples,
            test_samples: self.test_samples,
            seed,
            shuffle: self.shuffle,
            resample: self.resample,
            rule: self.optimizer.kind(),
            learning_rate: self.learning_rate,
            decay: match (self.decay, self.decay_end) {
                (DecayName::Cosine, Some(end)) => Decay::Cosine { end },
                (DecayName::Exponential, Some(end)) => Decay::Exponential { end },
                _ => Decay::Constant,
            },
            warm_up: self.warm_up,
            average: self.average,
            smoothing: self.smoothing(),
            clip: match (self.clip, self.clip_limit) {
                (ClipName::Value, Some(limit)) => Clip::Value(limit),
                (ClipName::Norm, Some(limit)) => Clip::Norm(limit),
                _ => Clip::None,
            },
            max_skipped: self.max_skipped,
            workers,
            memory: self.budget(),
        }
    }
}

/// Allowed values of `training.memory`.
const BYTES: &str = "a number of bytes such as \"64MB\", in B, kB, MB, GB, KiB, MiB or GiB";

/// Reads a text, with [`BYTES`] as the allowed values in the error of another type.
fn text_of_bytes<'de, D: Deserializer<'de>>(deserializer: D) -> Result<Option<String>, D::Error> {
    struct Text;

    impl Visitor<'_> for Text {
        type Value = String;

        fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
            f.write_str(BYTES)
        }

        fn visit_str<E: de::Error>(self, text: &str) -> Result<String, E> {
            Ok(text.to_owned())
        }
    }

    deserializer.deserialize_str(Text).map(Some)
}

/// Parses a number of bytes with its unit, from 1 B to below 1e15 B.
fn bytes(text: &str) -> Option<u64> {
    let end = text.find(|c: char| c.is_ascii_alphabetic())?;
    let number: f64 = text[..end].trim().parse().ok()?;
    let unit = match &text[end..] {
        "B" => 1.0,
        "kB" => 1e3,
        "MB" => 1e6,
        "GB" => 1e9,
        "KiB" => 1024.0,
        "MiB" => 1024.0 * 1024.0,
        "GiB" => 1024.0 * 1024.0 * 1024.0,
        _ => return None,
    };
    (number >= 1.0 / unit && number * unit < 1e15).then_some((number * unit) as u64)
}

#[cfg(test)]
mod tests {
    use super::{TrainingSettings, bytes};
    use physgrad::{Field, Flow};

    #[test]
    fn discount_control_truncation_and_cut_apply_to_both_flows_of_c() {
        let settings = TrainingSettings {
            discount: 0.5,
            control: 0.25,
            truncation: Some(8),
            cut: Some(2.0),
            ..TrainingSettings::default()
        };
        let expected = [Flow::MODIFIED, Flow::REGULAR].map(|flow| Flow {
            control: 0.125 * flow.control,
            ..flow.discounted(0.5).truncated(8).cut(2.0)
        });
        assert_eq!(settings.weighted(Field::combined()).flows(), expected);
        assert_eq!(TrainingSettings::default().weighted(Field::combined()), Field::combined());
    }

    #[test]
    fn bytes_have_a_positive_number_and_a_unit_from_b_to_gib() {
        assert_eq!(
            ["64MB", "1.5 kB", "2GiB", "7B"].map(bytes),
            [Some(64_000_000), Some(1500), Some(1 << 31), Some(7)]
        );
        assert_eq!(["64", "MB", "-1MB", "0MB", "1 mb", "nanMB", "1e30GB"].map(bytes), [None; 7]);
    }
}
