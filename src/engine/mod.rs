//! Rollouts and their gradients: the parts behind [`Rollout`](crate::Rollout) and
//! [`Adjoint`](crate::Adjoint).
//!
//! - `rollout.rs`: forward pass of a task under a policy. Read this file first.
//! - `adjoint.rs`: reverse pass for one or two flows (`flow.rs`) of one forward pass.
//!   `adjoint/reverse_step.rs` is the physics of one step,
//!   `adjoint/recursion.rs` the loop. `pass.rs` has the arguments of both passes.
//! - `initial_states.rs`: initial states, drawn by a task from seeded streams.
//! - `observe.rs`: observations of all samples.
//! - [`Schedule`], [`Checkpointed`]: recomputation of steps from checkpoints.
//! - [`Batch`], [`Evaluation`]: mini-batches and data sets, split over threads and [`ranks`].
//! - `gradient.rs`, [`Growth`], `divergence.rs`: results and errors of the passes.
//! - [`rows`]: steps and costs of many samples as arrays, outside of rollouts. [`open_loop`]:
//!   rollouts with given controls.
//! - [`any`]: object-safe tasks and systems. They contain the vectorized steps of both passes, whose
//!   workspaces name them in turn, so `any`, `pass`, `rollout` and `adjoint` form a circle, the only
//!   one.
//!
//! Imports `numbers`, `dynamics` and `policy`, but no concrete task.

pub(crate) mod adjoint;
pub mod any;
pub(crate) mod batch;
pub(crate) mod checkpointed;
pub(crate) mod divergence;
pub(crate) mod evaluation;
pub(crate) mod flow;
pub(crate) mod gradient;
pub(crate) mod growth;
pub(crate) mod initial_states;
pub(crate) mod observe;
pub mod open_loop;
pub(crate) mod parallel;
pub(crate) mod pass;
pub mod ranks;
pub(crate) mod rollout;
pub mod rows;
pub(crate) mod schedule;
pub(crate) mod step_forward;
pub(crate) mod visited;

pub use crate::dynamics::cause::Cause;
#[doc(hidden)]
pub use crate::dynamics::outline::outline;
#[doc(hidden)]
pub use crate::numbers::kernels;
#[doc(hidden)]
pub use crate::numbers::pool::lend;
#[cfg(feature = "parallel")]
pub use crate::numbers::threads;
pub use batch::Batch;
pub use checkpointed::Checkpointed;
pub use divergence::Variable;
pub use evaluation::Evaluation;
pub use growth::Growth;
pub use initial_states::append_starts;
pub use ranks::Ranks;
pub use schedule::{MemoryError, Schedule};
