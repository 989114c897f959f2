//! Articulated bodies with contact from files, with exact reverse derivatives.

#![deny(missing_docs, unsafe_op_in_unsafe_fn)]

mod adjoint;
pub mod components;
mod cone;
mod contact;
mod distribution;
mod drag;
mod dynamics;
pub mod files;
#[cfg(test)]
mod fuzz;
mod geometry;
mod mass;
mod matrix;
pub mod mjcf;
pub mod model;
pub mod models;
mod names;
mod rotation;
mod rows;
mod solver;
mod spatial;
mod step;
mod system;
mod task;
mod tree;
pub mod urdf;
mod xml;

pub use step::ContactForce;
pub use system::{Bodies, BodiesError};
pub use task::BodiesTask;
