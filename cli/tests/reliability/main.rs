//! Interruptions, power loss, damaged inputs, and comparisons and studies in several processes.

#[path = "../common/running.rs"]
mod running;

mod interruptions;
mod power_loss;
#[cfg(unix)]
mod shards;
