//! Rollouts, reverse passes and trainings: memory, determinism, non-finite numbers, checkpoints.

mod allocation;
mod average;
mod bytes;
mod causes;
mod checkpoints;
mod determinism;
mod divergence;
mod empty;
mod episodes;
mod memory;
mod noise;
mod ranks;
mod rows;
mod schedule;
mod sensor;
mod smoothing;
mod training;
mod trajectories;
