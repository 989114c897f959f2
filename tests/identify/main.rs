//! Identification of parameters, on simulated and on measured trajectories.

mod pendulum;
mod shooting;
mod simulated;
