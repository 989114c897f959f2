//! Articulated bodies with contact from files, with exact reverse derivatives.

#![deny(missing_docs, unsafe_op_in_unsafe_fn)]

pub mod model;
