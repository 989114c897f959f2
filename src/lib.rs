//! Differentiable physics: write a physical system once, train a neural controller through long rollouts of it, and
//! choose which vector field the optimizer follows.
//!
//! A simulator is written against [`Scalar`]; its derivatives are exact, by dual numbers, until one writes faster ones,
//! and [`check`] compares the two. From one forward pass come the true gradient (R), the gradient through the physics
//! only (M), and their combination (C) of "Stabilizing Backpropagation Through Time to Learn Complex Physics" (ICLR
//! 2024); see [`Flow`] for the recursion and [`Field`] for the fields.
//!
//! # A system of your own
//! This file is `examples/pendulum.rs`; it is compiled, run and gradient-checked as a test.
//! ```
#![doc = include_str!("../examples/pendulum.rs")]
//! ```
//!
//! # The pieces
//! [`Trainer`] is thin. The same update by hand is five calls:
//! ```
//! use physgrad::{Adjoint, Clip, Field, Gradient, Optimizer, Rollout, Task, Weights, policy::Mlp, rng, tasks::CartPole};
//!
//! let (task, policy, field) = (CartPole::new(1), Mlp::new([4, 16, 1]), Field::combined());
//! let mut weights = Weights::<f64>::init(&policy, &mut rng::stream(0, rng::Purpose::Policy, 0));
//! let mut start = [0.0; 4];
//! task.start(&mut rng::stream(0, rng::Purpose::Train, 0), &mut start);
//!
//! // Sized once, used for every update.
//! let mut rollout = Rollout::new(&task, &policy, 1);
//! let mut adjoint = Adjoint::new(&policy, &rollout, &field.flows());
//! let mut gradients = vec![Gradient::zeros(weights.theta().len()); 2];
//! let mut descent = Gradient::zeros(weights.theta().len());
//! let mut optimizer = Optimizer::adam(1e-3, weights.theta().len());
//!
//! rollout.start(&start);
//! rollout.run(&task, &policy, &weights)?;
//! adjoint.run(&task, &policy, &weights, &rollout, 1.0)?;
//! for (k, gradient) in gradients.iter_mut().enumerate() {
//!     adjoint.param_gradient(k, &policy, &weights, &rollout, 0..1, gradient);
//! }
//! field.compose(&gradients, &mut descent);
//! Clip::Norm(1.0).apply(&mut descent);
//! weights.update(&policy, |theta| optimizer.step(theta, descent.values()));
//! # Ok::<(), physgrad::Divergence>(())
//! ```
//!
//! # Effects
//! Friction, wind, obstacles, potentials: optional physics is an [`Effect`], and what is in play is part of a system's
//! type. What is absent is absent code, which [`Cost`] counts exactly. [`Actuator`]s stand between policy and system, and
//! [`Substeps`] make several small steps of one.
//! ```
//! use physgrad::tasks::{CartPole, CartPoleSystem, PoleDamping, SteadyWind};
//! use physgrad::{Actuated, Cost, Lag, With, check};
//!
//! let system = CartPoleSystem { poles: 2, ..CartPoleSystem::default() };
//! let windy = With { system, effects: (PoleDamping::default(), SteadyWind { speed: 4.0, ..SteadyWind::default() }) };
//! assert_eq!(Cost::of(&With { system, effects: () }), Cost::of(&system));
//! let task = CartPole::around(Actuated { system: windy, actuator: Lag::new(0.05, system.dt) });
//! check::system(&task.system);
//! ```
//! One of your own is a few lines: see `docs/scenes.md` and `examples/own_effect.rs`.
//!
//! # Features
//! `default-features = false` leaves the library alone. `parallel` splits mini-batches over cores, `report` draws
//! curves and animations, `schema` gives the settings of systems and effects a JSON schema, `double-double` adds numbers of
//! 31 digits and derivatives in them, as references, `program` (the default) is
//! everything the `physgrad` binary needs.

#![deny(missing_docs, unsafe_op_in_unsafe_fn)]

mod actuator;
mod aligned;
pub mod any;
mod apart;
mod backward;
mod batch;
pub mod check;
mod checkpointed;
mod cost;
mod divergence;
mod effect;
mod field;
mod forward_mode;
mod gradient;
mod growth;
mod integrator;
#[doc(hidden)]
pub mod kernels;
mod ode;
mod optim;
mod parallel;
pub mod policy;
#[cfg(feature = "report")]
pub mod report;
pub mod rng;
mod rollout;
mod scalar;
mod schedule;
// Not in the library's own unit tests, which would compile all of it once more: `tests/stress.rs` holds it.
#[cfg(all(feature = "stress", not(test)))]
pub mod stress;
mod substeps;
mod system;
mod task;
pub mod tasks;
pub mod toy;
mod train;
mod wide;
mod zip;

pub use actuator::{Actuated, Actuator, AnyActuator, Bars, Delay, Lag, Limit, LimitKind};
pub use backward::{Adjoint, Flow};
pub use batch::{Batch, Evaluation};
pub use checkpointed::Checkpointed;
pub use cost::Cost;
pub use divergence::{Cause, Divergence, Variable};
pub use effect::{Around, Effect, Host, Named, With};
pub use field::{Compose, Field, SignAgreement, UnknownField};
pub use gradient::Gradient;
pub use growth::Growth;
pub use integrator::{
    Adaptive, AnyIntegrator, Discretized, ImplicitMidpoint, Integrated, Integrator, RungeKutta, SemiImplicit, Stretch, Verlet,
};
pub use ode::{Flowing, Ode, RateOn, ReverseOn};
pub use optim::{Clip, Optimizer, Rule};
pub use policy::{Policy, Weights};
pub use rollout::Rollout;
#[cfg(feature = "double-double")]
pub use scalar::DoubleDouble;
pub use scalar::{Columns, Cotangent, Counted, Counts, Dual, Float, Lanes, Real, Scalar};
pub use schedule::{MemoryError, Schedule};
pub use substeps::Substeps;
pub use system::System;
pub use task::Task;
pub use train::{CheckpointError, Record, Report, Session, Skip, TrainError, Trainer, Training, differences};
pub use wide::Wide;

/// What a file with a system of one's own needs.
pub mod prelude {
    pub use crate::check;
    pub use crate::policy::Mlp;
    pub use crate::rng::Rng;
    pub use crate::{Field, Scalar, System, Task, Trainer};
    #[doc(no_inline)]
    pub use rand::RngExt as _;
}

#[cfg(doctest)]
#[doc = include_str!("../README.md")]
struct Readme;

#[cfg(doctest)]
#[doc = include_str!("../docs/scenes.md")]
struct Scenes;
