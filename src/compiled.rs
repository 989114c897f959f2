//! Code that is compiled with this crate, for the crates that depend on it.
//!
//! Rust compiles a generic function in every crate that uses it. Functions with
//! `#[inline(never)]` are an exception: a crate links to their instances in its dependencies. The
//! functions below are of this kind, and most code for a task, a policy and a precision is reached
//! from them. The program therefore links to the engine and the built-in tasks, and may itself be
//! compiled at a low level of optimization. Other tasks and policies are compiled where they are
//! used.

use crate::dynamics::actuator::{Actuated, AnyActuator};
use crate::dynamics::dyn_task::{DynSystem, DynTask, frequent};
use crate::dynamics::effect::{Forced, Named};
use crate::dynamics::integrator::{AnyIntegrator, Discretized, Integrated};
use crate::dynamics::substeps::Substeps;
use crate::engine::adjoint::Adjoint;
use crate::engine::batch::Batch;
use crate::engine::initial_states::append_starts;
use crate::engine::rollout::Rollout;
use crate::engine::{open_loop, rows};
use crate::graph::{GraphPolicy, GraphTask, Replaced};
use crate::numbers::scalar::Float;
use crate::policy::{
    Bounded, Conv, DynPolicy, Elman, Gru, Linear, Mlp, OpenLoop, Policy, Sum, WithParams,
};
use crate::tasks::*;
use crate::train::calls;
use crate::train::combination::Combination;
use crate::train::field::Field;
use crate::train::{Session, Trainer};
use crate::{identify, optimize};

/// A system with the integrator, the substeps and the actuator of a scene.
type Adjusted<S> = Actuated<Substeps<S>, Vec<AnyActuator>>;
/// An [`Adjusted`] system with a list of effects.
type Listed<S, E> = Adjusted<Discretized<Forced<S, Vec<Named<E>>>>>;
/// Swing-up with the integrator of a scene.
type Swung<O> = Upright<Integrated<O, AnyIntegrator>>;
/// The effects of guidance in the paper.
type PaperEffects = (Named<Friction>, Named<Spread>, Named<Evade>, Named<Flock>);

type Function = *const ();

/// All instances.
#[doc(hidden)]
#[inline(never)]
pub fn compiled() -> Vec<Function> {
    let tasks: [fn() -> Vec<Function>; 14] = [
        frequent::<CartPole<CartPoleSystem>>,
        frequent::<CartPole<Listed<CartPoleModel, CartPoleEffect>>>,
        frequent::<Guidance<Forced<GuidanceSystem, PaperEffects>>>,
        frequent::<Guidance<Listed<GuidanceSystem, GuidanceEffect>>>,
        frequent::<Quantum<Adjusted<Absorbing<Forced<QuantumScheme, Vec<Named<QuantumEffect>>>>>>>,
        frequent::<Lqr>,
        frequent::<Swung<DoublePendulum>>,
        frequent::<Swung<MultiPendulum>>,
        frequent::<Swung<PoleChain>>,
        frequent::<Slider>,
        frequent::<Bounce>,
        frequent::<Push>,
        frequent::<GraphTask>,
        frequent::<Replaced>,
    ];
    let any_policy =
        [identify::identify::<DynSystem> as Function, optimize::optimize::<DynTask> as Function];
    let others = [
        &any_policy[..],
        &of_policy::<WithParams<DynPolicy>>(),
        &policies(),
        &of_precision::<f32>(),
        &of_precision::<f64>(),
    ];
    tasks.iter().flat_map(|frequent| frequent()).chain(others.concat()).collect()
}

fn of_precision<F: Float>() -> [Function; 26] {
    [
        Rollout::<F>::with_steps as Function,
        Rollout::<F>::bytes_of as Function,
        Rollout::<F>::start as Function,
        Rollout::<F>::run as Function,
        Adjoint::<F>::new as Function,
        Adjoint::<F>::run as Function,
        Adjoint::<F>::param_gradient as Function,
        Batch::<F>::within as Function,
        Batch::<F>::run as Function,
        Field::<Combination>::combine::<F> as Function,
        append_starts::<F> as Function,
        calls::gradients_until::<F> as Function,
        calls::rollout_vjp::<F> as Function,
        open_loop::states::<F, DynTask> as Function,
        open_loop::states_vjp::<F, DynTask> as Function,
        rows::transition::<F, DynTask> as Function,
        rows::transition_vjp::<F, DynTask> as Function,
        rows::step::<F, DynTask> as Function,
        rows::step_vjp::<F, DynTask> as Function,
        rows::step_jvp::<F, DynTask> as Function,
        rows::observe::<F, DynTask> as Function,
        rows::observe_vjp::<F, DynTask> as Function,
        rows::running_cost::<F, DynTask> as Function,
        rows::running_cost_vjp::<F, DynTask> as Function,
        rows::terminal_cost::<F, DynTask> as Function,
        rows::terminal_cost_vjp::<F, DynTask> as Function,
    ]
}

fn policies() -> [Function; 9] {
    [
        DynPolicy::new::<Mlp> as Function,
        DynPolicy::new::<Conv> as Function,
        DynPolicy::new::<Linear> as Function,
        DynPolicy::new::<Gru> as Function,
        DynPolicy::new::<Elman> as Function,
        DynPolicy::new::<OpenLoop> as Function,
        DynPolicy::new::<GraphPolicy> as Function,
        DynPolicy::new::<Bounded<DynPolicy>> as Function,
        DynPolicy::new::<Sum<DynPolicy, DynPolicy>> as Function,
    ]
}

fn of_policy<P: Policy + 'static>() -> Vec<Function> {
    [sessions::<P, f32>(), sessions::<P, f64>()].concat()
}

fn sessions<P: Policy + 'static, F: Float>() -> [Function; 8] {
    [
        Trainer::<DynTask, P, F>::session as Function,
        Session::<DynTask, P, F>::share as Function,
        Session::<DynTask, P, F>::advance as Function,
        Session::<DynTask, P, F>::test_loss as Function,
        Session::<DynTask, P, F>::changed_test_loss as Function,
        Session::<DynTask, P, F>::epoch_warnings_about as Function,
        Session::<DynTask, P, F>::checkpoint as Function,
        Session::<DynTask, P, F>::restore as Function,
    ]
}
