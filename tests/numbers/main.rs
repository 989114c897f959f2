//! Numbers: kernels, dual numbers, singular points, double-double, compiler errors of simulators.

#[path = "../common/operations.rs"]
mod operations;

mod double_double;
mod duals;
mod kernels;
mod mistakes;
mod singular;
