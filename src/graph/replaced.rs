//! [`Replaced`]: a task whose observation or costs are expressions.

use super::equations::EquationError;
use super::function::Function;
use super::reader::{Reader, Vocabulary};
use crate::dynamics::dyn_task::{DynSystem, DynTask};
use crate::dynamics::inputs::{Cotangents, Inputs, Start};
use crate::dynamics::task::Task;
use crate::numbers::rng::Rng;
use crate::numbers::scalar::{Cotangent, Real, Scalar};
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;
use std::sync::Arc;

/// Expressions in place of the observation and the costs of a task. What is empty stays as it is.
///
/// Expressions are those of [`Equations`](super::Equations). Parameters of a sample have the names
/// of their settings, as in `system.cart_mass`.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(deny_unknown_fields)]
pub struct Replacement {
    /// What the policy observes.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub observe: Vec<String>,
    /// Cost of each step. `next.NAME` is a state after the step.
    #[serde(default, skip_serializing_if = "String::is_empty")]
    pub running: String,
    /// Cost of the final state.
    #[serde(default, skip_serializing_if = "String::is_empty")]
    pub terminal: String,
    /// Expressions by name, for use in the others.
    #[serde(default, skip_serializing_if = "BTreeMap::is_empty")]
    pub define: BTreeMap<String, String>,
}

/// Names of the components of a task, and its time step.
#[derive(Clone, Debug, Default)]
pub struct Names {
    /// Names of the state components.
    pub states: Vec<String>,
    /// Names of the control components.
    pub controls: Vec<String>,
    /// Names of the parameters of a sample.
    pub params: Vec<String>,
    /// Time step, s.
    pub dt: f64,
}

/// A task with a [`Replacement`]. A cost replaces both costs of the task: that which is not given
/// is 0.
#[derive(Clone)]
pub struct Replaced {
    task: DynTask,
    observe: Option<Arc<Function>>,
    running: Option<Arc<Function>>,
    terminal: Option<Arc<Function>>,
    dt: f64,
}

impl Replaced {
    /// The task with other costs and another observation.
    ///
    /// # Errors
    /// An expression does not fit.
    pub fn new(
        task: DynTask,
        names: Names,
        replacement: &Replacement,
    ) -> Result<Self, EquationError> {
        let Names { states, controls, params, dt } = names;
        let define = &replacement.define;
        if *replacement == (Replacement { define: define.clone(), ..Replacement::default() }) {
            let what = "has no effect; write `observe`, `running` or `terminal` too";
            return Err(EquationError::new("define", what));
        }
        let vocabulary =
            Vocabulary { states, controls, params, tables: vec![], constants: vec![], dt, define };
        let mut reader = Reader::new(vocabulary)?;
        Ok(Self {
            observe: reader.observation("observe", &replacement.observe)?.map(Arc::new),
            running: reader.running_cost("running", &replacement.running)?.map(Arc::new),
            terminal: reader.terminal_cost("terminal", &replacement.terminal)?.map(Arc::new),
            task,
            dt,
        })
    }

    fn keeps_costs(&self) -> bool {
        self.running.is_none() && self.terminal.is_none()
    }

    #[inline(always)]
    fn time<T: Scalar>(&self, t: usize) -> [T; 1] {
        [T::from(t as f64 * self.dt)]
    }
}

impl Task for Replaced {
    type System = DynSystem;

    fn system(&self) -> &DynSystem {
        self.task.system()
    }

    fn horizon(&self) -> usize {
        self.task.horizon()
    }

    fn param_dim(&self) -> usize {
        self.task.param_dim()
    }

    fn start(&self, rng: &mut Rng, start: Start<'_>) {
        self.task.start(rng, start);
    }

    fn control_bounds(&self) -> Option<Vec<[f64; 2]>> {
        self.task.control_bounds()
    }

    fn observation_dim(&self) -> Option<usize> {
        self.observe.as_ref().map_or_else(|| self.task.observation_dim(), |y| Some(y.len()))
    }

    fn observe<T: Scalar>(&self, inputs: Inputs<'_, T>, y: &mut [T]) {
        match &self.observe {
            Some(function) => {
                let Inputs { x, p, t, .. } = inputs;
                function.eval([x, &[], p, &[], &self.time(t)], y);
            }
            None => self.task.observe(inputs, y),
        }
    }

    fn observe_vjp<R: Real, C: Cotangent<R>>(
        &self,
        inputs: Inputs<'_, R>,
        y_bar: &[C],
        cotangents: Cotangents<'_, C>,
    ) {
        match &self.observe {
            Some(function) => {
                let Inputs { x, p, t, .. } = inputs;
                let lists = [x, &[], p, &[], &self.time(t)];
                function.vjp(lists, y_bar, [cotangents.x, None, cotangents.p, None]);
            }
            None => self.task.observe_vjp(inputs, y_bar, cotangents),
        }
    }

    fn running_cost<T: Scalar>(&self, inputs: Inputs<'_, T>, next: &[T]) -> T {
        if self.keeps_costs() {
            return self.task.running_cost(inputs, next);
        }
        let mut cost = [T::zero()];
        if let Some(function) = &self.running {
            let Inputs { x, u, p, t } = inputs;
            function.eval([x, u, p, next, &self.time(t)], &mut cost);
        }
        cost[0]
    }

    fn terminal_cost<T: Scalar>(&self, x: &[T], p: &[T]) -> T {
        if self.keeps_costs() {
            return self.task.terminal_cost(x, p);
        }
        let mut cost = [T::zero()];
        if let Some(function) = &self.terminal {
            function.eval([x, &[], p, &[], &[]], &mut cost);
        }
        cost[0]
    }

    fn running_cost_gradient<R: Real>(
        &self,
        inputs: Inputs<'_, R>,
        next: &[R],
        cotangents: Cotangents<'_, R>,
        next_bar: &mut [R],
    ) {
        if self.keeps_costs() {
            return self.task.running_cost_gradient(inputs, next, cotangents, next_bar);
        }
        if let Some(function) = &self.running {
            let Inputs { x, u, p, t } = inputs;
            let [x_bar, u_bar, p_bar] = cotangents.lists();
            let lists = [x, u, p, next, &self.time(t)];
            function.vjp(lists, &[R::one()], [x_bar, u_bar, p_bar, Some(next_bar)]);
        }
    }

    fn terminal_cost_gradient<R: Real>(
        &self,
        x: &[R],
        p: &[R],
        x_bar: &mut [R],
        p_bar: Option<&mut [R]>,
    ) {
        if self.keeps_costs() {
            return self.task.terminal_cost_gradient(x, p, x_bar, p_bar);
        }
        if let Some(function) = &self.terminal {
            let lists = [x, &[], p, &[], &[]];
            function.vjp(lists, &[R::one()], [Some(x_bar), None, p_bar, None]);
        }
    }
}
