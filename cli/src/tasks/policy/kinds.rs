//! The built-in kinds of policies.

use super::{AnyPolicyKind, Controlled, PolicyKind, kind};
use crate::settings::config_error::{ConfigError, allowed, count};
use crate::tasks::equations::{keys_of, located};
use physgrad::graph::{Controller, GraphPolicy};
use physgrad::policy::{
    Activation, Conv, DynPolicy, Elman, Gru, Linear, Mlp, OpenLoop, TrainedParam,
};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// All built-in kinds.
pub(super) const BUILT_IN: [&dyn AnyPolicyKind; 7] = [
    kind::<MlpSettings>(),
    kind::<LinearSettings>(),
    kind::<GruSettings>(),
    kind::<ElmanSettings>(),
    kind::<ConvSettings>(),
    kind::<OpenLoopSettings>(),
    kind::<Controller>(),
];

/// Name of the multilayer perceptron, the default of most tasks.
pub const MLP: &str = MlpSettings::NAME;
/// Name of the convolutional network, the default of `quantum`.
pub const CONV: &str = ConvSettings::NAME;

/// Multilayer perceptron of the observation: the whole state, unless the task has another one.
#[derive(Clone, Debug, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
struct MlpSettings {
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

impl PolicyKind for MlpSettings {
    const NAME: &'static str = "mlp";
    const ABOUT: &'static str = "Multilayer perceptron of the observation.";

    fn validate(&self) -> Result<(), ConfigError> {
        let (found, most) = (self.widths.len(), 1000);
        allowed(
            "widths",
            format!("a list of {found}"),
            found <= most,
            format!("up to {most} layers"),
        )?;
        if self.widths.is_empty() && self.activation != Activation::Tanh {
            let name = format!("{:?}", self.activation).to_lowercase();
            return Err(ConfigError::unread("activation", name, "`policy.widths` is []"));
        }
        match self.widths.iter().find(|w| !(1..=10_000).contains(*w)) {
            Some(width) => {
                let what =
                    format!("has {width}; allowed: 1 to 10000 each, or [] for a linear policy");
                Err(ConfigError::new("widths", what))
            }
            None => Ok(()),
        }
    }

    fn build(&self, of: &Controlled) -> Result<DynPolicy, ConfigError> {
        let widths = [&[of.observations.len()], &self.widths[..], &[of.controls.len()]].concat();
        let network = Mlp::new(widths).activation(self.activation).bias(self.bias);
        Ok(DynPolicy::new(network.zero_init_output(self.zero_init_output)))
    }
}

/// Linear feedback of the observation. All gains are 0 at first.
#[derive(Clone, Debug, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
struct LinearSettings {
    /// Adds a bias to every control.
    bias: bool,
}

impl Default for LinearSettings {
    fn default() -> Self {
        Self { bias: true }
    }
}

impl PolicyKind for LinearSettings {
    const NAME: &'static str = "linear";
    const ABOUT: &'static str = "Linear feedback of the observation, 0 at first.";

    fn build(&self, of: &Controlled) -> Result<DynPolicy, ConfigError> {
        let new = if self.bias { Linear::with_bias } else { Linear::new };
        Ok(DynPolicy::new(new(of.observations.len(), of.controls.len())))
    }
}

/// Gated recurrent units with a linear output.
#[derive(Clone, Debug, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
struct GruSettings {
    /// Number of units, each with one number of memory.
    units: usize,
}

/// Number of units of a recurrent network, by default.
const UNITS: usize = 32;

impl Default for GruSettings {
    fn default() -> Self {
        Self { units: UNITS }
    }
}

impl PolicyKind for GruSettings {
    const NAME: &'static str = "gru";
    const ABOUT: &'static str = "Recurrent network of gated units, with a memory.";

    fn validate(&self) -> Result<(), ConfigError> {
        count("units", self.units, 1..=10_000)
    }

