//! Scalar types, derivatives, vectorized kernels and random streams.
//!
//! - [`scalar`]: traits of scalars. A simulator is generic over [`Scalar`](scalar::Scalar).
//!   Scalars are `f64`, SIMD lanes, dual and reverse-mode numbers, operation counters and
//!   double-doubles.
//! - [`forward_mode`], [`reverse_mode`]: default derivatives, by dual numbers and by a [`tape`].
//! - [`instances`]: generic functions behind trait objects, one instance per scalar type.
//! - [`extended`]: numbers beyond the range of `f64`.
//! - [`kernels`]: matrix products and elementwise operations, dispatched by instruction set at run
//!   time; tanh, sine and cosine. Contains the only unsafe code of the library.
//! - [`rng`]: seeded random streams.
//! - [`text`]: numbers in messages and tables.
//! - `threads`: the threads that share the work of parallel calls.
//! - [`aligned`], [`pool`]: buffers. [`zip`]: an iterator that is always inlined.
//!
//! Imports no other module of the crate; every other module may import it. Start reading in
//! `scalar.rs`.

pub(crate) mod aligned;
pub(crate) mod extended;
pub(crate) mod forward_mode;
pub(crate) mod instances;
#[doc(hidden)]
pub mod kernels;
pub(crate) mod pool;
pub(crate) mod reverse_mode;
pub mod rng;
pub(crate) mod scalar;
pub(crate) mod tape;
pub mod text;
#[cfg(feature = "parallel")]
pub mod threads;
pub(crate) mod zip;
