//! Articulated bodies with contact from files, with exact reverse derivatives.

#![deny(missing_docs, unsafe_op_in_unsafe_fn)]

pub mod files;
#[cfg(test)]
mod fuzz;
mod mass;
pub mod mjcf;
pub mod model;
mod names;
mod rotation;
pub mod urdf;
mod xml;
