//! Systems as data: graphs, lists of scalar operations with derivatives, without a compiler.
//!
//! A graph comes from equations as text ([`Equations`]) or from a task in Rust ([`GraphTask::of`]).
//! [`GraphTask`] makes it a [`System`](crate::System) and a [`Task`](crate::Task), so everything
//! accepts it: rollouts, checks, trainings, identification.
//!
//! ```
//! use physgrad::graph::{Costs, Equations, GraphTask};
//! use physgrad::integrator::{AnyIntegrator, RungeKutta};
//! use physgrad::{Trainer, check, policy::Mlp};
//!
//! // A mass on a spring, pushed by u.
//! let equations = Equations {
//!     states: vec!["x".into(), "v".into()],
//!     controls: vec!["u".into()],
//!     dt: 0.1,
//!     parameters: [("stiffness".into(), 3.0.into())].into(),
//!     start: [("x".into(), 1.0.into())].into(),
//!     rate: [("x".into(), "v".into()), ("v".into(), "u - stiffness * x".into())].into(),
//!     ..Equations::default()
//! };
//! let costs = Costs { running: "next.x^2 + 0.1 * u^2".into(), ..Costs::default() };
//! let method = AnyIntegrator::RungeKutta(RungeKutta::RK4);
//! let task = GraphTask::new(&equations, &costs, method, 1, 50)?;
//! check::task(&task, &Mlp::new([2, 8, 1])).unwrap();
//! Trainer::new(task, Mlp::new([2, 8, 1])).epochs(1).run()?;
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```
//!
//! - `op`: the operations, shared and simplified without changing a bit.
//! - `record`: a scalar that records.
//! - `adjoint`: the reverse derivative, as a second list of operations on cotangents.
//! - `lower`: instructions on registers, which the kernel `interpreter` executes.
//! - `function`: a function of a graph, for any scalar, and its transposed Jacobian product.
//! - `lexer`, `parse`: one expression as text.
//! - `reader`: expressions as functions, with names for their inputs.
//! - `equations`: the names, numbers and expressions of a system.
//! - `parts`: observation and costs as such functions.
//! - `replaced`: expressions in place of the observation and the costs of another task.
//! - `task`: the system and the task.
//! - `policy`: a controller.

mod adjoint;
mod equations;
mod function;
mod lexer;
mod lower;
mod op;
mod parse;
mod parts;
mod policy;
mod quantities;
mod reader;
mod record;
mod replaced;
mod task;

pub use equations::{Costs, EquationError, Equations, Operations};
pub use parse::is_name;
pub use policy::{Controller, GraphPolicy};
pub use quantities::Quantities;
pub use replaced::{Names, Replaced, Replacement};
pub use task::{GraphSystem, GraphTask, RecordError};
