//! What the program knows of a task beyond its physics: names, defaults, limits, a picture.

mod cart_pole;
mod guidance;
mod quantum;

use anyhow::{Result, bail};
use physgrad::Task;
use physgrad::policy::{Mlp, Policy};
use physgrad::report::Animation;
use serde::{Deserialize, Serialize, de::DeserializeOwned};
use std::fmt::Debug;

/// A task that the program can run by name.
pub trait Scene: Task + Clone + Send {
    /// The `system` section: settings of the physics.
    type Setup: Clone + Debug + Serialize + DeserializeOwned + Send + Sync;
    /// The `loss` section: settings of the cost.
    type Loss: Clone + Debug + Default + Serialize + DeserializeOwned + Send + Sync;
    /// Settings of the policy; its defaults are the task's.
    type Network: Network;

    const NAME: &'static str;
    const ABOUT: &'static str;
    /// Default number of epochs.
    const EPOCHS: usize;
    /// Default number of steps.
    const HORIZON: usize;

    fn setup() -> Self::Setup;
    /// An error that names the key, its value and what is allowed.
    fn validate(setup: &Self::Setup, loss: &Self::Loss) -> Result<()>;
    fn build(setup: &Self::Setup, loss: &Self::Loss, horizon: usize) -> Self;
    /// Variants worth checking, with a name for each.
    fn variants() -> Vec<(String, Self)>;

    /// Seconds per step.
    fn dt(&self) -> f64;
    fn state_names(&self) -> Vec<String>;
    fn control_names(&self) -> Vec<String>;
    /// A rollout that moves: states and controls step by step.
    fn animation(&self, states: &[Vec<f64>], controls: &[Vec<f64>]) -> Animation;
}

/// The `policy` section of a task's settings.
pub trait Network: Clone + Debug + Default + Serialize + DeserializeOwned + Send + Sync {
    type Policy: Policy + Clone;
    /// An error that names the key, its value and what is allowed.
    fn validate(&self) -> Result<()>;
    fn build(&self, state_dim: usize, control_dim: usize) -> Self::Policy;
}

/// The policy that a task's settings describe.
pub type PolicyOf<S> = <<S as Scene>::Network as Network>::Policy;

/// An MLP that sees the whole state.
#[derive(Clone, Debug, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct MlpSettings {
    /// Hidden layers; none is a linear policy.
    widths: Vec<usize>,
    bias: bool,
    /// Start with a zeroed last kernel.
    zero_last: bool,
}

impl Default for MlpSettings {
    fn default() -> Self {
        Self { widths: vec![100, 100], bias: true, zero_last: true }
    }
}

impl Network for MlpSettings {
    type Policy = Mlp;

    fn validate(&self) -> Result<()> {
        match self.widths.iter().find(|w| !(1..=10_000).contains(*w)) {
            Some(width) => bail!("`policy.widths` has {width}; allowed: 1 to 10000 each, or [] for a linear policy"),
            None => Ok(()),
        }
    }

    fn build(&self, state_dim: usize, control_dim: usize) -> Mlp {
        let widths = [&[state_dim], &self.widths[..], &[control_dim]].concat();
        Mlp::new(widths).bias(self.bias).zero_last(self.zero_last)
    }
}

/// Runs the body with the type of the task of that name.
macro_rules! with_scene {
    ($name:expr, $scene:ident => $body:expr) => {
        match $name {
            "cart_pole" => {
                type $scene = physgrad::tasks::CartPole;
                $body
            }
            "guidance" => {
                type $scene = physgrad::tasks::Guidance;
                $body
            }
            "quantum" => {
                type $scene = physgrad::tasks::Quantum;
                $body
            }
            other => anyhow::bail!("unknown task `{other}`; allowed: {}", $crate::cli::scene::NAMES.join(", ")),
        }
    };
}
pub(crate) use with_scene;

/// Every task's name.
pub const NAMES: [&str; 3] = ["cart_pole", "guidance", "quantum"];
