//! The `training` section.

use crate::program::settings::config_error::{ConfigError, allowed, count, positive};
use crate::program::settings::{ClipName, OptimizerName};
use physgrad::{Clip, OptimizerKind, Training};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// How to train.
#[derive(Clone, Debug, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct TrainingSettings {
    /// Samples per update.
    pub batch: usize,
    /// Start states to train on.
    pub train_samples: usize,
    /// Start states to test on.
    pub test_samples: usize,
    /// A new order of the training set in every epoch.
    pub shuffle: bool,
    /// What makes steps of the field.
    pub optimizer: OptimizerName,
    /// The optimizer's learning rate.
    pub learning_rate: f64,
    /// Limits the field before the optimizer: every component (value), or the length (norm).
    pub clip: ClipName,
    /// Limit of `clip`; 1 if there is a `clip` and no limit.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub clip_limit: Option<f64>,
    /// The most bytes that the states and tapes of a mini-batch may take, on all threads together, as in "64MB"; what does not
    /// fit is computed again, with the same bits. Without it, everything is stored.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub memory: Option<String>,
    /// Updates in a row that may be skipped because a number was not finite.
    pub max_skipped: usize,
}

impl Default for TrainingSettings {
    fn default() -> Self {
        let Training { batch, train_samples, test_samples, shuffle, learning_rate, max_skipped, .. } = Training::default();
        Self {
            batch,
            train_samples,
            test_samples,
            shuffle,
            optimizer: OptimizerName::Adam,
            learning_rate,
            clip: ClipName::None,
            clip_limit: None,
            memory: None,
            max_skipped,
        }
    }
}

impl TrainingSettings {
    /// Decides what depends on other settings.
    pub fn complete(&mut self) {
        if self.clip != ClipName::None {
            self.clip_limit.get_or_insert(1.0);
        }
    }

    /// What is out of range, and what nothing reads.
    pub fn validate(&self) -> Result<(), ConfigError> {
        count("training.batch", self.batch, 1..=1_000_000)?;
        count("training.train_samples", self.train_samples, 1..=1_000_000)?;
        count("training.test_samples", self.test_samples, 1..=1_000_000)?;
        let rate = self.learning_rate;
        allowed("training.learning_rate", rate, rate > 0.0 && rate <= 1e6, "a positive number up to 1e6")?;
        if let Some(memory) = &self.memory {
            let what = "bytes, as in \"64MB\": a number, then B, kB, MB, GB, KiB, MiB or GiB";
            allowed("training.memory", format!("{memory:?}"), bytes(memory).is_some(), what)?;
        }
        match (self.clip, self.clip_limit) {
            (_, None) => Ok(()),
            (ClipName::None, Some(limit)) => Err(ConfigError::unread("training.clip_limit", limit, "`training.clip` is none")),
            (_, Some(limit)) => positive("training.clip_limit", limit),
        }
    }

    /// The most bytes for rollouts and gradients of a mini-batch.
    pub fn budget(&self) -> Option<u64> {
        self.memory.as_deref().and_then(bytes)
    }

    /// The same for the library.
    pub fn training(&self, epochs: usize, seed: u64, workers: usize) -> Training {
        let rule = match self.optimizer {
            OptimizerName::Adam => "adam",
            OptimizerName::Sgd => "sgd",
            OptimizerName::Momentum => "momentum",
            OptimizerName::RmsProp => "rmsprop",
            OptimizerName::Adagrad => "adagrad",
            OptimizerName::Adadelta => "adadelta",
        };
        Training {
            epochs,
            batch: self.batch,
            train_samples: self.train_samples,
            test_samples: self.test_samples,
            seed,
            shuffle: self.shuffle,
            rule: OptimizerKind::named(rule).expect("every name is a rule"),
            learning_rate: self.learning_rate,
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

/// A number of bytes with its unit.
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
    use super::bytes;

    #[test]
    fn bytes_have_a_number_and_a_unit() {
        assert_eq!(["64MB", "1.5 kB", "2GiB", "7B"].map(bytes), [Some(64_000_000), Some(1500), Some(1 << 31), Some(7)]);
        assert_eq!(["64", "MB", "-1MB", "0MB", "1 mb", "nanMB", "1e30GB"].map(bytes), [None; 7]);
    }
}
