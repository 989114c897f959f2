//! Systems and their parts: steps, vector fields, integrators, effects, actuators.
//!
//! - [`Inputs`](inputs::Inputs) are the arguments of a step, [`Cotangents`](inputs::Cotangents) the
//!   outputs of its VJP.
//! - [`System`](system::System) maps these inputs to the next state. Implement a step, or a vector
//!   field ([`Ode`](ode::Ode)) that an [`Integrator`](integrator::Integrator) discretizes.
//! - [`Substeps`](substeps::Substeps) performs several steps of a system as one.
//! - [`Effect`](effect::Effect)s add forces to a system.
//! - [`Number`](number::Number)s of systems and effects are fixed, drawn or trained.
//! - [`Actuator`](actuator::Actuator)s map the control of the policy to the control of the system.
//! - [`Task`](task::Task) adds a horizon, initial states and costs.
//! - [`Sensor`](sensor::Sensor)s map the observation of a task to what the policy sees.
//! - [`Ending`](ending::Ending) ends the episodes of a task before its horizon.
//! - [`DynTask`](dyn_task::DynTask) is any task behind a pointer.
//! - [`OpCount`](op_count::OpCount) counts the operations of a system.
//!
//! Depends on `numbers` only. Start reading in `system.rs`.

pub(crate) mod actuator;
mod adapted;
pub(crate) mod cause;
pub(crate) mod default_vjp;
pub(crate) mod dyn_task;
pub(crate) mod effect;
pub(crate) mod ending;
pub(crate) mod forward;
pub(crate) mod inputs;
pub(crate) mod integrator;
pub(crate) mod number;
pub(crate) mod ode;
pub(crate) mod op_count;
pub(crate) mod outline;
pub(crate) mod sensor;
pub(crate) mod substeps;
pub(crate) mod system;
pub(crate) mod task;
