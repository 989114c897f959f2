//! Interruptions, power loss and damaged inputs.

#[path = "../common/running.rs"]
mod running;

#[cfg(feature = "fuzz")]
mod fuzz;
mod interruptions;
mod power_loss;
#[cfg(unix)]
mod shards;
