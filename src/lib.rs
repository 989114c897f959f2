//! wip
mod backward;
mod batch;
pub mod check;
mod field;
mod forward_mode;
#[doc(hidden)]
pub mod kernels;
mod optim;
pub mod policy;
pub mod rng;
#[cfg(feature = "report")]
pub mod report;
mod rollout;
mod scalar;
mod system;
mod task;
pub mod tasks;
mod train;
pub use backward::{Adjoint, Flow};
pub use batch::{Batch, Evaluation};
pub use field::{Compose, Field, SignAgreement, UnknownField};
pub use optim::{Clip, Optimizer, Rule};
pub use policy::{Policy, Weights};
pub use rollout::{Divergence, Rollout};
pub use scalar::*;
pub use system::System;
pub use task::Task;
pub use train::*;
