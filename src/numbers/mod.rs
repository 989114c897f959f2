//! Numbers that simulators compute with, and the loops over them.
//!
//! [`scalar`] holds the traits: a simulator is written once against [`Scalar`](scalar::Scalar) and runs on plain floats, SIMD
//! lanes, dual numbers, operation counters and double-doubles. [`kernels`] holds the matrix product and elementary functions
//! for the processor at hand, and the only unsafe code of the library. [`rng`] holds seeded random streams.
//!
//! Imports nothing of the crate. Every other module may import it. Start reading in `scalar.rs`.

pub(crate) mod aligned;
pub(crate) mod forward_mode;
#[doc(hidden)]
pub mod kernels;
pub mod rng;
pub(crate) mod scalar;
pub(crate) mod wide;
pub(crate) mod zip;