    fn build(&self, of: &Controlled) -> Result<DynPolicy, ConfigError> {
        Ok(DynPolicy::new(Gru::new(of.observations.len(), self.units, of.controls.len())))
    }
}

/// Elman network: one recurrent layer of tanh with a linear output.
#[derive(Clone, Debug, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
struct ElmanSettings {
    /// Number of units, each with one number of memory.
    units: usize,
}

impl Default for ElmanSettings {
    fn default() -> Self {
        Self { units: UNITS }
    }
}

impl PolicyKind for ElmanSettings {
    const NAME: &'static str = "elman";
    const ABOUT: &'static str = "Recurrent network of one layer of tanh, with a memory.";

    fn validate(&self) -> Result<(), ConfigError> {
        count("units", self.units, 1..=10_000)
    }

    fn build(&self, of: &Controlled) -> Result<DynPolicy, ConfigError> {
        Ok(DynPolicy::new(Elman::new(of.observations.len(), self.units, of.controls.len())))
    }
}

/// Convolutional network of a wave function, with one control.
#[derive(Clone, Debug, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
struct ConvSettings {
    /// Number of filters of each convolution.
    width: usize,
    /// Initializes the weights of the output layer with zeros.
    zero_init_output: bool,
}

impl Default for ConvSettings {
    fn default() -> Self {
        Self { width: 60, zero_init_output: false }
    }
}

impl PolicyKind for ConvSettings {
    const NAME: &'static str = "conv";
    const ABOUT: &'static str = "Convolutional network of pairs of numbers on a grid.";

    fn validate(&self) -> Result<(), ConfigError> {
        count("width", self.width, 1..=10_000)
    }

    /// Two convolutions of kernel size 3 and stride 2 need at least seven points.
    fn build(&self, of: &Controlled) -> Result<DynPolicy, ConfigError> {
        let (observations, controls) = (of.observations.len(), of.controls.len());
        if observations % 2 == 1 || observations < 14 || controls != 1 {
            let what = format!(
                "is conv, which reads pairs of numbers at 7 or more points and gives one control, but the scene has \
                 {observations} observations and {controls} controls; choose another kind"
            );
            return Err(ConfigError::new("kind", what));
        }
        let network = Conv::new(observations / 2, self.width);
        Ok(DynPolicy::new(network.zero_init_output(self.zero_init_output)))
    }
}

/// One control per step, independent of the observation.
#[derive(Clone, Debug, Default, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
struct OpenLoopSettings {}

impl PolicyKind for OpenLoopSettings {
    const NAME: &'static str = "open_loop";
    const ABOUT: &'static str = "Sequence of controls, one per step, 0 at first.";

    fn build(&self, of: &Controlled) -> Result<DynPolicy, ConfigError> {
        Ok(DynPolicy::new(OpenLoop::new(of.observations.len(), of.controls.len(), of.horizon)))
    }
}

impl PolicyKind for Controller {
    const NAME: &'static str = "equations";
    const ABOUT: &'static str = "Controller as expressions, with a memory and trained numbers.";
    const SATURATES: bool = true;

    fn build(&self, of: &Controlled) -> Result<DynPolicy, ConfigError> {
        let Controlled { observations, controls, dt, .. } = of;
        let policy = GraphPolicy::new(self, observations, controls, *dt);
        Ok(DynPolicy::new(policy.map_err(|error| located("", error))?))
    }

    fn numbers(&self) -> Vec<(String, TrainedParam)> {
        let trained = self.trained().unwrap_or_default().into_iter();
        trained.map(|(name, map)| (format!("parameters.{name}"), map)).collect()
    }

    fn remarks(&self) -> Vec<String> {
        let remarks = Controller::remarks(self).into_iter();
        remarks.map(|remark| format!("{remark} in the policy")).collect()
    }

    fn unused(&self) -> Vec<String> {
        keys_of(Controller::unused(self))
    }

    fn expressions(&self, controls: &[String]) -> Vec<String> {
        let controls = controls.iter().map(|name| format!("control.{name}"));
        controls.chain(self.next.keys().map(|name| format!("next.{name}"))).collect()
    }

    fn equations(&self) -> Vec<(String, String)> {
        let Self { control, next, define, .. } = self;
        let named = |prefix: &'static str, list: &std::collections::BTreeMap<String, String>| {
            let list = list.iter();
            list.map(|(name, text)| (format!("{prefix}{name}"), text.clone())).collect::<Vec<_>>()
        };
        [named("", define), named("next ", next), named("control ", control)].concat()
    }
}
