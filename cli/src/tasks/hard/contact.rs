//! Contact settings, shared by `bounce` and `push`.

use crate::settings::config_error::{ConfigError, allowed, not_negative, positive};
use physgrad::tasks::Contact;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// Contact between two bodies.
#[derive(Clone, Copy, Debug, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct ContactSettings {
    /// Contact model: time of impact, or penalty spring.
    model: Model,
    /// Ratio of the speeds after and before an impact, 0 to 1; only for `time_of_impact`.
    #[serde(skip_serializing_if = "Option::is_none")]
    restitution: Option<f64>,
    /// Spring stiffness, N/m, 10000 by default; only for `penalty`.
    #[serde(skip_serializing_if = "Option::is_none")]
    stiffness: Option<f64>,
    /// Damping of the spring force, s/m, 0 by default; only for `penalty`.
    #[serde(skip_serializing_if = "Option::is_none")]
    damping: Option<f64>,
}

/// Contact model.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
enum Model {
    /// Finds the instant of impact within the step: exact, derivatives included.
    TimeOfImpact,
    /// Spring and damper: derivatives differ from those of an impact.
    Penalty,
}

impl ContactSettings {
    /// Contact by time of impact, with the default restitution of the task.
    pub(super) const DEFAULT: Self =
        Self { model: Model::TimeOfImpact, restitution: None, stiffness: None, damping: None };

    pub(super) fn validate(&self) -> Result<(), ConfigError> {
        let Self { model, restitution, stiffness, damping } = *self;
        let unread = |key: &str, value: Option<f64>, of: Model| match value {
            Some(value) if model != of => {
                let name = if of == Model::Penalty { "penalty" } else { "time_of_impact" };
                Err(ConfigError::unread(
                    &format!("system.contact.{key}"),
                    value,
                    &format!("`system.contact.model` is not {name}"),
                ))
            }
            _ => Ok(()),
        };
        unread("restitution", restitution, Model::TimeOfImpact)?;
        unread("stiffness", stiffness, Model::Penalty)?;
        unread("damping", damping, Model::Penalty)?;
        let share = restitution.unwrap_or(0.0);
        allowed("system.contact.restitution", share, (0.0..=1.0).contains(&share), "0 to 1")?;
        positive("system.contact.stiffness", stiffness.unwrap_or(1.0))?;
        not_negative("system.contact.damping", damping.unwrap_or(0.0))
    }

    /// Contact model of these settings. `restitution` is the default of the task.
    pub(super) fn contact(&self, restitution: f64) -> Contact {
        match self.model {
            Model::TimeOfImpact => {
                Contact::TimeOfImpact { restitution: self.restitution.unwrap_or(restitution) }
            }
            Model::Penalty => Contact::Penalty {
                stiffness: self.stiffness.unwrap_or(1e4),
                damping: self.damping.unwrap_or(0.0),
            },
        }
    }

    /// Penalty contact with a stiffness of 10 kN/m, which substeps of 1 ms resolve.
    pub(super) fn soft() -> Self {
        Self { model: Model::Penalty, stiffness: Some(1e4), ..Self::DEFAULT }
    }
}
