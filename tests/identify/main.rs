//! Identification of parameters, on simulated and on measured trajectories.

mod errors;
mod pendulum;
mod shooting;
mod simulated;
