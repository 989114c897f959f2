//! Differentiable physics: adjoints of long rollouts, and training of neural controllers with a
//! choice of vector fields.
//!
//! Systems are generic over [`Scalar`]. The default derivatives are exact: by dual numbers for
//! small systems, in reverse mode for large ones. Faster analytic derivatives can replace them, and
//! [`check`] compares the two.
//!
//! One forward pass yields several vector fields for the optimizer. The main three are the gradient
//! of the loss (R), the gradient through the physics only (M), and their combination (C). Source:
//! "Stabilizing Backpropagation Through Time to Learn Complex Physics" (ICLR 2024). [`Flow`]
//! documents the recursion and [`Field`] the fields.
//!
//! # A custom system
//! This is the file `examples/pendulum.rs`.
//! ```
#![doc = include_str!("../examples/pendulum.rs")]
//! ```
//!
//! # One update, step by step
//! [`Trainer`] combines public parts. One update consists of a forward pass, a reverse pass for all
//! flows, parameter gradients, their combination, clipping and an optimizer step:
//! ```
//! use physgrad::{Adjoint, Clip, Field, Gradient, Optimizer, Rollout, Weights, initial_states, policy::Mlp, rng, tasks::CartPole};
//!
//! let (task, policy, field) = (CartPole::new(1), Mlp::new([4, 16, 1]), Field::combined());
//! let mut weights = Weights::<f64>::init(&policy, &mut rng::stream(0, rng::Purpose::Policy, 0));
//! let starts = initial_states(&task, 0, rng::Purpose::Train, 1);
//!
//! // Allocates the buffers once. Every update reuses them.
//! let mut rollout = Rollout::new(&task, &policy, 1);
//! let mut adjoint = Adjoint::new(&task, &policy, &rollout, &field.flows());
//! let mut gradients = vec![Gradient::zeros(weights.theta().len()); 2];
//! let mut descent = Gradient::zeros(weights.theta().len());
//! let mut optimizer = Optimizer::adam(1e-3, weights.theta().len());
//!
//! rollout.start(&starts);
//! rollout.run(&task, &policy, &weights)?;
//! adjoint.run(&task, &policy, &weights, &rollout, 1.0)?;
//! for (k, gradient) in gradients.iter_mut().enumerate() {
//!     adjoint.param_gradient(k, &policy, &weights, &rollout, 0..1, gradient);
//! }
//! field.combine(&gradients, &mut descent);
//! Clip::Norm(1.0).apply(&mut descent);
//! weights.update(&policy, |theta| optimizer.step(theta, &descent));
//! # Ok::<(), physgrad::Divergence>(())
//! ```
//!
//! # Effects
//! An [`Effect`] is an optional part of the physics: friction, wind, obstacles, potentials. The
//! effects of a system are part of its type, so absent effects cost nothing.
//! [`OpCount`](count::OpCount) counts the operations of a system exactly. An
//! [`Actuator`](actuator::Actuator) transforms controls between policy and system. [`Substeps`]
//! performs several small steps of a system as one. [`Integrated`] combines an [`Ode`] and an
//! [`Integrator`](integrator::Integrator) into a system.
//! ```
//! use physgrad::tasks::{CartPole, CartPoleSystem, PoleDamping, SteadyWind};
//! use physgrad::{Actuated, Forced, check, actuator::Lag, count::OpCount};
//!
//! let system = CartPoleSystem { poles: 2, ..CartPoleSystem::default() };
//! let windy = Forced { system, effects: (PoleDamping::default(), SteadyWind { speed: 4.0.into(), ..SteadyWind::default() }) };
//! assert_eq!(OpCount::of(&Forced { system, effects: () }), OpCount::of(&system));
//! let task = CartPole::with_system(Actuated { system: windy, actuator: Lag::new(0.05, system.dt) });
//! check::system(&task.system).unwrap();
//! ```
//! `docs/systems.md` and `examples/own_effect.rs` show how to write a custom effect.
//!
//! # Physical numbers, measurements and plans
//! - [`Number`]: a physical number that is fixed, drawn for each sample, or trained.
//! - [`identify`]: physical numbers and initial states from measured trajectories.
//! - [`optimize`]: controls that minimize the loss from one initial state.
//!
//! # Features
//! - `parallel` splits mini-batches, data sets, arrays of [`rows`](engine::rows) and the windows of
//!   an identification over threads.
//! - `schema` provides a JSON schema for the settings of systems and effects.
//! - `compiled` compiles the engine and the built-in tasks in this crate, for programs that use
//!   them through [`DynTask`]. Without it, they are compiled where they are used.
//! - `portable` also simulates on x86-64 processors without AVX2 and fused multiply-add. Without it,
//!   rollouts panic there; with it, the build takes a quarter longer.
//! - `double-double` adds `DoubleDouble`, a 31-digit scalar type for reference results and their
//!   derivatives.
//!
//! The crate `physgrad-plot` draws charts and animations. The crate `physgrad-cli` is the program
//! `physgrad`, and runs it with tasks of your own.

