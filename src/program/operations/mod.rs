//! Computations that need the concrete types of a task and its policy: sessions, checks,
//! simulations, gradients, costs.
//!
//! Each implements [`Visit`]. Imports `platform` and `settings`. Start with `session`.

pub mod adjoint_norms;
pub mod checks;
pub mod costs;
pub mod gradients;
pub mod memory;
pub mod session;
pub mod simulation;
pub mod trajectory;

use physgrad::{Policy, Task};

/// Computation that needs the concrete types of task and policy.
///
/// Keep implementations short: the compiler monomorphizes them once per task and policy.
pub trait Visit {
    /// Result type.
    type Out;
    /// Runs the computation.
    fn visit<T: Task + Clone + 'static, P: Policy + Clone + 'static>(self, task: T, policy: P) -> Self::Out;
}
