//! When a task looks at its states.

use serde::{Deserialize, Serialize};

/// When the states are paid for.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(rename_all = "snake_case")]
pub enum LossMode {
    /// At the last state only.
    #[default]
    Terminal,
    /// At every state after the start: as a mean over time, or as a sum where the task says so.
    Running,
}