#![deny(missing_docs, unsafe_op_in_unsafe_fn)]

pub mod check;
// Unit tests need no instances for other crates.
#[cfg(all(not(test), feature = "compiled"))]
mod compiled;
mod dynamics;
pub mod engine;
pub mod graph;
pub mod identify;
mod numbers;
pub mod optimize;
pub mod policy;
pub mod tasks;
pub mod train;

#[cfg(all(not(test), feature = "compiled"))]
#[doc(hidden)]
pub use compiled::compiled;
pub use dynamics::actuator::Actuated;
pub use dynamics::dyn_task::{DynSystem, DynTask};
pub use dynamics::effect::{Effect, Forced};
pub use dynamics::inputs::{Cotangents, Inputs, OdeInputs, Start, Tangents};
pub use dynamics::integrator::Integrated;
pub use dynamics::number::{Number, Numbers};
pub use dynamics::ode::Ode;
pub use dynamics::substeps::Substeps;
pub use dynamics::system::System;
pub use dynamics::task::Task;
pub use engine::adjoint::Adjoint;
pub use engine::divergence::Divergence;
pub use engine::flow::Flow;
pub use engine::gradient::Gradient;
pub use engine::initial_states::initial_states;
pub use engine::rollout::Rollout;
pub use numbers::rng;
pub use numbers::scalar::{Cotangent, Float, Real, Scalar};
pub use numbers::text;
pub use policy::{Policy, Weights};
pub use train::calls::{gradients, losses, rollout};
pub use train::field::Field;
pub use train::optim::{Clip, Optimizer};
pub use train::{TrainError, Trainer, Training};

/// Maps from the control of a policy to that of a system: limits, lags, delays. [`Actuated`]
/// combines a system and an actuator.
pub mod actuator {
    pub use crate::dynamics::actuator::{
        Actuator, AnyActuator, Delay, Lag, Limit, LimitKind, OutputCotangents,
    };
}

/// Sensors between the observation of a task and the policy: lag, bias, noise, sampling, delay.
pub mod sensor {
    pub use crate::dynamics::sensor::{Sensed, Sensor, SensorError};
}

/// Episodes: tasks that end before their horizon, and trainings by windows of an episode.
pub mod episode {
    pub use crate::dynamics::ending::Ending;
    pub use crate::train::critic::ValueSettings;
    pub use crate::train::episodes::Windows;
}

/// Exact counts of the operations of steps and derivatives.
pub mod count {
    pub use crate::dynamics::op_count::{OpCount, TaskOpCount};
    pub use crate::numbers::scalar::{Counted, Ops};
}

/// Systems to whose forces an [`Effect`] can add, and forms of effects.
pub mod effect {
    pub use crate::dynamics::effect::{DynEffect, ForcedSystem, HasModel, Named};
    pub use crate::dynamics::ode::ForcedOde;
}

/// Methods that advance an [`Ode`] by a time step. [`Integrated`] combines both into a system.
pub mod integrator {
    pub use crate::dynamics::integrator::{
        Adaptive, AnyIntegrator, Discretized, ImplicitMidpoint, Integrator, RungeKutta, Sdirk2,
        SemiImplicit, Verlet,
    };
    pub use crate::dynamics::ode::{DynOde, DynOdeVjp};
}

/// Parts of a [`Number`] that varies between samples.
pub mod number {
    pub use crate::dynamics::number::{Choice, Noise, NoiseNumbers, Varied};
}

/// Types that implement [`Scalar`] and [`Cotangent`].
pub mod scalar {
    pub use crate::numbers::extended::ExtendedF64;
    #[cfg(feature = "double-double")]
    pub use crate::numbers::scalar::DoubleDouble;
    pub use crate::numbers::scalar::{CotangentPack, Dual, Lanes, Single};
}

/// Imports for a file that defines a system and trains a controller for it.
pub mod prelude {
    pub use crate::check;
    pub use crate::numbers::rng::Rng;
    pub use crate::policy::Mlp;
    pub use crate::{Field, Inputs, Number, Numbers, Scalar, Start, System, Task, Trainer};
    #[doc(no_inline)]
    pub use rand::RngExt as _;
}

#[cfg(doctest)]
#[doc = include_str!("../README.md")]
struct Readme;

#[cfg(doctest)]
#[doc = include_str!("../docs/optimize.md")]
struct Optimization;

#[cfg(doctest)]
#[doc = include_str!("../docs/systems.md")]
struct Systems;
