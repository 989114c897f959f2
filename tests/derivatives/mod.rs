//! Derivatives: comparison with dual numbers, identities of the flows, numbers of calls and
//! operations, norms of adjoints.

mod adjoint_norms;
mod checks;
mod counts;
mod derivative_calls;
mod extremes;
mod flows;
mod gradients;
mod identities;
mod inputs;
mod jumps;
mod memory;
mod no_controls;
mod reverse_mode;
mod stability;
mod trained_params;
