//! Numbers: kernels, dual numbers, singular points, double-double, compiler errors of simulators.

mod double_double;
mod duals;
mod kernels;
mod mistakes;
mod singular;
