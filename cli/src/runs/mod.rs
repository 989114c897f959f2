//! Runs in folders: training, resuming, comparisons, output files, statistics.
//!
//! Imports all parts of the program except `commands` and `api`. Start with `run`.

pub mod comparison;
mod limits;
pub mod listed;
pub mod metrics;
pub mod outputs;
pub mod progress;
#[cfg(test)]
mod reproducible;
pub mod run;
pub mod saved;
pub mod shard;
pub mod statistics;
pub mod tensorboard;
pub mod trained;
