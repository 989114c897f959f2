//! Types of tasks that are compiled with this crate.
//!
//! Rust compiles a generic function in every crate that uses it. Functions with
//! `#[inline(never)]` are an exception: a crate links to their instances in its dependencies.
//! [`DynTask::new`] is one, and all code of a task is reached from it. The program therefore links to
//! the tasks below, and may itself be compiled at a low level of optimization.

use super::*;
use crate::dynamics::actuator::{Actuated, AnyActuator};
use crate::dynamics::dyn_task::DynTask;
use crate::dynamics::effect::{Forced, Named};
use crate::dynamics::integrator::{AnyIntegrator, Discretized, Integrated};
use crate::dynamics::substeps::Substeps;
use crate::dynamics::task::Task;

/// A system with the integrator, the substeps and the actuator of a scene.
type Adjusted<S> = Actuated<Substeps<S>, Vec<AnyActuator>>;
/// A system with a list of effects, and with the integrator, the substeps and the actuator of a
/// scene.
type Listed<S, E> = Adjusted<Discretized<Forced<S, Vec<Named<E>>>>>;
/// Effects of guidance in the paper.
type PaperEffects = (Named<Friction>, Named<Spread>, Named<Evade>, Named<Flock>);
type Swung<O> = Upright<Integrated<O, AnyIntegrator>>;

/// Instances of [`DynTask::new`].
#[doc(hidden)]
#[inline(never)]
pub fn compiled() -> impl IntoIterator<Item = *const ()> {
    fn new<T: Task + 'static>() -> *const () {
        DynTask::new::<T> as *const ()
    }
    [
        new::<CartPole<CartPoleSystem>>(),
        new::<CartPole<Listed<CartPoleModel, CartPoleEffect>>>(),
        new::<Guidance<Forced<GuidanceSystem, PaperEffects>>>(),
        new::<Guidance<Listed<GuidanceSystem, GuidanceEffect>>>(),
        new::<Quantum<Adjusted<Absorbing<Forced<QuantumScheme, Vec<Named<QuantumEffect>>>>>>>(),
        new::<Lqr>(),
        new::<Swung<DoublePendulum>>(),
        new::<Swung<MultiPendulum>>(),
        new::<Swung<PoleChain>>(),
        new::<Slider>(),
        new::<Bounce>(),
        new::<Push>(),
    ]
}
