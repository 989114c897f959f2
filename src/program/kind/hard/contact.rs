//! What happens where two bodies touch, in scenes.

use crate::program::problem::{Problem, allowed, not_negative, positive};
use physgrad::tasks::Contact;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// What happens where two bodies touch.
#[derive(Clone, Copy, Debug, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct ContactSettings {
    /// By the instant of the impact, or by a spring.
    model: Model,
    /// Of `time_of_impact`: the share of the speed that is left, 0 to 1.
    #[serde(skip_serializing_if = "Option::is_none")]
    restitution: Option<f64>,
    /// Of `penalty`: N/m.
    #[serde(skip_serializing_if = "Option::is_none")]
    stiffness: Option<f64>,
    /// Of `penalty`: s/m.
    #[serde(skip_serializing_if = "Option::is_none")]
    damping: Option<f64>,
}

/// A model of contacts.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
enum Model {
    /// The instant is found within the step: exact, derivatives included.
    TimeOfImpact,
    /// A spring and a damper: derivatives are not those of an impact.
    Penalty,
}

impl ContactSettings {
    pub(super) const USUAL: Self = Self { model: Model::TimeOfImpact, restitution: None, stiffness: None, damping: None };

    pub(super) fn validate(&self) -> Result<(), Problem> {
        let Self { model, restitution, stiffness, damping } = *self;
        let unread = |key: &str, value: Option<f64>, of: Model| match value {
            Some(value) if model != of => {
                let name = if of == Model::Penalty { "penalty" } else { "time_of_impact" };
                Err(Problem::unread(&format!("system.contact.{key}"), value, &format!("`system.contact.model` is not {name}")))
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

    /// With this restitution, if none is given.
    pub(super) fn contact(&self, restitution: f64) -> Contact {
        match self.model {
            Model::TimeOfImpact => Contact::TimeOfImpact { restitution: self.restitution.unwrap_or(restitution) },
            Model::Penalty => Contact::Penalty { stiffness: self.stiffness.unwrap_or(1e4), damping: self.damping.unwrap_or(0.0) },
        }
    }

    /// By a spring that substeps of 1 ms resolve.
    pub(super) fn soft() -> Self {
        Self { model: Model::Penalty, stiffness: Some(1e4), ..Self::USUAL }
    }
}
