//! Interruptions, power loss, damaged inputs, and plans in several processes.

#[path = "../common/running.rs"]
mod running;

mod interruptions;
mod power_loss;
#[cfg(unix)]
mod shards;
