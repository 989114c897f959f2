//! Articulated bodies with contact from files, with exact reverse derivatives.

#![deny(missing_docs, unsafe_op_in_unsafe_fn)]

mod adjoint;
mod cone;
mod contact;
mod drag;
mod dynamics;
mod geometry;
mod matrix;
pub mod model;
mod rows;
mod solver;
mod spatial;
mod step;
mod system;
mod tree;

pub use system::{Bodies, BodiesError};
