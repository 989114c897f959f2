//! Rollouts and their gradients.
//!
//! - [`rollout`]: forward pass of a task under a policy.
//! - [`adjoint`]: reverse pass for one or two flows of one forward pass.
//!   `adjoint/recursion.rs` contains the recursion.
//! - [`initial_states`]: initial states, drawn by a task from seeded streams.
//! - [`observe`]: observations of all samples.
//! - [`schedule`], [`checkpointed`]: recomputation of steps from checkpoints.
//! - [`batch`], [`evaluation`]: mini-batches and data sets, split over threads and ranks.
//! - [`ranks`]: processes that share mini-batches and data sets.
//! - [`gradient`], [`growth`], [`divergence`]: results and errors of the passes.
//! - [`rows`]: steps and costs of many samples as arrays, outside of rollouts.
//! - [`any`]: object-safe tasks and systems. [`parallel`]: threads.
//!
//! Imports `numbers`, `dynamics` and `policy`, but no concrete task. Read `rollout.rs` first.

pub(crate) mod adjoint;
pub mod any;
pub(crate) mod batch;
pub(crate) mod checkpointed;
pub(crate) mod closed;
pub(crate) mod divergence;
pub(crate) mod evaluation;
pub(crate) mod gradient;
pub(crate) mod growth;
pub(crate) mod initial_states;
pub(crate) mod observe;
pub(crate) mod parallel;
pub mod ranks;
pub(crate) mod rollout;
pub mod rows;
pub(crate) mod schedule;

pub use crate::dynamics::cause::Cause;
#[doc(hidden)]
pub use crate::numbers::kernels;
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
