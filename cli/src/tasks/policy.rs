//! The `policy` section.

use crate::settings::config_error::{ConfigError, allowed};
use crate::tasks::Section;
use physgrad::Number;
use physgrad::number::Varied;
use physgrad::policy::{Activation, AnyNetwork, Mlp, TrainedParam, WithParams};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// The policy of a scene, with the trained numbers of its system.
pub type ScenePolicy = WithParams<AnyNetwork>;

/// The `policy` section of a task's settings.
pub trait PolicySpec: Section + Default {
    /// Checks the ranges of all settings.
    fn validate(&self) -> Result<(), ConfigError>;
    /// Builds the network for these dimensions of observation and control. By default, a task
    /// observes its state.
    fn build(&self, state_dim: usize, control_dim: usize) -> AnyNetwork;
}

/// Converts a trained number to an entry of `θ`. None for other numbers.
pub fn trained(varied: &Varied) -> Option<TrainedParam> {
    let Number::Trained { start, min, max } = varied.number else { return None };
    let index = varied.index;
    Some(if max.is_finite() {
        TrainedParam::bounded(index, start, min, max)
    } else if min.is_finite() {
        TrainedParam::above(index, start, min)
    } else {
        TrainedParam::linear(index, start)
    })
}

/// Multilayer perceptron of the observation: the whole state, unless the task has another one.
#[derive(Clone, Debug, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct MlpSettings {
    /// Widths of the hidden layers; an empty list gives a linear policy.
    widths: Vec<usize>,
    /// Activation of the hidden layers.
    activation: Activation,
    /// Adds a bias to every layer.
    bias: bool,
    /// Initializes the weights of the output layer with zeros.
    zero_init_output: bool,
}

impl Default for MlpSettings {
    fn default() -> Self {
        Self {
            widths: vec![100, 100],
            activation: Activation::Tanh,
            bias: true,
            zero_init_output: true,
        }
    }
}

impl PolicySpec for MlpSettings {
    fn validate(&self) -> Result<(), ConfigError> {
        let (found, most) = (self.widths.len(), 1000);
        allowed(
            "policy.widths",
            format!("a list of {found}"),
            found <= most,
            format!("up to {most} layers"),
        )?;
        if self.widths.is_empty() && self.activation != Activation::Tanh {
            let name = format!("{:?}", self.activation).to_lowercase();
            return Err(ConfigError::unread("policy.activation", name, "`policy.widths` is []"));
        }
        match self.widths.iter().find(|w| !(1..=10_000).contains(*w)) {
            Some(width) => {
                let what =
                    format!("has {width}; allowed: 1 to 10000 each, or [] for a linear policy");
                Err(ConfigError::new("policy.widths", what))
            }
            None => Ok(()),
        }
    }

    fn build(&self, state_dim: usize, control_dim: usize) -> AnyNetwork {
        let widths = [&[state_dim], &self.widths[..], &[control_dim]].concat();
        let network = Mlp::new(widths).activation(self.activation).bias(self.bias);
        AnyNetwork::Mlp(network.zero_init_output(self.zero_init_output))
    }
}
