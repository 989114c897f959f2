//! Identification of parameters on simulated trajectories, and the pendulum of several arms.

mod errors;
mod failures;
mod pendulum;
mod shooting;
mod simulated;
mod statistics;
