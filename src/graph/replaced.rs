//! [`Replaced`]: a task whose observation or costs are expressions.

use super::equations::EquationError;
use super::parts::Parts;
use super::quantities::{Quantities, RecordedQuantities};
use super::reader::{Reader, Vocabulary};
use crate::dynamics::dyn_task::{DynSystem, DynTask};
use crate::dynamics::forward::forward;
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
    /// Condition of the state that ends an episode, for example `z < 0.7`. Later costs are 0.
    #[serde(default, skip_serializing_if = "String::is_empty")]
    pub end: String,
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
    parts: Parts,
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
        Self::read(task, names, replacement, &())
    }

    /// As [`new`](Self::new), with further names for numbers that the task computes from a state.
    ///
    /// # Errors
    /// An expression does not fit.
    pub fn with_quantities(
        task: DynTask,
        names: Names,
        replacement: &Replacement,
        quantities: &impl Quantities,
    ) -> Result<Self, EquationError> {
        Self::read(task, names, replacement, quantities)
    }

    fn read(
        task: DynTask,
        names: Names,
        replacement: &Replacement,
        quantities: &dyn RecordedQuantities,
    ) -> Result<Self, EquationError> {
        let Names { states, controls, params, dt } = names;
        let define = &replacement.define;
        if *replacement == (Replacement { define: define.clone(), ..Replacement::default() }) {
            let what = "has no effect; write `observe`, `running`, `terminal` or `end` too";
            return Err(EquationError::new("define", what));
        }
        let vocabulary = Vocabulary {
            states,
            controls,
            params,
            tables: vec![],
            constants: vec![],
            dt,
            define,
            quantities,
        };
        let mut reader = Reader::new(vocabulary)?;
        let parts = Parts {
            observe: reader.observation("observe", &replacement.observe)?.map(Arc::new),
            running: reader.running_cost("running", &replacement.running)?.map(Arc::new),
            margin: reader.margin("end", &replacement.end)?.map(Arc::new),
            terminal: reader.terminal_cost("terminal", &replacement.terminal)?.map(Arc::new),
        };
        Ok(Self { task, parts, dt })
    }

    fn keeps_costs(&self) -> bool {
        self.parts.running.is_none() && self.parts.terminal.is_none()
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

    forward!(Task of task: horizon, param_dim, control_bounds);

    fn start(&self, rng: &mut Rng, start: Start<'_>) {
        self.task.start(rng, start);
    }

    fn can_end(&self) -> bool {
        self.parts.margin.is_some() || self.task.can_end()
    }

    fn margin<T: Scalar>(&self, x: &[T], p: &[T]) -> T {
        match self.parts.margin {
            Some(_) => self.parts.margin(x, p),
            None => self.task.margin(x, p),
        }
    }

    fn observation_dim(&self) -> Option<usize> {
        self.parts.observations().or_else(|| self.task.observation_dim())
    }

    fn observe<T: Scalar>(&self, inputs: Inputs<'_, T>, y: &mut [T]) {
        if !self.parts.observe(inputs, &self.time(inputs.t), y) {
            self.task.observe(inputs, y);
        }
    }

    fn observe_vjp<R: Real, C: Cotangent<R>>(
        &self,
        inputs: Inputs<'_, R>,
        y_bar: &[C],
        mut cotangents: Cotangents<'_, C>,
    ) {
        if !self.parts.observe_vjp(inputs, &self.time(inputs.t), y_bar, &mut cotangents) {
            self.task.observe_vjp(inputs, y_bar, cotangents);
        }
    }

    fn running_cost<T: Scalar>(&self, inputs: Inputs<'_, T>, next: &[T]) -> T {
        if self.keeps_costs() {
            self.task.running_cost(inputs, next)
        } else {
            self.parts.running_cost(inputs, next, &self.time(inputs.t))
        }
    }

    fn terminal_cost<T: Scalar>(&self, x: &[T], p: &[T]) -> T {
        if self.keeps_costs() {
            self.task.terminal_cost(x, p)
        } else {
            self.parts.terminal_cost(x, p)
        }
    }

    fn running_cost_gradient<R: Real>(
        &self,
        inputs: Inputs<'_, R>,
        next: &[R],
        cotangents: Cotangents<'_, R>,
        next_bar: &mut [R],
    ) {
        if self.keeps_costs() {
            self.task.running_cost_gradient(inputs, next, cotangents, next_bar);
        } else {
            let time = self.time(inputs.t);
            self.parts.running_cost_gradient(inputs, next, &time, cotangents, next_bar);
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
            self.task.terminal_cost_gradient(x, p, x_bar, p_bar);
        } else {
            self.parts.terminal_cost_gradient(x, p, x_bar, p_bar);
        }
    }
}
