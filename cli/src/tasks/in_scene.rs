//! [`in_scene`]: adds horizon, substeps and actuators of a scene to any task.

use crate::tasks::{Settings, TaskSpec};
use physgrad::rng::Rng;
use physgrad::{
    Actuated, AnyActuator, Cotangent, Cotangents, DynSystem, DynTask, Inputs, Real, Scalar, Start,
    Substeps, System, Task,
};

/// The task with horizon, substeps and actuators of a scene. `system` is the physics of the task,
/// with the time step of a substep.
pub fn in_scene<K: TaskSpec>(settings: &Settings<K>, task: DynTask, system: DynSystem) -> DynTask {
    let count = settings.integrator.count();
    if count == 1 && settings.actuator.is_empty() && settings.horizon == task.horizon() {
        return task;
    }
    let states = system.state_dim();
    let system = settings.actuator.wrap(Substeps { system, count }, K::dt(settings));
    DynTask::new(InScene { task, system, states, horizon: settings.horizon })
}

/// Task with horizon, substeps and actuators of a scene. The first `states` components of the state
/// belong to the inner task, the others to the actuators.
struct InScene {
    task: DynTask,
    system: Actuated<Substeps<DynSystem>, Vec<AnyActuator>>,
    states: usize,
    horizon: usize,
}

impl InScene {
    /// Inputs without the state of the actuators.
    fn inner<'a, R: Scalar>(&self, inputs: Inputs<'a, R>) -> Inputs<'a, R> {
        inputs.with_x(&inputs.x[..self.states])
    }

    /// Cotangents of the inputs without the state of the actuators.
    fn inner_cotangents<'a, C>(&self, cotangents: Cotangents<'a, C>) -> Cotangents<'a, C> {
        Cotangents { x: cotangents.x.map(|bar| &mut bar[..self.states]), ..cotangents }
    }
}

impl Task for InScene {
    type System = Actuated<Substeps<DynSystem>, Vec<AnyActuator>>;

    fn system(&self) -> &Self::System {
        &self.system
    }

    fn horizon(&self) -> usize {
        self.horizon
    }

    fn param_dim(&self) -> usize {
        self.task.param_dim()
    }

    fn start(&self, rng: &mut Rng, start: Start<'_>) {
        self.task.start(rng, Start { x: &mut start.x[..self.states], p: start.p });
    }

    fn observation_dim(&self) -> Option<usize> {
        self.task.observation_dim()
    }

    fn observe<R: Scalar>(&self, inputs: Inputs<'_, R>, y: &mut [R]) {
        self.task.observe(self.inner(inputs), y);
    }

    fn observe_vjp<R: Real, C: Cotangent<R>>(
        &self,
        inputs: Inputs<'_, R>,
        y_bar: &[C],
        cotangents: Cotangents<'_, C>,
    ) {
        self.task.observe_vjp(self.inner(inputs), y_bar, self.inner_cotangents(cotangents));
    }

    fn running_cost<R: Scalar>(&self, inputs: Inputs<'_, R>, next: &[R]) -> R {
        self.task.running_cost(self.inner(inputs), &next[..self.states])
    }

    fn running_cost_gradient<R: Real>(
        &self,
        inputs: Inputs<'_, R>,
        next: &[R],
        cotangents: Cotangents<'_, R>,
        next_bar: &mut [R],
    ) {
        let (next, next_bar) = (&next[..self.states], &mut next_bar[..self.states]);
        self.task.running_cost_gradient(
            self.inner(inputs),
            next,
            self.inner_cotangents(cotangents),
            next_bar,
        );
    }

    fn terminal_cost<R: Scalar>(&self, x: &[R], p: &[R]) -> R {
        self.task.terminal_cost(&x[..self.states], p)
    }

    fn terminal_cost_gradient<R: Real>(
        &self,
        x: &[R],
        p: &[R],
        x_bar: &mut [R],
        p_bar: Option<&mut [R]>,
    ) {
        self.task.terminal_cost_gradient(&x[..self.states], p, &mut x_bar[..self.states], p_bar);
    }
}
