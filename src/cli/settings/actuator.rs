//! The `actuator` section.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// What stands between the policy and the physics.
#[derive(Clone, Debug, Default, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct ActuatorSettings {}
