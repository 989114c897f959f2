//! Systems as data: [`Graph`], a list of scalar operations with derivatives, without a compiler.
//!
//! A graph comes from equations as text ([`Equations`]) or from a task in Rust ([`GraphTask::of`]).
//! [`GraphTask`] makes it a [`System`](crate::System) and a [`Task`](crate::Task), so everything
//! accepts it: rollouts, checks, trainings, identification.
//!
//! - `op`: the operations, shared and simplified without changing a bit.
//! - `record`: a scalar that records.
//! - `adjoint`: the reverse derivative, as a second list of operations on cotangents.
//! - `lower`: instructions on registers, which [`Program`](crate::numbers::kernels::interpreter)
//!   executes.
//! - `function`: a function of a graph, for any scalar, and its transposed Jacobian product.
//! - `parse`: one expression as text.
//! - `reader`: expressions as functions, with names for their inputs.
//! - `equations`: the names, numbers and expressions of a system.
//! - `replaced`: expressions in place of the observation and the costs of another task.
//! - `task`: the system and the task.

mod adjoint;
mod equations;
mod function;
mod lower;
mod op;
mod parse;
mod reader;
mod record;
mod replaced;
mod task;

pub use equations::{Costs, EquationError, Equations};
pub use op::{Graph, Id, Op};
pub use replaced::{Names, Replaced, Replacement};
pub use task::{GraphSystem, GraphTask, RecordError};
