//! The `window` section.

use crate::settings::config_error::{ConfigError, allowed, count, not_negative, positive};
use physgrad::episode::{ValueSettings, Windows};
use physgrad::policy::AnyPolicy;
use physgrad::{DynTask, System as _, Task as _};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// Training by windows of an episode: each update sees some steps, and the next one continues where
/// they ended. Without this section, an update sees whole rollouts.
#[derive(Clone, Debug, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct WindowSettings {
    /// Steps of a window.
    pub steps: usize,
    /// Standard deviation of normal noise on the controls, in their units, during training: one number
    /// for all, or a list with one per control. A control with its noise keeps the bounds of the policy.
    #[serde(default)]
    noise: Noise,
    /// Whether policy and value function are trained as networks of the observation in units of its
    /// running mean and standard deviation, and bounded controls in units of half their range.
    #[serde(default)]
    normalize: bool,
    /// Value function of the last state of a window; absent if not listed.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    value: Option<ValueFunction>,
}

/// One number for all controls, or one per control.
#[derive(Clone, Debug, Serialize, Deserialize, JsonSchema)]
#[serde(untagged, expecting = "a number, or a list with one number per control")]
enum Noise {
    All(f64),
    Each(Vec<f64>),
}

impl Default for Noise {
    fn default() -> Self {
        Self::All(0.0)
    }
}

/// A network of the observation, trained on TD(λ) targets of the visited states.
#[derive(Clone, Debug, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
struct ValueFunction {
    /// Widths of the hidden layers, with tanh.
    widths: Vec<usize>,
    /// Learning rate of Adam.
    learning_rate: f64,
    /// Passes over the visited states after each window.
    passes: usize,
    /// Updates per pass, each with an equal part of the episodes.
    parts: usize,
    /// λ of the targets: 0 for one step, 1 for the whole window.
    lambda: f64,
    /// Part of the way that the slow copy, which ends windows, moves to the network after each window.
    follow: f64,
}

impl Default for ValueFunction {
    fn default() -> Self {
        let ValueSettings { widths, learning_rate, passes, parts, lambda, follow } =
            ValueSettings::default();
        Self { widths, learning_rate, passes, parts, lambda, follow }
    }
}

impl WindowSettings {
    /// Checks all ranges. `horizon` and `discount` are those of the scene.
    pub fn validate(&self, horizon: usize, discount: f64) -> Result<(), ConfigError> {
        positive("training.discount", discount)?;
        count("window.steps", self.steps, 1..=horizon)?;
        match &self.noise {
            Noise::All(noise) => not_negative("window.noise", *noise)?,
            Noise::Each(noise) => noise
                .iter()
                .enumerate()
                .try_for_each(|(i, &noise)| not_negative(&format!("window.noise[{i}]"), noise))?,
        }
        let Some(value) = &self.value else { return Ok(()) };
        let ValueFunction { widths, learning_rate, passes, parts, lambda, follow } = value;
        for (i, &width) in widths.iter().enumerate() {
            count(&format!("window.value.widths[{i}]"), width, 1..=10_000)?;
        }
        positive("window.value.learning_rate", *learning_rate)?;
        count("window.value.passes", *passes, 1..=10_000)?;
        count("window.value.parts", *parts, 1..=1_000_000)?;
        allowed("window.value.lambda", lambda, (0.0..=1.0).contains(lambda), "0 to 1")?;
        let follows = *follow > 0.0 && *follow <= 1.0;
        allowed("window.value.follow", follow, follows, "a positive number up to 1")?;
        let what = "below 1 with `window.value`, for example 0.99";
        allowed("training.discount", discount, discount < 1.0, what)
    }

    /// Whether episodes begin anew at any window of an epoch.
    pub fn restarts(&self) -> bool {
        self.value.is_some()
    }

    /// Refuses policies that windows do not train, and noise of another number of controls.
    pub fn check_policy(&self, policy: &dyn AnyPolicy<f64>) -> Result<(), ConfigError> {
        if let Noise::Each(noise) = &self.noise {
            let controls = policy.control_dim();
            let what = format!("{controls} numbers, one per control, or one number for all");
            allowed("window.noise", format!("{noise:?}"), noise.len() == controls, what)?;
        }
        if let Some(problem) = Windows::problem_of(policy) {
            return Err(ConfigError::new(
                "policy.kind",
                format!("with `window`: the policy {problem}"),
            ));
        }
        if self.normalize && policy.input_layer().is_none() {
            let what = "needs a policy of the kind `mlp`, with or without bounds; without hidden layers, \
                        `widths = []`, it is linear";
            return Err(ConfigError::new("window.normalize", what));
        }
        Ok(())
    }

    /// Settings of the library, for this task.
    pub fn windows(&self, task: DynTask, discount: f64) -> Windows {
        let value = self.value.clone().map(|value| {
            let ValueFunction { widths, learning_rate, passes, parts, lambda, follow } = value;
            ValueSettings { widths, learning_rate, passes, parts, lambda, follow }
        });
        let controls = task.system().control_dim();
        Windows {
            task,
            steps: self.steps,
            discount,
            noise: match &self.noise {
                Noise::All(noise) => vec![*noise; controls],
                Noise::Each(noise) => noise.clone(),
            },
            normalize: self.normalize,
            value,
        }
    }
}
