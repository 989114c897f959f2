//! Trajectory optimization: known optima, conditions of optimality, swing-ups, tracking, errors.

mod bounds;
mod compare;
mod errors;
mod linear;
mod problems;
mod search;
mod swing_up;
mod tracking;
