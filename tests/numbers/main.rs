//! Numbers: kernels, dual numbers, double-double.

#[path = "../common/operations.rs"]
mod operations;

mod double_double;
mod duals;
mod kernels;
