//! Derivatives: against dual numbers and differences, identities of the flows, calls and operation
//! counts, norms.

#[path = "../common/operations.rs"]
mod operations;

mod adjoint_norms;
mod counts;
mod derivative_calls;
mod flows;
mod gradients;
mod identities;
mod inputs;
mod memory;
mod reverse_mode;
