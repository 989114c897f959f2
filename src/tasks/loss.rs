//! [`LossMode`]: the states that enter a loss.

use serde::{Deserialize, Serialize};

/// States that enter the loss.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(rename_all = "snake_case")]
pub enum LossMode {
    /// The last state only.
    #[default]
    Terminal,
    /// Every state after the initial one, as a mean over time (quantum control: as a sum).
    Running,
}
