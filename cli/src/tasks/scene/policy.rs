//! The policy of a scene: its trained numbers, its parameters before the first epoch, and what they
//! mean.

use super::{INITIAL_POLICY, Scene, checksum};
use crate::operations::policy_file::{self, About};
use crate::settings::config_error::ConfigError;
use crate::tasks::policy::{Controlled, ScenePolicy, trained};
use anyhow::{Context, Result};
use physgrad::engine::Variable;
use physgrad::policy::{Policy as _, TrainedParam, WithParams};
use physgrad::train::TrainedNumber;
use physgrad::{Divergence, DynTask, Number, System as _, Task as _};
use toml::Table;

/// Numbers that a task trains with its policy.
pub(super) fn trained_of(physics: &DynTask) -> Vec<TrainedParam> {
    physics.system().varied(physics.param_dim()).iter().filter_map(trained).collect()
}

impl Scene {
    /// The policy, with the trained numbers of the system.
    pub fn policy(&self) -> &ScenePolicy {
        &self.policy
    }

    /// The kind of the policy, with its bounds and base.
    pub fn policy_kind(&self) -> String {
        self.policy_settings.description()
    }

    /// The trained numbers, by their keys: those of the system, then those of the policy.
    pub fn trained_numbers(&self) -> Vec<TrainedNumber> {
        let (names, params) = (self.param_names(), self.policy.trained_params());
        let first = self.policy.param_count() - params.len();
        let of_system = params.iter().enumerate().map(|(i, &map)| TrainedNumber {
            name: names[map.index()].clone(),
            index: first + i,
            map,
        });
        of_system.chain(self.policy_numbers.iter().cloned()).collect()
    }

    /// Values of the [`trained_numbers`](Self::trained_numbers) before the first epoch.
    ///
    /// # Errors
    /// Those of [`initial_theta`](Self::initial_theta).
    pub fn starts_of_numbers(&self) -> Result<Vec<f64>> {
        let theta = self.initial_theta()?;
        Ok(self.trained_numbers().iter().map(|n| n.map.value(theta[n.index])).collect())
    }

    /// Names and values of the trained numbers of the policy with these parameters.
    pub fn policy_numbers(&self, theta: &[f64]) -> Vec<(String, f64)> {
        let numbers = self.policy_numbers.iter();
        numbers.map(|number| (number.name.clone(), number.map.value(theta[number.index]))).collect()
    }

    /// The expression of the scene that gave a number of a forward pass that is not finite, if the
    /// pass tells: its key, and that it is not finite.
    pub fn expression_at(&self, divergence: &Divergence) -> Option<ConfigError> {
        let Divergence::Forward { variable, component, cause, .. } = *divergence else {
            return None;
        };
        let controls = self.control_names();
        let keys = self.policy_settings.expressions(&controls);
        let key = match variable {
            Variable::Control => format!("policy.{}", keys.get(component)?),
            Variable::Memory => format!("policy.{}", keys.get(controls.len() + component)?),
            Variable::State => self.settings.expression_of(component, cause)?,
            Variable::Parameter => return None,
        };
        Some(ConfigError::new(key, "is not finite"))
    }

    /// Starts the training from the policy file with these contents.
    pub fn starting_from(self, policy: Vec<u8>) -> Self {
        Self { initial_policy: Some(policy.into()), ..self }
    }

    /// CRC-32C of the policy file from which the training starts.
    pub fn initial_policy_checksum(&self) -> Option<u32> {
        self.initial_policy.as_deref().map(checksum)
    }

    /// Contents of the policy file from which the training starts.
    pub fn initial_policy(&self) -> Option<&[u8]> {
        self.initial_policy.as_deref()
    }

    /// What the policy observes and controls.
    pub fn controlled(&self) -> Controlled {
        self.settings.controlled(&self.physics)
    }

    /// What the parameters of the policy of `other` mean in this scene.
    pub fn meaning_of(&self, other: &Self) -> Table {
        other.policy_settings.meaning(&self.controlled())
    }

    /// The policy of `other` in this scene.
    ///
    /// # Errors
    /// It does not suit the scene.
    pub fn policy_of(&self, other: &Self) -> Result<ScenePolicy, ConfigError> {
        let built = other.policy_settings.build(&self.controlled());
        let built = built.map_err(|error| error.within("policy"))?;
        Ok(WithParams::new(built.policy, trained_of(&other.physics.task)))
    }

    /// Description of the policy, for other programs.
    pub fn about(&self) -> About {
        let finite = |bound: f64| Some(bound).filter(|bound| bound.is_finite());
        let trained = |(name, number)| match number {
            Number::Trained { min, max, .. } => {
                Some(policy_file::TrainedNumber { name, min: finite(min), max: finite(max) })
            }
            _ => None,
        };
        About {
            physgrad: env!("CARGO_PKG_VERSION"),
            task: self.task.name().into(),
            observations: self.observation_names(),
            controls: self.control_names(),
            trained: self.varied().into_iter().filter_map(trained).collect(),
            kind: self.policy_kind(),
            policy: self.meaning_of(self),
        }
    }

    /// Parameters before the first epoch: those of the initial policy, or random ones.
    ///
    /// # Errors
    /// A run does not fit in the memory of this machine. The initial policy does not fit the scene.
    pub fn initial_theta(&self) -> Result<Vec<f64>> {
        self.check_memory()?;
        let Some(bytes) = self.initial_policy() else {
            return Ok(policy_file::random(&self.policy, self.seed));
        };
        policy_file::read(bytes, &self.about(), &self.policy, self.seed).with_context(|| {
            let file = self.initial_policy_file.as_deref().unwrap_or_default();
            format!("`{INITIAL_POLICY}` {file:?}")
        })
    }
}
