//! Identification of parameters on simulated trajectories, and the pendulum of several arms.

mod errors;
mod pendulum;
mod shooting;
mod simulated;
