//! Rollouts and their gradients.
//!
//! [`rollout`] runs a task under a policy. [`adjoint`] runs back through it, for the flows R, M, N and S from one forward
//! pass; `adjoint/recursion.rs` holds the recursion. [`schedule`] and [`checkpointed`] trade memory for operations, and
//! [`batch`] splits samples over threads.
//!
//! Imports `numbers`, `dynamics` and `policy`. Knows no concrete task. Start reading in `rollout.rs`.

pub(crate) mod adjoint;
pub mod any;
pub(crate) mod batch;
pub(crate) mod checkpointed;
pub(crate) mod divergence;
pub(crate) mod gradient;
pub(crate) mod growth;
pub(crate) mod parallel;
pub(crate) mod rollout;
pub(crate) mod schedule;
