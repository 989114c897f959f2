//! [`DynTask::adapted`]: a task with another horizon, with substeps, and with actuators.

use crate::dynamics::actuator::{Actuated, Actuator, AnyActuator};
use crate::dynamics::dyn_task::{DynSystem, DynTask};
use crate::dynamics::inputs::{Cotangents, Inputs, Start};
use crate::dynamics::substeps::Substeps;
use crate::dynamics::system::System;
use crate::dynamics::task::Task;
use crate::numbers::rng::Rng;
use crate::numbers::scalar::{Cotangent, Real, Scalar};

impl DynTask {
    /// The task with another horizon, with `substeps` steps of `system` in place of one step of its
    /// own system, and with an actuator between policy and system.
    ///
    /// `system` is the physics of the task with the time step of a substep. Components that the
    /// actuator adds to the state follow those of the system; observations and costs do not see them.
    pub fn adapted(
        self,
        system: DynSystem,
        substeps: usize,
        actuator: Vec<AnyActuator>,
        horizon: usize,
    ) -> Self {
        if substeps == 1 && actuator.is_empty() && horizon == self.horizon() {
            return self;
        }
        let states = system.state_dim();
        let system = Actuated { system: Substeps { system, count: substeps }, actuator };
        Self::new(Adapted { task: self, system, states, horizon })
    }
}

/// Result of [`DynTask::adapted`]. The first `states` components of the state belong to the inner
/// task, the others to the actuator.
struct Adapted {
    task: DynTask,
    system: Actuated<Substeps<DynSystem>, Vec<AnyActuator>>,
    states: usize,
    horizon: usize,
}

impl Adapted {
    /// Inputs without the state of the actuators.
    fn inner<'a, R: Scalar>(&self, inputs: Inputs<'a, R>) -> Inputs<'a, R> {
        inputs.with_x(&inputs.x[..self.states])
    }

    /// Cotangents of the inputs without the state of the actuators.
    fn inner_cotangents<'a, C>(&self, cotangents: Cotangents<'a, C>) -> Cotangents<'a, C> {
        Cotangents { x: cotangents.x.map(|bar| &mut bar[..self.states]), ..cotangents }
    }
}

impl Task for Adapted {
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

    /// The range to which the actuators limit the controls, otherwise the bounds of the task.
    fn control_bounds(&self) -> Option<Vec<[f64; 2]>> {
        let limited =
            self.system.actuator.range().map(|range| vec![range; self.system.control_dim()]);
        limited.or_else(|| self.task.control_bounds())
    }

    fn can_end(&self) -> bool {
        self.task.can_end()
    }

    fn margin<R: Scalar>(&self, x: &[R], p: &[R]) -> R {
        self.task.margin(&x[..self.states], p)
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
